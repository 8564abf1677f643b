"""The options of `skd ncap`; light, for help reads them."""

from __future__ import annotations

from typing import Any

from skd_evaluator.assessment.options import AssessmentOptions
from skd_evaluator.cli.arguments import (
    CAR_GROUP,
    add_options,
    add_output_arguments,
    add_runner_arguments,
    steps_of,
)
from skd_evaluator.extensions.ncap.matrices import known_scenarios

SCENARIOS = "cpna,cpfa,cpnco"
TRIALS = 5


def add_ncap(commands: Any) -> None:
    """Add `skd ncap` to a parser's commands."""
    ncap = commands.add_parser(
        "ncap",
        help="run a regulator's tests: colours of Euro NCAP 2026, and the margin of each",
        description="Run the static tests of Euro NCAP 2026, test speeds × impact places, in which the target does "
        "what the protocol prescribes. Each cell has the impact speed, its colour, and the safety margin. So a test "
        "that is passed with little room stands out. This is not an official rating (docs/campaigns.md).",
    )
    tests = ncap.add_argument_group(CAR_GROUP)
    without = "the car under test: basic, cal, carla, a registered name, file.py:Class or package.module:Class"
    add_options(tests, "ncap", CAR_GROUP, controller={"help": f"{without} (default: basic)"})
    scenarios = tests.add_argument(
        "--scenarios",
        default=SCENARIOS,
        metavar="LIST",
        help="scenarios with impact places, names or files, with commas in between (default: %(default)s)",
    )
    scenarios.names = known_scenarios  # which a shell completes
    tests.add_argument(
        "--speeds",
        type=steps_of("km/h", 0.0, 200.0),
        metavar="FROM:TO:STEP",
        help="test speeds of the car, km/h, as 10:60:10 (default: those of each scenario's matrix)",
    )
    margins = ncap.add_argument_group("margins")
    add_options(margins, "ncap", table=AssessmentOptions)
    trials = f"how many trials there are in each cell, each with draws of its own (default: {TRIALS})"
    add_options(margins, "ncap", "campaign", kamikaze_count={"default": TRIALS, "help": trials})
    add_runner_arguments(ncap)
    add_output_arguments(ncap)
    ncap.set_defaults(module="skd_evaluator.extensions.ncap.command")
