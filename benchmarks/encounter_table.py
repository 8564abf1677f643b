"""Every encounter that has a name × cars: what kamikazes reach, how often φ itself is hit, and whether all is in order.

Cars: the basic one at C = 0.75, 1 and 1.25; the same as a multi-body car; beside people on foot CAL, the agent of CARLA
0.8 and highway-env's driver (examples/idm, where that library is installed); beside whoever comes as a box three brakes
of known order that look at the car's own strip (cars/triggers.py). Each on the φ of the encounter's protocol, or, where
it has none, on synthetic ones; with fewer φ there are more attempts on each, so that all rows have as many. An attempt
without a hit counts as η_max. Intervals are normal ones over attempts, φ given. Each episode is held against the limits
of its road user by an oracle of its own (road_user_limits.py).

Of the first attempts on each φ also the margin, exact where it can be, else found by search: closeness is the planned
deformation of these attempts over it. With --graph two kamikazes and two runs along φ of the first row of each
encounter and of every row of a driver that others have written also run through the node graph, are recorded, and are
compared with those in process to the last bit.

    .venv/bin/python benchmarks/encounter_table.py --graph --out encounter_table.json
    .venv/bin/python benchmarks/encounter_table.py --encounters cpna cpfa --cars C=1 --attempts 20
    .venv/bin/python benchmarks/encounter_table.py --encounters benchmarks/encounters/*.yaml

FILE keeps the rows; the same command goes on from there, and prints all of them. `--most-minutes` begins no further row
after so much processor time.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import os
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from cars.triggers import TRIGGERS
from encounter_rows import closeness_lines, line, order_lines, table_head
from kept_rows import KeptRows, Row, add_table_options
from road_user_limits import beyond
from skd_adversary.safe_trajectories import REGULATORY
from skd_evaluator.assessing.graph_options import GraphOptions
from skd_evaluator.assessing.pipeline import planners_of
from skd_evaluator.bags.reader import read_episodes
from skd_evaluator.campaign.plan.plan import Plan, collision_runs, safe_trajectories
from skd_evaluator.campaign.run.workers import InProcessRunner
from skd_evaluator.cli.arguments import whole_number
from skd_evaluator.margin.assessment_margin import least_ways, why_no_margin, with_planned_hits
from skd_evaluator.measure.distances.deformation import deformation
from skd_evaluator.measure.margins import Margins
from skd_evaluator.measure.statistics.statistics import normal_interval
from skd_evaluator.ros.session import graph_session, prepare_ros
from skd_sim.choices.knowledge import Knowledge
from skd_sim.choices.objective import Objective
from skd_sim.controllers import control_period_of, make_controller, with_control_period
from skd_sim.encounter.scenario import Scenario, load_scenario
from skd_sim.episode.episode import EpisodeLog, Mode, Outcome
from skd_sim.errors import UsageError
from skd_sim.geometry.trajectory import Trajectory

CARS: Mapping[str, Mapping[str, Any]] = {
    "C=0.75": {"multiplier": 0.75},
    "C=1": {"multiplier": 1.0},
    "C=1.25": {"multiplier": 1.25},
    "multi-body C=1": {"multiplier": 1.0},
    "cal": {"controller": "cal", "knowledge": Knowledge.NOTHING},
    **{name: {"controller": where, "knowledge": Knowledge.NOTHING} for name, where in TRIGGERS.items()},
    "carla": {"controller": "carla", "knowledge": Knowledge.NOTHING},
    "highway-env": {"controller": "highway_idm:HighwayIdm", "knowledge": Knowledge.NOTHING},
}
FOR_PEOPLE = {"cal": "CAL knows", "carla": "CARLA's agent looks for", "highway-env": "highway-env's driver follows"}
EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
THIRD_PARTY = ("carla", "highway-env")
"""Cars whose drivers others have written; their rows, too, are compared with the graph."""
ON_FOOT = ("pedestrian", "runner", "child")
OF_THE_PAPER = ("crossing", "citr_crossing", "crossing_multi_body")
_ROUNDING = 1e-6


def plan_for(name: str, car: str, arguments: argparse.Namespace) -> Plan | str:
    """Return the plan of a row, or why there is none."""
    scenario = load_scenario(name)
    on_foot = scenario.adversary.kind in ON_FOOT
    if car.startswith("multi-body"):
        if not scenario.road.straight:
            return "the multi-body car does not steer"
        body = load_scenario("crossing_multi_body").car
        kept = ("start_speed", "start_gap", "start_gap_range", "meet_safe_trajectory")
        held = {key: getattr(scenario.car, key) for key in kept}
        scenario = dataclasses.replace(scenario, car=dataclasses.replace(body, **held))
    if car in FOR_PEOPLE and not (on_foot and scenario.road.straight):
        return f"{FOR_PEOPLE[car]} people on foot, on straight roads"
    if car in TRIGGERS and (on_foot or not scenario.road.straight):
        return "for boxes, on straight roads"
    chosen = CARS[car]
    if "controller" in chosen:
        named = chosen["controller"]
        scenario = with_control_period(scenario, control_period_of(make_controller(named, 1.0), named), named)
    protocol = scenario.protocol
    count = arguments.safe if protocol is None else min(arguments.safe, len(protocol.impact_places))
    return Plan(
        scenario,
        safe="synthetic" if protocol is None else REGULATORY,
        safe_count=count,
        kamikaze_count=math.ceil(arguments.attempts / count),
        collision_runs=arguments.runs,
        objective=Objective.DEFORMATION,
        simulations=arguments.paper_simulations if name in OF_THE_PAPER else arguments.simulations,
        **chosen,
    )


def excess(scenario: Scenario, phi: Trajectory, way: np.ndarray) -> float:
    """Return by how much the worst step of a way is beyond what its road user can do, m/s² or rad.

    The paper's pedestrian changes its velocity as it likes: of it no step is faster than its speed, or than φ (m/s).
    """
    adversary, step = scenario.adversary, scenario.time_step
    if adversary.kind == "pedestrian":
        most = max(adversary.speed, float(np.hypot(*np.diff(phi.positions, axis=0).T).max(initial=0.0)) / step)
        return float(np.hypot(*np.diff(way, axis=0).T).max(initial=0.0)) / step - most
    return beyond(adversary.kind, phi.positions, way, step, adversary.first_heading)


def row_of(plan: Plan, arguments: argparse.Namespace) -> tuple[dict[str, Any], list[EpisodeLog]]:
    """Run one row; return it, and the episodes that are compared with the graph."""
    begin = time.perf_counter()
    with InProcessRunner(arguments.workers, isolated=not plan.car.is_own) as runner:
        runner.start(planners_of(plan, [Objective.DEFORMATION]))
        safe = safe_trajectories(plan, runner)
        tried = range(plan.kamikaze_count)
        episodes = [plan.episode(Mode.KAMIKAZE, index, n, phi) for index, phi in enumerate(safe) for n in tried]
        logs = list(runner.run(episodes))
        along = collision_runs(plan, safe, runner)
        strayed = np.array([deformation_of(log) for log in logs])
        seconds = time.perf_counter() - begin
        found: dict[str, Any] = {
            "φ": len(safe),
            "attempts": len(logs),
            "simulations": plan.simulations,
            "eta_max": plan.scenario.eta_max,
            "deformation": float(strayed.mean()),
            "ci95": normal_interval(strayed),
            "success": float(np.mean([log.hit for log in logs])),
            "hits along φ": float(np.mean([log.hit for log in along])),
            "runs along φ": len(along),
            "impact speeds": _impact_speeds(logs),
            "episodes": len(logs) + len(along),
            **_limits(plan.scenario, logs, along),
            "aborted": sum(log.outcome == Outcome.ABORTED for log in (*logs, *along)),
            "seconds": seconds,
        }
        found |= _closeness(plan, logs, strayed, runner, arguments)
    return found, [*logs[:2], *along[:2]]


def deformation_of(log: EpisodeLog) -> float:
    """Return the deformation of an attempt, m; η_max where it did not hit."""
    eta_max, phi = log.episode.scenario.eta_max, log.episode.safe_trajectory
    if not log.hit or phi is None:
        return eta_max
    ticks = log.impact_time / log.episode.scenario.time_step
    return min(eta_max, deformation(phi.positions, log.trajectory.positions, ticks))


def _impact_speeds(logs: Sequence[EpisodeLog]) -> dict[str, float] | None:
    """Return mean, 10 and 90 % quantile of the car's speed where it hit a kamikaze, m/s."""
    speeds = [log.impact_speed for log in logs if log.hit]
    if not speeds:
        return None
    low, high = np.quantile(speeds, (0.1, 0.9))
    return {"mean": float(np.mean(speeds)), "low": float(low), "high": float(high)}


def _limits(scenario: Scenario, *groups: Sequence[EpisodeLog]) -> dict[str, Any]:
    """Return in how many kamikazes the road user goes beyond its limits, and by how much the worst step does.

    Runs along φ have φ's own steps, whatever those are: it is counted how many are elsewhere than φ.
    """
    kamikazes, along = groups
    found = []
    for log in kamikazes:
        assert log.episode.safe_trajectory is not None
        if len(log.adversary) > 1:
            found.append(excess(scenario, log.episode.safe_trajectory, log.adversary))
    astray = 0
    for log in along:
        assert log.episode.safe_trajectory is not None
        path = log.episode.safe_trajectory.positions
        number = min(len(path), len(log.adversary)) - 1  # the last place may lie within a tick, at the contact
        astray += bool(np.abs(log.adversary[:number] - path[:number]).max(initial=0.0) > _ROUNDING)
    worst = max(found, default=-math.inf)
    return {"beyond limits": sum(one > _ROUNDING for one in found), "worst": worst, "astray along φ": astray}


def _closeness(
    plan: Plan, logs: Sequence[EpisodeLog], strayed: np.ndarray, runner: InProcessRunner, arguments: argparse.Namespace
) -> dict[str, Any]:
    """Return margin and closeness of the first attempts on each φ."""
    if not arguments.margins or (why_not := why_no_margin(plan, arguments.margin_limit)):
        return {"no margin": "not asked for" if not arguments.margins else why_not}
    each = plan.kamikaze_count
    kept = min(each, math.ceil(arguments.margins / (len(logs) // each)))
    chosen = [place for place in range(len(logs)) if place % each < kept]
    some = [logs[place] for place in chosen]
    episodes = [log.episode for log in some]
    starts = [[log.trajectory.positions] if log.hit else [] for log in some]
    found = least_ways(episodes, lambda: starts, runner, lambda *_told: None, arguments.margin_limit)
    by_id = {log.episode.episode_id: [log] for log in some}
    ways, _ = with_planned_hits(episodes, found.ways, by_id)
    margins = Margins((tuple(ways),), plan.scenario.eta_max, found.budget, found.converged)
    return {
        "margin": margins.mean,
        "margin attempts": len(some),
        "margin exact": found.budget is None,
        "margin converged": found.converged,
        "planned in them": float(strayed[chosen].mean()),
    }


def same_in_graph_and_recording(controller: str, logs: Sequence[EpisodeLog]) -> str:
    """Run episodes again through the graph, recorded; return how many are alike in all three, of how many."""
    with tempfile.TemporaryDirectory() as scratch:
        bags = Path(scratch) / "bags"  # one a row: the episodes of two rows have the same ids
        with graph_session(
            GraphOptions(), controller=controller, campaign="benchmark", log_folder=Path(scratch), record_to=bags
        ) as evaluator:
            through = list(evaluator.run([log.episode for log in logs]))
        recorded = [one.log for one in read_episodes([bags])]
    alike = sum(
        same(one, other) and any(same(one, third) for third in recorded)
        for one, other in zip(logs, through, strict=True)
    )
    return f"{alike}/{len(logs)}"


def same(one: EpisodeLog, other: EpisodeLog) -> bool:
    """Return whether the same happened in two episodes, to the last bit."""
    return (
        one.outcome == other.outcome
        and one.episode.scenario == other.episode.scenario
        and np.array_equal(one.adversary, other.adversary)
        and np.array_equal(one.car, other.car)
        and repr(one.impact_time) == repr(other.impact_time)
    )


def main() -> None:
    """Run the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_table_options(parser, 100, "of each row, on all φ together")
    parser.add_argument("--cars", nargs="+", default=list(CARS), choices=list(CARS), metavar="CAR")
    number: dict[str, Any] = {"type": whole_number(1), "metavar": "N"}
    parser.add_argument("--runs", **number, default=100, help="runs along φ")
    parser.add_argument("--simulations", **number, default=300, help="for each decision")
    parser.add_argument("--paper-simulations", **number, default=1000, help="in the encounters of the paper")
    parser.add_argument("--margins", type=whole_number(0), default=20, metavar="N", help="attempts with a margin")
    parser.add_argument("--graph", action="store_true", help="compare with the node graph and its recordings")
    arguments = parser.parse_args()
    let_cars_be_found()
    if arguments.graph:
        prepare_ros(GraphOptions())
    kept = KeptRows(arguments.out, arguments.most_minutes)
    print(table_head(), flush=True)
    for source in arguments.encounters:
        name = shown_name(source)
        for car in arguments.cars:
            work = partial(_with_graph, name=name, car=car, kept=kept, arguments=arguments)
            row = kept.row(name, car, partial(computed, source, car, arguments, work))
            if row is not None:
                print(line(name, car, row), flush=True)
    shown = {name: kept.rows[name] for name in map(shown_name, arguments.encounters) if name in kept.rows}
    print("", *order_lines(shown), "", *closeness_lines(shown), sep="\n")


def let_cars_be_found() -> None:
    """Have cars that are classes be found, also by processes of their own."""
    for folder in (EXAMPLES / "idm", Path(__file__).parent):
        sys.path.append(str(folder))
        os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, (os.environ.get("PYTHONPATH"), str(folder))))


def shown_name(source: str) -> str:
    """Return the name of an encounter that is given by its name or its file."""
    return Path(source).stem


def computed(source: str, car: str, arguments: argparse.Namespace, work: Callable[[Plan], Row]) -> Row:
    """Return one row, computed from its plan, or why there is none."""
    try:
        plan = plan_for(source, car, arguments)
        return {"refused": plan} if isinstance(plan, str) else work(plan)
    except UsageError as error:
        return {"refused": str(error)}


def _with_graph(plan: Plan, *, name: str, car: str, kept: KeptRows, arguments: argparse.Namespace) -> Row:
    """Return a row; the first of its encounter and those of third parties are compared with the graph."""
    row, some = row_of(plan, arguments)
    others = kept.rows.get(name, {}).values()
    if arguments.graph and (car in THIRD_PARTY or not any("graph" in one for one in others)):
        row["graph"] = same_in_graph_and_recording(plan.controller, some)
    return row


if __name__ == "__main__":
    main()
