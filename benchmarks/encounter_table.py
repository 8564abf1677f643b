"""Every encounter that has a name × cars: what kamikazes reach, how often φ itself is hit, and whether all is in order.

The basic car at C = 0.75, 1 and 1.25, the same as a multi-body car, and CAL beside people on foot, each on φ of the
encounter's protocol, or, where it has none, on synthetic ones. Each kamikaze is held against the limits of its kind by
an oracle of its own (road_user_limits.py). With --graph the first two kamikazes and runs along φ of each row also run
through the node graph, are recorded, and are compared with those in process to the last bit:

    .venv/bin/python benchmarks/encounter_table.py --graph --out encounter_table.json
    .venv/bin/python benchmarks/encounter_table.py --encounters cpna cpfa --cars C=1 --kamikazes 5
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from road_user_limits import BODIES, beyond
from skd_adversary.safe_trajectories import REGULATORY
from skd_evaluator.assessing.graph_options import GraphOptions
from skd_evaluator.bags.reader import read_episodes
from skd_evaluator.campaign.plan.plan import Plan, collision_runs, kamikaze_sets, safe_trajectories
from skd_evaluator.campaign.run.workers import InProcessRunner
from skd_evaluator.cli.arguments import whole_number
from skd_evaluator.measure.distances.deformation import deformation
from skd_evaluator.ros.session import graph_session, prepare_ros
from skd_sim.choices.knowledge import Knowledge
from skd_sim.choices.objective import Objective
from skd_sim.encounter.known_scenarios import SCENARIOS
from skd_sim.encounter.scenario import Scenario, load_scenario
from skd_sim.episode.episode import EpisodeLog, Outcome
from skd_sim.errors import UsageError

CARS: Mapping[str, Mapping[str, Any]] = {
    "C=0.75": {"multiplier": 0.75},
    "C=1": {"multiplier": 1.0},
    "C=1.25": {"multiplier": 1.25},
    "multi-body C=1": {"multiplier": 1.0},
    "cal": {"controller": "cal", "knowledge": Knowledge.NOTHING},
}
ON_FOOT = ("pedestrian", "runner", "child")
_ROUNDING = 1e-6
_COLUMNS = ("deformation", "success", "hits along φ", "impact speed", "within limits", "seconds")


def plan_for(name: str, car: str, arguments: argparse.Namespace) -> Plan | str:
    """Return the plan of a row, or why there is none."""
    scenario = load_scenario(name)
    if car.startswith("multi-body"):
        if not scenario.road.straight:
            return "the multi-body car does not steer"
        body = load_scenario("crossing_multi_body").car
        kept = ("start_speed", "start_gap", "start_gap_range", "meet_safe_trajectory")
        held = {key: getattr(scenario.car, key) for key in kept}
        scenario = dataclasses.replace(scenario, car=dataclasses.replace(body, **held))
    if car == "cal" and (scenario.adversary.kind not in ON_FOOT or not scenario.road.straight):
        return "CAL knows people on foot, on straight roads"
    if car == "cal" and scenario.sensor is None:
        return "CAL needs a laser"
    protocol = scenario.protocol
    count = arguments.safe if protocol is None else min(arguments.safe, len(protocol.impact_places))
    return Plan(
        scenario,
        safe="synthetic" if protocol is None else REGULATORY,
        safe_count=count,
        kamikaze_count=arguments.kamikazes,
        collision_runs=arguments.runs,
        objective=Objective.DEFORMATION,
        simulations=arguments.simulations,
        **CARS[car],
    )


def within_limits(scenario: Scenario, logs: Sequence[EpisodeLog]) -> str:
    """Return how many kamikazes keep to the limits of their kind, of how many; nothing for the paper's pedestrian."""
    kind = scenario.adversary.kind
    if kind not in BODIES:
        return "–"
    kept = 0
    for log in logs:
        assert log.episode.safe_trajectory is not None
        phi, heading = log.episode.safe_trajectory.positions, scenario.adversary.first_heading
        kept += beyond(kind, phi, log.adversary, scenario.time_step, heading) <= _ROUNDING
    return f"{kept}/{len(logs)}"


def row_of(plan: Plan, arguments: argparse.Namespace) -> tuple[dict[str, Any], list[EpisodeLog]]:
    """Run one row; return it, and the episodes that are compared with the graph."""
    begin = time.perf_counter()
    with InProcessRunner(arguments.workers) as runner:
        safe = safe_trajectories(plan, runner)
        sets = kamikaze_sets(plan, safe, runner)
        along = collision_runs(plan, safe, runner)
    logs = [log for one in sets for log in one.in_order]
    eta_max, least = plan.scenario.eta_max, []
    for log in logs:
        if not log.hit:
            least.append(eta_max)
            continue
        phi, psi = log.episode.safe_trajectory, log.trajectory
        assert phi is not None
        least.append(min(eta_max, deformation(phi.positions, psi.positions, log.impact_time / plan.scenario.time_step)))
    hits = [log.impact_speed for log in logs if log.hit]
    found = {
        "deformation": float(np.mean(least)),
        "deformation_deviation": float(np.std(least)),
        "attempts": len(logs),
        "success": float(np.mean([log.hit for log in logs])),
        "hits along φ": float(np.mean([log.hit for log in along])),
        "impact speed": float(np.mean(hits)) if hits else math.nan,
        "within limits": within_limits(plan.scenario, logs),
        "aborted": sum(log.outcome == Outcome.ABORTED for log in (*logs, *along)),
        "φ": len(safe),
        "seconds": time.perf_counter() - begin,
    }
    return found, [*logs[:2], *along[:2]]


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


def line(name: str, car: str, row: Mapping[str, Any]) -> str:
    """Return a row of the table in Markdown."""
    if "refused" in row:
        return f"| {name} | {car} | {row['refused']} |" + " |" * (len(_COLUMNS) - 1)
    speed = "–" if math.isnan(row["impact speed"]) else f"{row['impact speed']:.1f}"
    return (
        f"| {name} | {car} | {row['deformation']:.2f} | {row['success']:.0%} | {row['hits along φ']:.0%} | {speed} | "
        f"{row['within limits']} | {row['seconds']:.0f} |"
    )


def main() -> None:
    """Run the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--encounters", nargs="+", default=list(SCENARIOS.own), metavar="NAME")
    parser.add_argument("--cars", nargs="+", default=list(CARS), choices=list(CARS), metavar="CAR")
    parser.add_argument("--safe", type=whole_number(1), default=5, metavar="N", help="φ of each encounter")
    parser.add_argument("--kamikazes", type=whole_number(1), default=20, metavar="N", help="for each φ")
    parser.add_argument("--runs", type=whole_number(1), default=100, metavar="N", help="runs along φ")
    parser.add_argument("--simulations", type=whole_number(1), default=1000, metavar="N")
    parser.add_argument("--workers", type=whole_number(1), default=1, metavar="N")
    parser.add_argument("--graph", action="store_true", help="compare with the node graph and its recordings")
    parser.add_argument("--out", type=Path, metavar="FILE", help="JSON of all rows")
    arguments = parser.parse_args()
    if arguments.graph:
        prepare_ros(GraphOptions())
    print(f"| encounter | car | {' | '.join(_COLUMNS)} |\n|{'---|' * (len(_COLUMNS) + 2)}", flush=True)
    rows: dict[str, dict[str, Any]] = {}
    alike = every = 0
    for name in arguments.encounters:
        for car in arguments.cars:
            try:
                plan = plan_for(name, car, arguments)
                if isinstance(plan, str):
                    row: dict[str, Any] = {"refused": plan}
                else:
                    row, some = row_of(plan, arguments)
                    if arguments.graph:
                        row["graph"] = same_in_graph_and_recording(plan.controller, some)
                        found = row["graph"].split("/")
                        alike, every = alike + int(found[0]), every + int(found[1])
            except UsageError as error:
                row = {"refused": str(error)}
            rows.setdefault(name, {})[car] = row
            print(line(name, car, row), flush=True)
            if arguments.out:
                arguments.out.write_text(json.dumps(rows, indent=1, ensure_ascii=False), encoding="utf-8")
    if arguments.graph:
        print(f"alike in process, graph and recording: {alike} of {every} episodes")


if __name__ == "__main__":
    main()
