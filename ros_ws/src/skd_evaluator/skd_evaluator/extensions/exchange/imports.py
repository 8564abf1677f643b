"""Import: finds recorded tracks in files of any format and turns them into safe trajectories in the frame `map`."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from skd_adversary.safe_trajectories.recordings import in_car_frame
from skd_adversary.safe_trajectories.sources import safe_trajectory
from skd_sim.arrays import FloatArray
from skd_sim.errors import UsageError
from skd_sim.inputs.files import is_there, read_json, read_xml
from skd_sim.scenario.road import right_and_along
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.episode import Mode

from skd_evaluator.bags.checks import METADATA
from skd_evaluator.bags.mcap_file import Condition, read_messages
from skd_evaluator.bags.read import ADVERSARY as ADVERSARY_TOPIC
from skd_evaluator.bags.read import CAR as CAR_TOPIC
from skd_evaluator.extensions.exchange.osi import SCHEMA, read_osi
from skd_evaluator.extensions.exchange.scene import ADVERSARY, ADVERSARY_ID, EGO, EGO_ID, EXPORT
from skd_evaluator.extensions.exchange.track_tables import is_beside_tracks, read_table
from skd_evaluator.extensions.exchange.tracks import (
    COMMONROAD,
    OPENSCENARIO,
    TrackedObject,
    one_of,
    read_commonroad,
    read_openscenario,
    track_of,
)
from skd_evaluator.extensions.fusion.recording import TABLE_CAR, TABLE_OTHER, BagTrack, bag_tracks
from skd_evaluator.extensions.fusion.track import FASTEST, RecordingFrame, Track

_SUFFIXES = (".xosc", ".xml", ".csv", ".mcap")
_OSI_NAME = re.compile(r"\d{8}T\d{6}Z?_[a-z]+_\d+_\d+_\d+_")
_XML = {
    OPENSCENARIO: (read_openscenario, "OpenSCENARIO XML", EGO, ADVERSARY),
    COMMONROAD: (read_commonroad, "CommonRoad XML", str(EGO_ID), str(ADVERSARY_ID)),
}
"""By the root element: reader, what it is, and what `skd export` calls car and adversary there."""


@dataclass(frozen=True)
class ImportRequest:
    """Whose ways are asked for.

    Attributes:
        road_user: name of the road user; None: the usual one, or every track of a kind.
        car: name of the car; None: the usual one, if it is needed.
        kind: kind of road user, where a file has many.
        needs_car: whether the car's way is needed.
        map_frame: frame of bags in which ways are wanted.
    """

    road_user: str | None = None
    car: str | None = None
    kind: str = "pedestrian"
    needs_car: bool = False
    map_frame: str | None = None


@dataclass(frozen=True, eq=False)
class TrackSource:
    """A way that was found in a file.

    Attributes:
        stem: name for its file, without ending.
        path: where it was found.
        format: what the file is.
        found: the road user.
        car: the car; None where it is not needed.
    """

    stem: str
    path: Path
    format: str
    found: TrackedObject
    car: TrackedObject | None


def files_in(paths: Sequence[Path]) -> tuple[list[Path], list[Path]]:
    """Return the files, and folders of bags, that hold ways, of a folder those in it, by name; and those left out.

    Of a folder that `skd export` has written only safe trajectories are taken, for its export.json says which they are.

    Raises:
        UsageError: a path is not there, or a folder has no such file.
    """
    found: list[Path] = []
    beside: list[Path] = []
    for path in paths:
        if not is_there(path):
            raise UsageError(f"{path}: no such file or folder")
        if not path.is_dir() or (path / METADATA).exists():
            kept = _safe_in_export(path.parent)
            if kept is not None and path.name not in kept:
                raise UsageError(f"{path}: {EXPORT} beside it says that it is no safe trajectory; give one of its φ")
            found.append(path)
            continue
        inside = sorted(one for one in path.iterdir() if not one.name.startswith("."))
        files = [one for one in inside if _holds_ways(one)]
        if not files:
            raise UsageError(f"{path}: no file in it ends in {', '.join(_SUFFIXES)}, and none is a bag's folder")
        kept = _safe_in_export(path)
        if kept is not None:
            beside += [one for one in files if one.name not in kept]
            files = [one for one in files if one.name in kept]
        found += files
    return found, beside


def _safe_in_export(folder: Path) -> set[str] | None:
    """Return the names of the safe trajectories in a folder of `skd export`; None of any other folder."""
    path = folder / EXPORT
    if not is_there(path):
        return None
    content = read_json(path)
    try:
        return {str(one["file"]) for one in content["files"] if one["mode"] == Mode.SAFE.name.lower()}
    except (KeyError, TypeError) as error:
        raise UsageError(f"{path}: is not of skd export") from error


def _holds_ways(path: Path) -> bool:
    if path.is_dir():
        return (path / METADATA).exists()
    return path.suffix.lower() in _SUFFIXES and not is_beside_tracks(path) and path.is_file()


def read_sources(path: Path, asked: ImportRequest) -> list[TrackSource]:
    """Return the ways that are asked for out of a file or a bag's folder.

    Raises:
        UsageError: it cannot be read, is of no known format, or nobody in it is who is asked for.
    """
    stem = _OSI_NAME.sub("", path.stem)
    if path.is_dir() or path.suffix.lower() == ".mcap":
        return [_from_osi(path, asked, stem) if _is_osi(path) else _from_bag(path, asked, stem)]
    if path.suffix.lower() == ".csv":
        return _from_table(path, asked, stem)
    root = read_xml(path)
    if root.tag not in _XML:
        raise UsageError(f"{path}: its root is {root.tag[:40]!r}; read are {' and '.join(_XML)}")
    reader, said, ego, adversary = _XML[root.tag]
    return [_chosen(path, said, reader(root, str(path)), asked, stem, (ego, adversary))]


def _chosen(
    path: Path, said: str, found: Sequence[TrackedObject], asked: ImportRequest, stem: str, usual: tuple[str, str]
) -> TrackSource:
    ego, adversary = usual
    others = [one for one in found if one.name != ego] if asked.road_user is None else found
    user = one_of(others, asked.road_user, adversary, "--road-user", str(path))
    return TrackSource(stem, path, said, user, _car(path, found, asked, ego))


def _car(path: Path, found: Sequence[TrackedObject], asked: ImportRequest, usual: str) -> TrackedObject | None:
    if not asked.needs_car:
        return None
    return one_of(found, asked.car or usual, usual, "--car", str(path))


def _from_table(path: Path, asked: ImportRequest, stem: str) -> list[TrackSource]:
    names = {asked.road_user, asked.car} - {None} if asked.road_user is not None else set()
    found, said = read_table(path, {str(one) for one in names}, asked.kind)
    usual = (TABLE_CAR, TABLE_OTHER)
    many = [one for one in found if one.kind]
    if asked.road_user is None and many:
        if asked.needs_car:
            raise UsageError(f"{path}: --frame car needs one --road-user and one --car of its tracks")
        return [TrackSource(f"{stem}_{one.name}", path, said, one, None) for one in many]
    return [_chosen(path, said, found, asked, stem, usual)]


def _is_osi(path: Path) -> bool:
    """Return whether an MCAP file holds ground truth of OSI, by the type of its first message."""
    if path.is_dir():
        return False
    first = next(read_messages(path, lambda _topic: True, Condition()), None)
    return first is not None and first.schema.name == SCHEMA


def _from_osi(path: Path, asked: ImportRequest, stem: str) -> TrackSource:
    return _chosen(path, "OSI ground truth", read_osi(path), asked, stem, (EGO, ADVERSARY))


def _from_bag(path: Path, asked: ImportRequest, stem: str) -> TrackSource:
    user, car = asked.road_user or ADVERSARY_TOPIC, asked.car or CAR_TOPIC
    tracks = bag_tracks(path, [user, car] if asked.needs_car else [user], asked.map_frame)
    found = {name: _found(path, name, one) for name, one in tracks.items()}
    if asked.needs_car and found[user].frame != found[car].frame:
        raise UsageError(
            f"{path}: {user} in {found[user].frame!r} and {car} in {found[car].frame!r}: two frames; give --map-frame, "
            "if /tf was recorded"
        )
    return TrackSource(stem, path, "a bag of ROS 2", found[user], found.get(car) if asked.needs_car else None)


def _found(path: Path, name: str, one: BagTrack) -> TrackedObject:
    rows = np.array([row[:3] for row in sorted({row[:3] for row in one.rows})], np.float64).reshape(-1, 3)
    return TrackedObject(name, track_of(rows[:, 0], rows[:, 1:], f"{path}, {name}"), frame=one.frame)


_GAP = 1.5  # times the usual step, from which on a step is a gap
_LEAST_DRIVE = 0.5  # m that a car moves, or it has no direction
_JITTER = 0.3  # m
_FARTHEST_ASIDE = 2.0  # m


class UnusableError(UsageError):
    """A way that cannot be a safe trajectory; the message says why."""


@dataclass(frozen=True)
class TrackQuality:
    """What was seen of a track, and what was done with it.

    Attributes:
        positions: how many there were.
        duration: from the first to the last, s.
        rate: positions per second, by the median step.
        longest_step: between two positions, s.
        gaps: steps of more than one and a half times the usual; they are filled in a straight line.
        filled: how long these gaps are together, s.
        frame: name of the frame in the file; empty where it has none.
        placed: what was done to come into the frame `map`, in words.
        cut: what was cut off, in words; empty: nothing.
        starts: clock of the file when the way begins, s.
    """

    positions: int
    duration: float
    rate: float
    longest_step: float
    gaps: int
    filled: float
    frame: str
    placed: str
    cut: str
    starts: float

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain data."""
        return asdict(self)

    @property
    def text(self) -> str:
        """It in a line."""
        gaps = f"{self.gaps} gap{'s' if self.gaps != 1 else ''}, {self.filled:.2f} s in all, filled in straight lines"
        parts = [
            f"{self.positions} positions in {self.duration:.2f} s, {self.rate:.3g} a second",
            gaps if self.gaps else "no gaps",
            self.placed,
            self.cut,
        ]
        return "; ".join(filter(None, parts))


@dataclass(frozen=True, eq=False)
class ImportedTrajectory:
    """A safe trajectory that came in.

    Attributes:
        source: where it comes from.
        times: n times from 0 on, s.
        places: n × 2, m, in the frame `map`.
        look: what was seen, and done.
    """

    source: TrackSource
    times: FloatArray
    places: FloatArray
    look: TrackQuality

    def write(self, path: Path) -> None:
        """Write it as csv with the columns t, x, y, which `--safe` reads; numbers come back to the last bit."""
        rows = zip(self.times.tolist(), self.places.tolist(), strict=True)
        lines = ["t,x,y", *(f"{time!r},{x!r},{y!r}" for time, (x, y) in rows)]
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def trajectory_of(
    source: TrackSource, frame: RecordingFrame | None, longest_gap: float, scenario: Scenario | None
) -> ImportedTrajectory:
    """Return a source's way in the frame `map`.

    Args:
        source: track of the road user, and of the car where the frame goes by it.
        frame: where `map` lies in the file's frame; None: as the car drives.
        longest_gap: a longer gap is not filled, s.
        scenario: a way that lasts longer than its horizon is cut to what is around the crossing; None: none is cut.

    Raises:
        UnusableError: it jumps, or has a longer gap.
    """
    track = source.found.track
    steps = np.diff(track.times)
    usual = float(np.median(steps))
    gaps = steps[steps > _GAP * usual]
    if gaps.size and gaps.max() > longest_gap:
        raise UnusableError(f"a gap of {gaps.max():.2f} s, longer than --longest-gap {longest_gap:g} s")
    moved = np.hypot(*np.diff(track.places, axis=0).T)
    jump = moved > FASTEST * steps + _JITTER
    if jump.any():
        row = int(np.argmax(jump))
        raise UnusableError(f"moves {moved[row]:.3g} m in {steps[row]:.3g} s: are positions in m and times in s?")
    placed, said = _in_map(source, frame, 1.0 if scenario is None else scenario.end.crossing)
    begin, end, cut = 0, len(track.times), ""
    if scenario is not None and track.times[-1] - track.times[0] > scenario.horizon:
        begin, end, cut = _around_crossing(scenario, track.times, placed)
    times = track.times[begin:end]
    look = TrackQuality(
        len(track.times),
        float(track.times[-1] - track.times[0]),
        1.0 / usual,
        float(steps.max()),
        int(gaps.size),
        float(gaps.sum()),
        source.found.frame,
        said,
        cut,
        float(times[0]),
    )
    if len(times) < 2:
        raise UnusableError("nothing of it is near the crossing within the scenario's horizon")
    return ImportedTrajectory(source, times - times[0], placed[begin:end], look)


def _in_map(source: TrackSource, frame: RecordingFrame | None, crossing: float) -> tuple[FloatArray, str]:
    """Return positions in the frame `map`, n × 2, m, and what was done."""
    track = source.found.track
    if frame is not None:
        if frame == RecordingFrame():
            return track.places, "in the file's own frame"
        turned = math.degrees(frame.turned)
        return track.placed(frame).places, f"map lies at ({frame.x:g}, {frame.y:g}) m, turned by {turned:g}°"
    if source.car is None:
        raise UsageError(f"{source.path}: --frame car needs the car's way")
    return by_car(source.car.track, track, crossing)


def by_car(car: Track, user: Track, crossing: float) -> tuple[FloatArray, str]:
    """Return a road user's positions in the frame that goes by the car's way, n × 2, m, and what was done.

    Args:
        car: the car's track.
        user: the road user's.
        crossing: 1 for a scenario in which the adversary crosses towards the East, −1 towards the West.

    Raises:
        UnusableError: the car does not drive, or not straight.
    """
    if np.hypot(*np.ptp(car.places, axis=0)) < _LEAST_DRIVE:
        raise UnusableError("the car does not drive, so nothing says where North is")
    seen = in_car_frame(car.places, user.places)
    if seen.aside > _FARTHEST_ASIDE:
        raise UnusableError(
            f"the car is up to {seen.aside:.2f} m off a straight line, more than {_FARTHEST_ASIDE:g} m, so its way "
            "does not say where North is: cut it to what is straight, or give --frame"
        )
    said = f"North is where the car drives (at most {seen.aside:.2f} m off its line), y = 0 where its line is crossed"
    towards = "east" if crossing > 0.0 else "west"
    mirrored = seen.mirrored != (crossing < 0.0)
    return seen.positions * [crossing, 1.0], said + (f", mirrored to cross {towards}wards" if mirrored else "")


def _around_crossing(scenario: Scenario, times: FloatArray, places: FloatArray) -> tuple[int, int, str]:
    """Return which positions are within half of the horizon of when the lane's middle is crossed, and what was cut.

    A way that does not cross is cut around where it comes nearest to the middle.
    """
    right = right_and_along(scenario.road.line, np.ascontiguousarray(places))[:, 0]
    crosses = np.flatnonzero(np.diff(np.sign(right)) != 0)
    middle = times[int(crosses[0] if crosses.size else np.argmin(np.abs(right)))]
    half = 0.5 * scenario.horizon
    low = min(max(middle - half, times[0]), times[-1] - scenario.horizon)
    begin = int(np.searchsorted(times, low - 1e-9))
    end = int(np.searchsorted(times, times[begin] + scenario.horizon + 1e-9, side="right"))
    before, behind = times[begin] - times[0], times[-1] - times[end - 1]
    return begin, end, f"cut to the horizon: {before:.2f} s before and {behind:.2f} s after left out"


def as_safe_trajectory(way: ImportedTrajectory, scenario: Scenario) -> FloatArray:
    """Return a way as `--safe` reads it with a scenario: positions at its ticks, n × 2, m.

    Raises:
        UnusableError: `--safe` would refuse it.
    """
    path = way.source.path
    try:
        read = safe_trajectory(way.times, way.places, scenario, path, np.arange(len(way.times)))
    except UsageError as error:
        raise UnusableError(re.sub(r"^(, line \d+)?: ", "", str(error).removeprefix(str(path)))) from error
    return read.positions


def entry(way: ImportedTrajectory, file: str) -> Mapping[str, Any]:
    """Return what import.json says of a way."""
    source = way.source
    return {
        "file": file,
        "source": str(source.path),
        "format": source.format,
        "road_user": source.found.name,
        "kind": source.found.kind,
        **way.look.as_dict(),
    }
