"""Whether a user's controller always is the same car: a few episodes are run again, and it is asked again, alone.

Two things make a rating worthless, and neither is seen in its figures: a controller that carries something from one
episode into the next, so that it is another car for every order and every number of workers; and one that looks for
what no car can see, whether somebody tries to be hit, say.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from functools import partial
from typing import NamedTuple

import numpy as np
from skd_sim.choices.car_under_test import CarUnderTest
from skd_sim.choices.simulators import is_own_world
from skd_sim.controllers import make_controller
from skd_sim.controllers.isolated import isolated
from skd_sim.episode.episode import EpisodeLog, Mode
from skd_sim.errors import UsageError

from skd_evaluator.assessing.otherwise import further_of, hid_hits, is_same, lost_of, named, some_of, went_otherwise
from skd_evaluator.campaign.judge.rating import Rating
from skd_evaluator.campaign.plan.lot import shuffled, spread_by_lot
from skd_evaluator.campaign.run.alone import Alone, Questions, overhear
from skd_evaluator.campaign.run.executor_runner import ExecutorRunner
from skd_evaluator.campaign.run.led import ALIKE, LedAdversary, LedWay, led_again
from skd_evaluator.campaign.run.runner import run_episode
from skd_evaluator.errors import AssessmentError
from skd_evaluator.measure.doubt import DISBELIEF, DOUBT

WAYS = 96
"""So many of the ways on which the search for the margin has led the car are gone again, spread over all."""
_LEARNED_FROM = "of those by which the adversary learned the car, "
_SLOWER = 3.0  # times as long the answers may take as the episodes did
_HITS, _OF_WAYS = 5, 0.05  # on so many ways, and on such a share of them, a car is hit that had not been

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
        seen: some of the episodes from which it was learned just now.
        keep_now: keeps the model that was learned from them, if that was to be done later; tells whether it is kept.
    """

    def __init__(self, car: CarUnderTest, fresh: Fresh | None, *, later: bool = False) -> None:
        """Look at no episode yet.

        Args:
            car: what is learned.
            fresh: makes what runs episodes again; None: nobody does.
            later: whether somebody runs them again later, so that no model is kept before `keep_now` is called.
        """
        self.found: tuple[str, ...] = ()
        self.seen: tuple[EpisodeLog, ...] = ()
        self.keep_now: Callable[[], bool] = lambda: False
        self._car, self._fresh, self._later = car, None if car.is_own or car.is_external else fresh, later

    def believed(self, logs: Sequence[EpisodeLog], keep: Callable[[], bool]) -> bool:
        """Keep the model that was learned by `keep` if some of the episodes go as before; tell whether it is kept."""
        self.seen = tuple(logs)
        if self._later:  # who is ended meanwhile leaves no model of a car at which nobody has looked
            self.keep_now = keep
        if self._fresh is not None:
            found = doubts_of_episodes(self._car, logs, (), self._fresh)
            for line in found:
                told = line.removeprefix(DISBELIEF).removeprefix(DOUBT)
                self.found += (f"{line.removesuffix(told)}{_LEARNED_FROM}{told}",)
        return not self._later and not self.found and keep()


def _heard(log: EpisodeLog) -> Heard:
    """Run an episode again and listen to its controller: in a worker."""
    return isolated(log.episode.car.user_code, _heard_here, log)


def _heard_here(log: EpisodeLog) -> Heard:
    episode = log.episode
    controller = overhear(make_controller(episode.controller), episode.controller)
    again = run_episode(episode, controller)
    return Heard(again, controller.questions, controller.answers)


def _led_again(log: EpisodeLog) -> EpisodeLog:
    """Run an episode again with somebody who is led where whoever planned had gone: in a worker."""
    return isolated(log.episode.car.user_code, _led_again_here, log)


def _led_again_here(log: EpisodeLog) -> EpisodeLog:
    planned = log.episode.mode == Mode.KAMIKAZE
    return run_episode(log.episode, None, _led(log) if planned else None)


def _led(log: EpisodeLog) -> LedAdversary:
    return LedAdversary.along(log.adversary, log.episode.scenario.time_step)


def doubts_of_the_controller(rating: Rating, fresh: Fresh) -> tuple[str, ...]:
    """Return, a line each, why a user's controller is not the car that its episodes show; empty if it is.

    Args:
        rating: the rating, whose episodes have been run in process.
        fresh: makes a new process in which episodes are run again; see `Fresh`.
    """
    lost = [log for one in rating.assessments for group in one.kamikaze for log in group.lost]
    logs = (*rating.kamikaze_logs, *rating.replays, *lost)
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
    some = [*some_of(besides)[::-1], *some_of(logs)[::-1]]
    if not some:
        return ()
    with Alone(car) as alone:  # begins while another process runs the episodes again
        # None of another simulator, which are slow.
        own = ([log for log in group if is_own_world(log.episode.simulator)] for group in (besides, logs))
        further = shuffled([log for group in own for log in further_of(group, some)])
        hidden = partial(_hidden_hits, car.controller, [*besides, *logs], some[0])
        return _doubts(car, some, further, spread_by_lot(led, WAYS), fresh, alone, hidden)


def _doubts(
    car: CarUnderTest,
    logs: Sequence[EpisodeLog],
    further: Sequence[EpisodeLog],
    led: Sequence[LedWay],
    fresh: Fresh,
    alone: Alone,
    hidden: Callable[[ExecutorRunner], tuple[str, ...]],
) -> tuple[str, ...]:
    name, every = car.controller, [*logs, *further]
    try:
        with fresh() as runner:
            runner.start()
            begin = time.perf_counter()
            heard = list(runner.map(_heard, logs))
            seconds = time.perf_counter() - begin
            again = [*(one.log for one in heard), *runner.map(_led_again, further)]
            ways = list(runner.map(led_again, led))
            hid = hidden(runner)
    except (AssessmentError, UsageError) as error:
        return (
            f"{DOUBT}when {len(every)} episodes were run again to see whether they go as before, this came of it: "
            f"{error}",
        )
    otherwise, touched = (sum(column) for column in zip(*ways, strict=True)) if ways else (0, 0)
    copies = (
        f"on {otherwise} of {len(led)} ways that the search for the margin tried, {name} answered otherwise when "
        "nobody made copies of it"
    )
    changed = [(log, other) for log, other in zip(every, again, strict=True) if not is_same(log, other)]
    if changed:
        found: tuple[str, ...] = (went_otherwise(name, changed, len(every)),)
        if otherwise:  # which may come of the same; but no margin is right on whose ways others are hit
            sure = touched >= _HITS and touched >= _OF_WAYS * len(led)
            hits = f", and hit on {touched} of them where it had not" if touched else ""
            found += (
                f"{DISBELIEF if sure else DOUBT}{copies}{hits}: the margin {'is' if sure else 'may be'} that of "
                "another car",
            )
        return (*found, *hid)
    doubts = _doubts_alone(name, alone, heard, _SLOWER * seconds)
    if otherwise:
        doubts += (f"{DISBELIEF}{copies}: the margin is that of another car",)
    return (*doubts, *hid)


def _hidden_hits(name: str, logs: Sequence[EpisodeLog], fine: EpisodeLog, runner: ExecutorRunner) -> tuple[str, ...]:
    """Run some aborted episodes again, each after one that is fine; see `hid_hits`.

    Where one process after the other ends before it has finished anything, the work would end.
    """
    pairs = [(log, list(runner.run([fine.episode, log.episode]))[1]) for log in lost_of(logs)]
    return hid_hits(name, pairs, logs)


def _doubts_alone(name: str, alone: Alone, heard: Sequence[Heard], limit: float) -> tuple[str, ...]:
    found = alone.answers([one.questions for one in heard], limit)
    if isinstance(found, str):
        return (
            f"{DOUBT}{name} could not be asked again what it was asked in {len(heard)} episodes, alone in a "
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
        f"{named(heard[wrong[0]].log)}; by up to {max(far):.3g} m/s²). It answers by something that no car sees",
    )
