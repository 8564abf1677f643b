"""The floor of SKD: what clairvoyant kamikazes reach in an assessment's episodes, by the Fréchet distance.

It is exact, and known for the basic car only. The least deformation is the margin (`skd_evaluator.margin`).
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from skd_adversary.model.objectives import objective_named
from skd_adversary.model.road_user import pedestrian
from skd_adversary.model.road_users import road_user_named
from skd_adversary.warm_up import warm_up_episodes
from skd_sim.arrays import FloatArray
from skd_sim.choices.actions import Actions
from skd_sim.choices.car_under_test import CarUnderTest
from skd_sim.choices.objective import Objective
from skd_sim.choices.simulators import WORLD, is_own_world
from skd_sim.encounter.scenario import Scenario
from skd_sim.episode.episode import EpisodeLog, Mode
from skd_sim.errors import UsageError
from skd_sim.geometry.trajectory import Trajectory

from skd_evaluator.campaign.judge.assessment import Assessment
from skd_evaluator.campaign.judge.rating import Rating
from skd_evaluator.campaign.plan.plan import Progress
from skd_evaluator.campaign.run.executor_runner import ExecutorRunner
from skd_evaluator.floor.clairvoyant import clairvoyant_floor
from skd_evaluator.margin.ways.foretold import foretold

LABEL = "clairvoyant floor"
_FARTHEST_END = 3.5  # m; at 3.3 m an episode takes about 0.2 s, at 4.7 m many seconds and two million states


@dataclass(frozen=True)
class _Job:
    log: EpisodeLog  # of the kamikaze that was run
    distance: float  # what it reached, m


def check_floor(
    car: CarUnderTest,
    scenario: Scenario,
    objectives: Iterable[Objective],
    simulator: str = WORLD,
    actions: Actions = Actions.LISTED,
) -> None:
    """Refuse a car whose answers to other actions are not known, and objectives without a Fréchet distance.

    Raises:
        UsageError: it is not the basic one in SKD's own world, on a straight road and beside a pedestrian that is a
            disc; or no objective plans for anything but the deformation, under which the margin is.
    """
    if not is_own_world(simulator):
        raise UsageError(f"--floor needs SKD's own world: what simulator {simulator} would have done is not known")
    if actions != Actions.LISTED:
        raise UsageError(
            f"--floor searches listed actions, and these kamikazes have others: leave out --actions {actions}"
        )
    if all(objective_named(one).plans_deformation for one in objectives):
        raise UsageError(
            "--floor is the floor of the Fréchet distance: add --objective paper, frechet or both; the floor of the "
            "deformation is the margin, which every assessment has"
        )
    kind = scenario.adversary.kind
    if road_user_named(kind) is not pedestrian.ROAD_USER:
        raise UsageError(f"--floor searches what a pedestrian can do, and adversary.kind is {kind}: leave it out")
    if foretold(car, scenario):
        return
    clock = "" if scenario.control_periods == 1 else f" that decides every {scenario.control_duration:g} s"
    named = f"controller {car.controller} with car.dynamics {scenario.car.dynamics}{clock}"
    needs = "the basic controller and car.dynamics basic"
    if not scenario.road.straight or scenario.adversary.is_box:
        named = "a road with curves" if not scenario.road.straight else "an adversary that is a box"
        needs = "a straight road and an adversary that is a disc"
    for what, there in (("obstacles", scenario.obstacles), ("others", scenario.others)):
        if there:
            named, needs = f"one with {what}", f"a scenario without {what}"
    if scenario.end.crossing < 0.0 or scenario.ending is not None:
        named, needs = "another one", "an adversary that crosses to the right, to its destination"
    raise UsageError(f"--floor needs {needs}, not {named}; every car has a margin, which needs no option")


def check_ends(trajectories: Iterable[Trajectory], scenario: Scenario, objectives: Iterable[Objective]) -> None:
    """Refuse safe trajectories that end so far beyond the car's path that the search would need millions of states.

    The way from the path to the end of φ is a lower bound of every distance. Where it is long, nearly every position is
    within such a distance of φ, and the search has next to nothing to leave out.

    By deformation what φ does after the contact does not matter, and nothing is refused.

    Raises:
        UsageError: one ends too far off, and an objective plans for the Fréchet distance.
    """
    if all(objective_named(one).plans_deformation for one in objectives):
        return
    for trajectory in trajectories:
        beyond = float(abs(trajectory.positions[-1, 0])) - scenario.path_edge
        if beyond > _FARTHEST_END:
            raise UsageError(
                f"--floor needs safe trajectories that end within {_FARTHEST_END:g} m of the car's path; "
                f"{trajectory.name!r} ends {beyond:.1f} m beyond it; --objective deformation has no such limit"
            )


def warm_up_floor() -> None:
    """Compile the search, or load it from its cache, before it is timed or forked."""
    for episode in warm_up_episodes():
        if episode.mode == Mode.KAMIKAZE:
            clairvoyant_floor(episode)


def _floor_of(job: _Job) -> float:
    """Return the floor of one episode, m; nan where there is none."""
    # In real time a command can come late, and what then collided need not do so when commands are in time.
    known = clairvoyant_floor(job.log.episode, job.distance) or clairvoyant_floor(job.log.episode)
    return math.nan if known is None else known.distance


def floors_of(
    logs: Sequence[EpisodeLog], distances: Sequence[float], runner: ExecutorRunner, progress: Progress
) -> FloatArray:
    """Return the floor of each of some kamikaze episodes, m; nan where no sequence collides.

    Args:
        logs: what happened in the episodes, whose car `check_floor` accepts.
        distances: what their kamikazes reached, m.
        runner: computes the floors, in several processes.
        progress: told of it.
    """
    floors = np.empty(len(logs))
    jobs = [_Job(log, float(distance)) for log, distance in zip(logs, distances, strict=True)]
    for count, value in enumerate(runner.map(_floor_of, jobs)):
        floors[count] = value
        progress(LABEL, count + 1, len(jobs))
    floors.setflags(write=False)
    return floors


def with_floors(rating: Rating, runner: ExecutorRunner, progress: Progress) -> Rating:
    """Return the rating with the floors of those assessments that have a Fréchet distance; see `with_floor`.

    Raises:
        UsageError: none can have one.
    """
    begin = time.perf_counter()
    plan = rating.plan
    check_floor(
        plan.car, plan.scenario, [one.plan.objective for one in rating.assessments], plan.simulator, plan.actions
    )
    assessments = tuple(
        one if one.plan.limits_deformation else with_floor(one, runner, progress) for one in rating.assessments
    )
    return replace(rating, assessments=assessments, seconds=rating.seconds + time.perf_counter() - begin)


def with_floor(assessment: Assessment, runner: ExecutorRunner, progress: Progress) -> Assessment:
    """Return the assessment with the floor of every pair that counts in SKD.

    Raises:
        UsageError: the car has no floor, or a safe trajectory ends too far beyond the car's path.
    """
    plan = assessment.plan
    check_floor(plan.car, plan.scenario, [plan.objective], plan.simulator, plan.actions)
    check_ends((kamikaze.safe_trajectory for kamikaze in assessment.kamikaze), plan.scenario, [plan.objective])
    begin = time.perf_counter()
    pairs = [
        kamikaze.logs[index]
        for kamikaze, row in zip(assessment.kamikaze, assessment.skd.per_safe_trajectory, strict=True)
        for index in row.kept.tolist()
    ]
    floors = floors_of(pairs, assessment.skd.distances.tolist(), runner, progress)
    return replace(assessment, floors=floors, seconds=assessment.seconds + time.perf_counter() - begin)
