"""Whether a user's controller always is the same car: a few episodes are run again, and it is asked again, alone.

Two things make a rating worthless, and neither is seen in its figures: a controller that carries something from one
episode into the next, so that it is another car for every order and every number of workers; and one that looks for
what no car can see, whether somebody tries to be hit, say.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from typing import NamedTuple, TypeVar

import numpy as np
from skd_sim.apart.apart import apart
from skd_sim.choices.car_under_test import CarUnderTest
from skd_sim.choices.knowledge import Knowledge
from skd_sim.episode.episode import Episode, EpisodeLog, Mode, Outcome
from skd_sim.errors import UsageError

from skd_evaluator.campaign.judge.rating import DISBELIEF, Rating
from skd_evaluator.campaign.plan.plan import Stage, split_episode_id
from skd_evaluator.campaign.run.alone import Alone, Questions, overhear
from skd_evaluator.campaign.run.executor_runner import ExecutorRunner
from skd_evaluator.campaign.run.led import ALIKE, NEARLY, LedWay, led_otherwise
from skd_evaluator.campaign.run.runner import run_episode
from skd_evaluator.errors import AssessmentError

EPISODES = 12
"""So many are run again, spread over all."""
WAYS = 96
"""So many of the ways on which the search for the margin has led the car are gone again, spread over all."""
_LEARNED_FROM = "of those by which the adversary learned the car, "
_SLOWER = 3.0  # times as long the answers may take as the episodes did

_Item = TypeVar("_Item")

Fresh = Callable[[], AbstractContextManager[ExecutorRunner]]
"""Makes a runner with a process of its own, into which no controller has been loaded."""


class Heard(NamedTuple):
    """An episode that was run again.

    Attributes:
        log: what happened in the episode.
        questions: what its controller was asked, in this order.
        answers: what the controller answered, m/s².
    """

    log: EpisodeLog
    questions: Questions
    answers: list[float]


class DoubtsOfLearning:
    """Whether a car is the same in the episodes from which it was learned: the adversary plans with what they show.

    Attributes:
        found: why it is not, a line each.
    """

    def __init__(self, car: CarUnderTest, fresh: Fresh | None) -> None:
        """Run episodes again by what `fresh` makes; None: nobody looks."""
        self.found: tuple[str, ...] = ()
        self._car, self._fresh = car, None if car.is_own or car.is_external else fresh

    def believed(self, logs: Sequence[EpisodeLog]) -> bool:
        """Tell whether some of the episodes go as before."""
        if self._fresh is not None:
            found = doubts_of_episodes(self._car, logs, (), self._fresh)
            for line in found:
                told = line.removeprefix(DISBELIEF)
                self.found += (f"{DISBELIEF if told != line else ''}{_LEARNED_FROM}{told}",)
        return not self.found


def _heard(episode: Episode) -> Heard:
    """Run an episode again and listen to its controller: in a worker."""
    controller = overhear(apart(episode.car), episode.controller)
    log = run_episode(episode, controller)
    return Heard(log, controller.questions, controller.answers)


def doubts_of_the_controller(rating: Rating, fresh: Fresh) -> tuple[str, ...]:
    """Return, a line each, why a user's controller is not the car that its episodes show; empty if it is.

    Args:
        rating: the rating, whose episodes have been run in process.
        fresh: makes a new process in which episodes are run again; see `Fresh`.
    """
    logs = (*rating.kamikaze_logs, *rating.replays)
    return doubts_of_episodes(rating.plan.car, logs, rating.led, fresh, rating.besides)


def doubts_of_episodes(
    car: CarUnderTest,
    logs: Sequence[EpisodeLog],
    led: Sequence[LedWay],
    fresh: Fresh,
    besides: Sequence[EpisodeLog] = (),
) -> tuple[str, ...]:
    """Return the same of any episodes of a user's car, of which a few are run again.

    Args:
        car: the car.
        logs: its episodes, which have been run in process.
        led: ways on which a search has led it.
        fresh: makes a new process in which episodes are run again; see `Fresh`.
        besides: further episodes, of which as many are run again.
    """
    some = [*_some(besides), *_some(logs)]
    if not some:
        return ()
    with Alone(car) as alone:  # begins while another process runs the episodes again
        return _doubts(car, some, _spread(led, WAYS), fresh, alone)


def _doubts(
    car: CarUnderTest, logs: Sequence[EpisodeLog], led: Sequence[LedWay], fresh: Fresh, alone: Alone
) -> tuple[str, ...]:
    name = car.controller
    try:
        with fresh() as runner:
            runner.start()
            begin = time.perf_counter()
            heard = list(runner.map(_heard, [log.episode for log in logs]))
            seconds = time.perf_counter() - begin
            otherwise = sum(runner.map(led_otherwise, led))
    except (AssessmentError, UsageError) as error:
        return (f"when {len(logs)} episodes were run again to see whether they go as before, this came of it: {error}",)
    changed = [log for log, again in zip(logs, heard, strict=True) if not _same(log, again.log)]
    if changed:
        return (
            f"{len(changed)} of {len(logs)} episodes went otherwise when they were run again, in a new process and in "
            f"another order (the first is {_named(changed[0])}): {name} answers by more than what reset gave it and "
            "what it saw since, as by what it keeps from one episode to the next; so its figures depend on the order "
            "of the episodes and on --workers",
        )
    doubts = _doubts_alone(name, alone, heard, _SLOWER * seconds)
    if otherwise:
        doubts += (
            f"{DISBELIEF}on {otherwise} of {len(led)} ways that the search for the margin tried, {name} answered "
            "otherwise when nobody made copies of it: the margin is that of another car",
        )
    return doubts


def _doubts_alone(name: str, alone: Alone, heard: Sequence[Heard], limit: float) -> tuple[str, ...]:
    found = alone.answers([one.questions for one in heard], limit)
    if isinstance(found, str):
        return (
            f"{name} could not be asked again what it was asked in {len(heard)} episodes, alone in a "
            f"process: {found}; nobody has seen whether it answers by what a car sees",
        )
    far = [
        float(np.max(np.abs(np.subtract(one.answers, answers)), initial=0.0))
        for one, answers in zip(heard, found, strict=True)
    ]
    wrong = [number for number, one in enumerate(far) if one > ALIKE]
    if not wrong:
        return ()
    return (
        f"{DISBELIEF}in {len(wrong)} of {len(heard)} episodes {name} answered otherwise "
        "when it was asked the same alone, in a process that knows nothing of the test (the first is "
        f"{_named(heard[wrong[0]].log)}; by up to {max(far):.3g} m/s²). It answers by something that no car sees",
    )


def _some(logs: Sequence[EpisodeLog]) -> list[EpisodeLog]:
    """Return a few episodes, spread over all, the last first."""
    fit = [
        log
        for log in logs
        if log.outcome != Outcome.ABORTED
        # Its adversary plans with copies of the controller, and would hear what they are asked, too.
        and not (log.episode.mode == Mode.KAMIKAZE and log.episode.knowledge == Knowledge.ITSELF)
    ]
    return _spread(fit, EPISODES)[::-1]


def _spread(items: Sequence[_Item], most: int) -> list[_Item]:
    """Return some items, spread over all."""
    if not items:
        return []
    numbers = np.unique(np.linspace(0, len(items) - 1, min(most, len(items))).round().astype(int))
    return [items[number] for number in numbers.tolist()]


def _same(first: EpisodeLog, second: EpisodeLog) -> bool:
    """Whether two logs of an episode tell the same."""
    if _stage(first) == Stage.RISK:  # which `commands` may have answered, by a little otherwise than `command`
        count = min(len(first.car), len(second.car))
        return np.allclose(first.car[:count], second.car[:count], rtol=0.0, atol=NEARLY)
    if first.outcome != second.outcome or first.adversary.shape != second.adversary.shape:
        return False
    pairs = ((first.adversary, second.adversary), (first.car, second.car))
    return all(np.allclose(one, other, rtol=0.0, atol=ALIKE) for one, other in pairs)


def _stage(log: EpisodeLog) -> Stage:
    return split_episode_id(log.episode.episode_id)[0]


def _named(log: EpisodeLog) -> str:
    kind = "a kamikaze" if log.episode.mode == Mode.KAMIKAZE else "a run along φ"
    kind = {Stage.RISK: "a crossing of the risk", Stage.SAFE: "a static test"}.get(_stage(log), kind)
    return f"{kind}, episode {log.episode.episode_id}"
