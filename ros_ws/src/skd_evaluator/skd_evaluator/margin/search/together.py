"""Searches for the margins of several attempts side by side, whose policy is asked for all of them at once.

Each search goes on in a thread of its own until it needs a command, and then waits until all others do, too: one call
answers them all. Who is asked together follows from the attempts alone, so that no figure depends on who computes.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from skd_sim.controllers import make_controller
from skd_sim.controllers.isolated import isolated
from skd_sim.controllers.user_controller import UserController
from skd_sim.encounter.scenario import Scenario
from skd_sim.episode.episode import Episode
from skd_sim.episode.randomness import controller_generator, controller_seed
from skd_sim.state import AdversaryState, CarState

from skd_evaluator.margin.search.search import SearchResult, search_margin

GROUP: Final = 16
"""Attempts side by side."""


def can_be_together(episode: Episode) -> bool:
    """Tell whether the policy of a car may be asked for several attempts like this one at once, if it answers that."""
    return not (episode.car.is_own or episode.car.is_external or episode.scenario.others)


class _Table:
    """Where the searches wait for one another."""

    def __init__(self, policy: UserController, seats: int) -> None:
        self.turn = threading.Condition()
        self._policy, self._left = policy, seats
        self._asked: dict[int, tuple[float, ...]] = {}
        self._answers: dict[int, float | BaseException] = {}

    def ask(self, seat: int, numbers: tuple[float, ...]) -> float:
        """Return the command in a state of one search, once all others that go on have asked, too."""
        with self.turn:
            self._asked[seat] = numbers
            self._serve()
            while seat not in self._answers:
                self.turn.wait()
            answer = self._answers.pop(seat)
        if isinstance(answer, BaseException):
            raise answer
        return answer

    def leave(self) -> None:
        """Be waited for no more."""
        with self.turn:
            self._left -= 1
            self._serve()

    def _serve(self) -> None:
        if not self._asked or len(self._asked) < self._left:
            return
        seats = sorted(self._asked)
        try:
            found = self._policy.commands(np.array([self._asked[seat] for seat in seats]).T)
            self._answers.update(zip(seats, found.tolist(), strict=True))
        except BaseException as error:  # every search is to end by it
            self._answers.update(dict.fromkeys(seats, error))
        self._asked.clear()
        self.turn.notify_all()


class _Seated:
    """The policy as one search sees it: without a memory, so that a copy of it is the same."""

    takes_scene = False  # the policy's own process makes the scene

    def __init__(self, table: _Table, seat: int, control_period: float | None) -> None:
        self._table, self._seat, self.control_period = table, seat, control_period

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Do nothing: the policy was reset for all searches."""

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        """Wait for the command; see `Controller.command`."""
        return self._table.ask(self._seat, (*car, *adversary))

    def __deepcopy__(self, memo: dict[int, Any]) -> _Seated:
        return self


class _Alone:
    """A controller of its own, asked one by one while no other thread asks."""

    def __init__(self, table: _Table, controller: UserController) -> None:
        self._table, self._controller = table, controller
        self.control_period, self.takes_scene = controller.control_period, controller.takes_scene

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Pass the call on."""
        with self._table.turn:
            self._controller.reset(scenario, rng)

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        """Pass the call on."""
        with self._table.turn:
            return self._controller.command(car, adversary)


def search_side_by_side(jobs: Sequence[Any]) -> list[SearchResult]:
    """Do jobs (`attempts.SearchJob`) of one car that takes batches.

    Raises:
        AssessmentError: the controller fails, or `command` answers otherwise than `commands` on a way that was found.
    """
    return isolated(jobs[0].episode.car.user_code, _search_side_by_side, jobs)


def _made(episode: Episode) -> UserController:
    made = make_controller(episode.controller)
    assert isinstance(made, UserController)
    return made


def _search_side_by_side(jobs: Sequence[Any]) -> list[SearchResult]:
    first = jobs[0].episode
    policy = _made(first)
    policy.reset(first.public_scenario, controller_generator(controller_seed(first.seed, first.episode_id)))
    singles = [_made(first) for _ in jobs]
    table = _Table(policy, len(jobs))
    results: list[SearchResult | None] = [None] * len(jobs)
    errors: dict[int, BaseException] = {}

    def search(seat: int) -> None:
        job = jobs[seat]
        try:
            results[seat] = search_margin(
                job.episode,
                job.budget,
                job.ways,
                lambda: _Seated(table, seat, policy.control_period),
                job.samples,
                walks=lambda: _Alone(table, singles[seat]),
            )
        except BaseException as error:  # raised below, in the process's own thread
            errors[seat] = error
        finally:
            table.leave()

    threads = [threading.Thread(target=search, args=(seat,), daemon=True) for seat in range(len(jobs))]
    for one in threads:
        one.start()
    for one in threads:
        one.join()
    if errors:
        raise errors[min(errors)]
    return [one for one in results if one is not None]
