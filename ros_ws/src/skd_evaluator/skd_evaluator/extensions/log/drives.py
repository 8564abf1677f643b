"""Recorded drives: the car and the road users beside it, in one frame and on one clock, as smooth states."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from scipy.signal import savgol_filter
from skd_adversary.safe_trajectories.recordings import header_of
from skd_adversary.safe_trajectories.sources import FRAME_RATE, Clip, ClipTrack, is_citr, read_clips
from skd_sim.errors import UsageError
from skd_sim.world.state import FloatArray

from skd_evaluator.bags.checks import Damage
from skd_evaluator.bags.files import find_recordings, holds_recordings, name_of
from skd_evaluator.bags.tracks import TABLE_CAR, TF, Listed, Track, bag_objects, table_tracks

SMOOTHED, CAR_SMOOTHED = 1.0, 2.0
"""s over which a parabola is fitted to positions of a road user, and of the car, whose speed decides most."""
_FEWEST = 5  # positions of a piece without a gap
_BEFORE, _AFTER = (0.5, 1.0, 2.0, 3.0, 4.0, 6.0), (0.0, 0.25, 0.5, 1.0, 2.0, 3.0)  # s about a time, of a steady drive
_UNEVEN, _AGREES = 2.5, 1.5  # standard errors
_NAMED = 8  # ids in a message
_OWN = 1.0  # m: what is nearer to the car's reference point all the time is the car itself


@dataclass(frozen=True)
class DriveRequest:
    """How drives are read.

    Attributes:
        car: name of the car; None: the usual one.
        map_frame: frame in which tracks of bags are taken; None: the car's.
        tf: topic of a bag's transforms.
        longest_gap: time over which nothing is filled in, s.
    """

    car: str | None = None
    map_frame: str | None = None
    tf: str = TF
    longest_gap: float = 0.5


@dataclass(frozen=True, eq=False)
class RecordedDrive:
    """A drive.

    Attributes:
        name: of the recording.
        car: its track.
        users: the road users.
        left_out: name of each object that is left out, and why.
    """

    name: str
    car: Track
    users: tuple[Track, ...]
    left_out: tuple[tuple[str, str], ...]


def read_drives(
    paths: Sequence[Path], request: DriveRequest, damage: Damage
) -> Iterator[RecordedDrive | tuple[str, str]]:
    """Yield each drive of files and folders, or the name of a recording and why it is none.

    Args:
        paths: recordings of ROS, csv tables with the columns t, id, x, y, folders of CITR, or folders of these.
        request: how they are read.
        damage: takes note of what is left out.

    Raises:
        UsageError: a path is not there, or holds nothing of this kind.
    """
    for path in paths:
        if not path.exists():
            raise UsageError(f"{path}: no such file or folder")
        found = list(_sources(path, request, damage))
        if not found:
            raise UsageError(f"{path}: holds no recording, no csv with the columns t, id, x, y, and no clip of CITR")
        for name, read in found:
            try:
                car, others = read()
            except UsageError as error:
                yield name, str(error)
                continue
            drive = _drive(name, car, others, request.longest_gap)
            if isinstance(drive, RecordedDrive) and not _drives(car):
                damage.warn(f"{name}: the car never drives faster than 1 m/s: are positions in m?")
            yield drive


_Read = Callable[[], tuple[Track, list[Track | Listed]]]


def _sources(path: Path, request: DriveRequest, damage: Damage) -> Iterator[tuple[str, _Read]]:
    """Yield the name of each recording at or below a path, and what reads it."""
    if path.is_dir() and is_citr(path):
        for clip in read_clips(path):
            yield clip.name, partial(_clip, clip)
        return
    tables = sorted(path.rglob("*.csv")) if path.is_dir() else [path] if path.suffix.lower() == ".csv" else []
    for table in tables:
        if path == table or {"t", "id", "x", "y"} <= set(header_of(table)):
            yield table.stem, partial(_table, table, request.car or TABLE_CAR)
    if holds_recordings(path) if path.is_dir() else path not in tables:
        gap, tf = request.longest_gap, request.tf
        for files in find_recordings([path], damage):
            read = partial(bag_objects, files, request.car, request.map_frame, longest_gap=gap, tf=tf, damage=damage)
            yield name_of(files), read


def _table(path: Path, car: str) -> tuple[Track, list[Track | Listed]]:
    found = table_tracks(path)
    own = found.pop(car, None)
    if not isinstance(own, Track):
        known = ", ".join(sorted(found)[:_NAMED])
        raise UsageError(f"{path}: {own.why if own else f'has no id {car!r}; name the car by --car: {known}'}")
    return own, list(found.values())


def _clip(clip: Clip) -> tuple[Track, list[Track | Listed]]:
    def track(one: ClipTrack, name: str) -> Track:
        return Track(one.frames / FRAME_RATE, one.positions, f"{clip.name}, {name}", name=name)

    return track(clip.cart, TABLE_CAR), [track(one, str(one.id)) for one in clip.tracks]


def _drive(name: str, car: Track, others: Sequence[Track | Listed], gap: float) -> RecordedDrive | tuple[str, str]:
    if why := car.jump or car.rate(gap):
        return name, f"{car.name}: {why}"
    users, left_out = [], []
    for one in others:
        why = one.why if isinstance(one, Listed) else one.jump or one.rate(gap) or _is_car(car, one)
        if isinstance(one, Track) and not why:
            users.append(one)
        else:
            left_out.append((one.name, why))
    return RecordedDrive(name, car, tuple(users), tuple(left_out))


def _drives(car: Track) -> bool:
    """Return whether a car goes 1 m or more in any second: one whose positions are in km does not."""
    seconds = np.arange(car.times[0], car.times[-1] + 2.0)
    places = [np.interp(seconds, car.times, column) for column in car.places.T]
    return bool(np.hypot(*np.diff(places)).max() >= 1.0)


def _is_car(car: Track, other: Track) -> str:
    """Return, in words, that an object is always where the car is; empty where it is not."""
    times = other.times[(other.times >= car.times[0]) & (other.times <= car.times[-1])]
    seen = [np.interp(times, car.times, column) for column in car.places.T]
    places = [np.interp(times, other.times, column) for column in other.places.T]
    apart = np.hypot(*np.subtract(seen, places))
    return "is where the car is, all the time: the car itself" if apart.size and apart.max() < _OWN else ""


def states_at(track: Track, times: FloatArray, longest_gap: float, smoothed: float = SMOOTHED) -> FloatArray:
    """Return x, y (m) and their velocities (m/s) at some times (s), n × 4; nan where it is not tracked.

    They are those of the parabola that fits best to the positions of `smoothed` s about each time.
    """
    found = np.full((len(times), 4), np.nan)
    for rows in np.split(np.arange(len(track.times)), np.flatnonzero(np.diff(track.times) > longest_gap) + 1):
        known = track.times[rows]
        if len(rows) < _FEWEST:
            continue
        count = max(_FEWEST, 1 + round((known[-1] - known[0]) / float(np.median(np.diff(known)))))
        even, step = np.linspace(known[0], known[-1], count, retstep=True)
        places = np.column_stack([np.interp(even, known, column) for column in track.places[rows].T])
        window = min(max(_FEWEST, 2 * round(0.5 * smoothed / step) + 1), count - 1 + count % 2)
        fitted = np.column_stack([savgol_filter(places, window, 2, deriv, step, axis=0) for deriv in (0, 1)])
        inside = np.flatnonzero((times >= known[0] - 1e-9) & (times <= known[-1] + 1e-9))
        found[inside] = np.column_stack([np.interp(times[inside], even, column) for column in fitted.T])
    return found


def path_at(track: Track, times: FloatArray, longest_gap: float) -> FloatArray:
    """Return x, y (m) of a road user at some times (s), n × 2; nan where it is not tracked.

    Of the parabolas over 1, 2 and 4 s that is taken which is the longest to agree with the shorter ones, within their
    errors (Katkovnik's intersection of confidence intervals).
    """
    found = np.full((len(times), 2), np.nan)
    low, high, agrees = np.full_like(found, -np.inf), np.full_like(found, np.inf), np.ones(len(times), dtype=bool)
    to_end = np.minimum(times - track.times[0], track.times[-1] - times)
    for smoothed in (SMOOTHED, 2.0 * SMOOTHED, 4.0 * SMOOTHED):
        places = states_at(track, times, longest_gap, smoothed)[:, :2]
        one = _AGREES * _noise(track) * 1.5 / math.sqrt(smoothed / float(np.median(np.diff(track.times))))
        error = np.where(to_end < 0.5 * smoothed, 2.0 * one, one)[:, None]
        low, high = np.fmax(low, places - error), np.fmin(high, places + error)
        agrees = agrees & (low <= high).all(axis=1)
        found = np.where(agrees[:, None], places, found)
    return found


def steady_state(track: Track, time: float, longest_gap: float) -> FloatArray | None:
    """Return x, y (m) and their velocities (m/s) at a time (s) by what was driven evenly about it; None: nothing was.

    Of all spans about the time in which a constant velocity or acceleration leaves no more than noise, it is fitted to
    the one from which the velocity follows best: a car at a steady speed is known better than by `states_at`.
    """
    noise, least, best = _noise(track), math.inf, None
    for before, after, degree in itertools.product(_BEFORE, _AFTER, (1, 2)):
        near = (track.times >= time - before) & (track.times <= time + after)
        passed, free = track.times[near] - time, int(near.sum()) - degree - 1
        if free < _FEWEST or np.diff(passed).max() > longest_gap:
            continue
        base, triangle = np.linalg.qr(np.vander(passed, degree + 2, increasing=True))
        shares = base.T @ track.places[near]  # the last is of the next degree: it is to be noise, as what is left
        left = float(((track.places[near] - base[:, :-1] @ shares[:-1]) ** 2).mean(axis=1).sum()) / free
        if np.abs(shares[-1]).max() < _UNEVEN * noise and left < noise**2 * (1.0 + _UNEVEN / math.sqrt(free)):
            inverse = np.linalg.inv(triangle[:-1, :-1])
            if (error := float(np.linalg.norm(inverse[1]))) < least:
                least, best = error, (inverse @ shares[:-1])[:2].ravel()
    return best


def _noise(track: Track) -> float:
    """Return the standard deviation of positions about the line through their neighbours, m; jumps count little."""
    steps = np.diff(track.times)
    share = (steps[:-1] / (steps[:-1] + steps[1:]))[:, None]
    off = track.places[1:-1] - (1.0 - share) * track.places[:-2] - share * track.places[2:]
    return float(1.4826 * np.median(np.abs(off) / np.sqrt(1.0 + share**2 + (1.0 - share) ** 2)))
