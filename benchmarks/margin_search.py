"""What the margin's search says of cars, and what a hundred times the effort still finds.

    python benchmarks/margin_search.py [--cars NAME ...] [--scenario NAME ...] [--seeds N ...] [--trials N] [--times N]

Of each car, scenario and seed: the margin that the search says with the effort of an assessment, whether it has
converged, its candidates a trial, and how much too high it estimates the margin to be. Some of the trials, drawn at
random, are then searched anew with so many times the candidates that a trial may have by default. "deep / default" is
the mean of the least that is known then, over the mean of the same trials before: 1 where nothing less was found.
Basic cars, whose margins are exact, are left out.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from cars.catalogue import CARS, Car, available
from cars.memory import MEMORY_CARS
from rich.console import Console
from rich.table import Table
from skd_evaluator.assessment.options import SYNTHETIC
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories
from skd_evaluator.errors import AssessmentError
from skd_evaluator.margin.search.rounds import in_processes
from skd_evaluator.margin.search.search import DEEPER, IN_PROCESS, Effort, SearchedMargins, search_margins
from skd_sim.arrays import FloatArray
from skd_sim.errors import UsageError
from skd_sim.world.episode import EpisodeSpec, Mode

COLUMNS = ("car", "scenario", "seed", "said (m)", "converged", "budget", "excess (m)", "deep / default", "s", "s deep")
DEEP_TRIALS = 20


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
        trajectories = safe_trajectories(plan, runner)
    return [
        plan.episode(Mode.KAMIKAZE, index, trial, phi)
        for index, phi in enumerate(trajectories)
        for trial in range(each)
    ]


def searched(episodes: Sequence[EpisodeSpec], workers: int, effort: Effort) -> tuple[SearchedMargins, float]:
    """Return what a search finds in trials, and how long it takes, s."""
    begin = time.perf_counter()
    with InProcessRunner(workers) as runner:
        found = search_margins(episodes, {}, in_processes(runner, lambda *_: None), effort)
    return found, time.perf_counter() - begin


def margins(found: SearchedMargins, eta_max: float) -> FloatArray:
    """Return the margin of each trial, m; η_max where no hit was found."""
    return np.array([eta_max if hit is None else hit.distance for hit in found.hits])


def row(car: Car, episodes: Sequence[EpisodeSpec], workers: int, times: int) -> list[str]:
    """Return what a car's row says from "said" on."""
    found, seconds = searched(episodes, workers, IN_PROCESS)
    said = margins(found, car.scenario.eta_max)
    drawn = np.random.default_rng(episodes[0].seed).permutation(len(episodes))[:DEEP_TRIALS]
    chosen = np.sort(drawn).tolist()
    # All of so few trials are searched DEEPER times the limit.
    limit = max(1, times * IN_PROCESS.limit // DEEPER)
    more, deep_seconds = searched(
        [episodes[number] for number in chosen], workers, IN_PROCESS._replace(first=limit, limit=limit)
    )
    least = np.minimum(said[chosen], margins(more, car.scenario.eta_max))
    before = float(said[chosen].mean())
    excess = "–" if found.search.excess is None else f"{found.search.excess.mean:.3f} ± {found.search.excess.error:.3f}"
    return [
        f"{said.mean():.3f}",
        "yes" if found.search.converged else "no",
        str(found.search.budget),
        excess,
        f"{least.mean() / before:.3f}" if before > 0.0 else "–",
        f"{seconds:.0f}",
        f"{deep_seconds:.0f}",
    ]


def main() -> None:
    """Print the table."""
    cars = [car for car in (*CARS, *MEMORY_CARS) if not car.is_basic]
    labels = [car.label for car in cars]
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cars", nargs="+", default=labels, choices=labels, metavar="NAME", help="as in the catalogue")
    parser.add_argument("--scenario", nargs="+", default=[""], metavar="NAME", help="default: the car's own")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0], metavar="N")
    parser.add_argument("--safe", default=SYNTHETIC, help="nominal trajectories, as in skd assess")
    parser.add_argument("--safe-count", type=int, default=20, metavar="N")
    parser.add_argument("--trials", type=int, default=500, metavar="N", help="in all (default 500)")
    parser.add_argument("--times", type=int, default=100, metavar="N", help="the default limit (default 100)")
    parser.add_argument("--workers", type=int, default=1, metavar="N")
    arguments = parser.parse_args()
    table = Table(*COLUMNS)
    made, missing = available([car for car in cars if car.label in arguments.cars])
    for name in arguments.scenario:
        for car in made:
            other = replace(car, scenario_name=name or car.scenario_name)
            for seed in arguments.seeds:
                head = (other.label, other.scenario_name, str(seed))
                try:
                    episodes = episodes_of(other, seed, arguments.safe, arguments.safe_count, arguments.trials)
                    table.add_row(*head, *row(other, episodes, arguments.workers, arguments.times))
                except (AssessmentError, UsageError) as error:
                    missing.append(f"{', '.join(head)}: {error}")
    Console(width=max(120, Console().width)).print(table)
    for line in missing:
        print(line)


if __name__ == "__main__":
    main()
