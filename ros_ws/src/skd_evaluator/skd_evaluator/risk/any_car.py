"""Crossings in front of any car: whole episodes in which somebody follows the way that the normals say."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.encounter.road import road_pose, road_position
from skd_sim.encounter.scenario import Scenario
from skd_sim.episode.episode import Episode, EpisodeLog, Mode, Outcome
from skd_sim.geometry.contact import rectangle_distance
from skd_sim.geometry.trajectory import Trajectory
from skd_sim.state import AdversaryState

from skd_evaluator.campaign.plan.plan import EpisodeRunner, Stage, episode_id
from skd_evaluator.measure.behaviour.walking import walked
from skd_evaluator.measure.risks import Touch
from skd_evaluator.risk.crossings import Crossings, Encounter, Ends
from skd_evaluator.risk.touching import clearance_of, in_car_frame, side_touched

_TOUCHES: Final = 0.05  # m; the car's way within a tick is taken as straight


class AnyCar:
    """Runs crossings as episodes.

    Attributes:
        hits: logs of those that were run last in which the car hit.
    """

    car_normals = 0

    def __init__(self, encounter: Encounter, runner: EpisodeRunner) -> None:
        """Run episodes by `runner`."""
        self._encounter, self._runner = encounter, runner
        self.hits: list[EpisodeLog] = []
        self._specs: list[Episode] = []
        scenarios: dict[float, Scenario] = {}
        for index, phi in enumerate(encounter.safe):
            # A kamikaze's: its car starts as in an assessment, and is not met by a way that is no φ.
            spec = encounter.plan.episode(Mode.KAMIKAZE, index, 0, phi)
            car = replace(spec.scenario.car, meet_safe_trajectory=False, start_gap=spec.start_gap)
            scenario = scenarios.setdefault(spec.start_gap, replace(spec.scenario, car=car))
            self._specs.append(replace(spec, mode=Mode.REPLAY, scenario=scenario))

    def episodes(self, crossings: Crossings, scale: float) -> list[Episode]:
        """Return the episodes of crossings."""
        found = []
        for phi, normals, draw in zip(crossings.phi.tolist(), crossings.walker, crossings.draw.tolist(), strict=True):
            spec, intended = self._specs[phi], self._encounter.safe[phi]
            way = walked(intended.positions, self._encounter.values, normals, scale, intended.time_step)
            way = until_obstacle(spec.scenario, way)
            number = episode_id(Stage.RISK, phi, draw)
            trajectory = Trajectory(way, intended.time_step, intended.name)
            found.append(replace(spec, episode_id=number, safe_trajectory=trajectory))
        return found

    def run(self, crossings: Crossings, scale: float) -> Ends:
        """Run crossings."""
        logs = list(self._runner.run(self.episodes(crossings, scale)))
        ends = [end_of(log) for log in logs]
        self.hits = [log for log, (touch, _) in zip(logs, ends, strict=True) if touch == Touch.FRONT]
        touch = np.array([one for one, _ in ends], np.int64)
        ticks = np.array([len(log.adversary) - 1 for log in logs], np.int64)
        return Ends(touch, np.array([near for _, near in ends], np.float64), ticks)


def until_obstacle(scenario: Scenario, way: FloatArray) -> FloatArray:
    """Return a way as far as the last tick before it runs into an obstacle, but for its first step."""
    if not len(scenario.rectangles):
        return way
    step = np.diff(way, axis=0) / scenario.time_step
    for tick, (vx, vy) in enumerate(step.tolist()):
        x, y = way[tick + 1].tolist()
        if scenario.ran_into_obstacle(AdversaryState(x, y, vx, vy, 0.0)):
            return way[: max(tick + 1, 2)]
    return way


def end_of(log: EpisodeLog) -> tuple[Touch, float]:
    """Return how a crossing ended, and the least clearance to the front of the moving car, m."""
    if log.outcome == Outcome.ABORTED:
        return Touch.ABORTED, math.inf
    scenario, least, path = log.episode.scenario, math.inf, np.empty((2, 4))
    footprint = (scenario.car.front, scenario.car.rear, scenario.car.half_width)
    radius, hit_speed = scenario.adversary.reach, scenario.collision.hit_speed
    collided, last = log.outcome == Outcome.COLLISION, len(log.car) - 2
    passed = log.impact_time / scenario.time_step - last if collided else 1.0
    for tick in range(last + 1):
        path[:, [0, 1, 3]] = log.car[tick : tick + 2]
        path[:, 2] = _heading(scenario, path)
        here, there = tuple(log.adversary[tick].tolist()), tuple(log.adversary[tick + 1].tolist())
        until = passed if tick == last else 1.0
        least = min(least, float(clearance_of(path, here, there, until, footprint, radius, hit_speed)))
    if not collided or not _is_the_walker(path, here, there, passed, footprint, radius):
        return Touch.NONE, max(least, 1e-9)
    side = Touch(side_touched(path, here, there, passed, footprint, radius, log.impact_speed, hit_speed))
    return side, 0.0 if side == Touch.FRONT else max(least, 1e-9)


def _heading(scenario: Scenario, path: FloatArray) -> float:
    """Return where the car points in a tick, rad: as the road does, for it keeps to it."""
    if scenario.road.straight:
        return float(road_pose(scenario.road.line, 0.0)[2])
    middle = path.mean(axis=0)
    s = float(road_position(scenario.road.line, float(middle[0]), float(middle[1]))[0])
    return float(road_pose(scenario.road.line, s)[2])


def _is_the_walker(
    path: FloatArray,
    here: tuple[float, float],
    there: tuple[float, float],
    share: float,
    footprint: tuple[float, float, float],
    radius: float,
) -> bool:
    """Return whether it is the walker whom the car touches, and not one of the others of the scenario."""
    ahead, left, _ = in_car_frame(path, here, there, share)
    return bool(rectangle_distance(ahead, left, *footprint) <= radius + _TOUCHES)
