"""Episodes that are run in order to learn the car: kamikazes that plan with a model of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from skd_sim.options.adversary import DEFAULT_OBJECTIVES, Objective
from skd_sim.world.episode import Episode, EpisodeLog, Mode, Outcome
from skd_sim.world.state import Trajectory

from skd_evaluator.assessment.plan.plan import EpisodeRunner, Plan, Progress, Stage, episode_id
from skd_evaluator.errors import AssessmentError

SEED: Final = 2_718_281_828
"""Of every draw; no campaign's, unless somebody asks for it."""


def own_trials(
    plan: Plan,
    car_model: str,
    safe: Sequence[Trajectory],
    count: int,
    *,
    begin: int = 0,
    objectives: Sequence[Objective] = DEFAULT_OBJECTIVES,
) -> list[Episode]:
    """Return kamikazes that plan with a model; the objectives take turns.

    Args:
        plan: the plan of the assessment, whose car they meet.
        car_model: the model of the car with which they plan, as an episode carries it.
        safe: φ, from which they start in turn.
        count: how many kamikazes there are.
        begin: number of the first; trials of the same number have their draws in common.
        objectives: the objectives of the kamikazes.
    """
    return [
        Episode(
            plan.scenario,
            Mode.KAMIKAZE,
            SEED,
            episode_id(Stage.LEARNING, number % len(safe), number // len(safe)),
            safe_trajectory=safe[number % len(safe)],
            controller=plan.controller,
            multiplier=plan.multiplier,
            simulator=plan.simulator,
            car_model=car_model,
            objective=objectives[number // len(safe) % len(objectives)],
        )
        for number in range(begin, begin + count)
    ]


def finished(runner: EpisodeRunner, episodes: Sequence[Episode], label: str, progress: Progress) -> list[EpisodeLog]:
    """Run episodes; return the logs of those that were not aborted, in order.

    Raises:
        AssessmentError: all of them were aborted.
    """
    found: list[EpisodeLog] = []
    reason = ""
    for count, log in enumerate(runner.run(episodes), start=1):
        progress(label, count, len(episodes))
        if log.outcome == Outcome.ABORTED:
            reason = log.reason
        else:
            found.append(log)
    if not found:
        raise AssessmentError(f"the car cannot be learned: all {len(episodes)} {label} were aborted ({reason})")
    return found
