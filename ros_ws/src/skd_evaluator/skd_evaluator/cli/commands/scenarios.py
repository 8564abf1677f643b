"""`skd scenarios`: those that have a name, one of them, a file of one's own; with a picture each."""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from skd_sim.errors import AssessmentError, UsageError

from skd_evaluator.cli.arguments import Parser, result_folder, speeds
from skd_evaluator.cli.output import finish
from skd_evaluator.files import check_file, write_file

if TYPE_CHECKING:
    from skd_sim.scenario.scenario import Scenario

_KMH = 3.6
_ACTIONS = "list", "show", "check", "campaign"
_CAMPAIGN = """\
# {names} at {speeds} km/h
defaults:
  safe: regulatory
  kamikaze_count: 20
  objective: deviation
scenarios:
{scenarios}
sweep:
  scenario.car.start_speed: [{metres}] # m/s
"""


def add(parser: Parser) -> None:
    """List scenarios, show one, check a file of your own.

    list: scenarios that have a name. show: what happens in some, with a picture each. check: the same of files of your
    own. campaign: the file of a campaign at several test speeds.
    """
    parser.set_defaults(group="look")
    text = f"what to do: {', '.join(_ACTIONS)} (default: list)"
    parser.add_value("action", text, metavar="ACTION", nargs="?", default="list")
    parser.add_value("names", "names or files of scenarios", nargs="*", metavar="NAME")
    text = "with campaign, test speeds of the car, km/h, as 10:60:10"
    parser.add_value("--speeds", text, type=speeds, metavar="FROM:TO:STEP")
    text = "folder for the pictures, or with campaign the file to write (default: skd_results/scenarios-<time>)"
    parser.add_output("PATH", text)


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    from skd_sim.scenario.scenario import load_scenario
    from skd_sim.scenario.scenario_file import SCENARIOS

    if arguments.action not in _ACTIONS:
        known = f"give {', '.join(_ACTIONS)}; did you mean skd scenarios show {arguments.action}?"
        raise UsageError(f"unknown action {arguments.action!r}: {known}")
    if arguments.action == "list":
        if arguments.names:
            raise UsageError("skd scenarios list takes no names; skd scenarios show does")
        every = [load_scenario(name) for name in SCENARIOS.names()]
        return _list(arguments, every) if arguments.out is None else _show(arguments, every)
    if not arguments.names:
        what = "a file" if arguments.action == "check" else "a name, as cpna or cpna-75"
        raise UsageError(f"skd scenarios {arguments.action} needs {what}")
    if arguments.action == "campaign":
        return _campaign(arguments)
    if arguments.speeds:
        raise UsageError("--speeds goes with skd scenarios campaign")
    return _show(arguments, [load_scenario(name) for name in arguments.names])


def _list(arguments: argparse.Namespace, scenarios: Sequence[Scenario]) -> int:
    from rich.markup import escape

    from skd_evaluator.report.formats import places_of, scenario_data
    from skd_evaluator.report.terminal import narrow_table, print_table

    rows = [
        (
            one.name,
            one.adversary.kind,
            f"{_KMH * one.car.start_speed:.0f}",
            " ".join(f"{place:g}" for place in places_of(one)) or "–",
            escape(one.description),
        )
        for one in scenarios
    ]
    heads = ("name", "adversary", "km/h", "impact places (%)", "what happens")
    table = narrow_table("Scenarios; with an impact place after a dash, as cpna-75", heads, rows)
    content = {"scenarios": [scenario_data(one, _unknown(one)) for one in scenarios]}
    return finish(arguments, content, lambda: print_table(table))


def _show(arguments: argparse.Namespace, scenarios: Sequence[Scenario]) -> int:
    from skd_adversary.crossing.road_users import check_kind
    from skd_adversary.safe_trajectories.sources import load_safe_trajectories
    from skd_sim.scenario.scenario_file import REGULATORY

    from skd_evaluator.assessment.files.result_folder import write_json
    from skd_evaluator.report.formats import scenario_data, scenario_lines
    from skd_evaluator.report.pictures import save_scenario

    trajectories = []
    for one in scenarios:  # all checks that an assessment makes before any work
        check_kind(one)
        count = 0 if one.protocol is None else len(one.protocol.impact_places)
        trajectories.append(load_safe_trajectories(REGULATORY, one, count) if count else [])
    known = [_unknown(one) for one in scenarios]
    names = [f"{one.name}.png" for one in scenarios]
    if len(set(names)) < len(names):
        raise UsageError("two of these scenarios have one name; give one of them at a time")
    entries = [
        {**scenario_data(one, why), "picture": name} for one, why, name in zip(scenarios, known, names, strict=True)
    ]
    out = result_folder(arguments)

    def write(folder: Path) -> None:
        for one, drawn, name in zip(scenarios, trajectories, names, strict=True):
            save_scenario(folder / name, one, drawn)
        write_json(folder / "scenarios.json", {"scenarios": entries})

    def show() -> None:
        for one, why, name in zip(scenarios, known, names, strict=True):
            print("\n".join(scenario_lines(one, why)))
            print(f"  picture: {out.path / name}")

    out.write(write)
    return finish(arguments, {"scenarios": entries}, show)


def _unknown(scenario: Scenario) -> str | None:
    """Return why the basic car's margin is not exact in a scenario, in a few words; None where it is."""
    from skd_evaluator.assessment.plan import Plan
    from skd_evaluator.margin.basic_margins import unknown_for

    return unknown_for(Plan(scenario)) or None


def _campaign(arguments: argparse.Namespace) -> int:
    """Print a campaign's file, or write it."""
    from skd_adversary.safe_trajectories.sources import count_safe_trajectories
    from skd_sim.inputs.yaml_file import as_yaml
    from skd_sim.scenario.scenario import changed_scenario
    from skd_sim.scenario.scenario_file import REGULATORY

    from skd_evaluator.assessment.from_options import inputs_of, refuse_to_replace

    if not arguments.speeds:
        raise UsageError("skd scenarios campaign needs --speeds, as 10:60:10")
    for name in arguments.names:
        for speed in arguments.speeds:
            count_safe_trajectories(REGULATORY, changed_scenario(name, {"car.start_speed": speed / _KMH}))
    names = [as_yaml(_as_named(name, arguments.out)) for name in arguments.names]
    text = _CAMPAIGN.format(
        names=", ".join(names),
        speeds=", ".join(f"{speed:g}" for speed in arguments.speeds),
        scenarios="\n".join(f"  - scenario: {name}" for name in names),
        metres=", ".join(repr(speed / _KMH) for speed in arguments.speeds),
    )
    if arguments.out is None:
        print(text, end="")
        return 0
    check_file(arguments.out, "--out", overwrite=arguments.overwrite)
    refuse_to_replace(arguments.out, inputs_of(vars(arguments)))
    try:
        write_file(arguments.out, text, overwrite=arguments.overwrite)
    except OSError as error:
        raise AssessmentError(f"--out {arguments.out}: nothing was written: {error.strerror}") from error
    print(f"campaign in {arguments.out}; skd campaign {arguments.out} runs it")
    return 0


def _as_named(name: str, campaign: Path | None) -> str:
    """Return how a campaign's file names a scenario: a file by the way to it from where the campaign is."""
    from skd_sim.scenario.scenario_file import SCENARIOS, is_named

    if campaign is None or name in SCENARIOS.own or not Path(name).is_file():
        return name
    found = os.path.relpath(Path(name).absolute(), campaign.absolute().parent)
    return f"./{found}" if is_named(found) else found
