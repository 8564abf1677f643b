"""How long kamikazes should wait for a learned car: a few choices are tried against the car itself.

The search knows what it would see next, and so overrates what waiting gains. But with a car that can be hit while it
creeps, too much haste costs as much. Only the car itself shows which of the two it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from skd_adversary.car_models.car_model_file import FittedCar, car_model_text
from skd_adversary.crossing.cars import FOREST_WAITING_REWARD, WAITING_REWARD
from skd_sim.options.adversary import Objective
from skd_sim.world.episode import EpisodeLog
from skd_sim.world.state import Trajectory

from skd_evaluator.assessment.learning.trials import finished, own_trials
from skd_evaluator.assessment.plan.plan import EpisodeRunner, Plan, Progress
from skd_evaluator.metrics.deviation import deviation
from skd_evaluator.metrics.measures import pair_of

CHOICES: Final = (FOREST_WAITING_REWARD, WAITING_REWARD, -0.4)
"""m of deviation for each step after φ's end."""
TRIALS: Final = 60
"""Trials with each choice, which have their draws in common."""
_FIRST: Final = 100  # number of each φ's first trial, beyond those that the car is learned from
_ENOUGH: Final = 0.98  # of the trials hit: what is left to be gained is not in the waiting


def with_waiting_reward(
    plan: Plan,
    car: FittedCar,
    safe: Sequence[Trajectory],
    runner: EpisodeRunner,
    progress: Progress,
) -> FittedCar:
    """Return a learned car with the waiting reward by which kamikazes stray least; one that fails counts as η_max.

    If nearly all are hit with the reward that this kind of model has, it is kept, and nothing else is tried.

    Args:
        plan: the plan of the assessment, whose car it is.
        car: the learned car.
        safe: φ, from which they start in turn.
        runner: runs the episodes; it has been started.
        progress: called with how far the work is.

    Raises:
        AssessmentError: all trials with one of the choices were aborted.
    """
    usual = WAITING_REWARD if car.forest is None else FOREST_WAITING_REWARD
    best, least = usual, np.inf
    for choice in (usual, *(one for one in CHOICES if one != usual)):
        model = car_model_text(replace(car, waiting_reward=choice))
        trials = own_trials(plan, model, safe, TRIALS, begin=_FIRST * len(safe), objectives=(Objective.DEVIATION,))
        logs = finished(runner, trials, f"trials that wait at {-choice:g} m a step", progress)
        mean = float(np.mean([_strayed(log) for log in logs]))
        if mean < least:
            best, least = choice, mean
        if choice == usual and np.mean([log.hit for log in logs]) >= _ENOUGH:
            break
    return replace(car, waiting_reward=best)


def _strayed(log: EpisodeLog) -> float:
    """Return the deviation of a trial, m; η_max where it did not hit."""
    episode = log.episode
    assert episode.safe_trajectory is not None
    if not log.hit:
        return episode.scenario.eta_max
    pair = pair_of(log)
    found = deviation(episode.safe_trajectory.positions, pair.psi.positions, pair.duration)
    return min(found, episode.scenario.eta_max)
