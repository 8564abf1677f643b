"""Recorded people and cars: no leaps and holes, velocities that are those of positions, nobody twice; world frame."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from skd_sim.arrays import FloatArray, IntArray
from skd_sim.errors import UsageError

LONGEST_HOLE: Final = 0.6
"""s without a row, up to which a straight line says where somebody was."""
_LEAP: Final = 0.5
"""m by which a row may be off what the velocities before and at it give; filtered tracks of CITR are 0.17 m off."""
_LEAST_WAY: Final = 2.0
"""m, from which on a way shows in which units and which direction it is."""
_LEAST_POSITIONS: Final = 3
"""Positions at the least by which somebody is told from others."""


def check_motion(
    times: FloatArray, positions: FloatArray, velocities: FloatArray, lines: IntArray, where: Path, share: float
) -> None:
    """Refuse a track that leaps, has a hole, or whose stated velocities are not those of its positions.

    Args:
        times: n, s, strictly increasing.
        positions: n × 2, m.
        velocities: n × 2, m/s, as the recording states them.
        lines: of the file, of each row.
        where: the file, for messages.
        share: of the longer way, by positions or velocities, by which the two may differ.

    Raises:
        UsageError: it is so.
    """
    passed = np.diff(times)
    if not len(passed):
        return
    hole = int(np.argmax(passed))
    if passed[hole] > LONGEST_HOLE:
        raise UsageError(
            f"{where}, line {lines[hole + 1]}: {passed[hole]:.3g} s after the row before of the same id, more than "
            f"{LONGEST_HOLE:g} s; cut a track where it has a hole"
        )
    moved, stated = np.diff(positions, axis=0), 0.5 * (velocities[1:] + velocities[:-1]) * passed[:, None]
    off = np.hypot(*(moved - stated).T)
    if off.max() > _LEAP:
        leap = int(np.argmax(off > _LEAP))
        raise UsageError(
            f"{where}, line {lines[leap + 1]}: moves {float(np.hypot(*moved[leap])):.3g} m in {passed[leap]:.3g} s, "
            f"and {float(np.hypot(*stated[leap])):.3g} m by its velocities: are positions in m, without jumps?"
        )
    went, said = moved.sum(axis=0), stated.sum(axis=0)
    longer = max(float(np.hypot(*went)), float(np.hypot(*said)))
    if longer > _LEAST_WAY and float(np.hypot(*(went - said))) > share * longer:
        raise UsageError(
            f"{where}, line {lines[0]}: the positions from here on go ({went[0]:.3g}, {went[1]:.3g}) m, and their "
            f"velocities ({said[0]:.3g}, {said[1]:.3g}) m: are columns, units (m, m/s, rad), frame rate and order "
            "those of the dataset?"
        )


def check_once(ways: Iterable[tuple[str, FloatArray]], *, moved: bool = True) -> None:
    """Refuse a way that is there twice: one person would count as two.

    Args:
        ways: name (file, or recording and id) and positions (n × 2, m) of each.
        moved: also the same way from another place. No two people who were tracked go the same way; such as were drawn
            may.

    Raises:
        UsageError: two are the same to a hundredth of a millimetre.
    """
    named = list(ways)
    for second, first in repeated([positions for _, positions in named], moved=moved):
        raise UsageError(f"{named[second][0]}: {duplicate_of(named[first][0])}; leave one of them out")


def repeated(ways: Sequence[FloatArray], *, moved: bool) -> Iterator[tuple[int, int]]:
    """Yield the index of each way (n × 2, m) that is there once more, and that of the first that it is the same as.

    Args:
        ways: positions of each; with a third column, that is compared as well.
        moved: also the same way from another place.
    """
    known: dict[bytes, int] = {}
    for index, positions in enumerate(ways):
        if len(positions) < _LEAST_POSITIONS:
            continue
        key = (np.round(positions - positions[0] * moved, 5) + 0.0).tobytes()  # + 0: −0 is 0
        first = known.setdefault(key, index)
        if first != index:
            yield index, first


def duplicate_of(name: str) -> str:
    """Return what is said of the way that is that of `name` once more."""
    return f"is the way of {name} once more, and would count as another person's"


class CarFrameTrack(NamedTuple):
    """A way as it is seen from the car's.

    Attributes:
        positions: n × 2 (East, North), m.
        mirrored: whether East and West were exchanged, so that it goes East.
        aside: how far the car was off its straight line at most, m.
    """

    positions: FloatArray
    mirrored: bool
    aside: float


def in_car_frame(car: FloatArray, way: FloatArray) -> CarFrameTrack:
    """Return a recorded way in the world frame.

    Rotated so that the car drives North: its direction and x = 0 are those of the straight line fitted to its positions
    (total least squares). Mirrored, if need be, so that the way goes East. y = 0 is where it crosses x = 0 for the
    first time (linear interpolation), or its first point where it does not.

    Args:
        car: k × 2 positions of the car, m, which are not all the same.
        way: n × 2 positions of the road user, m, in the same frame.
    """
    centre = car.mean(axis=0)
    direction = np.linalg.svd(car - centre, full_matrices=False)[2][0]
    if direction @ (car[-1] - car[0]) < 0.0:
        direction = -direction
    across = np.array([direction[1], -direction[0]])
    offset = way - centre
    north = offset @ direction
    east = offset @ across
    mirrored = bool(east[-1] < east[0])
    if mirrored:
        east = -east
    after = np.flatnonzero((east[:-1] < 0.0) & (east[1:] >= 0.0))
    origin = north[0]
    if len(after):
        i = int(after[0])
        origin = north[i] + (north[i + 1] - north[i]) * east[i] / (east[i] - east[i + 1])
    aside = float(np.abs((car - centre) @ across).max())
    return CarFrameTrack(np.column_stack([east, north - origin]), mirrored, aside)
