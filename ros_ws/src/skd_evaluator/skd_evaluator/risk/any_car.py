"""Crossings in front of any car: whole episodes in which somebody follows the way that the normals say."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.kernels.compilation import kernel
from skd_sim.scenario.road import road_pose, road_position
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.episode import Episode, EpisodeLog, Mode, Outcome
from skd_sim.world.state import AdversaryState, Trajectory

from skd_evaluator.assessment.judge.collision_partner import ADVERSARY, collision_partner
from skd_evaluator.assessment.plan.plan import EpisodeRunner, Stage, episode_id
from skd_evaluator.metrics.behaviour.walking import walked
from skd_evaluator.metrics.contact_place import Pose, car_at_contact, goes_straight
from skd_evaluator.metrics.risks import Touch
from skd_evaluator.risk.crossings import CrossingPlan, Crossings, Ends
from skd_evaluator.risk.touching import IN_A_CURVE, SAME, in_car_frame, missed_by, side_touched

NOWHERE: Final = (0.0, 0.0, 0.0)
"""Pose at a contact where there is none."""


class AnyCar:
    """Runs crossings as episodes.

    Attributes:
        hits: logs of those that were run last in which the car hit.
    """

    car_normals = 0

    def __init__(self, crossing_plan: CrossingPlan, runner: EpisodeRunner | None) -> None:
        """Run episodes by `runner`; without one they can only be asked for."""
        self._crossing_plan, self._runner = crossing_plan, runner
        self.hits: list[EpisodeLog] = []
        self._specs: list[Episode] = []
        scenarios: dict[float, Scenario] = {}
        for index, phi in enumerate(crossing_plan.safe):
            # A kamikaze's: its car starts as in an assessment, and is not met by a way that is no φ.
            spec = crossing_plan.plan.episode(Mode.KAMIKAZE, index, 0, phi)
            car = replace(spec.scenario.car, meet_safe_trajectory=False, start_gap=spec.start_gap)
            scenario = scenarios.setdefault(spec.start_gap, replace(spec.scenario, car=car))
            self._specs.append(replace(spec, mode=Mode.REPLAY, scenario=scenario, public=spec.public_scenario))

    def episodes(self, crossings: Crossings, scale: float) -> list[Episode]:
        """Return the episodes of crossings."""
        found = []
        for phi, normals, draw in zip(crossings.phi.tolist(), crossings.walker, crossings.draw.tolist(), strict=True):
            spec, intended = self._specs[phi], self._crossing_plan.safe[phi]
            way = walked(intended.positions, self._crossing_plan.values, normals, scale, intended.time_step)
            way = until_obstacle(spec.scenario, way)
            number = episode_id(Stage.RISK, phi, draw)
            trajectory = Trajectory(way, intended.time_step, intended.name)
            found.append(replace(spec, episode_id=number, safe_trajectory=trajectory))
        return found

    def run(self, crossings: Crossings, scale: float) -> Ends:
        """Run crossings."""
        assert self._runner is not None
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
    """Return how a crossing ended, and the least time by which the front of the moving car missed, s."""
    if log.outcome == Outcome.ABORTED:
        return Touch.ABORTED, math.inf
    scenario, last = log.episode.scenario, len(log.car) - 2
    collided = log.outcome == Outcome.COLLISION
    pose, passed = car_at_contact(log) if collided else (NOWHERE, 1.0)
    headings = np.array([_heading(scenario, log.car[tick : tick + 2]) for tick in range(last + 1)])
    touch, missed = ended(
        np.ascontiguousarray(log.adversary), np.ascontiguousarray(log.car), headings,
        collision_partner(log) == ADVERSARY, passed, pose,
        collided and not goes_straight(scenario, log.car[-2:]), footprint_of(scenario), scenario.adversary.reach,
        log.impact_speed, scenario.collision.hit_speed, SAME if scenario.road.straight else IN_A_CURVE,
        scenario.time_step,
    )  # fmt: skip
    return Touch(touch), missed


def footprint_of(scenario: Scenario) -> tuple[float, float, float]:
    """Return front, rear and half width of the car, m."""
    return scenario.car.front, scenario.car.rear, scenario.car.half_width


def _heading(scenario: Scenario, ends: FloatArray) -> float:
    """Return where the car points in a tick between two of its places, rad: as the road does, for it keeps to it."""
    if scenario.road.straight:
        return float(road_pose(scenario.road.line, 0.0)[2])
    x, y = ends[:, :2].mean(axis=0).tolist()
    return float(road_pose(scenario.road.line, float(road_position(scenario.road.line, x, y)[0]))[2])


@kernel
def ended(
    users: FloatArray,
    cars: FloatArray,
    headings: FloatArray,
    touched: bool,
    passed: float,
    pose: Pose,
    carried: bool,
    footprint: tuple[float, float, float],
    radius: float,
    impact: float,
    hit_speed: float,
    same: float,
    time_step: float,
) -> tuple[int, float]:
    """Return how a crossing ended, a `Touch`, and the least time by which the front of the moving car missed, s.

    Args:
        users: places of somebody at ticks, n × 2, m.
        cars: places (m) and speeds (m/s) of the car at ticks, n × 3.
        headings: of the car in each tick, n − 1, rad.
        touched: whether the car touched somebody in the last tick, and not one of the others.
        passed: share of the last tick that counts: up to the contact, with whomever, or all of it.
        pose: of the car at the contact, m and rad.
        carried: whether that is not where it would be between both ends of the tick.
        footprint: of the car: front, rear and half width, m.
        radius: of the disc, m.
        impact: speed of the car at the contact, m/s.
        hit_speed: of a hit, at the least, m/s.
        same: how exactly it is known how far beside the car somebody is, m.
        time_step: duration of a tick, s.
    """
    least, path, last = math.inf, np.empty((2, 4)), headings.shape[0] - 1
    for tick in range(last + 1):
        for end in range(2):
            path[end, 0], path[end, 1] = cars[tick + end, 0], cars[tick + end, 1]
            path[end, 2], path[end, 3] = headings[tick], cars[tick + end, 2]
        here, there = (users[tick, 0], users[tick, 1]), (users[tick + 1, 0], users[tick + 1, 1])
        until = passed if tick == last else 1.0
        if carried and tick == last:  # the tick ends at the contact
            path[1, 0], path[1, 1], path[1, 2], path[1, 3] = pose[0], pose[1], pose[2], impact
            there = (here[0] + passed * (there[0] - here[0]), here[1] + passed * (there[1] - here[1]))
            until = 1.0
        least = min(least, missed_by(path, here, there, until, footprint, radius, hit_speed, time_step))
    if not touched:
        return 0, max(least, 1e-9)
    ahead, left, _ = in_car_frame(path, here, there, until)
    side = side_touched(ahead, left, footprint, radius, impact, hit_speed, same)
    return side, 0.0 if side == 1 else max(least, 1e-9)
