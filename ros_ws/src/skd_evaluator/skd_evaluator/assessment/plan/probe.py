"""Episodes that show how an unknown car reacts: adversaries vary what they do, without a plan or a model of the car.

A parameter shows where the car is near its boundary. So adversaries stand, cross, stop halfway, step out late and walk
along the lane, at many distances, times and speeds: the car meets the distance (or time, or place) at which it begins
to brake again and again, each time at another phase of its ticks.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.controllers import with_control_period
from skd_sim.options.car_under_test import DEFAULT, CarUnderTest
from skd_sim.scenario.road import beside_road
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.episode import Episode, Mode, Role, generator
from skd_sim.world.state import Trajectory

from skd_evaluator.assessment.plan.plan import Stage, episode_id, split_episode_id

MANOEUVRES = ("stand", "along", "cross", "along", "stop", "along", "late", "along")
_APPROACH = 1.5  # times κ: the least distance from which the car comes, beyond the trigger of a cautious car
_LONGEST = 40  # ticks: the car has passed, or stands


def probe_scenario(scenario: Scenario) -> Scenario:
    """Return the scenario with a car that starts far enough away to be seen driving freely first."""
    gap = max(scenario.car.start_gap, _APPROACH * scenario.car.safe_distance)
    spread = max(scenario.car.start_gap_range, scenario.car.start_speed * scenario.time_step)
    car = dataclasses.replace(
        scenario.car, meet_safe_trajectory=False, start_gap=min(gap, 500.0), start_gap_range=min(spread, 50.0)
    )
    return dataclasses.replace(scenario, car=car)


def probe_trajectory(scenario: Scenario, manoeuvre: str, rng: np.random.Generator) -> Trajectory:
    """Return what the adversary of one probe does.

    Args:
        scenario: fixed description of the test.
        manoeuvre: what the adversary does, one of `MANOEUVRES`.
        rng: draws start, times and speeds.
    """
    adversary, step = scenario.adversary, scenario.time_step
    ticks = min(scenario.ticks, _LONGEST)
    edge = scenario.path_edge
    near = max(abs(adversary.start_x), edge + 1.0)
    velocity = np.zeros((ticks, 2))
    x, y = -near, adversary.start_y + rng.uniform(0.0, scenario.car.safe_distance)
    pace = adversary.speed * rng.uniform(0.3, 1.0)
    begin = int(rng.integers(0, 1 + int(3.0 / step)))
    if manoeuvre == "stand":
        x = rng.uniform(-near, near) if rng.random() < 0.5 else rng.uniform(-edge, edge)
    elif manoeuvre == "cross":
        velocity[:, 0] = pace
    elif manoeuvre == "stop":
        velocity[: max(1, round((near + rng.uniform(-edge, edge)) / (pace * step))), 0] = pace
    elif manoeuvre == "late":
        x = -rng.uniform(edge, near)
        velocity[begin:, 0] = pace
    elif manoeuvre == "along":
        x = rng.uniform(-near, near) if rng.random() < 0.5 else rng.uniform(-edge, edge)
        velocity[:, 1] = adversary.speed * rng.uniform(0.7, 1.0) if rng.random() < 0.8 else -0.5 * pace
        tick = 10 + begin
        while tick < ticks:  # stops and goes on: what follows slowly shows the noise of its brake best
            rest = int(rng.integers(2, 10))
            velocity[tick : tick + rest] = 0.0
            tick += rest + int(rng.integers(2, 10))
    else:
        raise ValueError(f"no such manoeuvre: {manoeuvre}")
    offsets: FloatArray = np.array([x, y]) + np.vstack([np.zeros(2), np.cumsum(step * velocity, axis=0)])
    offsets[:, 0] *= scenario.end.crossing
    return Trajectory(beside_road(scenario.road.line, offsets), step, f"probe/{manoeuvre}")


def probed(scenario: Scenario, seed: int, number: int) -> Trajectory:
    """Return what the adversary does in the probe with an id.

    Args:
        scenario: the scenario of the probe, as `probe_scenario` returns it.
        seed: seed of every random draw.
        number: number of the probe's episode, which is its id.
    """
    manoeuvre = MANOEUVRES[split_episode_id(number)[2] % len(MANOEUVRES)]
    return probe_trajectory(scenario, manoeuvre, generator(seed, number, Role.PROBE))


def probe_episodes(
    scenario: Scenario, count: int, *, seed: int, controller: str = DEFAULT, multiplier: float = 1.0
) -> list[Episode]:
    """Return the episodes of a probe; the same seed gives the same ones for every car.

    Args:
        scenario: the scenario of the assessment for which the model is made.
        count: number of episodes; the manoeuvres take turns.
        seed: seed of every random draw.
        controller: name of the car under test, as in `Plan`.
        multiplier: C of the basic controller.
    """
    clocked = with_control_period(scenario, CarUnderTest(controller).control_period, controller)
    seen = probe_scenario(clocked)
    car: dict[str, Any] = {"controller": controller, "multiplier": multiplier}
    episodes = []
    for index in range(count):
        number = episode_id(Stage.PROBE, 0, index)
        trajectory = probed(seen, seed, number)
        episodes.append(Episode(seen, Mode.REPLAY, seed, number, trajectory, public=clocked, **car))
    return episodes
