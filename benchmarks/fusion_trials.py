"""Physical trials for the benchmark of `skd fuse`, played by the multi-body car with other friction and another delay.

    nice .venv/bin/python benchmarks/fusion_trials.py --out fusion_trials.npz

People walk φ as they do: paces, moments of waiting at the kerb and drifts differ. Of each car the simulator is the
multi-body car on a dry road, and the physical car the same with less friction, a later brake and draws of its own. A φ
holds its timing: the car starts at one distance. Of each φ there are several simulated and several physical runs.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.episodes import run_episode
from skd_evaluator.extensions.fusion.trials import figures_of
from skd_evaluator.metrics.contact_place import car_until_contact
from skd_evaluator.metrics.surrogate_scenes import scene_of
from skd_sim.scenario.scenario import Scenario, load_scenario, scenario_from_dict
from skd_sim.world.episode import EpisodeLog, Mode, Outcome, until_contact
from skd_sim.world.state import Trajectory

FIGURES = ("clearance", "required_deceleration", "hit")
RUNS = 2
"""Simulated, and physical, of each φ."""


@dataclass(frozen=True)
class Car:
    """A car, and how its physical trials differ from what the simulator takes."""

    controller: str
    multiplier: float
    start_gap: float
    friction: float
    brake_delay: float
    control_period: float | None = None


CARS = {
    "graded brake, 0.8, 0.2 s": Car("cars.required_brake:RequiredDecelerationBrake", 1.0, 18.0, 0.8, 0.2, 0.1),
    "basic C = 1.5, 0.8, 0.2 s": Car("basic", 1.5, 20.0, 0.8, 0.2),
    "brake by time to collision, 0.6, 0.3 s": Car("cars.collision_time:EarlyBrake", 1.0, 22.0, 0.6, 0.3, 0.05),
    "late graded brake, 0.6, 0.2 s": Car("cars.required_brake:LateRequiredBrake", 1.0, 20.0, 0.6, 0.2, 0.1),
}


def walks(count: int, rng: np.random.Generator, time_step: float) -> list[Trajectory]:
    """Return φ of people who cross a lane: pace 1.4 m/s, log-normal by 0.2, up to a second at the kerb, some drift."""
    found = []
    for number in range(count):
        pace, waits, drift = np.exp(rng.normal(np.log(1.4), 0.2)), rng.uniform(0.0, 1.0), rng.normal(0.0, 0.15)
        walked = np.maximum(0.0, np.arange(0.0, waits + 6.5 / pace + time_step, time_step) - waits)
        found.append(Trajectory(np.column_stack([pace * walked - 3.5, drift * walked]), time_step, f"walk/{number}"))
    return found


def scenario_of(car: Car, *, physical: bool) -> Scenario:
    """Return the crossing of the multi-body car, dry or as on the proving ground."""
    data: dict[str, Any] = load_scenario("crossing_multi_body").as_dict()
    data["car"] = {**data["car"], "start_gap": car.start_gap, "start_gap_range": 0.1}
    if physical:
        data["road"] = {**data["road"], "friction": car.friction}
        data["car"]["brake_delay"] = car.brake_delay
    if car.control_period is not None:
        data["control_period"] = car.control_period
    return scenario_from_dict(data)


def figures_in(log: EpisodeLog) -> Mapping[str, float]:
    """Return the figures of an episode that ran."""
    if log.outcome == Outcome.ABORTED:
        raise RuntimeError(log.reason)
    scenario, adversary, car = log.episode.scenario, log.adversary, log.car
    times = np.arange(len(adversary), dtype=np.float64) * scenario.time_step
    if log.outcome == Outcome.COLLISION:
        ticks = log.impact_time / scenario.time_step
        adversary, times[-1] = until_contact(adversary, ticks), log.impact_time
        car = car_until_contact(scenario, car, ticks, log.impact_speed, adversary[-1])
    found = figures_of(scene_of(scenario, times, adversary, car), hit=log.hit)
    return {**found, "clearance": 0.0} if log.outcome == Outcome.COLLISION else found


def played(car: Car, phi: int, seed: int) -> np.ndarray:
    """Return the figures of all runs: simulated and physical × φ × runs × figures."""
    found = np.empty((2, phi, RUNS, len(FIGURES)))
    for physical in (False, True):
        scenario = scenario_of(car, physical=physical)
        plan = Plan(
            scenario=scenario,
            seed=seed + physical,
            controller=car.controller,
            multiplier=car.multiplier,
            safe_count=phi,
        )
        for number, way in enumerate(walks(phi, np.random.default_rng(seed), scenario.time_step)):
            for run in range(RUNS):
                values = figures_in(run_episode(plan.episode(Mode.REPLAY, number, run, way)))
                found[int(physical), number, run] = [values[name] for name in FIGURES]
    return found


def main() -> None:
    """Write the figures of all cars."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, metavar="FILE")
    parser.add_argument("--phi", type=int, default=500, metavar="N", help="of each car")
    parser.add_argument("--seed", type=int, default=0, metavar="N")
    arguments = parser.parse_args()
    found = {}
    for name, car in CARS.items():
        found[name] = played(car, arguments.phi, arguments.seed)
        x, y = found[name][0].mean(axis=1), found[name][1].mean(axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):
            shown = [float(np.corrcoef(x[:, one], y[:, one])[0, 1]) for one in range(len(FIGURES))]
        print(name, "simulated", x.mean(axis=0), "physical", y.mean(axis=0), "correlation", shown, flush=True)
        np.savez_compressed(arguments.out, **found)


if __name__ == "__main__":
    main()
