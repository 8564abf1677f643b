"""The options of `skd campaign`; light, for help reads them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from skd_evaluator.cli.arguments import (
    add_max_aborted_argument,
    add_output_arguments,
    add_runner_arguments,
)


def add_campaign(commands: Any) -> None:
    """Add `skd campaign` to a parser's commands."""
    campaign = commands.add_parser(
        "campaign",
        help="rate many cars in many scenarios from one file; can be resumed",
        description="Rate many cars, in many scenarios, with many seeds and values of any key, all described in one "
        "YAML file. Every episode is stored as soon as it has run: whatever ends a campaign, --resume goes on with it.",
    )
    campaign.add_argument(
        "path", type=Path, metavar="FILE", help="YAML file that says what to rate (see docs/campaigns.md)"
    )
    campaign.add_argument(
        "--resume", action="store_true", help="go on with the campaign in --out, or begin it if there is none"
    )
    campaign.add_argument(
        "--dry-run", action="store_true", help="only say which assessments there would be, and of how many episodes"
    )
    add_runner_arguments(campaign)
    add_max_aborted_argument(campaign)
    add_output_arguments(campaign)
    campaign.set_defaults(module="skd_evaluator.extensions.campaign.command")
