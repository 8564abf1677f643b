"""The options of `skd ncap`; light, for help reads them."""

from __future__ import annotations

from skd_evaluator.assessment.options import AssessmentOptions
from skd_evaluator.cli.arguments import (
    CAR_GROUP,
    add_options,
    add_output_arguments,
    add_runner_arguments,
    steps_of,
)
from skd_evaluator.cli.parser import Parser
from skd_evaluator.extensions.ncap.matrices import known_scenarios

SCENARIOS = "cpna,cpfa,cpnco"
TRIALS = 5


def add_ncap(parser: Parser) -> None:
    """Run a regulator's tests: colours of Euro NCAP 2026, and the margin of each.

    Run the static tests of Euro NCAP 2026, test speeds × impact places, in which the target does what the protocol
    prescribes. Each cell has the impact speed, its colour, and the safety margin. So a test that is passed with little
    room stands out. This is not an official rating (docs/campaigns.md).
    """
    parser.set_defaults(group="rate", module="skd_evaluator.extensions.ncap.command")
    tests = parser.add_argument_group(CAR_GROUP)
    cars = "the car under test: basic, cal, carla, a registered name, file.py:Class or package.module:Class"
    add_options(tests, "ncap", CAR_GROUP, controller={"help": f"{cars} (default: basic)"})
    text = "scenarios with impact places, names or files, with commas in between (default: %(default)s)"
    scenarios = tests.add_argument("--scenarios", default=SCENARIOS, metavar="LIST", help=text)
    scenarios.names = known_scenarios  # type: ignore[attr-defined]  # which a shell completes
    text = "test speeds of the car, km/h, as 10:60:10 (default: those of each scenario's matrix)"
    tests.add_argument("--speeds", type=steps_of("km/h", 0.0, 200.0), metavar="FROM:TO:STEP", help=text)
    margins = parser.add_argument_group("margins")
    add_options(margins, "ncap", table=AssessmentOptions)
    trials = f"how many trials there are in each cell, each with draws of its own (default: {TRIALS})"
    add_options(margins, "ncap", "campaign", kamikaze_count={"default": TRIALS, "help": trials})
    add_runner_arguments(parser)
    add_output_arguments(parser)
