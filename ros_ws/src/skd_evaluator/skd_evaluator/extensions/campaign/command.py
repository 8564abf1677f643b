"""`skd campaign`: many assessments from one file, stored episode by episode."""

from __future__ import annotations

import argparse
from pathlib import Path

from skd_evaluator.cli.arguments import Parser
from skd_evaluator.cli.gate import add_limits


def add_campaign(parser: Parser) -> None:
    """Rate many cars in many scenarios from one file; can be resumed.

    Rate many cars, in many scenarios, with many seeds and values of any key, all described in one YAML file. Every
    episode is stored as soon as it has run: whatever ends a campaign, --resume goes on with it.
    """
    parser.set_defaults(group="rate")
    parser.add_value("path", "YAML file that says what to rate (see docs/campaigns.md)", type=Path, metavar="FILE")
    parser.add_flag("--resume", "go on with the campaign in --out, or begin it if there is none")
    parser.add_flag("--dry-run", "only say which assessments there would be, and of how many episodes")
    parser.add_runner()
    parser.add_max_aborted()
    add_limits(parser)
    parser.add_output()


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    from skd_evaluator.extensions.campaign.results import run_campaign

    return run_campaign(arguments)
