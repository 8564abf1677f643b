"""Why kamikazes stray further than the margin: the same attempts with one thing after another taken away from them.

Of each encounter and car some attempts of encounter_table.py, by mean deformation, m. An attempt without a hit counts
as η_max; how many there were stands in brackets.

* *planned*: as in the table, with what its kamikazes know of the car, its simulations and its sensor;
* *more*: the same with ten times the simulations: what the search leaves lies between the two;
* *sensed*: plans with copies of the car itself (`--knowledge itself`), which sees the car through the same sensor:
  knowledge of the car;
* *told*: the same, told the car's state in every tick (`--told`): the sensor;
* *no halves*: beside pedestrians the margin without half speeds, which no kamikaze has: what is left below *told* is
  the noise to come, and what a plan leaves;
* *margin*: searched from all of these hits on, so it is never more than the best of them; with a star the search has
  not converged.

What *planned* exceeds the margin by is split into what attempts without a hit bring in, at η_max each, and the rest.

    .venv/bin/python benchmarks/encounter_causes.py --out encounter_causes.json
    .venv/bin/python benchmarks/encounter_causes.py --encounters cpna cbfa --cars C=1 --attempts 10

FILE keeps the rows; the same command goes on from there. `--most-minutes` begins no further row after so much processor
time.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any
from unittest.mock import patch

import numpy as np
from encounter_table import CARS, computed, deformation_of, let_cars_be_found, shown_name
from half_speeds import whole_speeds
from kept_rows import KeptRows, add_table_options
from skd_evaluator.assessing.pipeline import planners_of
from skd_evaluator.campaign.plan.plan import Plan, safe_trajectories
from skd_evaluator.campaign.run.workers import InProcessRunner
from skd_evaluator.cli.arguments import whole_number
from skd_evaluator.margin.assessment_margin import least_ways, why_no_margin, with_planned_hits
from skd_evaluator.margin.search import tree
from skd_evaluator.margin.search.search import search_margin
from skd_evaluator.measure.margins import Margins
from skd_sim.choices.knowledge import Knowledge
from skd_sim.episode.episode import EpisodeLog, Mode

MORE = 10
"""Times as many simulations."""
_LITTLE = 0.01  # m: a ratio to less says nothing
COLUMNS = ("planned", "more", "sensed", "told", "no halves", "margin")
DERIVED = ("excess: misses + rest", "planned, told over margin")


def plans_of(plan: Plan, calls: int) -> Mapping[str, Plan]:
    """Return the plan of each kind of kamikaze."""
    itself = dataclasses.replace(plan, knowledge=Knowledge.ITSELF, controller_calls=calls)
    return {
        "planned": plan,
        "more": dataclasses.replace(plan, simulations=MORE * plan.simulations),
        "sensed": itself,
        "told": dataclasses.replace(itself, told=True),
    }


def row_of(plan: Plan, arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the deformations of each attempt by each kind of kamikaze, m, and the margins."""
    if why := why_no_margin(plan, arguments.margin_limit):
        return {"refused": why}
    plans = plans_of(plan, arguments.controller_calls)
    found: dict[str, Any] = {}
    hits: dict[int, list[EpisodeLog]] = {}
    with InProcessRunner(arguments.workers, isolated=not plan.car.is_own) as runner:
        runner.start(planners_of(plan, [plan.objective]))
        safe = safe_trajectories(plan, runner)
        each = math.ceil(arguments.attempts / len(safe))
        numbers = [(index, attempt, phi) for index, phi in enumerate(safe) for attempt in range(each)]
        for kind, one in plans.items():
            logs = list(runner.run([one.episode(Mode.KAMIKAZE, *number) for number in numbers]))
            found[kind] = [deformation_of(log) for log in logs]
            for log in logs:
                if log.hit:
                    hits.setdefault(log.episode.episode_id, []).append(log)
        episodes = [plan.episode(Mode.KAMIKAZE, *number) for number in numbers]
        starts = [[log.trajectory.positions for log in hits.get(one.episode_id, [])] for one in episodes]
        least = least_ways(episodes, lambda: starts, runner, lambda *_told: None, arguments.margin_limit)
        ways, _ = with_planned_hits(episodes, least.ways, hits)
    margins = Margins((tuple(ways),), plan.scenario.eta_max, least.budget, least.converged)
    found |= {"margin": margins.values.tolist(), "exact": least.budget is None, "converged": least.converged}
    if plan.scenario.adversary.kind == "pedestrian" and plan.car.is_own:
        with patch.object(tree, "velocities", whole_speeds):
            ends = [
                search_margin(one, arguments.margin_limit, begin).way
                for one, begin in zip(episodes, starts, strict=True)
            ]
        found["no halves"] = [plan.scenario.eta_max if way is None else way.distance for way in ends]
    return {**found, "eta_max": plan.scenario.eta_max}


def line(name: str, car: str, row: Mapping[str, Any]) -> str:
    """Return a row of the table: means, of the kamikazes with their misses."""
    if "refused" in row:
        return f"| {name} | {car} | – ({row['refused']}) |" + " |" * (len(COLUMNS) + 1)
    cells = []
    for kind in COLUMNS:
        values: Sequence[float] | None = row.get(kind)
        if values is None:
            cells.append("")
            continue
        missed = sum(value >= row["eta_max"] for value in values)
        star = "*" if kind == "margin" and not (row["exact"] or row["converged"]) else ""
        cells.append(f"{np.mean(values):.2f}{star}" + (f" ({missed})" if missed else ""))
    planned, least = np.array(row["planned"]), np.array(row["margin"])
    excess, missed = planned - least, planned >= row["eta_max"]
    cells.append(f"{np.mean(excess * missed):.2f} + {np.mean(excess * ~missed):.2f}")
    margin = float(least.mean())
    cells.append(f"{planned.mean() / margin:.2f}, {np.mean(row['told']) / margin:.2f}" if margin > _LITTLE else "–")
    return f"| {name} | {car} | {' | '.join(cells)} |"


def main() -> None:
    """Run the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_table_options(parser, 15, "on all φ together")
    parser.add_argument("--cars", nargs="+", default=["C=1"], choices=list(CARS), metavar="CAR")
    number: dict[str, Any] = {"type": whole_number(1), "metavar": "N"}
    parser.add_argument("--simulations", **number, default=300, help="for each decision")
    parser.add_argument("--paper-simulations", **number, default=1000, help="in the encounters of the paper")
    parser.add_argument("--controller-calls", **number, default=25_000, help="of copies of the car, an episode")
    arguments = parser.parse_args()
    arguments.runs = 1
    let_cars_be_found()
    kept = KeptRows(arguments.out, arguments.most_minutes)
    print(f"| encounter | car | {' | '.join((*COLUMNS, *DERIVED))} |\n|{'---|' * (len(COLUMNS) + len(DERIVED) + 2)}")
    for source in arguments.encounters:
        name = shown_name(source)
        for car in arguments.cars:
            row = kept.row(name, car, partial(computed, source, car, arguments, partial(row_of, arguments=arguments)))
            if row is not None:
                print(line(name, car, row), flush=True)


if __name__ == "__main__":
    main()
