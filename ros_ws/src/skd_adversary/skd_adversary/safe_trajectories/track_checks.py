"""Checks of tracked people and cars: no leaps and holes, velocities that are those of positions, nobody twice."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from skd_sim.arrays import FloatArray, IntArray
from skd_sim.errors import UsageError

LONGEST_HOLE: Final = 0.6
"""s without a row, up to which a straight line says where somebody was."""
_LEAP: Final = 0.5
"""m by which a row may be off what the velocities before and at it give; filtered tracks of CITR are 0.17 m off."""
_WINDOW: Final = 0.5
"""s over which ways are compared."""
_LEAST_WAY: Final = 2.0
"""m, from which on a way shows in which units and which direction it is."""
_ALONGSIDE: Final = 0.3
"""m, within which two people do not stay for as long as they are seen."""
_SEEN: Final = 0.5
"""s that two people are seen together at the least, before that says anything."""
_TOLD: Final = 3
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
        share: of the stated way by which that of the positions may differ, in length or direction.

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
    of = np.minimum(np.searchsorted(times, times + _WINDOW), len(times) - 1)
    went = np.vstack([np.zeros((1, 2)), np.cumsum(stated, axis=0)])
    seen, said = positions[of] - positions, went[of] - went
    way = max(float(np.hypot(*one.sum(axis=0))) for one in (moved, stated))
    if way < _LEAST_WAY:
        return
    # Least squares of a turn and a stretch that take stated ways for those of the positions: 1 where they agree.
    seen, said = seen @ np.array([1.0, 1j]), said @ np.array([1.0, 1j])
    squares = float(np.sum(np.abs(said) ** 2))
    turned = complex(np.sum(seen * said.conj())) / squares if squares > 0.0 else np.inf
    if abs(turned - 1.0) > share:
        raise UsageError(
            f"{where}, line {lines[0]}: the positions from here on go another way than the velocities beside them, "
            f"{abs(turned):.2g} times as far and {abs(np.degrees(np.angle(turned))):.0f}° aside: are columns, units "
            "(m, m/s, rad), frame rate and order those of the dataset?"
        )


def check_apart(where: Path, people: Sequence[tuple[int, IntArray, FloatArray]], rate: float) -> None:
    """Refuse two people of a recording who are one: of ids, frames (n) and positions (n × 2, m).

    Raises:
        UsageError: two of them stay within a step of each other as long as both are seen.
    """
    for place, (first, frames, positions) in enumerate(people):
        for second, others, beside in people[place + 1 :]:
            _, mine, theirs = np.intersect1d(frames, others, assume_unique=True, return_indices=True)
            if len(mine) > _SEEN * rate and np.hypot(*(positions[mine] - beside[theirs]).T).max() < _ALONGSIDE:
                raise UsageError(
                    f"{where}: ids {first} and {second} are never {_ALONGSIDE:g} m apart: one person under two ids? "
                    "Leave one of them out"
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
        raise UsageError(f"{named[second][0]}: {once_more(named[first][0])}; leave one of them out")


def repeated(ways: Sequence[FloatArray], *, moved: bool) -> Iterator[tuple[int, int]]:
    """Yield the index of each way (n × 2, m) that is there once more, and that of the first that it is the same as.

    Args:
        ways: positions of each; with a third column, that is compared as well.
        moved: also the same way from another place.
    """
    known: dict[bytes, int] = {}
    for index, positions in enumerate(ways):
        if len(positions) < _TOLD:
            continue
        key = (np.round(positions - positions[0] * moved, 5) + 0.0).tobytes()  # + 0: −0 is 0
        first = known.setdefault(key, index)
        if first != index:
            yield index, first


def once_more(name: str) -> str:
    """Return what is said of the way that is that of `name` once more."""
    return f"is the way of {name} once more, and would count as another person's"
