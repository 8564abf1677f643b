"""The trials of one φ, searched together: candidates are driven, and whatever hits is offered to all of them.

Candidates come from five sources: plans in a surrogate model of the controller, excursions from φ, changes of a trial's
own best hit, of its near misses, and of the best hits of other trials. Half of the effort goes to plans, the other half
to what has brought most lately. Effort is counted in candidates that were driven; a plan counts as what it takes.
"""

from __future__ import annotations

import copy
from collections import deque
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from skd_sim.arrays import IntArray
from skd_sim.world.episode import EpisodeLog, EpisodeSpec

from skd_evaluator.margin.search.planner import TrialPlanner
from skd_evaluator.margin.search.surrogate import Surrogate
from skd_evaluator.margin.search.trial import ActionSpace, Candidate, Trial, changed, excursion

Drive = Callable[[Sequence[EpisodeSpec]], Iterable[EpisodeLog]]
"""Runs episodes and returns their logs in order."""
PLAN, EXCURSION, OWN, NEAR_MISS, OTHER = SOURCES = (
    "plans",
    "excursions from φ",
    "changed hits",
    "changed near misses",
    "other trials",
)
_PLANS: Final = 1.0  # share of plans, on top of what they have earned; the shares of all sources add up to 1
_LEAST: Final = 0.1  # share of any other source
_FORGETS: Final = 0.998
_PRIOR: Final = 20.0  # m gained, and candidates driven, before anything is known of a source
_TRIES: Final = 20  # candidates in a row that cannot be better than the best


class Proposal(NamedTuple):
    """What is to be driven next in a trial."""

    trial: int
    source: str
    offered: bool
    candidate: Candidate
    episode: EpisodeSpec


@dataclass
class Brought:
    """What a source has brought: its candidates, how many were better hits, and by how much in all, m."""

    candidates: int = 0
    hits: int = 0
    lowered: float = 0.0


class Group:
    """Trials of one φ that share what they find.

    Attributes:
        trials: in the order of the episodes.
        space: where sequences of actions lead.
        spent: candidates driven, and plans as what they take.
        reasons: why episodes were aborted, one each.
        brought: what each source has brought.
    """

    def __init__(self, episodes: Sequence[EpisodeSpec], excursions: int, free_plans: bool = False) -> None:
        """Begin with φ itself and some excursions from it.

        Args:
            episodes: kamikaze mode, all with the same φ; their objective does not matter.
            excursions: for each trial.
            free_plans: whether to drive a candidate takes so long that plans do not count.
        """
        first = episodes[0]
        assert first.safe_trajectory is not None
        self.space = space = ActionSpace(first.scenario, first.safe_trajectory.positions)
        self.trials = [Trial(episode, space) for episode in episodes]
        self.surrogate = Surrogate(first.scenario.control_periods > 1)
        self.spent = 0
        self.reasons: list[str] = []
        self.brought = {source: Brought() for source in SOURCES}
        self._planners = [TrialPlanner(trial, self.surrogate) for trial in self.trials] if space.is_pedestrian else []
        self._plan_cost = 0.0 if free_plans else 1.0
        self._rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence((first.seed, first.episode_id))))
        self._gain = dict.fromkeys(SOURCES, _PRIOR)
        self._cost = dict.fromkeys(SOURCES, _PRIOR)
        self._effort = dict.fromkeys(SOURCES, 1.0)
        self._known: set[bytes] = set()
        self._others: list[IntArray] = []  # best hits of trials that are searched elsewhere
        self._offers: list[deque[tuple[IntArray, str]]] = [deque() for _ in self.trials]
        drawn = [self._excursion() for _ in range(excursions * len(self.trials))]
        at_end = min(space.ticks, len(space.path))
        order = np.argsort([space.candidate(one).deviations[at_end] for one in drawn], kind="stable")
        for place, number in enumerate(order.tolist()):
            self._offers[place % len(self.trials)].append((drawn[number], EXCURSION))
        self.offer(np.full(space.ticks, space.as_phi, np.int64), OTHER)

    @property
    def is_done(self) -> bool:
        """Whether nothing less can be found in any trial."""
        return all(trial.is_done for trial in self.trials)

    @property
    def has_offers(self) -> bool:
        """Whether something was offered that was not driven yet."""
        return any(self._offers)

    @property
    def found(self) -> list[IntArray]:
        """Actions of the best hits, by deviation, each once."""
        trials = sorted((one for one in self.trials if one.actions is not None), key=lambda one: one.least)
        mine = [one.actions for one in trials if one.actions is not None]
        return list({actions.tobytes(): actions for actions in (*mine, *self._others)}.values())

    def part(self, ids: Container[int]) -> Group:
        """Return a group of its own of the trials whose episodes have these ids; it may be empty."""
        other = copy.deepcopy(self)
        kept = [index for index, one in enumerate(self.trials) if one.episode.episode_id in ids]
        other._others = self.found
        other.trials = [other.trials[index] for index in kept]
        other._offers = [other._offers[index] for index in kept]
        other._planners = [other._planners[index] for index in kept] if other._planners else []
        other.spent = self.spent * len(kept) // len(self.trials)
        other.reasons, other.brought = [], {source: Brought() for source in SOURCES}
        return other

    def take(self, trials: Mapping[int, Trial]) -> None:
        """Take over what was found in copies of its trials, by the ids of their episodes."""
        for mine in self.trials:
            if mine.episode.episode_id in trials:
                mine.take(trials[mine.episode.episode_id])

    def offer(self, actions: IntArray, source: str, *, but: int = -1) -> None:
        """Let all trials (but one) try a sequence of actions next, unless they did before."""
        key = actions.tobytes()
        if key in self._known:
            return
        self._known.add(key)
        for index, queue in enumerate(self._offers):
            if index != but:
                queue.appendleft((actions, source))

    def proposals(self, *, offers_only: bool) -> list[Proposal]:
        """Return what to drive next, at most one candidate a trial."""
        found = []
        for index, trial in enumerate(self.trials):
            if trial.is_done:
                self._offers[index].clear()
                continue
            proposal = self._offered(index) or (None if offers_only else self._proposed(index))
            if proposal is not None:
                found.append(proposal)
        if not found and not offers_only:
            self.spent += len(self.trials)  # nothing new came to mind
        return found

    def learn(self, proposal: Proposal, log: EpisodeLog) -> None:
        """Take note of what happened to a candidate."""
        index, source, offered, candidate, _ = proposal
        trial = self.trials[index]
        before, near = trial.least, len(trial.near_misses)
        better = trial.learn(candidate, log)
        self._reward(source, before - trial.least, offered)
        if log.reason:
            self.reasons.append(log.reason)
            return
        if self._planners:
            planner = self._planners[index]
            planned = source == PLAN and not offered
            remember = planned or better or len(trial.near_misses) > near
            self.surrogate.learn(*planner.observe(candidate, log, remember=remember, planned=planned))
        if better:
            self.offer(candidate.actions, source, but=index)

    def _reward(self, source: str, gain: float, offered: bool) -> None:
        self.spent += 1
        for one in SOURCES:
            self._gain[one] *= _FORGETS
            self._cost[one] *= _FORGETS
            self._effort[one] *= _FORGETS
        self._gain[source] += gain
        self._cost[source] += 1
        brought = self.brought[source]
        brought.candidates += 1
        brought.hits += gain > 0.0
        brought.lowered += gain
        if not offered:
            self._effort[source] += 1

    def _offered(self, index: int) -> Proposal | None:
        queue = self._offers[index]
        while queue:
            actions, source = queue.popleft()
            candidate = self.space.candidate(actions)
            episode = self.trials[index].specification(candidate)
            if episode is not None:
                return Proposal(index, source, True, candidate, episode)
        return None

    def _proposed(self, index: int) -> Proposal | None:
        source = self._choose(self.trials[index])
        for _ in range(_TRIES):
            actions = self._planned(index) if source == PLAN else self._made(source, self.trials[index])
            if actions is None:
                return None
            candidate = self.space.candidate(actions)
            episode = self.trials[index].specification(candidate)
            if episode is not None:
                return Proposal(index, source, False, candidate, episode)
        return None

    def _choose(self, trial: Trial) -> str:
        """Return the source whose effort lags most behind its share."""
        able = {
            PLAN: bool(self._planners),
            EXCURSION: True,
            OWN: trial.actions is not None,
            NEAR_MISS: bool(trial.near_misses),
            OTHER: bool(self._others) or any(one.actions is not None for one in self.trials),
        }
        sources = [source for source in SOURCES if able[source]]
        earned = np.array([self._gain[one] / self._cost[one] for one in sources])
        shares = np.maximum(earned / earned.sum(), _LEAST)
        shares += np.array([_PLANS * (one == PLAN) for one in sources])
        return sources[int(np.argmin(np.array([self._effort[one] for one in sources]) / shares))]

    def _planned(self, index: int) -> IntArray | None:
        plan, cost = self._planners[index].plan(self._rng)
        cost *= self._plan_cost
        self.spent += int(cost)
        self._cost[PLAN] += cost
        self._effort[PLAN] += max(cost, 1.0 if plan is None else 0.0)
        if plan is None:
            return None
        rest = np.full(self.space.ticks, self.space.as_phi, np.int64)
        return np.concatenate([plan, rest])[: self.space.ticks]

    def _excursion(self) -> IntArray:
        space = self.space
        end = min(space.ticks, len(space.path))
        return excursion(self._rng, space.ticks, end, space.as_phi, space.action_count)

    def _made(self, source: str, trial: Trial) -> IntArray:
        if source == EXCURSION:
            return self._excursion()
        found, space, rng = self.found, self.space, self._rng
        if source == NEAR_MISS:
            near = trial.near_misses[int(rng.integers(len(trial.near_misses)))]
            actions, tick = near.actions, near.tick
        elif source == OWN and trial.actions is not None:
            actions, tick = trial.actions, trial.tick
        else:
            actions, tick = found[int(rng.integers(len(found)))], trial.tick or space.ticks // 2
        return changed(rng, actions, tick, found or [actions], space.as_phi, space.action_count)


def search(groups: Sequence[Group], budget: int, drive: Drive) -> None:
    """Search until each group has spent so many candidates a trial, and has driven all that was offered.

    Args:
        groups: what is searched; what can be driven at once is.
        budget: candidates a trial, those of earlier calls included.
        drive: runs episodes.
    """
    while True:
        proposals = []
        for group in groups:
            spent = group.spent >= budget * len(group.trials)
            if not group.is_done and (not spent or group.has_offers):
                proposals += [(group, proposal) for proposal in group.proposals(offers_only=spent)]
        if not proposals and all(one.is_done or one.spent >= budget * len(one.trials) for one in groups):
            return
        logs = drive([proposal.episode for _, proposal in proposals]) if proposals else ()
        for (group, proposal), log in zip(proposals, logs, strict=True):
            group.learn(proposal, log)
