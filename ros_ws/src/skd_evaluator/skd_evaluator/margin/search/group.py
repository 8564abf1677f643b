"""The trials of one φ, searched together: candidates are driven, and whatever hits is offered to all of them.

Candidates come from six sources: last steps (a trajectory left in one tick in which the car would have hit), plans in a
surrogate model of the controller, excursions from φ, and changes of a trial's own best hit, of its near misses, and of
the best hits of other trials. Last steps go first. A third of the other effort goes to plans, the rest to what has
brought most lately, counted in candidates that were driven; a plan counts as what it takes.
"""

from __future__ import annotations

import copy
from collections import deque
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from skd_sim.arrays import FloatArray, IntArray
from skd_sim.world.episode import EpisodeLog, EpisodeSpec

from skd_evaluator.margin.search.candidates import ActionSpace, Candidate, changed, excursion
from skd_evaluator.margin.search.planner import DetourPlanner
from skd_evaluator.margin.search.surrogate import Surrogate
from skd_evaluator.margin.search.trial import Trial

Drive = Callable[[Sequence[EpisodeSpec]], Iterable[EpisodeLog]]
"""Runs episodes and returns their logs in order."""
LAST_STEP, PLAN, EXCURSION, OWN, NEAR_MISS, OTHER = SOURCES = (
    "last steps",
    "plans",
    "excursions from φ",
    "changed hits",
    "changed near misses",
    "other trials",
)
_LEAST: Final = 0.1  # share of a source
_FORGETS: Final = 0.998
_PRIOR: Final = 20.0  # m gained, and candidates driven, before anything is known of a source
_TRIES: Final = 4  # candidates in a row that cannot be better than the best
_PLANS: Final = 0.5  # share of plans, on top of what they have earned; the shares of all sources add up to 1
_LESS: Final = 1e-3  # by which a planned hit has to be better than the best


class Proposal(NamedTuple):
    """What is to be driven next in a trial."""

    trial: int
    source: str
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
        self.spent = 0.0
        self.reasons: list[str] = []
        self.brought = {source: Brought() for source in SOURCES}
        plans, self._free_plans = space.table is not None, free_plans
        self._rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence((first.seed, first.episode_id))))
        self._gain = dict.fromkeys(SOURCES, _PRIOR)
        self._cost = dict.fromkeys(SOURCES, _PRIOR)
        self._effort = dict.fromkeys(SOURCES, 1.0)
        self.surrogate = Surrogate(first.scenario.control_periods > 1)
        self._planners = [DetourPlanner(trial.episode, space, self.surrogate) for trial in self.trials] if plans else []
        self._known: set[bytes] = set()
        self._planned_before: set[tuple[int, bytes]] = set()
        self._others: list[IntArray] = []  # best hits of trials that are searched elsewhere
        self._offers: list[deque[tuple[Candidate, str]]] = [deque() for _ in self.trials]
        if excursions:
            drawn = space.candidates(np.array([self._excursion() for _ in range(excursions * len(self.trials))]))
            drawn.sort(key=lambda one: float(one.deviations[min(space.ticks, len(space.path))]))
            for place, candidate in enumerate(drawn):
                self._offers[place % len(self.trials)].append((candidate, EXCURSION))
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
        other._planned_before = set()
        other.spent = self.spent * len(kept) / len(self.trials)
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
        candidate = self.space.candidate(actions)
        for index, queue in enumerate(self._offers):
            if index != but:
                queue.appendleft((candidate, source))

    def proposals(self, *, offers_only: bool) -> list[Proposal]:
        """Return what to drive next, at most one candidate a trial."""
        found, chosen = [], []
        for index, trial in enumerate(self.trials):
            if trial.is_done:
                self._offers[index].clear()
            elif proposal := self._first(index, self._offers[index]):
                found.append(proposal)
            elif not offers_only:
                chosen.append((index, self._choose(trial)))
        pool = self.found
        made = [self._made(source, index, pool) for index, source in chosen]
        sequences = [one for tries in made for one in tries]
        candidates = iter(self.space.candidates(np.array(sequences)) if sequences else ())
        for (index, source), tries in zip(chosen, made, strict=True):
            queue = deque((next(candidates), source) for _ in tries)
            if proposal := self._first(index, queue):
                found.append(proposal)
        if chosen and not found:
            self.spent += len(self.trials)  # nothing new came to mind
        return found

    def _first(self, index: int, queue: deque[tuple[Candidate, str]]) -> Proposal | None:
        """Return the first candidate of a queue that may be better than the best of a trial."""
        while queue:
            candidate, source = queue.popleft()
            episode = self.trials[index].specification(candidate)
            if episode is not None:
                return Proposal(index, source, candidate, episode)
        return None

    def learn(self, proposal: Proposal, log: EpisodeLog) -> None:
        """Take note of what happened to a candidate."""
        index, source, candidate, _ = proposal
        trial = self.trials[index]
        before, near = trial.least, len(trial.near_misses)
        better = trial.learn(candidate, log)
        self._reward(source, before - trial.least)
        if log.reason:
            self.reasons.append(log.reason)
            return
        if better:
            self.offer(candidate.actions, source, but=index)
        if self._planners:
            planner = self._planners[index]
            moments = planner.moments(log)
            if source == PLAN or better or len(trial.near_misses) > near:
                planner.learn(log, moments)
            for actions in self._detour(index, candidate.actions, moments, 1):
                self._offers[index].appendleft((self.space.candidate(actions), LAST_STEP))

    def _planned(self, index: int) -> list[IntArray]:
        """Return a plan that begins at a trial's best hit or at one of its near misses; there may be none."""
        trial, rng = self.trials[index], self._rng
        begins = [(one.actions, one.log) for one in trial.near_misses]
        if trial.actions is not None and trial.log is not None:
            begins += [(trial.actions, trial.log)] * max(1, len(begins))
        actions, log = begins[int(rng.integers(len(begins)))]
        return self._detour(index, actions, self._planners[index].moments(log), self.space.ticks)

    def _detour(self, index: int, actions: IntArray, moments: FloatArray, steps: int) -> list[IntArray]:
        bound = self.trials[index].least * (1.0 - _LESS)
        found, cost = self._planners[index].plan(actions, moments, bound, steps, self._rng)
        if steps > 1 and not self._free_plans:
            self.spent += cost
            self._cost[PLAN] += cost
            self._effort[PLAN] += cost
        if found is None or (index, found.tobytes()) in self._planned_before:
            return []
        self._planned_before.add((index, found.tobytes()))
        return [found]

    def _reward(self, source: str, gain: float) -> None:
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

    def _choose(self, trial: Trial) -> str:
        """Return the source whose effort lags most behind its share."""
        able = {
            LAST_STEP: False,
            PLAN: bool(self._planners) and (trial.actions is not None or bool(trial.near_misses)),
            EXCURSION: True,
            OWN: trial.actions is not None,
            NEAR_MISS: bool(trial.near_misses),
            OTHER: bool(self._others) or any(one.actions is not None for one in self.trials),
        }
        sources = [source for source in SOURCES if able[source]]
        earned = [self._gain[one] / self._cost[one] for one in sources]
        shares = [max(one / sum(earned), _LEAST) for one in earned]
        lags = {
            one: self._effort[one] / (share + _PLANS * (one == PLAN))
            for one, share in zip(sources, shares, strict=True)
        }
        chosen = min(sources, key=lags.__getitem__)
        self._effort[chosen] += 1
        return chosen

    def _excursion(self) -> IntArray:
        space = self.space
        end = min(space.ticks, len(space.path))
        return excursion(self._rng, space.ticks, end, space.as_phi, space.action_count)

    def _made(self, source: str, index: int, found: Sequence[IntArray]) -> list[IntArray]:
        """Return some sequences of a source."""
        if source == PLAN:
            return self._planned(index)
        if source == EXCURSION:
            return [self._excursion() for _ in range(_TRIES)]
        trial, space, rng = self.trials[index], self.space, self._rng
        if source == NEAR_MISS:
            near = trial.near_misses[int(rng.integers(len(trial.near_misses)))]
            actions, tick = near.actions, near.tick
        elif source == OWN and trial.actions is not None:
            actions, tick = trial.actions, trial.tick
        else:
            actions, tick = found[int(rng.integers(len(found)))], trial.tick or space.ticks // 2
        others = found or [actions]
        return [changed(rng, actions, tick, others, space.as_phi, space.action_count) for _ in range(_TRIES)]


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
