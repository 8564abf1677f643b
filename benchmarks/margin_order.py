"""Whether the margin puts cars of known order in that order, in every encounter that has a name.

The cars are those of encounter_table.py of which it is known which brakes later: the basic one at C = 0.75, 1 and 1.25
and, beside whoever comes as a box on a straight road, three brakes by time to collision (cars/triggers.py). Each margin
is exact where it can be, else searched for with so many ticks in each attempt and without planned ways, so that no
planner comes into it. Neighbours are compared attempt by attempt, for all cars meet the same φ with the same draws: the
mean difference and its normal 95 % interval, φ given.

A pair is *in order* if the interval lies above 0, *alike* if every attempt has the same margin to the millimetre, *not
told apart* if the interval holds 0, and *against it* if it lies below 0.

    .venv/bin/python benchmarks/margin_order.py --out margin_order.json
    .venv/bin/python benchmarks/margin_order.py --encounters cpna ccrs --margin-limit 2048

FILE keeps the rows; the same command goes on from there.
"""

from __future__ import annotations

import argparse
import itertools
import math
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from cars.triggers import TRIGGERS
from encounter_table import computed, shown_name
from kept_rows import KeptRows, add_table_options
from skd_evaluator.assessing.pipeline import planners_of
from skd_evaluator.campaign.plan.plan import Plan, safe_trajectories
from skd_evaluator.campaign.run.workers import InProcessRunner
from skd_evaluator.margin.assessment_margin import least_ways, why_no_margin
from skd_evaluator.measure.margins import Margins
from skd_evaluator.measure.statistics.statistics import normal_interval
from skd_sim.episode.episode import Mode

GROUPS = (("C=0.75", "C=1", "C=1.25"), tuple(reversed(list(TRIGGERS))))
"""Cars by which one brakes later, the latest first."""
SAME = 1e-3  # m


def margins_of(plan: Plan, arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the margins of a car's attempts, m, and how they were found."""
    if why := why_no_margin(plan, arguments.margin_limit):
        return {"refused": why}
    with InProcessRunner(arguments.workers, isolated=not plan.car.is_own) as runner:
        runner.start(planners_of(plan, []))
        safe = safe_trajectories(plan, runner)
        each = math.ceil(arguments.attempts / len(safe))
        episodes = [plan.episode(Mode.KAMIKAZE, index, n, phi) for index, phi in enumerate(safe) for n in range(each)]
        found = least_ways(
            episodes, lambda: [[] for _ in episodes], runner, lambda *_told: None, arguments.margin_limit
        )
    margins = Margins((tuple(found.ways),), plan.scenario.eta_max, found.budget, found.converged)
    values = margins.values.tolist()
    return {"margins": values, "exact": found.budget is None, "converged": found.converged}


def judged(later: Sequence[float], earlier: Sequence[float]) -> str:
    """Return what two cars' margins (m) in the same attempts say of their order."""
    apart = np.asarray(earlier) - np.asarray(later)
    if np.abs(apart).max() < SAME:
        return "alike"
    low, high = normal_interval(apart)
    return "in order" if low > 0.0 else "against it" if high < 0.0 else "not told apart"


def line(name: str, cars: Sequence[str], rows: dict[str, Any]) -> str | None:
    """Return a line of the table; None where there is no margin of two cars at least."""
    known = [car for car in cars if "margins" in rows.get(car, {})]
    if len(known) < 2:
        return None
    means = ", ".join(f"{np.mean(rows[car]['margins']):.3f}" for car in known)
    how = "exact" if all(rows[car]["exact"] for car in known) else "converged"
    if not all(rows[car]["converged"] for car in known):
        how = "not converged"
    pairs = itertools.pairwise(known)
    says = ", ".join(judged(rows[one]["margins"], rows[other]["margins"]) for one, other in pairs)
    return f"| {name} | {', '.join(known)} | {means} | {how} | {says} |"


def main() -> None:
    """Run the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_table_options(parser, 20, "of each car, on all φ together")
    arguments = parser.parse_args()
    arguments.runs = arguments.simulations = arguments.paper_simulations = 1
    kept = KeptRows(arguments.out, arguments.most_minutes)
    print(
        "| encounter | cars, later to earlier | margin (m) | found | later less than earlier |\n|---|---|---|---|---|"
    )
    for source in arguments.encounters:
        name = shown_name(source)
        for cars in GROUPS:
            for car in cars:
                work = partial(margins_of, arguments=arguments)
                kept.row(name, car, partial(computed, source, car, arguments, work))
            if said := line(name, cars, kept.rows.get(name, {})):
                print(said, flush=True)


if __name__ == "__main__":
    main()
