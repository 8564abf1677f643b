"""Whether the risk is right: subset simulation beside crude crossings, and how often its intervals hold the truth.

Two families of cars, whose crossings are compiled so that millions can be run: the paper's basic car, which brakes for
whoever is within a distance, and one that brakes for whoever it would reach within a time. For each case the truth is
the share of --crude crossings that end in a hit. The risk is estimated --repetitions times, by 16 replicates of 1000
crossings a level each, as in an assessment; counted is how often the log-t interval holds the truth, which is itself
known up to its own error. `gain` is how many times as many crude crossings would have had the same error.

    python benchmarks/risk_coverage.py [--case NAME ...] [--repetitions 200] [--crude N] [--known HITS] [--workers 2]

--known says how many of the --crude crossings were hits when they were run before; then they are not run again.
"""

from __future__ import annotations

import argparse
import math
import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.workers import InProcessRunner, available_workers
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories
from skd_evaluator.metrics.behaviour.model import load_behaviour, walk
from skd_evaluator.metrics.risks import ScaleRisk, Touch
from skd_evaluator.metrics.statistics import wilson_interval
from skd_evaluator.risk.crossings import (
    SAME,
    CrossingPlan,
    Crossings,
    Ends,
    KnownCar,
    in_car_frame,
    missed_by,
    side_touched,
)
from skd_evaluator.risk.subset import REPLICATES, Levels, Replicate, SubsetEffort, gathered, levels_of, replicate
from skd_sim.kernels.compilation import kernel
from skd_sim.scenario.road import HEADING_NORTH
from skd_sim.scenario.scenario import load_scenario
from skd_sim.world.contact import sweep
from skd_sim.world.state import Trajectory, next_speed, travelled

PART = 20_000
"""Crude crossings of a worker's task."""
DECELERATION = 6.0  # m/s², of the car that goes by time


@dataclass(frozen=True)
class Case:
    """A car at a scale of the behaviour.

    Attributes:
        name: in the output.
        family: `distance` (the basic car) or `time`.
        law: C of the basic car, or the time, s.
        scale: of the behaviour.
        crude: crossings that tell the truth, by default.
    """

    name: str
    family: str
    law: float
    scale: float
    crude: int


CASES = (
    Case("distance, 1e-2", "distance", 1.38, 1.0, 200_000),
    Case("distance, 1e-3", "distance", 1.5, 1.05, 1_000_000),
    Case("distance, 1e-4", "distance", 1.8, 1.2, 4_000_000),
    Case("distance, 1e-5", "distance", 1.8, 0.75, 20_000_000),
    Case("time, 1e-2", "time", 1.1, 1.0, 200_000),
    Case("time, 1e-3", "time", 1.18, 1.0, 1_000_000),
    Case("time, 1e-4", "time", 1.25, 1.0, 4_000_000),
    Case("time, 1e-5", "time", 1.3, 0.9, 20_000_000),
)


@kernel
def _cross_by_time(
    paths: np.ndarray, lengths: np.ndarray, values: np.ndarray, phi: np.ndarray, walker: np.ndarray, car: np.ndarray,
    scale: float, law: float, touch: np.ndarray, missed: np.ndarray,
) -> None:  # fmt: skip
    """Run crossings of scenario crossing in front of a car that brakes where it would be there within a time."""
    ticks, front, half_width, radius, least_speed = (car.shape[1] - 1) // 2, 2.25, 0.9, 0.25, 0.556
    way, path = np.empty((ticks + 1, 2)), np.empty((2, 4))
    footprint = (front, front, half_width)
    for row in range(phi.shape[0]):
        count = walk(paths[phi[row], : lengths[phi[row]]], values, walker[row], scale, 0.3, way)
        y = -(13.0 + 2.5 * 0.5 * math.erfc(-car[row, 0] * math.sqrt(0.5))) - front
        speed, least, end = 25.0 / 3.0, math.inf, 0
        for tick in range(count - 1):
            here, there = (way[tick, 0], way[tick, 1]), (way[tick + 1, 0], way[tick + 1, 1])
            gap = here[1] - y - front
            brakes = 0.0 <= gap <= law * speed and here[0] < 1.5
            command = -DECELERATION if brakes else 0.0
            of_speed = 0.05 * (math.erfc(-car[row, 1 + 2 * tick] * math.sqrt(0.5)) - 1.0)
            of_brake = 0.1 * (math.erfc(-car[row, 2 + 2 * tick] * math.sqrt(0.5)) - 1.0)
            after = next_speed(speed, command * (1.0 + of_brake), of_speed, 0.3)
            distance = travelled(speed, after, 0.3)
            path[0, 0], path[0, 1], path[0, 2], path[0, 3] = 0.0, y, HEADING_NORTH, speed
            path[1, 0], path[1, 1], path[1, 2], path[1, 3] = 0.0, y + distance, HEADING_NORTH, after
            velocity = ((there[0] - here[0]) / 0.3, (there[1] - here[1]) / 0.3)
            share, impact = sweep(path, here, there, velocity, 0.0, footprint, (radius, 0.0, 0.0), 0.3, 0, 1)
            until = share if share <= 1.0 else 1.0
            least = min(least, missed_by(path, here, there, until, footprint, radius, least_speed, 0.3))
            if share <= 1.0:
                ahead, left, _ = in_car_frame(path, here, there, share)
                end = side_touched(ahead, left, footprint, radius, impact, least_speed, SAME)
                break
            y, speed = y + distance, after
        touch[row], missed[row] = end, 0.0 if end == 1 else max(least, 1e-9)


class CarByTime:
    """Runs crossings in front of a car that goes by time."""

    def __init__(self, scenario: CrossingPlan, law: float) -> None:
        """Take the scenario apart into numbers."""
        self.car_normals = 1 + 2 * scenario.ticks
        self._law, self._values = law, scenario.values
        self._lengths = np.array([len(phi) for phi in scenario.safe], np.int64)
        self._paths = np.zeros((len(scenario.safe), int(self._lengths.max()), 2))
        for index, phi in enumerate(scenario.safe):
            self._paths[index, : len(phi)] = phi.positions

    def run(self, crossings: Crossings, scale: float) -> Ends:
        """Run crossings by the car's normals."""
        touch, missed = np.empty(len(crossings), np.int64), np.empty(len(crossings))
        _cross_by_time(
            self._paths, self._lengths, self._values, crossings.phi, crossings.walker, crossings.car, scale, self._law,
            touch, missed,
        )  # fmt: skip
        return Ends(touch, missed)


@dataclass(frozen=True, eq=False)
class Job:
    """A replicate, or a part of the crude crossings, of a case."""

    case: Case
    safe: tuple[Trajectory, ...]
    number: int
    levels: Levels | None = None


def made(job: Job) -> tuple[CrossingPlan, Any]:
    case = job.case
    multiplier = case.law if case.family == "distance" else 1.0
    plan = Plan(load_scenario("crossing"), safe_count=len(job.safe), multiplier=multiplier, seed=7)
    scenario = CrossingPlan(plan, job.safe, load_behaviour("walkers").values)
    return scenario, KnownCar(scenario) if case.family == "distance" else CarByTime(scenario, case.law)


def one_replicate(job: Job) -> Replicate:
    scenario, car = made(job)
    assert job.levels is not None
    return replicate(scenario, car, job.case.scale, SubsetEffort(), job.levels, job.number)


def levels_for(job: Job) -> Levels:
    scenario, car = made(job)
    again = replace(scenario, plan=replace(scenario.plan, seed=job.number))
    return levels_of(again, car, job.case.scale, SubsetEffort())


def crude_part(job: Job) -> int:
    scenario, car = made(job)
    rng = np.random.default_rng(np.random.SeedSequence(11, spawn_key=(job.number,)))
    hits = 0
    for first in range(0, PART, 1000):
        crossings = Crossings(
            (np.arange(1000) + first) % len(job.safe),
            rng.standard_normal((1000, scenario.walker_normals)),
            rng.standard_normal((1000, car.car_normals)),
            np.zeros(1000, np.int64),
        )
        hits += int((car.run(crossings, job.case.scale).touch == Touch.FRONT).sum())
    return hits


def examined(
    case: Case,
    repetitions: int,
    crude: int,
    runner: InProcessRunner,
    safe: tuple[Trajectory, ...],
    known: int | None = None,
) -> str:
    """Return what was found of a case, in a line."""
    parts, begin = math.ceil(crude / PART), time.perf_counter()
    hits = known or sum(runner.map(crude_part, [Job(case, safe, number) for number in range(parts)]))
    runs, crude_seconds = parts * PART, time.perf_counter() - begin
    truth, interval = hits / runs, wilson_interval(hits, runs)
    begin = time.perf_counter()
    numbers = range(repetitions * REPLICATES)
    levels = list(runner.map(levels_for, [Job(case, safe, number) for number in range(repetitions)]))
    jobs = [Job(case, safe, number, levels[number // REPLICATES]) for number in numbers]
    found = list(runner.map(one_replicate, jobs))
    none = np.zeros(len(safe), np.int64)  # crude crossings: no estimate goes by them
    risks = [
        ScaleRisk(case.scale, none, len(safe), gathered(found[first : first + REPLICATES], SubsetEffort()))
        for first in range(0, len(found), REPLICATES)
    ]
    values = np.array([one.value for one in risks])
    held = [one.ci95[0] <= truth <= one.ci95[1] for one in risks]
    spread = float(np.std(values, ddof=1)) if repetitions > 1 else math.nan
    episodes = float(np.mean([one.subsets.episodes for one in risks]))
    variation, gain = spread / float(values.mean()), truth * (1.0 - truth) / spread**2 / episodes
    ratio = float(values.mean()) / truth if truth else math.nan
    low, high = wilson_interval(sum(held), repetitions)
    return (
        f"{case.name}: crude {hits} of {runs} = {truth:.3g} [{interval[0]:.3g}, {interval[1]:.3g}]; subset simulation "
        f"{values.mean():.3g}, {ratio:.3f} times; intervals hold {sum(held)} of {repetitions} [{100 * low:.0f}, "
        f"{100 * high:.0f}] %; coefficient of variation {variation:.2f} with {episodes:.0f} crossings, gain "
        f"{gain:.1f}; {crude_seconds:.0f} + {time.perf_counter() - begin:.0f} s"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--case", nargs="+", choices=[one.name for one in CASES])
    parser.add_argument("--repetitions", type=int, default=200)
    parser.add_argument("--crude", type=int)
    parser.add_argument("--known", type=int, metavar="HITS")
    parser.add_argument("--workers", type=int, default=available_workers())
    arguments = parser.parse_args()
    if arguments.known is not None and (arguments.crude is None or len(arguments.case or ()) != 1):
        parser.error("--known is of one --case, and of as many crossings as --crude says")
    plan = Plan(load_scenario("crossing"), safe_count=20, seed=7)
    safe = tuple(safe_trajectories(plan, InProcessRunner(1)))
    for case in CASES:
        if arguments.case is not None and case.name not in arguments.case:
            continue
        with InProcessRunner(arguments.workers) as runner:
            crude = arguments.crude or case.crude
            print(examined(case, arguments.repetitions, crude, runner, safe, arguments.known), flush=True)


if __name__ == "__main__":
    main()
