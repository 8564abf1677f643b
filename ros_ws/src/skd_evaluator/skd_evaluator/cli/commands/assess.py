"""`skd assess`: the safety margin, nominal collision rate and risk of one car."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from skd_sim.errors import UsageError
from skd_sim.options.car_and_adversary import CarUnderTest

from skd_evaluator.cli.arguments import DETAILS, Parser, parameters_of, positive_number, rare
from skd_evaluator.cli.gate import add_gate_arguments, gate_of
from skd_evaluator.cli.main import make_parser, parse
from skd_evaluator.files import UNFINISHED, is_unfinished, unfinished


def add(parser: Parser) -> None:
    """Rate one car: its safety margin, nominal collision rate and risk.

    Rate one car. Pedestrians cross on safe trajectories φ. The safety margin is the least deviation from φ with which
    the moving car hits. Kamikazes are pedestrians that plan to be hit with what they know: their distance from φ is the
    Safe-Kamikaze Distance (SKD).
    """
    parser.set_defaults(group="rate")
    parser.add_car()
    parser.add_graph(record=True)
    output = parser.add_campaign()
    add_gate_arguments(parser)
    text = "go on with the interrupted assessment in DIR, or in --out; its options need not be repeated"
    output.add_argument("--resume", nargs="?", const="", metavar="DIR", help=text)
    parser.set_defaults(read_parameters=_given_elsewhere)
    output.add_flag("--details", DETAILS)
    output.add_flag("--no-pictures", rare("draw no pictures, which saves about a second"))
    text = "add --safe-count trajectories at a time, at most 10 times, until the planned deviation's interval is W wide"
    parser.add_value("--until-width", rare(text), type=positive_number, metavar="W")


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    gate = gate_of(arguments)
    with gate.watch(CarUnderTest(arguments.controller, arguments.multiplier, arguments.name).label):
        from skd_evaluator.cli.assessment import run_assessment  # it takes time to import

        return run_assessment(arguments, gate)


def _given_elsewhere(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return options by name that are not on the command line: of -p, of a file, of what --resume goes on with.

    Raises:
        UsageError: there is nothing to go on with, or it was begun elsewhere.
    """
    given = parameters_of(arguments)
    if arguments.resume is None:
        return given
    from skd_evaluator.assessment.files.episode_store import EpisodeStore

    out = _to_resume(arguments)
    store = EpisodeStore(unfinished(out))
    begun = store.about()
    store.close()
    if (folder := begun.get("folder", "")) != str(Path.cwd()):
        raise UsageError(f"--resume: {out} was begun in {folder}; go on with it there")
    words = ["assess", *begun["words"]]
    kept = vars(parse(make_parser(words), words))
    repeated = [name for name, value in vars(arguments).items() if value and isinstance(value, list)]
    for name in ("resume", "param", "params_file", *repeated):
        kept.pop(name, None)
    return {**kept, **given, "out": out, "begun": words}


def _to_resume(arguments: argparse.Namespace) -> Path:
    """Return the folder of the assessment that --resume goes on with."""
    if arguments.resume and arguments.out not in (None, Path(arguments.resume)):
        raise UsageError(f"--resume {arguments.resume} --out {arguments.out}: give one of them")
    if not (named := arguments.resume or arguments.out):
        found = [str(path).removesuffix(UNFINISHED) for path in sorted(Path("skd_results").glob(f"*{UNFINISHED}"))]
        if len(found) > 1:
            raise UsageError(f"--resume: several were interrupted; name one: {', '.join(found[:5])}")
        if not found:
            raise UsageError("--resume: nothing in skd_results was interrupted; name its folder")
        return Path(found[0])
    out = Path(named)
    if not is_unfinished(out):
        complete = (out / "assessment.json").is_file() and not arguments.overwrite
        why = "it is complete" if complete else "no interrupted assessment is kept"
        raise UsageError(f"--resume: nothing to go on with in {out}: {why}")
    return out
