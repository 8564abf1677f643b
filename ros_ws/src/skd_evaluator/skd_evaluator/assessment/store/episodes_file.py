"""episodes.npz: every trajectory of an assessment, so that all its figures can be computed anew; see docs/files.md."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import IO, Any

import numpy as np
import numpy.typing as npt
from skd_adversary.adversary import BelievedCar
from skd_sim.world.episode import EpisodeLog, Mode, Outcome

from skd_evaluator.assessment.judge.rating import Rating
from skd_evaluator.assessment.plan.plan import split_episode_id
from skd_evaluator.assessment.store.stored_failures import failure_columns
from skd_evaluator.metrics.risks import ScaleRisk, Touch

_NOWHERE = (math.nan, math.nan)
_BELIEVED = len(BelievedCar._fields)

Columns = dict[str, Any]  # name → array; numpy's savez would take one of arrays for its own options


class _Later:
    """An array that is made when it is written: `savez` makes one after the other, and keeps none.

    Of a hundred thousand episodes those with a row for each tick would be the most that an assessment ever holds.
    """

    def __init__(self, make: Callable[[], npt.NDArray[Any]]) -> None:
        """Have `make` make it, as often as somebody asks."""
        self._make = make

    def __array__(self, dtype: npt.DTypeLike | None = None, copy: bool | None = None) -> npt.NDArray[Any]:
        made = self._make()
        return made if dtype is None else made.astype(dtype)


def write_episodes(path: Path | IO[bytes], rating: Rating) -> None:
    """Write every trajectory of a rating; docs/files.md says what each array holds.

    First is Φ, then, objective by objective and φ by φ, every kamikaze episode in the order of its attempts, those that
    failed or were aborted too; last are the runs along φ. A kamikaze is told by its objective and its id: those of
    different objectives with one id have the same draws. Arrays that begin with `margin` are of the ways of least
    deviation, which nobody has planned.
    """
    logs: list[EpisodeLog] = []
    rows: list[tuple[int, str]] = []  # number of φ, objective
    for assessment in rating.assessments:
        for index, kamikaze in enumerate(assessment.kamikaze):
            for log in kamikaze.in_order:
                logs.append(log)
                rows.append((index, str(assessment.plan.objective)))
    for log, index in zip(rating.replays, _along(rating), strict=True):
        logs.append(log)
        rows.append((index, ""))
    safe = _columns_of_safe(rating)
    columns = episode_columns(logs, safe)
    offsets = columns.pop("offsets")
    indices, objectives = zip(*rows, strict=True) if rows else ((), ())
    count = len(rating.safe)
    if any(log.belief is not None for log in logs):
        columns["belief"] = _Later(lambda: _beliefs(logs, offsets[len(rating.safe) :]))
    if any(log.own_contact is not None for log in logs):
        own = [math.nan if log.own_contact is None else log.own_contact for log in logs]
        columns["own_contact"] = np.array([*[math.nan] * count, *own])
    np.savez_compressed(
        path,
        **columns,
        offsets=offsets,
        safe_index=np.array([*range(count), *indices], np.int32),
        objective=np.array([*[""] * count, *objectives], "U16"),
        safe_name=_texts([one.name for one in rating.safe]),
        **_margin_columns(rating),
        **_risk_columns(rating),
        **_settings(rating),
    )


def episode_columns(logs: Sequence[EpisodeLog], before: Mapping[str, Any] = MappingProxyType({})) -> Columns:
    """Return the arrays of episodes.npz that follow from logs alone, in their order, for `savez` to write.

    Args:
        logs: the episodes.
        before: such arrays of what stands before them.
    """
    positions, car = before.get("positions", np.empty((0, 2))), before.get("car", np.empty((0, 3)))
    offsets, lengths = before.get("offsets", np.zeros(1, np.int64)), [len(log.adversary) for log in logs]
    own = {
        "mode": np.array([int(log.episode.mode) for log in logs], np.int8),
        "outcome": np.array([int(log.outcome) for log in logs], np.int8),
        "episode_id": np.array([log.episode.episode_id for log in logs], np.int64),
        "impact_time": np.array([log.impact_time for log in logs], np.float64),
        "impact_speed": np.array([log.impact_speed for log in logs], np.float64),
        "contact": np.array([_contact(log) for log in logs], np.float64).reshape(-1, 2),
        "clipped": np.array([log.clipped for log in logs], np.int64),
        "reason": _texts([log.reason for log in logs]),
    }
    return {
        "positions": _Later(lambda: np.concatenate([positions, *(log.adversary for log in logs)])),
        "car": _Later(lambda: np.concatenate([car, *(log.car for log in logs)])),
        "offsets": np.concatenate([offsets, offsets[-1] + np.cumsum(lengths, dtype=np.int64)]),
        **{name: np.concatenate([before[name], column]) if before else column for name, column in own.items()},
    }


def _along(rating: Rating) -> list[int]:
    """Return which φ each run is along, in the order of Φ; recordings need not have every run, nor every φ."""
    places: dict[bytes, list[int]] = {}
    for index, phi in enumerate(rating.safe):
        places.setdefault(phi.positions.tobytes(), []).append(index)
    numbers = [split_episode_id(log.episode.episode_id)[1] for log in rating.replays]
    alike: dict[bytes, set[int]] = {}  # φ that are the same to the bit are told apart by their numbers
    followed = [log.episode.safe_trajectory for log in rating.replays]
    paths = [b"" if one is None else one.positions.tobytes() for one in followed]
    for path, number in zip(paths, numbers, strict=True):
        alike.setdefault(path, set()).add(number)
    turns = {(path, number): turn for path, found in alike.items() for turn, number in enumerate(sorted(found))}
    return [places[path][turns[path, number]] for path, number in zip(paths, numbers, strict=True)]


def _columns_of_safe(rating: Rating) -> Columns:
    """Return the same arrays of Φ, which were recorded, or made against another car."""
    count, lengths = len(rating.safe), [len(one) for one in rating.safe]
    return {
        "positions": np.concatenate([one.positions for one in rating.safe]),
        "car": np.full((sum(lengths), 3), np.nan),
        "offsets": np.cumsum([0, *lengths], dtype=np.int64),
        "mode": np.full(count, int(Mode.SAFE), np.int8),
        "outcome": np.full(count, int(Outcome.ARRIVED), np.int8),
        "episode_id": np.zeros(count, np.int64),
        "impact_time": np.full(count, np.nan),
        "impact_speed": np.full(count, np.nan),
        "contact": np.full((count, 2), np.nan),
        "clipped": np.zeros(count, np.int64),
        "reason": _texts([""] * count),
    }


def _settings(rating: Rating) -> Columns:
    """Return what the figures depend on beside the trajectories."""
    plan = rating.plan
    return {
        "time_step": np.array(plan.scenario.time_step),
        "eta_max": np.array(plan.scenario.eta_max),
        "hit_speed": np.array(plan.scenario.collision.hit_speed),
        "maximum_distance": np.array(math.nan if plan.maximum_distance is None else plan.maximum_distance),
        "seed": np.array(plan.seed, np.int64),
        "objectives": _texts([str(one.plan.objective) for one in rating.assessments]),
        "plans_deviation": np.array([one.plan.limits_deviation for one in rating.assessments]),
    }


def _contact(log: EpisodeLog) -> tuple[float, float]:
    """Return where the adversary was at the first contact, m; nan without one."""
    if log.outcome != Outcome.COLLISION:
        return _NOWHERE
    x, y = log.trajectory.positions[-1].tolist()
    return x, y


def _beliefs(logs: Sequence[EpisodeLog], offsets: npt.NDArray[np.int64]) -> npt.NDArray[np.float32]:
    """Return what was believed of the car at each state; nan where nothing was, or it is not known.

    In millimetres, which is finer than anybody looks, a file of them is half as large. Logs begin at `offsets`, of
    which the last is the number of all states.
    """
    believed = np.full((int(offsets[-1]), _BELIEVED), np.nan, np.float32)
    for log, begin in zip(logs, offsets.tolist(), strict=False):
        if log.belief is not None:
            believed[begin : begin + len(log.adversary)] = np.round(log.belief, 3)
    return believed


def _texts(texts: Sequence[str]) -> npt.NDArray[np.str_]:
    return np.array(texts, f"U{max(1, *map(len, texts))}" if texts else "U1")


def _margin_columns(rating: Rating) -> Columns:
    """Return the least way of each attempt of the margin, φ by φ; nothing where the margin is not known.

    An attempt without a way has no position, and counts as η_max.
    """
    if rating.margins is None:
        return {}
    rows = [(index, attempt, way) for index, ways in enumerate(rating.margins.ways) for attempt, way in enumerate(ways)]
    ways = [way for _, _, way in rows]
    lengths = [0 if way is None else len(way.trajectory) for way in ways]
    return {
        "margin": np.array([math.nan if way is None else way.distance for way in ways]),
        "margin_gap": np.array([math.nan if way is None else way.gap for way in ways]),
        "margin_safe_index": np.array([index for index, _, _ in rows], np.int32),
        "margin_attempt": np.array([attempt for _, attempt, _ in rows], np.int64),
        "margin_duration": np.array([math.nan if way is None else way.duration for way in ways]),
        "margin_impact_speed": np.array([math.nan if way is None else way.impact_speed for way in ways]),
        "margin_positions": np.concatenate(
            [np.empty((0, 2)), *(w.trajectory.positions for w in ways if w is not None)]
        ),
        "margin_offsets": np.cumsum([0, *lengths], dtype=np.int64),
    }


def _contact_ticks(risk: ScaleRisk) -> npt.NDArray[np.int32]:
    """Return of each crude crossing the number of the tick of a hit, from 1; 0 of one that is none."""
    ticks = np.zeros(len(risk.touches), np.int32) if risk.ticks is None else risk.ticks
    return np.where(risk.touches == Touch.FRONT, ticks, 0).astype(np.int32)


def _risk_columns(rating: Rating) -> Columns:
    """Return how the crossings of the risk ended, scale by scale; nothing where the risk is not known.

    What subset simulation estimates on each φ is replicates × φ, nan at scales at which it was not asked.
    """
    if rating.risks is None:
        return {}
    scales = rating.risks.scales
    subsets = [one.subsets for one in scales]
    replicates = max((len(one.levels) for one in subsets if one is not None), default=0)
    shares, levels = np.full((replicates, len(rating.safe)), math.nan), np.zeros(replicates, np.int64)
    return {
        "risk_scale": np.array([one.scale for one in scales]),
        "risk_touch": np.array([one.touches for one in scales], np.int8).reshape(-1),
        "risk_share": np.array([shares if one is None else one.shares for one in subsets]).reshape(-1),
        "risk_levels": np.array([levels if one is None else one.levels for one in subsets], np.int64).reshape(-1),
        "risk_per_level": np.array([0 if one is None else one.per_level for one in subsets], np.int64),
        "risk_open": np.array([0 if one is None else one.open_levels for one in subsets], np.int64),
        "risk_tick": np.concatenate([_contact_ticks(one) for one in scales]),
        **({"risk_lost": np.array([one.lost for one in scales], np.int64)} if any(one.lost for one in scales) else {}),
        **(failure_columns(rating.risks.failing) if rating.risks.failing else {}),
    }
