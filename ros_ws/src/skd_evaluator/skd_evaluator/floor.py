"""The floor of an assessment: what clairvoyant kamikazes reach in its episodes, and how close its own ones come.

It is of the distance that the objective plans for: deformation by objective `deformation`, else the Fréchet distance.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from skd_adversary.warm_up import warm_up_episodes
from skd_sim.episode import Episode, Mode
from skd_sim.errors import UsageError
from skd_sim.objective import Objective
from skd_sim.scenario import Scenario
from skd_sim.trajectory import Trajectory

from skd_evaluator.assessment import Assessment
from skd_evaluator.campaign import Progress
from skd_evaluator.clairvoyant import clairvoyant_floor
from skd_evaluator.clairvoyant_deformation import deformation_floor
from skd_evaluator.rating import Rating
from skd_evaluator.workers import InProcessRunner

LABEL = "clairvoyant floor"
_FARTHEST_END = 3.5  # m; at 3.3 m an episode takes about 0.2 s, at 4.7 m many seconds and two million states


@dataclass(frozen=True)
class _Job:
    episode: Episode
    distance: float  # of the kamikaze that was run, m


def check_floor(controller: str, scenario: Scenario) -> None:
    """Refuse a car whose answer to every action sequence is not known beforehand.

    Raises:
        UsageError: the controller is not the basic one, or the car's dynamics are not.
    """
    if scenario.car.dynamics != "basic":
        raise UsageError(f"--floor needs car.dynamics basic in scenario {scenario.name}, not {scenario.car.dynamics}")
    if controller != "basic":
        raise UsageError(
            f"--floor needs the basic controller: what {controller} would do in answer to other actions is not known"
        )


def check_ends(trajectories: Iterable[Trajectory], scenario: Scenario, objectives: Iterable[Objective]) -> None:
    """Refuse safe trajectories that end so far beyond the car's path that the search would need millions of states.

    The way from the path to the end of φ is a lower bound of every distance. Where it is long, nearly every position is
    within such a distance of φ, and the search has next to nothing to leave out.

    By deformation what φ does after the contact does not matter, and nothing is refused.

    Raises:
        UsageError: one ends too far off, and an objective plans for the Fréchet distance.
    """
    if set(objectives) == {Objective.DEFORMATION}:
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


def _floor_of(job: _Job) -> float:
    """Return the floor (m) of one episode; nan where no sequence collides."""
    search = deformation_floor if job.episode.objective == Objective.DEFORMATION else clairvoyant_floor
    found = search(job.episode, job.distance)
    if found is None:
        # In real time a command can come late, and what then collided need not do so when commands are in time.
        found = search(job.episode)
    return math.nan if found is None else found.distance


def with_floors(rating: Rating, runner: InProcessRunner, progress: Progress) -> Rating:
    """Return the rating with the floors of its assessments; see `with_floor`."""
    begin = time.perf_counter()
    assessments = tuple(with_floor(one, runner, progress) for one in rating.assessments)
    return replace(rating, assessments=assessments, seconds=rating.seconds + time.perf_counter() - begin)


def with_floor(assessment: Assessment, runner: InProcessRunner, progress: Progress) -> Assessment:
    """Return the assessment with the floor of every pair that SKD is the mean of.

    Raises:
        UsageError: the controller or the car's dynamics are not the basic ones, or a safe trajectory ends too far
            beyond the car's path.
    """
    check_floor(assessment.plan.controller, assessment.plan.scenario)
    plan = assessment.plan
    check_ends((kamikaze.safe_trajectory for kamikaze in assessment.kamikaze), plan.scenario, [plan.objective])
    begin = time.perf_counter()
    pairs = [
        kamikaze.logs[index].episode
        for kamikaze, row in zip(assessment.kamikaze, assessment.skd.per_safe_trajectory, strict=True)
        for index in row.kept.tolist()
    ]
    jobs = [_Job(episode, float(one)) for episode, one in zip(pairs, assessment.planned_distances, strict=True)]
    floors: npt.NDArray[np.float64] = np.empty(len(jobs))
    for count, value in enumerate(runner.map(_floor_of, jobs)):
        floors[count] = value
        progress(LABEL, count + 1, len(jobs))
    floors.setflags(write=False)
    return replace(assessment, floors=floors, seconds=assessment.seconds + time.perf_counter() - begin)
