"""Who drives the candidates of a margin's search: processes of this machine, or whoever runs whole episodes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from skd_sim.controllers.isolated import isolated
from skd_sim.controllers.loading import make_controller
from skd_sim.controllers.protocol import Controller, is_sensing, takes_batches
from skd_sim.world.episode import Outcome

from skd_evaluator.assessment.context import Progress, Runner
from skd_evaluator.assessment.run.batches import Replay, replayed, why_not_batched
from skd_evaluator.assessment.run.episodes import run_episode
from skd_evaluator.assessment.run.workers import Workers
from skd_evaluator.margin.search.group import Drive, Group, search
from skd_evaluator.margin.search.search import Rounds, SearchedMargins
from skd_evaluator.margin.search.trial import Trial
from skd_evaluator.metrics.deviation import Hit, hit_of

LABEL = "margin"
SAME = 1e-4
"""m by which a hit may be elsewhere when it is driven again: the two forms of a policy may add up in another order."""


def in_processes(runner: Workers, progress: Progress) -> Rounds:
    """Return what searches groups of trials in several processes, one for each group."""

    def go_on(groups: Sequence[Group], what: str) -> list[Group]:
        found = []
        for count, group in enumerate(runner.map(_search, groups), start=1):
            found.append(group)
            progress(f"{LABEL}, {what}", count, len(groups))
        return found

    return go_on


def one_by_one(groups: Sequence[Group], _what: str) -> list[Group]:
    """Search groups of trials in this process."""
    return [_search_here(group) for group in groups]


def by_episodes(runner: Runner, progress: Progress) -> Rounds:
    """Return what searches all groups at once by whole episodes, as of a stack behind the node graph."""

    def go_on(groups: Sequence[Group], what: str) -> list[Group]:
        search(groups, lambda episodes: list(runner.run(episodes)))
        progress(f"{LABEL}, {what}", 1, 1)
        return list(groups)

    return go_on


def repeated(found: SearchedMargins, runner: Runner) -> tuple[int, int]:
    """Run the best hit of each trial again; return how many there are, and how many hit in the same place again."""
    pairs = [(hit, one) for hit, one in zip(found.hits, found.episodes, strict=True) if hit and one]
    again = 0
    for (hit, _), log in zip(pairs, runner.run([one for _, one in pairs]), strict=True):
        if log.hit:
            place = log.trajectory.positions[-1] - hit.trajectory.positions[-1]
            again += bool(np.hypot(*place) <= SAME)
    return len(pairs), again


def confirmed(found: SearchedMargins, runner: Runner) -> list[Hit | None]:
    """Drive the best hit of each trial again, and return what it hits with then; None: it does not.

    So a hit of a car that does not repeat itself counts by its share, in the mean over trials.
    """
    again = iter(list(runner.run([one for hit, one in zip(found.hits, found.episodes, strict=True) if hit and one])))
    hits: list[Hit | None] = []
    for hit, episode in zip(found.hits, found.episodes, strict=True):
        log = next(again) if hit and episode else None
        if log is None or log.outcome == Outcome.ABORTED:  # a kamikaze's own hit, or nothing is known of the second run
            hits.append(hit)
        else:
            phi = log.episode.safe_trajectory
            hits.append(hit_of(phi.positions, log) if log.hit and phi is not None else None)
    return hits


def _search(group: Group) -> Group:
    return isolated(group.trials[0].episode.car.user_code, _search_here, group)


def _search_here(group: Group) -> Group:
    first = group.trials[0].episode
    controller = make_controller(first.controller, first.multiplier)
    together = not why_not_batched(first)
    if together and takes_batches(controller):
        search([group], replayed)
    elif together and not is_sensing(controller):
        search([group], replays(controller, group.trials))
    else:
        search([group], lambda episodes: [run_episode(one, controller) for one in episodes])
    return group


def replays(controller: Controller, trials: Sequence[Trial]) -> Drive:
    """Return what runs replays of some trials one by one, much faster than `run_episode` does."""
    of_trial = {trial.episode.episode_id: Replay(trial.prescribed) for trial in trials}
    return lambda episodes: [of_trial[one.episode_id].run(one, controller) for one in episodes]
