"""The trials of one φ, searched together: candidates are driven, and whatever hits is offered to all of them.

Candidates come from five sources: detours from what was driven, excursions from φ, and changes of a trial's own best
hit, of its near misses, and of the best hits of other trials. Each is used as much as it has brought lately for each
candidate that was driven. A detour in the very tick of the hit is tried at once, and counts as its origin's.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Outcome
from skd_sim.world.state import FloatArray, IntArray

from skd_evaluator.margin.search.candidates import ActionSpace, Candidate, changed, excursion
from skd_evaluator.margin.search.detours import detour, undisturbed_car
from skd_evaluator.margin.search.trial import Trial

Drive = Callable[[Sequence[EpisodeSpec]], Iterable[EpisodeLog]]
"""Runs episodes and returns their logs in order."""
DETOUR, EXCURSION, OWN, NEAR_MISS, OTHER = SOURCES = (
    "detours",
    "excursions from φ",
    "changed hits",
    "changed near misses",
    "other trials",
)
_LEAST: Final = 0.1  # share of a source
_FORGETS: Final = 0.998
_PRIOR: Final = 20.0  # m gained, and candidates driven, before anything is known of a source
_TRIES: Final = 4  # candidates in a row that cannot be better than the best
_LESS: Final = 1e-3  # by which a detour has to be better than the best
_LONGEST: Final = (2, 3, 4, 6, 8, 12)  # ticks of a detour
_GUESSES: Final = 32  # detours that are kept for a trial
_AIMED: Final = 0.5  # share of excursions that end in a detour to an undisturbed car


class Proposal(NamedTuple):
    """What is to be driven next in a trial."""

    trial: int
    source: str
    candidate: Candidate
    path: FloatArray


@dataclass
class Source:
    """What a source has brought: candidates, how many were better hits, by how much in all (m), and the same lately."""

    candidates: int = 0
    hits: int = 0
    lowered: float = 0.0
    lately_lowered: float = _PRIOR
    lately_used: float = _PRIOR

    @property
    def earns(self) -> float:
        """How much it has lowered margins lately, m a candidate."""
        return self.lately_lowered / self.lately_used


class Group:
    """Trials of one φ that share what they find.

    Attributes:
        trials: in the order of the episodes.
        space: where sequences of actions lead.
        reasons: why episodes were aborted, one each.
        sources: what each has brought.
    """

    def __init__(self, episodes: Sequence[EpisodeSpec], excursions: int) -> None:
        """Begin with φ itself and some excursions from it.

        Args:
            episodes: kamikaze mode, all with the same φ; their objective does not matter.
            excursions: for each trial.
        """
        first = episodes[0]
        assert first.safe_trajectory is not None
        self.space = space = ActionSpace(first.scenario, first.end, first.safe_trajectory.positions)
        self.trials = [Trial(episode, space) for episode in episodes]
        self.reasons: list[str] = []
        self.sources = {source: Source() for source in SOURCES}
        self._rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence((first.seed, first.episode_id))))
        self._cars = [undisturbed_car(trial.prescribed) for trial in self.trials]
        self._known: set[bytes] = set()
        self._guessed: set[tuple[int, bytes]] = set()
        self._guesses: list[list[tuple[float, IntArray]]] = [[] for _ in self.trials]
        self._offers: list[deque[tuple[Candidate, str]]] = [deque() for _ in self.trials]
        if excursions:
            drawn = [self._excursion(place % len(episodes)) for place in range(excursions * len(episodes))]
            end = min(space.ticks, len(space.path))
            begun = sorted(space.candidates(np.array(drawn)), key=lambda one: float(one.deviations[end]))
            for place, candidate in enumerate(begun):
                self._offers[place % len(self.trials)].append((candidate, EXCURSION))
        self.offer(np.full(space.ticks, space.as_phi, np.int64), OTHER)

    @property
    def is_open(self) -> bool:
        """Whether there is anything left to drive."""
        return any(
            not trial.is_done and (trial.spent < trial.goal or offers)
            for trial, offers in zip(self.trials, self._offers, strict=True)
        )

    @property
    def found(self) -> list[IntArray]:
        """Actions of the best hits, by deviation, each once."""
        hits = sorted((one for one in self.trials if one.actions is not None), key=lambda one: one.least)
        return list({one.actions.tobytes(): one.actions for one in hits if one.actions is not None}.values())

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

    def begin_with(self, logs: Mapping[int, EpisodeLog]) -> None:
        """Begin with what happens on the hits of an earlier version, by the place of their trial.

        A trial that is not hit on its own is offered those that hit in others.
        """
        driven = {place: self.space.candidate(self.space.actions_along(log.adversary)) for place, log in logs.items()}
        for place, candidate in driven.items():
            self._known.add(candidate.actions.tobytes())
            self.trials[place].learn(candidate, logs[place])
        for place in (one for one in driven if self.trials[one].best is None):
            self._offers[place].extendleft((driven[other], OTHER) for other, log in logs.items() if log.hit)

    def proposals(self) -> list[Proposal]:
        """Return what to drive next, at most one candidate a trial."""
        found, made, pool = [], [], self.found
        for index, trial in enumerate(self.trials):
            if trial.is_done:
                continue
            if proposal := self._first(index, self._offers[index]):
                found.append(proposal)
            elif trial.spent < trial.goal:
                source = self._choose(index, pool)
                made.append((index, source, self._made(source, index, pool)))
        sequences = [one for *_, tries in made for one in tries]
        candidates = iter(self.space.candidates(np.array(sequences)) if sequences else ())
        for index, source, tries in made:
            queue = deque((next(candidates), source) for _ in tries)
            if proposal := self._first(index, queue):
                found.append(proposal)
            else:  # nothing new came to mind
                self.trials[index].spent += 1
                self.sources[source].lately_used += 1
        return found

    def _first(self, index: int, queue: deque[tuple[Candidate, str]]) -> Proposal | None:
        """Return the first candidate of a queue that may be better than the best of a trial."""
        while queue:
            candidate, source = queue.popleft()
            path = self.trials[index].path(candidate)
            if path is not None:
                return Proposal(index, source, candidate, path)
        return None

    def learn(self, proposal: Proposal, log: EpisodeLog) -> None:
        """Take note of what happened to a candidate."""
        index, source, candidate, _ = proposal
        trial = self.trials[index]
        before = trial.least
        better = trial.learn(candidate, log)
        self._reward(source, before - trial.least)
        if log.reason:
            self.reasons.append(log.reason)
            return
        if better:
            self.offer(candidate.actions, source, but=index)
        self._guess(proposal, log)

    def _guess(self, proposal: Proposal, log: EpisodeLog) -> None:
        """Keep the detours of least deviation from what was driven: of one tick to be driven next, and of several."""
        index, source, (actions, *_), _ = proposal
        bound = self.trials[index].least * (1.0 - _LESS)
        for longest in (1, self._drawn(_LONGEST)):
            found = detour(self.space, actions, log.adversary, log.car, bound, longest, 0)
            if found is None or (index, found[1].tobytes()) in self._guessed:
                continue
            self._guessed.add((index, found[1].tobytes()))
            if longest == 1:
                self._offers[index].appendleft((self.space.candidate(found[1]), source))
            else:
                guesses = self._guesses[index]
                guesses.append(found)
                guesses.sort(key=lambda one: one[0])
                del guesses[_GUESSES:]

    def _excursion(self, index: int) -> IntArray:
        """Return an excursion from φ; some go on to where a car is hit that does not brake."""
        actions, tick = excursion(self._rng, self.space)
        if self._rng.random() < _AIMED:
            users, longest = self.space.positions(actions[None])[0], self._drawn(_LONGEST)
            bound = self.trials[index].least * (1.0 - _LESS)
            aimed = detour(self.space, actions, users, self._cars[index], bound, longest, tick)
            actions = actions if aimed is None else aimed[1]
        return actions

    def _drawn(self, lengths: Sequence[int]) -> int:
        return lengths[int(self._rng.random() * len(lengths))]

    def _reward(self, source: str, gain: float) -> None:
        for one in self.sources.values():
            one.lately_lowered *= _FORGETS
            one.lately_used *= _FORGETS
        brought = self.sources[source]
        brought.candidates += 1
        brought.hits += gain > 0.0
        brought.lowered += gain
        brought.lately_lowered += gain
        brought.lately_used += 1

    def _choose(self, index: int, pool: Sequence[IntArray]) -> str:
        """Return the source that was used least for what it has brought."""
        trial = self.trials[index]
        able = {
            DETOUR: bool(self._guesses[index]),
            EXCURSION: True,
            OWN: trial.actions is not None,
            NEAR_MISS: bool(trial.near_misses),
            OTHER: bool(pool),
        }
        sources = {name: self.sources[name] for name, is_able in able.items() if is_able}
        total = 0.0
        for one in sources.values():
            total += one.earns
        return min(sources, key=lambda name: sources[name].lately_used / max(sources[name].earns / total, _LEAST))

    def _made(self, source: str, index: int, pool: Sequence[IntArray]) -> Sequence[IntArray]:
        """Return some sequences of a source."""
        trial, rng = self.trials[index], self._rng
        if source == EXCURSION:
            return [self._excursion(index) for _ in range(_TRIES)]
        if source == DETOUR:
            return [self._guesses[index].pop(0)[1]]
        if source == NEAR_MISS:
            near = trial.near_misses[int(rng.random() * len(trial.near_misses))]
            actions, tick = near.actions, near.tick
        elif source == OWN and trial.actions is not None:
            actions, tick = trial.actions, trial.tick
        else:
            actions, tick = pool[int(rng.random() * len(pool))], trial.tick or self.space.ticks // 2
        space, others = self.space, np.array(pool or [actions])
        # Changes hardly matter after the tick of the contact.
        end = min(space.ticks, tick + 2)
        return list(changed(rng.random((_TRIES, 11)), actions, end, space.as_phi, space.action_count, others))


def search(groups: Sequence[Group], drive: Drive) -> None:
    """Search until each trial has been searched with as many candidates as its goal, and all offers were driven.

    Many candidates differ only after the tick in which they are of no more use; these are driven once.

    Args:
        groups: what is searched; what can be driven at once is.
        drive: runs episodes.
    """
    known: dict[tuple[int, bytes], EpisodeLog] = {}
    while any(group.is_open for group in groups):
        proposals = [(group.trials[one.trial], group, one) for group in groups for one in group.proposals()]
        keys = [(trial.episode.episode_id, one.path.tobytes()) for trial, _, one in proposals]
        new = {
            key: trial.specification(one.path)
            for key, (trial, _, one) in zip(keys, proposals, strict=True)
            if key not in known
        }
        if new:
            known.update(zip(new, drive(list(new.values())), strict=True))
        for key, (_, group, proposal) in zip(keys, proposals, strict=True):
            group.learn(proposal, known[key])
            if known[key].outcome == Outcome.ABORTED:  # it may not be again
                del known[key]
