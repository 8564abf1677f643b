"""How near the margin's search comes to the exact margin of basic cars, and how much twice the budget finds more.

    python benchmarks/margin_search.py [--safe recorded_folder] [--attempts 5] [--workers 2]

Of each basic car, searched as if nothing were known of it: the mean margin found by simulated ticks of an attempt, over
the exact mean; how far the search is below the exact least at most, which must be nothing; time an attempt.
Of each car that decides often, for which there is no exact margin: the mean found by ticks, m. "twice" is by what share
the mean of half the default budget exceeds that of all of it.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from cars.catalogue import CARS, Car, available
from skd_evaluator.campaign.plan.options import SYNTHETIC
from skd_evaluator.campaign.plan.plan import Plan, safe_trajectories
from skd_evaluator.campaign.run.workers import InProcessRunner
from skd_evaluator.margin.exact.exact import exact_margin
from skd_evaluator.margin.search.attempts import SearchedMargins, searched_margins
from skd_evaluator.margin.search.search import DEFAULT_BUDGET
from skd_sim.encounter.scenario import load_scenario
from skd_sim.episode.episode import Episode, Mode

MULTIPLIERS = (0.5, 0.625, 0.75, 0.875, 1.0, 1.05, 1.1, 1.125, 1.15, 1.5)
OFTEN = ("time to collision", "latched and delayed", "slows near anybody", "CAL", "Intelligent Driver Model")
RECORDED = "citr_crossing"
_SHOWN = 16  # ticks, the least that a table has


def episodes_of(car: Car, arguments: argparse.Namespace) -> list[Episode]:
    """Return the attempts of a car: `attempts` of each of `safe_count` trajectories of `safe`."""
    scenario = car.scenario
    if arguments.safe != SYNTHETIC:
        scenario = replace(load_scenario(RECORDED), control_period=scenario.control_period)
    plan = Plan(
        scenario,
        controller=car.controller,
        multiplier=car.multiplier,
        safe=arguments.safe,
        safe_count=arguments.safe_count,
    )
    with InProcessRunner(1) as runner:
        safe = safe_trajectories(plan, runner)
    return [
        plan.episode(Mode.KAMIKAZE, index, attempt, phi)
        for index, phi in enumerate(safe)
        for attempt in range(arguments.attempts)
    ]


def _searched(episodes: Sequence[Episode], arguments: argparse.Namespace) -> tuple[SearchedMargins, float]:
    with InProcessRunner(arguments.workers) as runner:
        begin = time.perf_counter()
        found = searched_margins(
            episodes, [()] * len(episodes), runner, lambda *_: None, arguments.budget, arguments.limit
        )
        return found, time.perf_counter() - begin


def _row(label: str, found: SearchedMargins, scale: float, seconds: float, rest: str) -> str:
    means = [f"{ticks}: {mean / scale:.3f}" for ticks, mean in found.means if ticks >= _SHOWN]
    (_, before), (_, after) = found.means[-2:]
    ticks = np.mean([one.simulated_ticks for one in found.results])
    twice = f"twice {(before - after) / max(after, 1e-9):.1%}"
    return f"{label:24} {'  '.join(means)}  {twice}  {ticks:.0f} ticks, {1e3 * seconds:.0f} ms an attempt{rest}"


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--safe", default=SYNTHETIC)
    parser.add_argument("--safe-count", type=int, default=20)
    parser.add_argument("--attempts", type=int, default=5, help="of each safe trajectory")
    parser.add_argument("--budget", type=int, default=DEFAULT_BUDGET)
    parser.add_argument("--limit", type=int, default=DEFAULT_BUDGET, help="of the budget as it is doubled")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--cars", choices=("basic", "often", "all"), default="all")
    arguments = parser.parse_args()
    eta_max = load_scenario("crossing").eta_max
    if arguments.cars != "often":
        print(f"found / exact, safe trajectories: {arguments.safe}")
        for multiplier in MULTIPLIERS:
            episodes = episodes_of(Car(f"basic, C = {multiplier:g}", "basic", "basic", multiplier), arguments)
            ways = [exact_margin(episode) for episode in episodes]
            least = np.array([eta_max if way is None else way.distance for way in ways])
            gaps = np.array([0.0 if way is None else way.gap for way in ways])
            found, seconds = _searched(episodes, arguments)
            reached = np.array([eta_max if one.way is None else one.way.distance for one in found.results])
            below = max(0.0, float((least - gaps - reached).max()))
            rest = f"; exact {least.mean():.3f} m, at most {below:.1e} m below it"
            print(
                _row(f"basic, C = {multiplier:g}", found, float(least.mean()), seconds / len(episodes), rest),
                flush=True,
            )
    if arguments.cars != "basic":
        print(f"mean margin, m, safe trajectories: {arguments.safe}")
        for car in available([car for car in CARS if car.label in OFTEN])[0]:
            episodes = episodes_of(car, arguments)
            found, seconds = _searched(episodes, arguments)
            print(_row(car.label, found, 1.0, seconds / len(episodes), ""), flush=True)


if __name__ == "__main__":
    main()
