"""The episodes of an assessment that is on disk: what episodes.npz holds, looked at before it is believed."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from skd_sim.arrays import FloatArray, IntArray
from skd_sim.errors import UsageError
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.episode import Mode, Outcome, until_contact

from skd_evaluator.arrays import FARTHEST, Column, read_arrays, within_reach
from skd_evaluator.assessment.plan.plan import Stage
from skd_evaluator.metrics.contact_place import car_until_contact
from skd_evaluator.metrics.distances.deviation import deviation_pairs
from skd_evaluator.metrics.distances.frechet import discrete_frechet_pairs

EPISODES = "episodes.npz"
_COLUMNS = {
    "positions": Column(np.float64, (-1, 2)),
    "car": Column(np.float64, (-1, 3)),
    "offsets": Column(np.int64, (-1,)),
    "mode": Column(np.int8, (-1,)),
    "safe_index": Column(np.int32, (-1,)),
    "outcome": Column(np.int8, (-1,)),
    "episode_id": Column(np.int64, (-1,)),
    "impact_time": Column(np.float64, (-1,)),
    "impact_speed": Column(np.float64, (-1,)),
    "objective": Column("U16", (-1,)),
    "time_step": Column(np.float64, ()),
    "hit_speed": Column(np.float64, ()),
}
_FURTHER = {
    "clipped": Column(np.int64, (-1,)),
    "reason": Column("U", (-1,)),
    "safe_name": Column("U", (-1,)),
    "objectives": Column("U", (-1,)),
    "plans_deviation": Column(np.bool_, (-1,)),
    "eta_max": Column(np.float64, ()),
    "maximum_distance": Column(np.float64, ()),
    "seed": Column(np.int64, ()),
}
"""What figures follow from beside the trajectories; see `recomputation`."""
_MARGIN = {
    "margin": Column(np.float64, (-1,)),
    "margin_safe_index": Column(np.int32, (-1,)),
    "margin_attempt": Column(np.int64, (-1,)),
    "margin_duration": Column(np.float64, (-1,)),
    "margin_impact_speed": Column(np.float64, (-1,)),
    "margin_gap": Column(np.float64, (-1,)),
    "margin_positions": Column(np.float64, (-1, 2)),
    "margin_offsets": Column(np.int64, (-1,)),
}
"""There where the margin is known."""
_OPTIONAL = {
    "own_contact": Column(np.float64, (-1,)),
    "risk_scale": Column(np.float64, (-1,)),
    "risk_touch": Column(np.int8, (-1,)),
    "risk_share": Column(np.float64, (-1,)),
    "risk_levels": Column(np.int64, (-1,)),
    "risk_per_level": Column(np.int64, (-1,)),
    "risk_open": Column(np.int64, (-1,)),
    "risk_lost": Column(np.int64, (-1,)),
    "risk_tick": Column(np.int32, (-1,)),
    "risk_failure": Column(np.int64, (-1,)),
    "risk_failure_positions": Column(np.float64, (-1, 2)),
    "risk_failure_car": Column(np.float64, (-1, 3)),
    "risk_failure_offsets": Column(np.int64, (-1,)),
    "risk_failure_impact_time": Column(np.float64, (-1,)),
    "risk_failure_impact_speed": Column(np.float64, (-1,)),
}
"""Likewise what figures follow from, where it was asked for."""
_OF_EPISODES = ("clipped", "reason", "own_contact")
_PER_EPISODE = ("mode", "safe_index", "outcome", "episode_id", "impact_time", "impact_speed", "objective")

_ROUNDING = 1e-9  # m


@dataclass(frozen=True, eq=False)
class StoredWay:
    """The way of least deviation of an attempt.

    Attributes:
        attempt: number of the attempt.
        distance: deviation of the way, m.
        positions: positions at ticks, n × 2, m; the last of them is at the contact.
        duration: time until the contact, in ticks.
        impact_speed: speed of the car at the contact, m/s.
        gap: the least is at most so far below the distance, m; nan where it was searched for.
    """

    attempt: int
    distance: float
    positions: FloatArray
    duration: float
    impact_speed: float
    gap: float


@dataclass(frozen=True, eq=False)
class StoredEpisodes:
    """Episodes read back from disk; row k of every array is of episode k, and safe trajectories are no episodes here.

    Attributes:
        safe: positions of each φ at ticks, m.
        time_step: time step of the scenario, s.
        adversary: for each episode the adversary's positions at ticks, n × 2, m.
        car: for each episode the car's reference point (x, y), m, and speed, m/s, at ticks, n × 3.
        mode: mode of each episode, kamikaze or replay (`skd_sim.world.episode.Mode`).
        objective: objective of each kamikaze; empty for a run along φ.
        safe_index: number of the φ of each episode, counted from 0.
        outcome: how each episode ended (`skd_sim.world.episode.Outcome`).
        episode_id: id of each episode, as `skd_evaluator.assessment.plan.plan.episode_id` makes it.
        impact_time: time of the contact, s; nan without a collision.
        impact_speed: speed of the car at the contact, m/s; nan without a collision.
        hit_speed: speed of the car, m/s, from which on a collision is a hit.
        margins: per φ the margin of each attempt in the order of their numbers, m; infinite: nobody is hit within
            η_max. None where the file holds none.
        margin_ways: per φ the ways of least deviation, of those attempts that have one.
        belief: per episode n × 4 as in `skd_sim.world.episode.EpisodeLog`, nan where nothing is known; none
            where the file holds none.
        further: arrays that figures follow from and that nothing is drawn of, by name, those of episodes without the
            rows of φ.
    """

    safe: tuple[FloatArray, ...]
    time_step: float
    adversary: tuple[FloatArray, ...]
    car: tuple[FloatArray, ...]
    mode: IntArray
    objective: npt.NDArray[np.str_]
    safe_index: IntArray
    outcome: IntArray
    episode_id: IntArray
    impact_time: FloatArray
    impact_speed: FloatArray
    belief: tuple[FloatArray, ...] = ()
    hit_speed: float = 0.0
    margins: tuple[FloatArray, ...] | None = None
    margin_ways: tuple[tuple[StoredWay, ...], ...] = ()
    further: Mapping[str, npt.NDArray[Any]] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.mode)

    @cached_property
    def collided(self) -> npt.NDArray[np.bool_]:
        """For each episode, whether it ended in a collision."""
        return np.asarray(self.outcome == Outcome.COLLISION)

    @cached_property
    def hit(self) -> npt.NDArray[np.bool_]:
        """For each episode, whether it ended in a hit by the moving car."""
        with np.errstate(invalid="ignore"):
            return np.asarray(self.collided & (self.impact_speed >= self.hit_speed))

    def contact(self, number: int) -> tuple[float, float] | None:
        """Return time (s) and speed of the car (m/s) at the contact of an episode; None without one."""
        return (float(self.impact_time[number]), float(self.impact_speed[number])) if self.collided[number] else None

    def until_contact(self, number: int) -> FloatArray:
        """Return the adversary's places in an episode, n × 2, the last one moved back to the contact, if any."""
        if not self.collided[number]:
            return self.adversary[number]
        return until_contact(self.adversary[number], float(self.impact_time[number]) / self.time_step)

    def car_until_contact(self, number: int, scenario: Scenario) -> FloatArray:
        """Return the car's states in an episode of a scenario, n × 3, the last moved back to the contact, if any."""
        if not self.collided[number]:
            return self.car[number]
        ticks = float(self.impact_time[number]) / self.time_step
        impact, adversary = float(self.impact_speed[number]), self.until_contact(number)[-1]
        return car_until_contact(scenario, self.car[number], ticks, impact, adversary)

    @cached_property
    def deviation(self) -> FloatArray:
        """Deviation of each episode that collided, m; nan for the others."""
        found = np.full(len(self), np.nan)
        for index, phi in enumerate(self.safe):
            mine = np.flatnonzero(self.collided & (self.safe_index == index))
            psis = [self.until_contact(int(number)) for number in mine]
            found[mine] = deviation_pairs(phi, psis, self.impact_time[mine] / self.time_step)
        return found

    @cached_property
    def frechet(self) -> FloatArray:
        """Discrete Fréchet distance to φ of each kamikaze that collided, m; nan for the others."""
        found = np.full(len(self), np.nan)
        kamikaze = self.collided & (self.mode == Mode.KAMIKAZE)
        for index, phi in enumerate(self.safe):
            mine = np.flatnonzero(kamikaze & (self.safe_index == index))
            found[mine] = discrete_frechet_pairs(phi, [self.until_contact(int(number)) for number in mine])
        return found

    def attempts(self, objective: str) -> list[IntArray]:
        """Return per φ the numbers of the attempts of an objective; one that was aborted is none."""
        tried = (self.mode == Mode.KAMIKAZE) & (self.objective == objective) & (self.outcome != Outcome.ABORTED)
        return [np.flatnonzero(tried & (self.safe_index == index)) for index in range(len(self.safe))]

    def deviations_of(self, objective: str) -> list[FloatArray]:
        """Return per φ the deviation of each attempt of an objective, m; infinite where it failed."""
        values = np.where(self.hit, self.deviation, np.inf)
        return [values[mine] for mine in self.attempts(objective)]

    def worst_first(self) -> IntArray:
        """Return the numbers of all episodes, the worst for the car first; see `badness`."""
        return np.array(sorted(range(len(self)), key=self.badness), np.int64)

    def badness(self, number: int) -> tuple[float, float, int]:
        """Return a key by which episodes stand in order, the worst for the car first.

        Those that collided by their deviation, and of those hit on φ itself the fastest impact; then the others.
        """
        hit = bool(self.hit[number])
        deviation = round(float(self.deviation[number]), 9) if hit else np.inf
        return deviation, -float(self.impact_speed[number]) if hit else 0.0, int(self.episode_id[number])


def read_episodes(folder: Path) -> StoredEpisodes:
    """Read episodes.npz of a folder.

    Raises:
        UsageError: it cannot be read, or its arrays do not go together.
    """
    path = folder / EPISODES
    arrays = read_arrays(
        path, {**_COLUMNS, **_FURTHER}, {"belief": Column(np.float32, (-1, 4)), **_MARGIN, **_OPTIONAL}
    )
    why = _mismatch(arrays)
    if why:
        raise UsageError(f"{path}: {why}")
    spans = list(itertools.pairwise(arrays["offsets"].tolist()))
    safe = np.flatnonzero(arrays["mode"] == Mode.SAFE)
    rest = np.flatnonzero(arrays["mode"] != Mode.SAFE)
    ways = {name: tuple(arrays[name][slice(*spans[row])] for row in rest) for name in ("positions", "car")}
    if "belief" in arrays:
        with np.errstate(invalid="ignore"):  # nan of a kind that signals is nan
            ways["belief"] = tuple(arrays["belief"][slice(*spans[row])].astype(np.float64) for row in rest)
    whole = {name: arrays[name][rest].astype(np.int64) for name in ("mode", "safe_index", "outcome", "episode_id")}
    phis = tuple(arrays["positions"][slice(*spans[row])] for row in safe)
    margins = _margins(arrays, phis, path)
    stored = StoredEpisodes(
        safe=phis,
        time_step=float(arrays["time_step"]),
        adversary=ways["positions"],
        car=ways["car"],
        mode=whole["mode"],
        objective=arrays["objective"][rest],
        safe_index=whole["safe_index"],
        outcome=whole["outcome"],
        episode_id=whole["episode_id"],
        impact_time=arrays["impact_time"][rest],
        impact_speed=arrays["impact_speed"][rest],
        belief=ways.get("belief", ()),
        hit_speed=float(arrays["hit_speed"]),
        margins=margins,
        margin_ways=() if margins is None else _margin_ways(arrays, margins),
        further=_further(arrays, rest),
    )
    try:
        _ = stored.deviation  # a contact outside its last tick is found here
    except (ValueError, IndexError) as error:
        raise UsageError(f"{path}: {error}") from error
    return stored


def _further(arrays: dict[str, npt.NDArray[Any]], rest: IntArray) -> dict[str, npt.NDArray[Any]]:
    """Return what figures follow from beside the trajectories; `rest` are the rows that are no φ."""
    found = {name: arrays[name] for name in (*_FURTHER, *_OPTIONAL) if name in arrays}
    return {name: one[rest] if name in _OF_EPISODES else one for name, one in found.items()}


def _margins(
    arrays: dict[str, npt.NDArray[Any]], safe: Sequence[FloatArray], path: Path
) -> tuple[FloatArray, ...] | None:
    """Return per φ the margins, each computed anew from its way; None where there are none.

    Raises:
        UsageError: the arrays do not go together, or a way has another deviation than is said.
    """
    if "margin" not in arrays:
        return None
    if missing := [name for name in _MARGIN if name not in arrays]:
        raise UsageError(f"{path}: it has margins and no {missing[0]}")
    said, offsets = arrays["margin"], arrays["margin_offsets"]
    index, attempt = arrays["margin_safe_index"], arrays["margin_attempt"]
    count = len(said)
    whole = len(offsets) == count + 1 and not offsets[0] and offsets[-1] == len(arrays["margin_positions"])
    whole = whole and not (offsets[1:] < offsets[:-1]).any()
    of_attempts = (index, attempt, *(arrays[f"margin_{name}"] for name in ("duration", "impact_speed", "gap")))
    if not (whole and all(len(one) == count for one in of_attempts)):
        raise UsageError(f"{path}: the arrays of the margins do not go together")
    found: list[FloatArray] = []
    for number, phi in enumerate(safe):
        mine = np.flatnonzero(index == number)
        if (attempt[mine] != np.arange(mine.size)).any():
            raise UsageError(f"{path}: the attempts of the margins are not numbered from 0")
        values = np.full(mine.size, np.inf)
        known = np.flatnonzero(np.isfinite(said[mine]))
        ways = [arrays["margin_positions"][offsets[row] : offsets[row + 1]] for row in mine[known].tolist()]
        try:
            values[known] = deviation_pairs(phi, ways, arrays["margin_duration"][mine[known]])
        except (ValueError, IndexError) as error:
            raise UsageError(f"{path}: a way of the margins: {error}") from error
        if (np.abs(values[known] - said[mine[known]]) > _ROUNDING).any():
            raise UsageError(f"{path}: the way of a margin has another deviation than it says")
        found.append(values)
    if sum(map(len, found)) != count:
        raise UsageError(f"{path}: margin_safe_index has a number of a φ that is not there")
    return tuple(found)


def _margin_ways(
    arrays: dict[str, npt.NDArray[Any]], margins: Sequence[FloatArray]
) -> tuple[tuple[StoredWay, ...], ...]:
    """Return per φ the ways of the margins; the arrays go together."""
    offsets = arrays["margin_offsets"].tolist()
    found = []
    for number, distances in enumerate(margins):
        rows = np.flatnonzero(arrays["margin_safe_index"] == number).tolist()
        found.append(
            tuple(
                StoredWay(
                    attempt,
                    distance,
                    arrays["margin_positions"][offsets[row] : offsets[row + 1]],
                    float(arrays["margin_duration"][row]),
                    float(arrays["margin_impact_speed"][row]),
                    float(arrays["margin_gap"][row]),
                )
                for attempt, (row, distance) in enumerate(zip(rows, distances.tolist(), strict=True))
                if np.isfinite(distance)
            )
        )
    return tuple(found)


def _mismatch(arrays: dict[str, npt.NDArray[Any]]) -> str:
    """Return why arrays are not those of episodes; empty where they are."""
    offsets, rows = arrays["offsets"], len(arrays["positions"])
    # Differences of numbers near 2⁶³ begin anew at the other end, and `repeat` would write beyond its array.
    if len(offsets) < 2 or offsets[0] != 0 or offsets[-1] != rows or (offsets[1:] <= offsets[:-1]).any():
        return "its offsets do not cut its positions into trajectories"
    count = len(offsets) - 1
    of_rows = [name for name in ("car", "belief") if name in arrays]
    of_episodes = [name for name in (*_PER_EPISODE, *_OF_EPISODES) if name in arrays]
    if any(len(arrays[name]) != rows for name in of_rows) or any(len(arrays[name]) != count for name in of_episodes):
        return "its arrays do not go together"
    for name, values in (("mode", [*map(int, Mode)]), ("outcome", [*map(int, Outcome)])):
        if not np.isin(arrays[name], values).all():
            return f"{name} has a value that this version does not know"
    is_safe = arrays["mode"] == Mode.SAFE
    if not is_safe.any():
        return "it has no φ"
    if not ((arrays["safe_index"] >= 0) & (arrays["safe_index"] < is_safe.sum())).all():
        return "safe_index has a number of a φ that is not there"
    of_episode = np.repeat(~is_safe, np.diff(offsets))
    # Of an episode that was aborted before it began there is no state of the car.
    never_began = np.repeat((arrays["outcome"] == Outcome.ABORTED) & (np.diff(offsets) == 1), np.diff(offsets))
    known = of_episode & ~(never_began & np.isnan(arrays["car"]).all(axis=1))
    if not within_reach(arrays["positions"], arrays["car"][known]):
        return f"a state is not finite, or beyond ±{FARTHEST:g}"
    hit = ~is_safe & (arrays["outcome"] == Outcome.COLLISION)
    if (np.diff(offsets)[hit] < 2).any() or not within_reach(arrays["impact_time"][hit]):
        return "a collision has no way or no time"
    speeds = arrays["impact_speed"][hit]
    if not (within_reach(speeds) and (speeds >= 0.0).all()):
        return f"a collision has no impact speed, or one below 0 or beyond {FARTHEST:g} m/s"
    for mode, stage in ((Mode.KAMIKAZE, Stage.KAMIKAZE), (Mode.REPLAY, Stage.COLLISION_RATE)):
        if ((arrays["mode"] == mode) & (arrays["episode_id"] >> 48 != stage)).any():
            return f"an episode id is not of its mode, {mode.name}"
    if not 1.0 / FARTHEST <= arrays["time_step"] <= FARTHEST:
        return f"time_step must be from {1.0 / FARTHEST:g} to {FARTHEST:g} s"
    belief = arrays.get("belief", np.empty((0, 4)))
    if not within_reach(belief[~np.isnan(belief)]) or (belief[:, 1::2] < 0.0).any():
        return f"a belief is beyond ±{FARTHEST:g}, or has a negative deviation"
    return ""
