"""Who drives the candidates of a margin's search: processes of this machine, or whoever runs whole episodes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from skd_sim.controllers import make_controller, takes_batches
from skd_sim.controllers.isolated import isolated
from skd_sim.world.episode import Episode, EpisodeLog, Outcome

from skd_evaluator.assessment.plan import Progress, Runner
from skd_evaluator.assessment.run.batches import replayed, why_not_side_by_side
from skd_evaluator.assessment.run.episodes import run_episode
from skd_evaluator.assessment.run.workers import Workers
from skd_evaluator.margin.search.group import Group, search
from skd_evaluator.margin.search.search import Rounds, SearchedMargins

LABEL = "margin"
SAME = 1e-4
"""m by which a hit may be elsewhere when it is driven again: the two forms of a policy may add up in another order."""


def in_processes(runner: Workers, progress: Progress) -> Rounds:
    """Return what searches groups of trials in several processes, one for each group."""

    def go_on(groups: Sequence[Group], budget: int, what: str) -> list[Group]:
        found = []
        for count, group in enumerate(runner.map(_search, [(group, budget) for group in groups]), start=1):
            found.append(group)
            progress(f"{LABEL}, {what}", count, len(groups))
        return found

    return go_on


def one_by_one(groups: Sequence[Group], budget: int, _what: str) -> list[Group]:
    """Search groups of trials in this process."""
    return [_search_here((group, budget)) for group in groups]


def by_episodes(runner: Runner, progress: Progress) -> Rounds:
    """Return what searches all groups at once by whole episodes, as of a stack behind the node graph."""

    def go_on(groups: Sequence[Group], budget: int, what: str) -> list[Group]:
        search(groups, budget, lambda episodes: list(runner.run(episodes)))
        progress(f"{LABEL}, {what}", 1, 1)
        return list(groups)

    return go_on


def repeated(found: SearchedMargins, runner: Runner) -> tuple[int, int]:
    """Run the best hit of each trial again; return how many there are, and how many hit in the same place again."""
    pairs = [(way, hit) for way, hit in zip(found.ways, found.hits, strict=True) if way is not None and hit is not None]
    again = 0
    for (way, _), log in zip(pairs, runner.run([hit for _, hit in pairs]), strict=True):
        if log.hit:
            place = log.trajectory.positions[-1] - way.trajectory.positions[-1]
            again += bool(np.hypot(*place) <= SAME)
    return len(pairs), again


def _search(job: tuple[Group, int]) -> Group:
    return isolated(job[0].trials[0].episode.car.user_code, _search_here, job)


def _search_here(job: tuple[Group, int]) -> Group:
    group, budget = job
    first = group.trials[0].episode
    controller = make_controller(first.controller, first.multiplier)
    if takes_batches(controller) and not why_not_side_by_side(first):
        search([group], budget, _side_by_side)
    else:
        search([group], budget, lambda episodes: [run_episode(one, controller) for one in episodes])
    return group


def _side_by_side(episodes: Sequence[Episode]) -> list[EpisodeLog]:
    """Run replays of a policy that answers many at once."""
    if not episodes:
        return []
    found, logs = replayed(episodes), []
    for row, episode in enumerate(episodes):
        ticks = int(found.ticks[row])
        users, cars = found.users[row, : ticks + 1], found.cars[row, : ticks + 1]
        if found.shares[row] <= 1.0:
            time = (ticks - 1 + float(found.shares[row])) * episode.scenario.time_step
            logs.append(EpisodeLog(episode, Outcome.COLLISION, users, cars, time, float(found.impacts[row])))
        else:
            logs.append(EpisodeLog(episode, Outcome.ARRIVED, users, cars))
    return logs
