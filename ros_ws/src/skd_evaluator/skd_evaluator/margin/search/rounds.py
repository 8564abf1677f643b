"""How the candidates of a margin's search are driven: in processes of this machine, or as whole episodes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from skd_sim.controllers.controller import Controller, is_sensing, make_controller, takes_batches
from skd_sim.controllers.isolated import isolated
from skd_sim.world.episode import EpisodeSpec, Outcome

from skd_evaluator.assessment.context import Progress, Runner
from skd_evaluator.assessment.run.episodes import Replay, replayed, run_episode, why_not_batched
from skd_evaluator.assessment.run.workers import Workers
from skd_evaluator.margin.search.group import Drive, Group, search
from skd_evaluator.margin.search.search import Rounds, SearchedMargins
from skd_evaluator.margin.search.trial import Trial
from skd_evaluator.metrics.deviation import Hit, hit_of

LABEL = "margin"
_TOGETHER = 3
"""Groups whose candidates a policy that answers many episodes at once is given together."""
SAME = 1e-4
"""m by which a hit may be elsewhere when it is driven again: the two forms of a policy may add up in another order."""


def in_processes(runner: Workers, progress: Progress) -> Rounds:
    """Return what searches groups of trials in several processes, some groups at once in each."""

    def go_on(groups: Sequence[Group], what: str) -> list[Group]:
        found: list[Group] = []
        progress(f"{LABEL}, {what}", 0, len(groups))
        for some in runner.map(_search, [groups[at : at + _TOGETHER] for at in range(0, len(groups), _TOGETHER)]):
            found += some
            progress(f"{LABEL}, {what}", len(found), len(groups))
        return found

    return go_on


def one_by_one(groups: Sequence[Group], _what: str) -> list[Group]:
    """Search groups of trials in this process."""
    return _search_here(groups)


def by_episodes(runner: Runner, progress: Progress) -> Rounds:
    """Return what searches all groups at once by whole episodes, as of a stack behind the node graph."""

    def go_on(groups: Sequence[Group], what: str) -> list[Group]:
        progress(f"{LABEL}, {what}", 0, 1)
        search(groups, lambda episodes: list(runner.run(episodes)))
        progress(f"{LABEL}, {what}", 1, 1)
        return list(groups)

    return go_on


def confirmed(
    trials: Sequence[EpisodeSpec], found: SearchedMargins, runner: Runner, within: float = SAME
) -> list[Hit | None]:
    """Run the best hit of each trial again, and return what it hits with then, within so many m of the place; or None.

    A hit of whose second run nothing is known stays as it is.
    """
    again = iter(list(runner.run([one for hit, one in zip(found.hits, found.episodes, strict=True) if hit and one])))
    hits: list[Hit | None] = []
    for trial, hit, episode in zip(trials, found.hits, found.episodes, strict=True):
        log, phi = next(again) if hit and episode else None, trial.safe_trajectory
        if hit is None or log is None or phi is None or log.outcome == Outcome.ABORTED:
            hits.append(hit)
        elif log.hit and np.hypot(*(log.trajectory.positions[-1] - hit.trajectory.positions[-1])) <= within:
            hits.append(hit_of(phi.positions, log))
        else:
            hits.append(None)
    return hits


def _search(groups: Sequence[Group]) -> list[Group]:
    return isolated(groups[0].trials[0].episode.car.user_code, _search_here, groups)


def _search_here(groups: Sequence[Group]) -> list[Group]:
    first = groups[0].trials[0].episode
    controller = make_controller(first.controller, first.multiplier)
    together = not why_not_batched(first)
    if together and takes_batches(controller):
        search(groups, replayed)
    elif together and not is_sensing(controller):
        search(groups, replays(controller, [trial for group in groups for trial in group.trials]))
    else:
        search(groups, lambda episodes: [run_episode(one, controller) for one in episodes])
    return list(groups)


def replays(controller: Controller, trials: Sequence[Trial]) -> Drive:
    """Return what runs replays of some trials one by one, much faster than `run_episode` does."""
    of_trial = {trial.episode.episode_id: Replay(trial.prescribed) for trial in trials}
    return lambda episodes: [of_trial[one.episode_id].run(one, controller) for one in episodes]
