"""What the margin's search says of cars, and what many times the effort still finds.

    python benchmarks/margin_search.py [--cars NAME ...] [--scenarios NAME ...] [--seeds N ...] [--trials N] [--times N]

A row for each car, scenario and seed: the margin that the search says with the effort of an assessment, whether it has
converged, its candidates a trial, its interval's part for the search (the estimated excess, and its standard error),
and its processor time. Some of the trials, drawn at random, are then searched anew with so many times the candidates
that a trial has by default. "too high" is the mean of these trials over the mean of the least that is known then: 1
where nothing less was found. Basic cars, whose margins are exact, are left out. The last lines count.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from cars.catalogue import CARS, Car, available
from cars.memory import MEMORY_CARS
from skd_evaluator.assessment.options import SYNTHETIC
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories
from skd_evaluator.errors import AssessmentError
from skd_evaluator.margin.search.rounds import one_by_one
from skd_evaluator.margin.search.search import DEEPER, IN_PROCESS, search_margins
from skd_sim.arrays import FloatArray
from skd_sim.errors import UsageError
from skd_sim.world.episode import EpisodeSpec

COLUMNS = "car", "scenario", "seed", "margin (m)", "converged", "budget", "excess (m)", "too high", "CPU (s)"


class Row(NamedTuple):
    """What was found of a car.

    Attributes:
        margin: m.
        converged: whether the search says so.
        budget: candidates a trial.
        excess: estimated, and its standard error, m; nan: it was not.
        too_high: margin over what deeper search finds, in the same trials.
        seconds: processor time of the search.
    """

    margin: float
    converged: bool
    budget: int
    excess: tuple[float, float]
    too_high: float
    seconds: float


def episodes_of(car: Car, seed: int, safe: str, safe_count: int, trials: int) -> list[EpisodeSpec]:
    """Return so many trials of a car, equally many on each nominal trajectory."""
    each = max(1, trials // safe_count)
    plan = Plan(
        car.scenario,
        controller=car.controller,
        multiplier=car.multiplier,
        safe=safe,
        safe_count=safe_count,
        kamikaze_count=each,
        seed=seed,
    )
    with InProcessRunner() as runner:
        return plan.trials(safe_trajectories(plan, runner), each)


def row(episodes: Sequence[EpisodeSpec], deep_trials: int, times: int) -> Row:
    """Return what is found of a car."""
    eta_max = episodes[0].scenario.eta_max
    begin = time.process_time()
    found = search_margins(episodes, {}, one_by_one)
    seconds = time.process_time() - begin
    said = margins(found.hits, eta_max)
    chosen = np.sort(np.random.default_rng(episodes[0].seed).permutation(len(episodes))[:deep_trials])
    limit = max(1, times * IN_PROCESS.limit // DEEPER)  # so few trials are searched DEEPER times as deep
    effort = IN_PROCESS._replace(first=DEEPER * limit, limit=limit)
    more = search_margins([episodes[number] for number in chosen.tolist()], {}, one_by_one, effort)
    least = np.minimum(said[chosen], margins(more.hits, eta_max)).mean()
    search, excess = found.search, found.search.excess
    return Row(
        float(said.mean()),
        search.converged,
        search.budget,
        (np.nan, np.nan) if excess is None else (excess.mean, excess.error),
        float(said[chosen].mean() / least) if least > 0.0 else 1.0,
        seconds,
    )


def margins(hits: Sequence[object], eta_max: float) -> FloatArray:
    """Return the margin of each trial, m; η_max where no hit was found."""
    return np.array([eta_max if hit is None else hit.distance for hit in hits])  # type: ignore[attr-defined]


def summary(rows: Sequence[Row]) -> list[str]:
    """Return lines that count."""
    lines = []
    for converged in (True, False):
        ratios = np.array([one.too_high for one in rows if one.converged == converged])
        if ratios.size:
            said = "converged" if converged else "not converged, so at most"
            lines.append(
                f"{said}: {ratios.size} rows, at most {100.0 * (ratios.max() - 1.0):.1f} % too high, "
                f"no more than 1 % in {(ratios <= 1.01).sum()}, no more than 3 % in {(ratios <= 1.03).sum()}"
            )
    seconds = np.array([one.seconds for one in rows])
    lines.append(f"processor time: median {np.median(seconds):.0f} s, nine tenths {np.quantile(seconds, 0.9):.0f} s")
    return lines


def main() -> None:
    """Print the table, row by row, as Markdown."""
    cars = [car for car in (*MEMORY_CARS, *CARS) if not car.is_basic]
    labels = [car.label for car in cars]
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cars", nargs="+", default=labels, choices=labels, metavar="NAME", help="as in the catalogue")
    parser.add_argument("--scenarios", nargs="+", default=[""], metavar="NAME", help="default: the car's own")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0], metavar="N")
    parser.add_argument("--safe", default=SYNTHETIC, help="nominal trajectories, as in skd assess")
    parser.add_argument("--safe-count", type=int, default=20, metavar="N")
    parser.add_argument("--trials", type=int, default=500, metavar="N", help="in all (default 500)")
    parser.add_argument("--deep-trials", type=int, default=20, metavar="N", help="searched deeper, at most 20")
    parser.add_argument("--times", type=int, default=100, metavar="N", help="the default limit (default 100)")
    arguments = parser.parse_args()
    made, missing = available([car for car in cars if car.label in arguments.cars])
    print("| " + " | ".join(COLUMNS) + " |", "|---" * len(COLUMNS) + "|", sep="\n", flush=True)
    rows = []
    for name in arguments.scenarios:
        for car in made:
            other = replace(car, scenario_name=name or car.scenario_name)
            for seed in arguments.seeds:
                head = f"{other.label} | {other.scenario_name} | {seed}"
                try:
                    episodes = episodes_of(other, seed, arguments.safe, arguments.safe_count, arguments.trials)
                    one = row(episodes, arguments.deep_trials, arguments.times)
                except (AssessmentError, UsageError) as error:
                    missing.append(f"{head}: {error}")
                    continue
                rows.append(one)
                print(
                    f"| {head} | {one.margin:.3f} | {'yes' if one.converged else 'no'} | {one.budget} | "
                    f"{one.excess[0]:.3f} ± {one.excess[1]:.3f} | {one.too_high:.3f} | {one.seconds:.0f} |",
                    flush=True,
                )
    print("", *summary(rows), *missing, sep="\n")


if __name__ == "__main__":
    main()
