"""How often the 95 % intervals of margin and equivalent multiplier hold what they speak of.

    .venv/bin/python benchmarks/margin_coverage.py [--phi 60] [--trials 100] [--safe synthetic] [--campaigns 1000]

A population is of exact margins: those of a car in so many trials on each of so many φ. A simulated campaign draws φ
from it with replacement, and trials from those of each φ; what an interval has to hold is the population's own
figure. Equal φ count one by one in the intervals by φ, and as one φ with more trials in those by distinct φ. The
margin is tried on basic cars, the equivalent multiplier on cars that are none of those that they are compared with:
they brake harder or more softly, or are less steady. Basic cars are compared with in the same trials, as in an
assessment.

In the populations named *hard* 15 % of the φ are four times as hard, for every car.
"""

from __future__ import annotations

import argparse
import sys
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.workers import InProcessRunner, available_workers
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories
from skd_evaluator.margin.basic_margins import HIGHEST, LOWEST, margin_of, yardstick
from skd_evaluator.metrics.clustered import MARGINS, clustered_mean
from skd_evaluator.metrics.margins import equivalent_multiplier
from skd_evaluator.metrics.statistics import normal_interval
from skd_sim.scenario.scenario import Scenario, load_scenario
from skd_sim.world.state import FloatArray, IntArray, Trajectory
from tally import Tally

SIZES = ((10, 25), (20, 25))
BASIC = {"basic, C = 0.75": 0.75, "basic, C = 1": 1.0, "basic, C = 1.15": 1.15}
OTHERS: dict[str, tuple[float, dict[str, Any]]] = {
    "brakes more softly": (0.7, {"deceleration": 2.8}),
    "brakes harder": (1.3, {"deceleration": 6.0}),
    "less steady": (1.0, {"speed_noise": 0.15, "acceleration_noise": 0.5}),
}
"""C and what is changed of the car."""
HARD_SHARE, HARDER = 0.15, 4.0
Row = tuple[float, list[Tally]]
"""The truth of a population, and how often its intervals hold, by size of the campaign and kind."""
NEAR, STEP = 12, 2
"""Hundredths: how far from the truth basic cars are compared, and how far apart they are."""


@dataclass(frozen=True)
class Populations:
    """Margins of cars in the same trials, computed as they are asked for and kept in a folder."""

    plan: Plan
    trials: int
    runner: InProcessRunner
    folder: Path | None

    @cached_property
    def safe(self) -> list[Trajectory]:
        """Φ."""
        return safe_trajectories(self.plan, self.runner)

    @cached_property
    def hard(self) -> FloatArray:
        """How much harder each φ is in the populations in which some are."""
        factors = np.ones(len(self.safe))
        chosen = np.random.default_rng(self.plan.seed).permutation(len(factors))
        factors[chosen[: round(HARD_SHARE * len(factors))]] = HARDER
        return factors

    @cached_property
    def _known(self) -> dict[str, FloatArray]:
        return {}

    def of(self, scenario: Scenario, multiplier: float) -> FloatArray:
        """Return margins of a basic car, φ × trials, m."""
        plan = replace(self.plan, scenario=scenario, multiplier=multiplier)
        name = f"{zlib.crc32(repr((scenario.as_dict(), plan.seed, self.trials)).encode()):08x}-{multiplier:g}.npy"
        if name not in self._known:
            path = None if self.folder is None else self.folder / name
            if path is None or not path.exists():
                found = self._computed(plan)
                if path is not None:
                    np.save(path, found)
            else:
                found = np.load(path)
            self._known[name] = found
        return self._known[name]

    def basic(self, hundredths: int) -> FloatArray:
        """Return margins of a car that is compared with."""
        return self.of(yardstick(self.plan, 1.0).scenario, hundredths / 100)

    def _computed(self, plan: Plan) -> FloatArray:
        episodes = plan.trials(self.safe, self.trials)
        print(f"  margins of C = {plan.multiplier:g} …", file=sys.stderr, flush=True)
        return np.array(list(self.runner.map(margin_of, episodes))).reshape(len(self.safe), self.trials)


def draws(phis: int, trials: int, campaigns: int, seed: int) -> Iterator[Iterator[tuple[IntArray, IntArray]]]:
    """Yield, for each size of campaigns, the φ and trials that its campaigns draw."""
    for safe, each in SIZES:
        rng = np.random.default_rng(np.random.SeedSequence((seed, safe, each)))
        yield ((rng.integers(phis, size=safe), rng.integers(trials, size=(safe, each))) for _ in range(campaigns))


def margins(population: FloatArray, equal: IntArray, eta_max: float, campaigns: int, seed: int) -> Row:
    """Return how often the intervals of the margin hold, by size of the campaign; `equal` numbers distinct φ."""
    truth, cells = float(population.mean()), []
    for drawn in draws(len(population), population.shape[1], campaigns, seed):
        by_phi, by_distinct, independent = Tally(), Tally(), Tally()
        for chosen, numbers in drawn:
            drawn_margins = population[chosen[:, None], numbers]
            merged = [drawn_margins[equal[chosen] == one].ravel() for one in np.unique(equal[chosen])]
            for tally, groups in ((by_phi, list(drawn_margins)), (by_distinct, merged)):
                found = clustered_mean(groups, prior=MARGINS, limits=(0.0, eta_max))
                assert found is not None
                tally.add(truth, found.interval)
            independent.add(truth, normal_interval(drawn_margins.ravel()))
        cells += [by_phi, by_distinct, independent]
    return truth, cells


def multipliers(car: FloatArray, populations: Populations, factors: FloatArray, campaigns: int, seed: int) -> Row:
    """Return how often the intervals of the equivalent multiplier hold, by size of the campaign."""
    eta_max = populations.plan.scenario.eta_max

    def basic(hundredths: int) -> FloatArray:
        return np.minimum(factors[:, None] * populations.basic(hundredths), eta_max)

    truth, cells = _truth(car, basic), []
    near = round(100 * truth) | 1  # the same hundredths for populations that are nearly alike
    grid = range(near - NEAR, near + NEAR + 1, STEP)
    for drawn in draws(len(car), car.shape[1], campaigns, seed):
        by_phi, of_these = Tally(), Tally()
        for chosen, numbers in drawn:
            mine = list(car[chosen[:, None], numbers])
            found = equivalent_multiplier(mine, {one / 100: list(basic(one)[chosen[:, None], numbers]) for one in grid})
            by_phi.add(truth, found.interval)
            of_these.add(truth, found.ci95_trials)
        cells += [by_phi, of_these]
    return truth, cells


def _truth(car: FloatArray, basic: Any) -> float:
    """Return the C of the population: between neighbouring hundredths of which one has less margin, and one not."""
    low, high = LOWEST, HIGHEST
    for probe in (75, 100, 115, 130):  # the margin of a C takes the longer the greater it is
        if basic(probe).mean() >= car.mean():
            high = probe
            break
        low = probe
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if basic(middle).mean() < car.mean() else (low, middle)
    below, above = basic(low).mean(), basic(high).mean()
    return float(low + (car.mean() - below) / (above - below)) / 100


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--phi", type=int, default=60, metavar="N", help="of a population")
    parser.add_argument("--trials", type=int, default=100, metavar="N", help="on each φ of a population")
    parser.add_argument("--seed", type=int, default=2, metavar="N", help="of the populations, and of the campaigns")
    parser.add_argument("--campaigns", type=int, default=1000, metavar="N", help="simulated, of each size")
    parser.add_argument("--scenario", default="crossing")
    parser.add_argument("--safe", default="synthetic", metavar="SOURCE", help="of φ, as of skd assess")
    parser.add_argument("--workers", type=int, default=available_workers(), metavar="N")
    parser.add_argument("--only", choices=("margin", "multiplier"), help="one of the two tables")
    parser.add_argument("--kept", type=Path, metavar="DIR", help="where populations are kept")
    arguments = parser.parse_args()
    if arguments.kept:
        arguments.kept.mkdir(parents=True, exist_ok=True)
    scenario, size = load_scenario(arguments.scenario), (arguments.campaigns, arguments.seed)
    plan = Plan(scenario, seed=arguments.seed, safe=arguments.safe, safe_count=arguments.phi)
    with InProcessRunner(arguments.workers) as runner:
        runner.start()
        populations = Populations(plan, arguments.trials, runner, arguments.kept)
        none, hard, eta_max = np.ones(arguments.phi), populations.hard, scenario.eta_max
        if arguments.only != "multiplier":
            cars = {name: populations.of(scenario, multiplier) for name, multiplier in BASIC.items()}
            ways = [phi.positions.tobytes() for phi in populations.safe]
            equal = np.unique(np.array(ways, dtype=object), return_inverse=True)[1]
            print(f"{equal.max() + 1} of {arguments.phi} φ are distinct", file=sys.stderr)
            print(head("by φ", "by distinct φ", "trials as independent"))
            for name, found in cars.items():
                show(name, margins(found, equal, eta_max, *size))
                scaled, which = np.minimum(hard[:, None] * found, eta_max), 2 * equal + (hard > 1.0)
                show(f"{name}, hard", margins(scaled, which, eta_max, *size))
        if arguments.only != "margin":
            print(head("by φ", "φ given"))
            for name, (multiplier, changes) in OTHERS.items():
                changed = replace(scenario, car=replace(scenario.car, **changes))
                found = populations.of(changed, multiplier)
                for label, factors in ((name, none), (f"{name}, hard", hard)):
                    scaled = np.minimum(factors[:, None] * found, eta_max)
                    show(label, multipliers(scaled, populations, factors, *size))


def head(*kinds: str) -> str:
    """Return the first lines of a table whose intervals are of these kinds."""
    heads = [f"{safe} × {trials}, {kind}" for safe, trials in SIZES for kind in kinds]
    return f"| population | truth | {' | '.join(heads)} |\n{'|---' * (2 + len(heads))}|"


def show(name: str, row: Row) -> None:
    """Print a line of the table, of one population."""
    print(f"| {name} | {row[0]:.4f} | {' | '.join(map(str, row[1]))} |", flush=True)


if __name__ == "__main__":
    main()
