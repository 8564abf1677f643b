"""The floor of an assessment: what clairvoyant kamikazes reach in its episodes, and how close its own ones come.

It is of the distance that the objective plans for: deformation by objective `deformation`, else the Fréchet distance.
For the basic car it is exact. Of another car that runs in process a search finds an upper bound on the floor of the
deformation (`anytime_floor`).
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from skd_adversary.model.objectives import objective_named
from skd_adversary.model.road_user import pedestrian
from skd_adversary.model.road_users import road_user_named
from skd_adversary.warm_up import warm_up_episodes
from skd_sim.car_under_test import CarUnderTest
from skd_sim.controllers import Controller, make_controller
from skd_sim.dynamics.kinds import DYNAMICS
from skd_sim.encounter.scenario import Scenario
from skd_sim.episode import EpisodeLog, Mode
from skd_sim.errors import UsageError
from skd_sim.objective import DEFAULT_FLOOR_BUDGET, Objective
from skd_sim.simulator_registry import WORLD, is_own_world
from skd_sim.trajectory import Trajectory

from skd_evaluator.campaign.assessment import Assessment
from skd_evaluator.campaign.executor_runner import ExecutorRunner
from skd_evaluator.campaign.guarded_controller import guard
from skd_evaluator.campaign.plan import Progress
from skd_evaluator.campaign.rating import Rating
from skd_evaluator.floor.anytime import actions_of, anytime_floor
from skd_evaluator.floor.clairvoyant import clairvoyant_floor
from skd_evaluator.floor.clairvoyant_deformation import deformation_floor

LABEL = "clairvoyant floor"
_FARTHEST_END = 3.5  # m; at 3.3 m an episode takes about 0.2 s, at 4.7 m many seconds and two million states

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class _Job:
    log: EpisodeLog  # of the kamikaze that was run
    distance: float  # what it reached, m; nan: it failed
    budget: int  # of the search where the car is not known


def foretold(car: CarUnderTest, scenario: Scenario) -> bool:
    """Tell whether it is known beforehand what a car answers to every sequence of actions: then its floor is exact."""
    known_car = car.is_known and DYNAMICS[scenario.car.dynamics].known and scenario.control_periods == 1
    return known_car and scenario.road.straight and not scenario.pedestrian.is_box


def check_floor(car: CarUnderTest, scenario: Scenario, objectives: Iterable[Objective], simulator: str = WORLD) -> None:
    """Refuse a car that cannot be asked what it would do in answer to other actions.

    Raises:
        UsageError: it runs outside of this process; or it is not the basic one, and no objective plans for deformation;
            or the adversary moves in other ways than those that are searched.
    """
    if not is_own_world(simulator):
        raise UsageError(f"--floor needs SKD's own world: what simulator {simulator} would have done is not known")
    kind = scenario.pedestrian.kind
    if road_user_named(kind) is not pedestrian.ROAD_USER:
        raise UsageError(f"--floor searches what a pedestrian can do, which is not what pedestrian.kind {kind} can")
    if foretold(car, scenario):
        return
    if car.is_external:
        raise UsageError(
            "--floor needs a car that runs in process, as basic, cal, carla or package.module:Class do: what external "
            "would do in answer to other actions is not known"
        )
    if not any(objective_named(one).plans_deformation for one in objectives):
        clock = "" if scenario.control_periods == 1 else f" that decides every {scenario.control_duration:g} s"
        named = f"controller {car.controller} with car.dynamics {scenario.car.dynamics}{clock}"
        needs = "the basic controller and car.dynamics basic"
        if not scenario.road.straight or scenario.pedestrian.is_box:
            named = "a road with curves" if not scenario.road.straight else "an adversary that is a box"
            needs = "a straight road and an adversary that is a disc"
        raise UsageError(
            f"--floor of the Fréchet distance needs {needs}, not {named}; --objective deformation has a floor for it"
        )


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
            deformation_floor(episode)
            anytime_floor(episode, budget=20)


class Floors(NamedTuple):
    """Floors of some episodes.

    Attributes:
        distances: one per episode, m; nan where no sequence collides (of a failed kamikaze: none within η_max).
        gap: none of them is more than this above the least that is possible, m; 0: exact. Infinity where they are what
            a search found.
    """

    distances: FloatArray
    gap: float


def _floor_of(job: _Job) -> tuple[float, float]:
    """Return the floor of one episode, nan where there is none or none was found, and its gap (both in m).

    Of a kamikaze that failed only what is up to η_max is looked for.
    """
    episode = job.log.episode
    if not foretold(episode.car, episode.scenario):
        return _found(job)
    bound = episode.scenario.eta_max if math.isnan(job.distance) else job.distance
    deforms = objective_named(episode.objective).plans_deformation
    search = deformation_floor if deforms else clairvoyant_floor
    try:
        known = search(episode, bound)
        if known is None and not math.isnan(job.distance):
            # In real time a command can come late, and what then collided need not do so when commands are in time.
            known = search(episode)
    except UsageError:  # no room for an exact answer
        if not deforms:
            raise
        return _found(job)
    return (math.nan, 0.0) if known is None else (known.distance, known.gap)


def _found(job: _Job) -> tuple[float, float]:
    """Return what the search for any car finds, nan: nothing, and an infinite gap (both in m)."""
    episode = job.log.episode
    found = anytime_floor(episode, job.budget, actions_of(job.log), lambda: _controller(episode.car))
    return math.nan if found is None else found.distance, math.inf


def _controller(car: CarUnderTest) -> Controller:
    controller = make_controller(car.controller, car.multiplier)
    return controller if car.is_own else guard(controller, car.controller)


def floors_of(
    logs: Sequence[EpisodeLog],
    distances: Sequence[float],
    runner: ExecutorRunner,
    progress: Progress,
    budget: int = DEFAULT_FLOOR_BUDGET,
) -> Floors:
    """Return the floor of each of some kamikaze episodes, by the distance that its objective plans for.

    Args:
        logs: of the episodes, whose car `check_floor` lets pass.
        distances: what their kamikazes reached, m; nan: failed.
        runner: does the work.
        progress: told of it.
        budget: ticks that may be simulated per episode where the car is not known.
    """
    floors, gap = np.empty(len(logs)), 0.0
    jobs = [_Job(log, float(distance), budget) for log, distance in zip(logs, distances, strict=True)]
    for count, (value, one_gap) in enumerate(runner.map(_floor_of, jobs)):
        floors[count], gap = value, max(gap, one_gap)
        progress(LABEL, count + 1, len(jobs))
    floors.setflags(write=False)
    return Floors(floors, gap)


def with_floors(
    rating: Rating, runner: ExecutorRunner, progress: Progress, budget: int = DEFAULT_FLOOR_BUDGET
) -> Rating:
    """Return the rating with the floors of those of its assessments that can have one; see `with_floor`.

    Raises:
        UsageError: none can.
    """
    begin = time.perf_counter()
    plan = rating.plan
    check_floor(plan.car, plan.scenario, [one.plan.objective for one in rating.assessments], plan.simulator)
    assessments = tuple(
        with_floor(one, runner, progress, budget)
        if foretold(plan.car, plan.scenario) or one.plan.limits_deformation
        else one
        for one in rating.assessments
    )
    return replace(rating, assessments=assessments, seconds=rating.seconds + time.perf_counter() - begin)


def with_floor(
    assessment: Assessment, runner: ExecutorRunner, progress: Progress, budget: int = DEFAULT_FLOOR_BUDGET
) -> Assessment:
    """Return the assessment with the floor of every pair that SKD is the mean of.

    By objective `deformation` also with that of the attempts that failed: somebody else might have succeeded.

    Raises:
        UsageError: the car has no floor that can be found, or a safe trajectory ends too far beyond the car's path.
    """
    plan = assessment.plan
    check_floor(plan.car, plan.scenario, [plan.objective], plan.simulator)
    check_ends((kamikaze.safe_trajectory for kamikaze in assessment.kamikaze), plan.scenario, [plan.objective])
    begin = time.perf_counter()
    pairs = [
        kamikaze.logs[index]
        for kamikaze, row in zip(assessment.kamikaze, assessment.skd.per_safe_trajectory, strict=True)
        for index in row.kept.tolist()
    ]
    misses: list[EpisodeLog] = []
    if plan.limits_deformation:
        misses = [log for kamikaze in assessment.kamikaze for log in kamikaze.misses]
    distances = [*assessment.planned_distances.tolist(), *[math.nan] * len(misses)]
    floors = floors_of([*pairs, *misses], distances, runner, progress, budget)
    return replace(
        assessment,
        floors=floors.distances[: len(pairs)],
        missed_floors=floors.distances[len(pairs) :],
        floor_gap=floors.gap,
        floor_budget=None if foretold(plan.car, plan.scenario) else budget,
        seconds=assessment.seconds + time.perf_counter() - begin,
    )
