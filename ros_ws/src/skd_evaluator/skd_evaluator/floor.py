"""The floor under SKD: what clairvoyant kamikazes reach in the episodes of an assessment, and how close SKD comes."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from skd_adversary.warm_up import warm_up_episodes
from skd_sim.episode import Episode, Mode
from skd_sim.errors import UsageError

from skd_evaluator.assessment import Assessment
from skd_evaluator.campaign import Progress
from skd_evaluator.clairvoyant import clairvoyant_floor
from skd_evaluator.workers import InProcessRunner

LABEL = "clairvoyant floor"


@dataclass(frozen=True)
class _Job:
    episode: Episode
    distance: float  # of the kamikaze that was run, m


def check_floor(controller: str) -> None:
    """Refuse a car whose answer to every action sequence is not known beforehand.

    Raises:
        UsageError: the controller is not the basic one.
    """
    if controller != "basic":
        raise UsageError(
            f"--floor needs the basic controller: what {controller} would do in answer to other actions is not known"
        )


def warm_up_floor() -> None:
    """Compile the search, or load it from its cache, before it is timed or forked."""
    for episode in warm_up_episodes():
        if episode.mode == Mode.KAMIKAZE:
            clairvoyant_floor(episode)


def _floor_of(job: _Job) -> float:
    """Return the floor (m) of one episode; nan where no sequence collides."""
    found = clairvoyant_floor(job.episode, job.distance)
    if found is None:
        # In real time a command can come late, and what then collided need not do so when commands are in time.
        found = clairvoyant_floor(job.episode)
    return math.nan if found is None else found.distance


def with_floor(assessment: Assessment, runner: InProcessRunner, progress: Progress) -> Assessment:
    """Return the assessment with the floor of every pair that SKD is the mean of.

    Raises:
        UsageError: the controller is not the basic one.
    """
    check_floor(assessment.plan.controller)
    begin = time.perf_counter()
    jobs = [
        _Job(kamikaze.logs[index].episode, float(distance))
        for kamikaze, row in zip(assessment.kamikaze, assessment.skd.per_safe_trajectory, strict=True)
        for index, distance in zip(row.kept.tolist(), row.distances, strict=True)
    ]
    floors: npt.NDArray[np.float64] = np.empty(len(jobs))
    for count, value in enumerate(runner.map(_floor_of, jobs)):
        floors[count] = value
        progress(LABEL, count + 1, len(jobs))
    floors.setflags(write=False)
    return replace(assessment, floors=floors, seconds=assessment.seconds + time.perf_counter() - begin)
