"""The most likely failures: crude crossings of the risk in which the car hits, by what the walker did, nearest first.

Why the walker is where the car hits is told by the walker's normals alone. Each of five groups of them (start, pace,
direction, doubt, sway; how restless a person is belongs to pace and doubt) is walked by itself, all others being 0: the
group that takes the walker furthest from φ, at the end of the tick of the contact, names the failure.

How near a failure is to how people walk is told by nine independent standard normals: the person's four, the means up
to the contact of the processes of pace, direction and doubt, each over its own standard deviation, and the sway at the
contact. Thousands of normals of single ticks are not asked one by one: their density says how long a crossing is, and
hardly anything else. The deviation is the distance of the nine from 0, times s; the greater the density, the less it
is. Nothing here needs the car: a reader of a result computes it anew from seed, φ and behaviour model.
"""

from __future__ import annotations

import functools
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import scipy
from skd_sim.scenario.road import right_and_along
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.episode import Role, generator
from skd_sim.world.state import FloatArray

from skd_evaluator.assessment.plan import EpisodeGroup, episode_id
from skd_evaluator.metrics.behaviour.model import NAMES, OF_PERSON, OF_TICK, normals_of, smooth, walked
from skd_evaluator.metrics.entry import Entry, Share
from skd_evaluator.metrics.risks import ScaleRisk, Touch

NEAREST: Final = 3
"""Failures of a kind that are kept."""
MOST: Final = 2000
"""Failures that are looked at, the first of those that there are."""
ENOUGH: Final = 10
"""Hits from which on a scale is taken rather than a greater one."""
CLOSE: Final = 0.25
"""m from where φ is then, within which it is φ that is hit, and not what people make of it."""
HARDLY: Final = "hardly leaves φ"
_PERSON, _TICK = len(OF_PERSON), len(OF_TICK)
_GROUPS: Final = {  # normals of the person, and of each tick
    "start": (("start",), ()),
    "pace": (("pace", "unrest"), ("pace",)),
    "direction": (("heading",), ("turn",)),
    "doubt": (("unrest",), ("doubt",)),
    "sway": ((), ("along", "across")),
}
_PROCESSES: Final = (("pace", "pace_time", False), ("turn", "turn_time", False), ("doubt", "hesitation_time", True))
_NORMALS: Final = _PERSON + len(_PROCESSES) + 2


@dataclass(frozen=True)
class Failure(Entry):
    """A crossing in which the car hits.

    Attributes:
        row: number of the crude crossing, from 0.
        phi: number of φ, from 0.
        draw: number of the crossing on it.
        kind: what the walker did, in a few words.
        deviation: of the walker from φ, in standard deviations of people.
        impact_speed: m/s; nan: not known yet.
    """

    KEYS = "safe_trajectory=phi trial=draw deviation people impact_speed"

    row: int
    phi: int
    draw: int
    kind: str
    deviation: float
    impact_speed: float = math.nan

    @property
    def people(self) -> Share:
        """Share of people who deviate as much or more."""
        return float(scipy.special.gammaincc(0.5 * _NORMALS, 0.5 * self.deviation**2))


@dataclass(frozen=True)
class FailureKind(Entry):
    """Failures that look alike.

    Attributes:
        kind: what the walker did.
        hits: crossings.
        share: of the hits.
        nearest: the most likely of them.
    """

    KEYS = "kind hits share nearest"

    kind: str
    hits: int
    share: Share
    nearest: tuple[Failure, ...]


@dataclass(frozen=True)
class Failures(Entry):
    """The failures at one scale.

    Attributes:
        scale: s at which they are.
        runs: crude crossings, aborted ones left out.
        hits: crude crossings in which the car hits.
        looked_at: of these, classified: the first of them.
        kinds: what walkers did, the most frequent first.
    """

    KEYS = "scale runs hits looked_at kinds"

    scale: float
    runs: int
    hits: int
    looked_at: int
    kinds: tuple[FailureKind, ...]

    @property
    def nearest(self) -> list[Failure]:
        """The failures that are kept, kind by kind."""
        return [one for kind in self.kinds for one in kind.nearest]

    def with_speeds(self, speeds: Mapping[int, float]) -> Failures:
        """Return them with the impact speed (m/s) of each row that is kept."""
        kinds = [
            replace(kind, nearest=tuple(replace(one, impact_speed=speeds[one.row]) for one in kind.nearest))
            for kind in self.kinds
        ]
        return replace(self, kinds=tuple(kinds))


@dataclass(frozen=True, eq=False)
class Walkers:
    """Who walks the crude crossings of an assessment.

    Attributes:
        scenario: of the test.
        safe: positions of each φ at ticks, m.
        seed: of the campaign.
        values: parameters of the behaviour model, in the order of `NAMES`.
    """

    scenario: Scenario
    safe: Sequence[FloatArray]
    seed: int
    values: FloatArray

    def normals(self, row: int) -> FloatArray:
        """Return the standard normals of the walker of a crossing; φ take turns."""
        number = episode_id(EpisodeGroup.RISK, row % len(self.safe), row // len(self.safe))
        return generator(self.seed, number, Role.WALKER).standard_normal(normals_of(self.scenario.ticks))

    def track(self, row: int, normals: FloatArray, scale: float) -> FloatArray:
        """Return where the walker of a crossing is at ticks, m."""
        return walked(self.safe[row % len(self.safe)], self.values, normals, scale, self.scenario.time_step)

    def failure(self, row: int, scale: float, ticks: int) -> Failure:
        """Return what a crossing is whose contact is in tick number `ticks`, from 1."""
        normals = self.normals(row)
        phis = len(self.safe)
        deviation = scale * float(np.linalg.norm(nine_normals(normals, ticks, self.values, self.scenario.time_step)))
        return Failure(row, row % phis, row // phis, self._kind(row, normals, scale, ticks), deviation)

    def _kind(self, row: int, normals: FloatArray, scale: float, ticks: int) -> str:
        phi, whole = self.safe[row % len(self.safe)], self.track(row, normals, scale)
        there = _at(phi, ticks)
        if math.dist(_at(whole, ticks), there) < CLOSE:
            return HARDLY
        tracks = {name: self.track(row, normals * _mask(name, len(normals)), scale) for name in _GROUPS}
        off = {name: _at(track, ticks) - there for name, track in tracks.items()}
        name = max(off, key=lambda one: float(np.hypot(*off[one])))  # the first of those that are equal
        if name == "start":
            return "starts late" if normals[OF_PERSON.index("start")] > 0.0 else "starts early"
        if name == "pace":
            onwards = _at(phi, ticks) - _at(phi, ticks - 1)
            onwards = onwards if onwards.any() else phi[-1] - phi[0]
            return "walks slowly" if float(off[name] @ onwards) < 0.0 else "walks fast"
        if name == "direction":  # the car comes from where the path coordinate is less
            here, meant = right_and_along(self.scenario.road.line, np.array([there + off[name], there]))[:, 1]
            return "drifts towards the car" if here < meant else "drifts away from the car"
        if name == "doubt":
            return f"hesitates {self._where(phi, tracks[name], whole, ticks)}"
        return "sways"

    def _where(self, phi: FloatArray, doubting: FloatArray, whole: FloatArray, ticks: int) -> str:
        """Return where the walker is whose doubt costs most in a tick: before the lane or in it."""
        lost = [math.dist(_at(phi, tick), _at(phi, tick + 1)) for tick in range(ticks)]
        lost = [one - math.dist(_at(doubting, tick), _at(doubting, tick + 1)) for tick, one in enumerate(lost)]
        place = _at(whole, int(np.argmax(lost)))
        right = float(right_and_along(self.scenario.road.line, place[None])[0, 0])
        return "in the lane" if abs(right) < 0.5 * self.scenario.road.lane_width else "before the lane"


def failures_of(scales: Sequence[ScaleRisk], walkers: Walkers) -> Failures | None:
    """Return the failures at the least scale that has enough, else at that with most; None without a hit.

    Where it is not known when they are hit, as in files of older versions, there are none either.
    """
    hits = [0 if one.ticks is None else one.hits for one in scales]
    if not any(hits):
        return None
    chosen = next((place for place, count in enumerate(hits) if count >= ENOUGH), int(np.argmax(hits)))
    risk = scales[chosen]
    assert risk.ticks is not None
    rows = np.flatnonzero(risk.touches == Touch.FRONT)[:MOST].tolist()
    found = [walkers.failure(row, risk.scale, int(risk.ticks[row])) for row in rows]
    kinds = Counter(one.kind for one in found).items()
    ordered = sorted(kinds, key=lambda one: (-one[1], one[0]))
    nearest = sorted(found, key=lambda one: (one.deviation, one.row))
    return Failures(
        risk.scale,
        risk.runs,
        risk.hits,
        len(found),
        tuple(
            FailureKind(kind, count, count / len(found), tuple([one for one in nearest if one.kind == kind][:NEAREST]))
            for kind, count in ordered
        ),
    )


def nine_normals(normals: FloatArray, ticks: int, values: FloatArray, time_step: float) -> FloatArray:
    """Return what a walker's normals come to up to the end of a tick, in nine independent standard normals."""
    of_ticks = dict(zip(OF_TICK, normals[_PERSON : _PERSON + _TICK * ticks].reshape(ticks, _TICK).T, strict=True))
    times = dict(zip(NAMES, values.tolist(), strict=True))
    means = [
        float(_weights(ticks, math.exp(-time_step / times[time]), smoothed) @ of_ticks[name])
        for name, time, smoothed in _PROCESSES
    ]
    return np.array([*normals[:_PERSON], *means, of_ticks["along"][-1], of_ticks["across"][-1]])


@functools.lru_cache(maxsize=1024)
def _weights(ticks: int, keep: float, smoothed: bool) -> FloatArray:
    """Return by which the normals of ticks enter the mean of a process, of length 1: so the mean has variance 1."""
    found = np.zeros(ticks)
    for tick in range(ticks):
        now = past = 0.0
        for other in range(ticks):
            normal = float(other == tick)
            if smoothed:
                now, past = smooth(now, past, keep, normal, other), now
            else:
                now = normal if other == 0 else keep * now + math.sqrt(1.0 - keep * keep) * normal
            found[tick] += now
    return found / float(np.linalg.norm(found))


@functools.cache
def _mask(group: str, count: int) -> FloatArray:
    """Return 1 where a normal is of a group, else 0."""
    person, tick = _GROUPS[group]
    found = np.zeros(count)
    found[:_PERSON] = [name in person for name in OF_PERSON]
    for place, name in enumerate(OF_TICK):
        found[_PERSON + place :: _TICK] = name in tick
    return found


def _at(track: FloatArray, tick: int) -> FloatArray:
    """Return where a way is at a tick; at its end after it."""
    found: FloatArray = track[min(tick, len(track) - 1)]
    return found
