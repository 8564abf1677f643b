"""The options of `skd campaign`; light, for help reads them."""

from __future__ import annotations

from pathlib import Path

from skd_evaluator.cli.arguments import (
    add_flag,
    add_max_aborted_argument,
    add_output_arguments,
    add_runner_arguments,
    add_value,
)
from skd_evaluator.cli.parser import Parser


def add_campaign(parser: Parser) -> None:
    """Rate many cars in many scenarios from one file; can be resumed.

    Rate many cars, in many scenarios, with many seeds and values of any key, all described in one YAML file. Every
    episode is stored as soon as it has run: whatever ends a campaign, --resume goes on with it.
    """
    parser.set_defaults(group="rate", module="skd_evaluator.extensions.campaign.command")
    add_value(parser, "path", "YAML file that says what to rate (see docs/campaigns.md)", type=Path, metavar="FILE")
    add_flag(parser, "--resume", "go on with the campaign in --out, or begin it if there is none")
    add_flag(parser, "--dry-run", "only say which assessments there would be, and of how many episodes")
    add_runner_arguments(parser)
    add_max_aborted_argument(parser)
    add_output_arguments(parser)
