"""What the page's script reads of episodes: the scene of each subject, and columns of numbers, packed.

The block is gzip of: the length of the JSON in bytes (uint32, little-endian), the JSON, zero bytes up to a multiple of
4, and the columns one after another, each beginning at a multiple of 4 bytes. The JSON's `columns` says of each its
name, type and length. Base64 has no character that means anything in HTML, so that no name of anybody's can.
"""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
from skd_sim.arrays import FloatArray
from skd_sim.scenario.scenario import Scenario

from skd_evaluator.report.episode_pictures import believed_car
from skd_evaluator.report.html.subjects import Subject

_STRAIGHT, _CURVED = 60.0, 80.0  # m of the lane to each side of the crossing
_DIGITS = 2
"""Of what is drawn in m: as many as ways have, so that who is on φ is drawn on it."""


def scene(subject: Subject) -> dict[str, Any]:
    """Return road (edges of its lanes and arrows on them, m), car, adversary, others and φ of a subject."""
    scenario = subject.scenario
    length = _STRAIGHT if scenario.road.straight else _CURVED
    radius, half_length, half_width = scenario.adversary.shape
    names = [str(row["name"]) for row in subject.figures["per_safe_trajectory"]]
    return {
        "lanes": [[_rounded(edge) for edge in edges] for edges in scenario.road.surfaces(-length, length)],
        "arrows": [_rounded(arrow) for arrow in scenario.road.arrows(-length, length)],
        "obstacles": [_rounded(one.corners) for one in scenario.obstacles],
        "others": [_other(scenario, index) for index in range(len(scenario.others))],
        "car": {"front": scenario.car.front, "rear": scenario.car.rear, "half": scenario.car.half_width},
        "user": {"radius": radius, "halfLength": half_length, "halfWidth": half_width},
        "timeStep": subject.episodes.time_step,
        "safe": [
            {"name": name, "points": _rounded(phi)} for name, phi in zip(names, subject.episodes.safe, strict=True)
        ],
    }


def _other(scenario: Scenario, index: int) -> dict[str, Any]:
    """Return shape, places (m) and headings (rad) at ticks of one of the others; one place of one that stands."""
    other = scenario.others[index]
    radius, half_length, half_width = other.shape
    states = [scenario.others_at(tick)[index] for tick in range(1 if other.stands else scenario.ticks + 1)]
    return {
        "radius": radius,
        "halfLength": half_length,
        "halfWidth": half_width,
        "points": _rounded(np.array([state[:2] for state in states])),
        "headings": [round(state.heading, 3) for state in states],
    }


def margin_hits(subject: Subject, most: int) -> list[list[dict[str, Any]]]:
    """Return per φ the margin trajectories, the least first, at most so many: points at ticks, m, and their figures."""
    if not subject.episodes.margin_hits:
        return [[] for _ in subject.episodes.safe]
    return [
        [
            {
                "points": _rounded(way.trajectory.positions),
                "deviation": round(way.distance, 3),
                "impactSpeed": round(way.impact_speed, 2),
                "trial": trial,
            }
            for trial, way in sorted(
                ((k, one) for k, one in enumerate(ways) if one is not None),
                key=lambda pair: (pair[1].distance, pair[0]),
            )[:most]
        ]
        for ways in subject.episodes.margin_hits
    ]


def _rounded(points: FloatArray) -> list[list[float]]:
    return [[round(float(x), _DIGITS), round(float(y), _DIGITS)] for x, y in points]


RESOLUTION = 0.01
"""m, m/s: of the positions and speeds that the page draws; figures in its table are rounded by themselves."""
_ALIGNED = 4
_TYPES = {"float32": "f4", "int32": "i4", "int16": "i2", "uint16": "u2", "uint8": "u1"}

Array = npt.NDArray[Any]


def pack(content: Mapping[str, Any], columns: Mapping[str, Array]) -> str:
    """Return the block, as base64.

    Args:
        content: data of the page as JSON has it; the key `columns` is added.
        columns: one-dimensional arrays of the types in `_TYPES`, by name.
    """
    listed = [{"name": name, "type": str(one.dtype), "length": len(one)} for name, one in columns.items()]
    text = json.dumps({**content, "columns": listed}, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    head = text.encode()
    parts = [len(head).to_bytes(4, "little"), head]
    for one in columns.values():
        parts.append(b"\0" * (-sum(map(len, parts)) % _ALIGNED))
        parts.append(one.astype(f"<{_TYPES[str(one.dtype)]}").tobytes())
    return base64.b64encode(gzip.compress(b"".join(parts), 9, mtime=0)).decode("ascii")


def unpack(block: str) -> tuple[dict[str, Any], dict[str, Array]]:
    """Return what `pack` was given."""
    content = gzip.decompress(base64.b64decode(block))
    length = int.from_bytes(content[:4], "little")
    head = json.loads(content[4 : 4 + length])
    columns, offset = {}, 4 + length
    for one in head.pop("columns"):
        offset += -offset % _ALIGNED
        kind = np.dtype(f"<{_TYPES[one['type']]}")
        columns[one["name"]] = np.frombuffer(content, kind, one["length"], offset)
        offset += one["length"] * kind.itemsize
    return head, columns


def episode_columns(subjects: Sequence[Subject], order: Sequence[tuple[int, int]], ways: int) -> dict[str, Array]:
    """Return episodes as columns, behind them the failures of each subject; row k of each but the ways is episode k.

    `rows` says how many positions an episode has, at ticks up to the contact; 0: they are not in the page. `ways` holds
    them in units of `RESOLUTION`: of each episode x of the adversary, then y, then x and y of the car, its speed, and
    its heading in units of a tenth of that; each as the first value and the differences from one tick to the next.
    `beliefs` likewise has, of the episodes whose `believed` is 1, what `report.believed_car` says of each tick.

    Args:
        subjects: assessments whose episodes are packed.
        order: episodes in the order of the page, each as (index of the subject, number of its episode).
        ways: for how many episodes, counted from the first, the page holds the positions.
    """
    objectives = objective_names(subjects)
    columns: dict[str, list[Any]] = {name: [] for name in _KINDS}
    found: list[Array] = [np.empty(0, np.int64)]
    beliefs: list[Array] = [np.empty(0, np.int64)]
    subjects = [*subjects, *(replace(one, episodes=one.failing) for one in subjects)]
    count = len(subjects) // 2
    sizes = enumerate((len(one.episodes) for one in subjects[count:]), start=count)
    failing = [(index, number) for index, size in sizes for number in range(size)]
    for place, (index, number) in enumerate([*order, *failing]):
        stored, shown = subjects[index].episodes, place < ways or index >= count
        columns["subject"].append(index % count)
        columns["objective"].append(objectives.index(str(stored.objective[number])))
        columns["hit"].append(bool(stored.hit[number]))
        columns["trial"].append(stored.episode_id[number] & 0xFFFF_FFFF)
        for name in ("safe_index", "outcome", "deviation", "frechet", "impact_time", "impact_speed"):
            columns[name].append(getattr(stored, name)[number])
        belief = _belief(subjects[index], number) if shown else None  # none where it never began
        columns["believed"].append(belief is not None)
        if belief is not None:
            beliefs.append(belief)
        drawn = shown and bool(np.isfinite(stored.car[number]).all())  # else it was aborted before it began
        if drawn:
            found.append(_way(subjects[index], number))
        columns["rows"].append(len(found[-1]) // _WAY if drawn else 0)
    packed = {name: np.array(values, dtype=_KINDS[name]) for name, values in columns.items()}
    return {**packed, "ways": _small(np.concatenate(found)), "beliefs": _small(np.concatenate(beliefs))}


def _small(values: Array) -> Array:
    """Return whole numbers in the smallest type that holds them."""
    fits = values.size == 0 or int(np.abs(values).max()) <= np.iinfo(np.int16).max
    return values.astype(np.int16 if fits else np.int32)


_WAY = 6
"""Columns of a way."""
_KINDS: Mapping[str, npt.DTypeLike] = {
    "subject": np.uint16, "safe_index": np.uint16, "objective": np.uint8, "outcome": np.uint8, "hit": np.uint8,
    "trial": np.int32, "rows": np.uint16, "believed": np.uint8, "deviation": np.float32, "frechet": np.float32,
    "impact_time": np.float32, "impact_speed": np.float32,
}  # fmt: skip


def worst_first(subjects: Sequence[Subject]) -> list[tuple[int, int]]:
    """Return (subject, number) of every episode, the worst for its car first."""
    orders = [one.episodes.worst_first() for one in subjects]
    pairs = [(index, int(number)) for index, order in enumerate(orders) for number in order]
    keys = [subjects[index].episodes.badness(number) for index, number in pairs]
    return [pairs[place] for place in sorted(range(len(pairs)), key=keys.__getitem__)]


def objective_names(subjects: Sequence[Subject]) -> list[str]:
    """Return what the numbers in the column `objective` mean: 0 is a run along φ, others are of kamikazes."""
    return list(dict.fromkeys(["", *(name for one in subjects for name in one.figures["objectives"])]))


def _way(subject: Subject, number: int) -> Array:
    """Return positions, speeds and headings of an episode as the page has them."""
    adversary = subject.episodes.until_contact(number)
    car = subject.episodes.car_until_contact(number, subject.scenario)
    heading = 10.0 * np.unwrap(car[:, 2])
    return _steps(np.column_stack([adversary, car[:, :2], car[:, 3], heading]))


def _belief(subject: Subject, number: int) -> Array | None:
    """Return what a kamikaze believed of the car as the page has it; none where that is not known."""
    stored = subject.episodes
    if not stored.belief:
        return None
    found = believed_car(subject.scenario, stored.car[number], stored.belief[number])
    return None if found is None else _steps(found)


def _steps(values: Array) -> Array:
    """Return columns in units of `RESOLUTION`, one after another, each as first value and differences."""
    return np.diff(np.rint(values / RESOLUTION).astype(np.int64), axis=0, prepend=0).T.ravel()
