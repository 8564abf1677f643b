"""Crossings in front of a car whose policy answers many episodes at once: the same as those of any car, and faster."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from skd_sim.controllers.isolated import LostProcessError, isolated
from skd_sim.scenario.road import road_pose

from skd_evaluator.assessment.run.side_by_side import answers_batches, replayed, why_not_side_by_side
from skd_evaluator.assessment.run.workers import ExecutorRunner
from skd_evaluator.metrics.contact_place import goes_straight, pose_at_contact
from skd_evaluator.risk.any_car import NOWHERE, AnyCar, ended, footprint_of
from skd_evaluator.risk.crossings import CrossingPlan, Crossings, Ends
from skd_evaluator.risk.touching import SAME

BLOCK: Final = 250
"""Crossings side by side; the same whoever computes, so that no figure depends on that."""


@dataclass(frozen=True, eq=False)
class _Job:
    """Some crossings, in whatever process."""

    crossing_plan: CrossingPlan
    crossings: Crossings
    scale: float


def batched_car(crossing_plan: CrossingPlan, runner: ExecutorRunner) -> BatchedCar | None:
    """Return who runs crossings side by side; None where the car's policy, or the scenario, has them one by one."""
    car = crossing_plan.plan.car
    if car.is_own or car.is_external:
        return None
    one = Crossings(np.array([0]), np.zeros((1, crossing_plan.walker_normals)), np.empty((1, 0)), np.array([0]))
    if why_not_side_by_side(AnyCar(crossing_plan, runner).episodes(one, 1.0)[0]):
        return None
    (takes,) = runner.map(answers_batches, [car])
    return BatchedCar(crossing_plan, runner) if takes else None


class BatchedCar:
    """Runs crossings side by side, a block at a time."""

    car_normals = 0

    def __init__(self, crossing_plan: CrossingPlan, runner: ExecutorRunner) -> None:
        """Run blocks by `runner`."""
        self._crossing_plan, self._runner = crossing_plan, runner

    def run(self, crossings: Crossings, scale: float) -> Ends:
        """Run crossings; those of a block that a worker has died of, one by one."""
        rows = [np.arange(at, min(at + BLOCK, len(crossings))) for at in range(0, len(crossings), BLOCK)]
        jobs = [_Job(self._crossing_plan, crossings.of(one), scale) for one in rows]
        parts = []
        for job, found in zip(jobs, self._runner.map(_crossed, jobs, _not_crossed), strict=True):
            parts.append(
                AnyCar(self._crossing_plan, self._runner).run(job.crossings, scale) if found is None else found
            )
        return Ends.together(parts)


def _not_crossed(_job: _Job, _reason: str) -> Ends | None:
    return None


def _crossed(job: _Job) -> Ends | None:
    try:
        return isolated(job.crossing_plan.plan.car.user_code, _crossed_here, job)
    except LostProcessError as error:
        return _not_crossed(job, error.reason)


def _crossed_here(job: _Job) -> Ends:
    """Run crossings side by side, and judge each."""
    crossing_plan = job.crossing_plan
    episodes = AnyCar(crossing_plan, None).episodes(job.crossings, job.scale)

    found = replayed(episodes)
    scenario = episodes[0].scenario
    heading, step = float(road_pose(scenario.road.line, 0.0)[2]), scenario.time_step
    touch, missed = np.empty(len(episodes), np.int64), np.empty(len(episodes))
    for row, (ticks, share, impact) in enumerate(
        zip(found.ticks.tolist(), found.shares.tolist(), found.impacts.tolist(), strict=True)
    ):
        last, collided = ticks - 1, share <= 1.0
        passed = (last + share) * step / step - last if collided else 1.0  # as of a log, which has times
        cars, pose = found.cars[row, : ticks + 1], NOWHERE
        if collided:
            pose = pose_at_contact(scenario, cars[-2:], passed, impact)
        touch[row], missed[row] = ended(
            found.users[row, : ticks + 1], cars, np.full(ticks, heading), collided, passed, pose,
            collided and not goes_straight(scenario, cars[-2:]),
            footprint_of(scenario), scenario.adversary.reach, impact, scenario.collision.hit_speed, SAME,
            scenario.time_step,
        )  # fmt: skip
    return Ends(touch, missed, found.ticks)
