"""`skd scenarios`: those that have a name, one of them, a file of one's own; with a picture each."""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from pathlib import Path

from rich.markup import escape
from skd_adversary.crossing.road_users import check_kind
from skd_adversary.safe_trajectories.sources import count_safe_trajectories, load_safe_trajectories
from skd_sim.errors import UsageError
from skd_sim.inputs.yaml_file import as_yaml
from skd_sim.scenario.scenario import Scenario, changed_scenario, load_scenario
from skd_sim.scenario.scenario_file import REGULATORY, SCENARIOS, is_named
from skd_sim.world.state import Trajectory

from skd_evaluator.assessment.files.result_folder import write_json
from skd_evaluator.assessment.from_options import inputs_of, refuse_to_replace
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.cli.arguments import result_folder
from skd_evaluator.cli.output import print_json
from skd_evaluator.errors import AssessmentError
from skd_evaluator.files import check_file, write_file
from skd_evaluator.margin.basic_margins import unknown_for
from skd_evaluator.report.episode_pictures import save_scenario
from skd_evaluator.report.formats import places_of, scenario_data, scenario_lines
from skd_evaluator.report.terminal import narrow_table, print_table

_KMH = 3.6


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    if arguments.action == "list":
        if arguments.names:
            raise UsageError("skd scenarios list takes no names; skd scenarios show does")
        return _list(arguments)
    if not arguments.names:
        what = "a file" if arguments.action == "check" else "a name, as cpna or cpna-75"
        raise UsageError(f"skd scenarios {arguments.action} needs {what}")
    if arguments.action == "campaign":
        return _campaign(arguments)
    if arguments.speeds:
        raise UsageError("--speeds goes with skd scenarios campaign")
    return _show(arguments, [load_scenario(name) for name in arguments.names])


def _list(arguments: argparse.Namespace) -> int:
    scenarios = [load_scenario(name) for name in SCENARIOS.names()]
    if arguments.out is not None:
        return _show(arguments, scenarios)
    if arguments.json:
        print_json({"scenarios": [scenario_data(one, _unknown(one)) for one in scenarios]})
        return 0
    table = narrow_table("Scenarios; with an impact place after a dash, as cpna-75")
    for name in ("name", "adversary"):
        table.add_column(name)
    table.add_column("km/h", justify="right")
    table.add_column("impact places (%)", overflow="fold")
    table.add_column("what happens", overflow="fold")
    for one in scenarios:
        places = " ".join(f"{place:g}" for place in places_of(one)) or "–"
        speed = f"{_KMH * one.car.start_speed:.0f}"
        table.add_row(one.name, one.adversary.kind, speed, places, escape(one.description))
    print_table(table)
    return 0


def _show(arguments: argparse.Namespace, scenarios: Sequence[Scenario]) -> int:
    ways = [_ways(one) for one in scenarios]
    known = [_unknown(one) for one in scenarios]
    names = [f"{one.name}.png" for one in scenarios]
    if len(set(names)) < len(names):
        raise UsageError("two of these scenarios have one name; give one of them at a time")
    entries = [
        {**scenario_data(one, why), "picture": name} for one, why, name in zip(scenarios, known, names, strict=True)
    ]
    out = result_folder(arguments)

    def write(folder: Path) -> None:
        for one, drawn, name in zip(scenarios, ways, names, strict=True):
            save_scenario(folder / name, one, drawn)
        write_json(folder / "scenarios.json", {"scenarios": entries})

    out.write(write)
    if arguments.json:
        print_json({"scenarios": entries})
        return 0
    for one, why, name in zip(scenarios, known, names, strict=True):
        print("\n".join(scenario_lines(one, why)))
        print(f"  picture: {out.path / name}")
    return 0


def _ways(scenario: Scenario) -> list[Trajectory]:
    """Return the ways of a scenario's protocol, after all checks that an assessment makes before any work."""
    check_kind(scenario)
    if scenario.protocol is None:
        return []
    return load_safe_trajectories(REGULATORY, scenario, len(scenario.protocol.impact_places))


def _unknown(scenario: Scenario) -> str | None:
    return unknown_for(Plan(scenario))


def _campaign(arguments: argparse.Namespace) -> int:
    """Print a campaign's file, or write it."""
    if not arguments.speeds:
        raise UsageError("skd scenarios campaign needs --speeds, as 10:60:10")
    for name in arguments.names:
        for speed in arguments.speeds:
            count_safe_trajectories(REGULATORY, changed_scenario(name, {"car.start_speed": speed / _KMH}))
    names = [_as_named(name, arguments.out) for name in arguments.names]
    text = "\n".join(_campaign_lines(names, arguments.speeds)) + "\n"
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
    if campaign is None or name in SCENARIOS.own or not Path(name).is_file():
        return name
    found = os.path.relpath(Path(name).absolute(), campaign.absolute().parent)
    return f"./{found}" if is_named(found) else found


def _campaign_lines(names: Sequence[str], speeds: Sequence[float]) -> list[str]:
    metres = ", ".join(repr(speed / _KMH) for speed in speeds)
    return [
        f"# {', '.join(map(as_yaml, names))} at {', '.join(f'{speed:g}' for speed in speeds)} km/h",
        "defaults:",
        "  safe: regulatory",
        "  kamikaze_count: 20",
        "  objective: deviation",
        "scenarios:",
        *(f"  - scenario: {as_yaml(name)}" for name in names),
        "sweep:",
        f"  scenario.car.start_speed: [{metres}] # m/s",
    ]
