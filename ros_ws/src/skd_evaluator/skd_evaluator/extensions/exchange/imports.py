"""The work of `skd import`: tracks that come in are checked, placed in the frame `map`, and cut to the crossing."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.markup import escape
from skd_adversary.safe_trajectories import recordings
from skd_adversary.safe_trajectories.recordings import interpolated
from skd_adversary.safe_trajectories.sources import safe_trajectory
from skd_sim.errors import UsageError
from skd_sim.scenario.road import right_and_along
from skd_sim.scenario.road_user import ROAD_USERS
from skd_sim.scenario.scenario import Scenario, load_scenario
from skd_sim.world.state import FloatArray

from skd_evaluator.assessment.files.result_folder import write_json
from skd_evaluator.bags.checks import Damage
from skd_evaluator.bags.tracks import GAP, Listed, RecordingFrame, Track
from skd_evaluator.cli.arguments import result_folder
from skd_evaluator.cli.output import finish, warn
from skd_evaluator.extensions.exchange.command import BY_CAR
from skd_evaluator.extensions.exchange.readers import ImportRequest, TrackSource, files_in, listing, read_sources
from skd_evaluator.extensions.exchange.scene import IMPORT
from skd_evaluator.report.formats import counted
from skd_evaluator.report.terminal import narrow_table, print_table
from skd_evaluator.version import version

SAFE = "safe"
"""Folder of the trajectories, in that of the result."""
_SHOWN = 20
_ON_FOOT = 12.5  # m/s, faster than any pedestrian runs
_LEAST_DRIVE = 0.5  # m that a car moves, or it has no direction
_FARTHEST_ASIDE = 2.0  # m


class UnusableError(UsageError):
    """A track that cannot be a safe trajectory; the message says why."""


@dataclass(frozen=True, eq=False)
class ImportedTrajectory:
    """A safe trajectory that came in.

    Attributes:
        source: where it comes from.
        track: as it was found.
        times: n times from 0 on, s.
        places: n × 2, m, in the frame `map`.
        placed: what was done to come into that frame, in words.
        cut: what was cut off, in words; empty: nothing.
        starts: clock of the file when it begins, s.
    """

    source: TrackSource
    track: Track
    times: FloatArray
    places: FloatArray
    placed: str
    cut: str
    starts: float

    def entry(self, file: str) -> dict[str, Any]:
        """Return its entry in import.json: rate (1/s) by the median step, and gaps, which are filled straight."""
        times = self.track.times
        steps = np.diff(times)
        usual = float(np.median(steps))
        gaps = steps[:0] if self.track.drawn else steps[steps > GAP * usual]
        return {
            "file": file,
            "source": str(self.source.path),
            "format": self.source.format,
            "road_user": self.track.name,
            "kind": self.track.kind,
            "positions": len(times),
            "duration": float(times[-1] - times[0]),
            "rate": 1.0 / usual,
            "longest_step": float(steps.max()),
            "gaps": int(gaps.size),
            "filled": float(gaps.sum()),
            "frame": self.track.frame,
            "placed": self.placed,
            "cut": self.cut,
            "starts": self.starts,
        }

    @property
    def text(self) -> str:
        """What was seen of it, and done with it, in a line."""
        seen = self.entry("")
        gaps = f"{counted(seen['gaps'], 'gap')}, {seen['filled']:.2f} s in all, filled in straight lines"
        rate = f"{seen['positions']} positions in {seen['duration']:.2f} s, {seen['rate']:.3g} a second"
        return "; ".join(filter(None, (rate, gaps if seen["gaps"] else "no gaps", self.placed, self.cut)))

    def write(self, path: Path) -> None:
        """Write it as csv with the columns t, x, y, which `--safe` reads."""
        recordings.write_trajectory(path, self.times, self.places)


def trajectory_of(
    source: TrackSource, frame: RecordingFrame | None, longest_gap: float, scenario: Scenario | None
) -> ImportedTrajectory:
    """Return a source's track in the frame `map`.

    Args:
        source: track of the road user, and of the car where the frame goes by it.
        frame: where `map` lies in the file's frame; None: as the car drives.
        longest_gap: a longer gap is not filled, s.
        scenario: a track that lasts longer than its horizon is cut to what is around the crossing; None: none is cut.

    Raises:
        UnusableError: it jumps, or has a longer gap.
    """
    track = source.found
    if isinstance(track, Listed):
        raise UnusableError(track.why)
    if why := track.jump or track.gap(longest_gap) or _too_fast(track):
        raise UnusableError(why)
    crossing = 1.0 if scenario is None else scenario.end.crossing
    if frame is None:
        if source.car is None:
            raise UsageError(f"{source.path}: --frame car needs the car's track")
        places, placed = by_car(source.car, track, crossing)
    elif frame == RecordingFrame():
        places, placed = track.places, "in the file's own frame"
    else:
        places = track.placed(frame).places
        placed = f"map lies at ({frame.x:g}, {frame.y:g}) m, turned by {math.degrees(frame.turned):g}°"
    begin, end, cut = 0, len(track.times), ""
    if scenario is not None and track.times[-1] - track.times[0] > scenario.horizon:
        begin, end, cut = _around_crossing(scenario, track.times, places)
    times = track.times[begin:end]
    if len(times) < 2:
        raise UnusableError("nothing of it is near the crossing within the scenario's horizon")
    starts = track.origin + float(times[0])
    return ImportedTrajectory(source, track, times - times[0], places[begin:end], placed, cut, starts)


def _too_fast(track: Track) -> str:
    """Return how a pedestrian is too fast for a whole second, in words; empty where not."""
    if "pedestrian" not in track.kind.lower() or track.times[-1] - track.times[0] < 1.0:
        return ""
    at = track.times[track.times <= track.times[-1] - 1.0]
    later, now = (interpolated(one, track.times, track.places) for one in (at + 1.0, at))
    fastest = float(np.hypot(*(later - now).T).max())
    return f"goes {fastest:.3g} m in a second on foot: are positions in m?" if fastest > _ON_FOOT else ""


def by_car(car: Track, user: Track, crossing: float) -> tuple[FloatArray, str]:
    """Return a road user's positions in the frame that goes by how the car drives, n × 2, m, and what was done.

    Args:
        car: the car's track.
        user: the road user's.
        crossing: 1 for a scenario in which the adversary crosses towards the East, −1 towards the West.

    Raises:
        UnusableError: the car does not drive, or not straight.
    """
    if np.hypot(*np.ptp(car.places, axis=0)) < _LEAST_DRIVE:
        raise UnusableError("the car does not drive, so nothing says where North is")
    seen = recordings.in_car_frame(car.places, user.places)
    if seen.aside > _FARTHEST_ASIDE:
        raise UnusableError(f"the car is up to {seen.aside:.2f} m off a straight line: cut it, or give --frame")
    said = f"North is where the car drives (at most {seen.aside:.2f} m off its line), y = 0 where its line is crossed"
    mirrored = seen.mirrored != (crossing < 0.0)
    more = f", mirrored to cross {'east' if crossing > 0.0 else 'west'}wards" if mirrored else ""
    return seen.positions * [crossing, 1.0], said + more


def _around_crossing(scenario: Scenario, times: FloatArray, places: FloatArray) -> tuple[int, int, str]:
    """Return which positions are within half of the horizon of when the lane's middle is crossed, and what was cut.

    That is the first crossing in the scenario's direction; what goes to and from another crossing is no part of it. A
    track that does not cross so is cut around where it comes nearest to the middle.
    """
    right = right_and_along(scenario.road.line, np.ascontiguousarray(places))[:, 0]
    side, eastwards = np.sign(right), scenario.end.crossing > 0.0
    every = np.flatnonzero((side[1:] != side[:-1]) & (side[1:] != 0.0)).tolist()
    ours = [one for one in every if side[one + 1] == (1.0 if eastwards else -1.0)]
    chosen = ours[0] if ours else int(np.argmin(np.abs(right)))
    before = max((one for one in every if one < chosen), default=None)
    behind = min((one for one in every if one > chosen), default=None)
    first = 0 if before is None else before + 1 + int(np.argmax(np.abs(right[before + 1 : chosen + 1])))
    last = len(times) - 1 if behind is None else chosen + 1 + int(np.argmax(np.abs(right[chosen + 1 : behind + 1])))
    middle, half = times[chosen], 0.5 * scenario.horizon
    low = min(max(middle - half, times[first]), max(times[last] - scenario.horizon, times[first]))
    begin = int(np.searchsorted(times, low - 1e-9))
    end = min(int(np.searchsorted(times, times[begin] + scenario.horizon + 1e-9, side="right")), last + 1)
    lost = times[begin] - times[0], times[-1] - times[end - 1]
    said = f"cut to the horizon: {lost[0]:.2f} s before and {lost[1]:.2f} s after left out"
    if len(every) > 1 and ours:
        towards, at = "east" if eastwards else "west", middle - times[0]
        said += f"; crosses {len(every)} times, taken is the first {towards}wards, at {at:.2f} s"
    return begin, end, said


def at_ticks(one: ImportedTrajectory, scenario: Scenario) -> FloatArray:
    """Return a trajectory as `--safe` reads it with a scenario: positions at its ticks, n × 2, m.

    Raises:
        UnusableError: `--safe` would refuse it.
    """
    path = one.source.path
    try:
        read = safe_trajectory(one.times, one.places, scenario, path, np.arange(len(one.times)))
    except UsageError as error:
        raise UnusableError(re.sub(r"^(, line \d+)?: ", "", str(error).removeprefix(str(path)))) from error
    return read.positions


def run(arguments: argparse.Namespace) -> int:
    """Import tracks, or with --list say what files hold; return the exit code."""
    ROAD_USERS.target(arguments.kind)  # that there is such a kind
    damage = Damage(skip=True)
    if arguments.list:
        return _list(arguments, damage)
    scenario = None if arguments.scenario is None else load_scenario(arguments.scenario)
    frame = None
    if arguments.frame != BY_CAR:
        x, y, degrees = arguments.frame
        frame = RecordingFrame(x, y, math.radians(degrees))
    same = ("road_user", "car", "kind", "map_frame", "longest_gap", "begin", "end")
    given = {name: getattr(arguments, name) for name in same}
    out = result_folder(arguments)
    request = ImportRequest(needs_car=frame is None, tf=arguments.tf_topic, **given)
    found, left_out = _imported(arguments.paths, request, frame, scenario, damage)
    if not found:
        path, name, why = left_out[0]
        more = f" (and {len(left_out) - 1} more are left out)" if len(left_out) > 1 else ""
        raise UsageError(f"{path}, {name}: {why}{more}: nothing is left")
    named = dict(zip(_file_names(found), found, strict=True))
    content = {
        "import": 1,
        "skd": version(),
        "scenario": arguments.scenario,
        "files": [one.entry(f"{SAFE}/{name}") for name, one in named.items()],
        "left_out": [{"source": str(path), "road_user": name, "why": why} for path, name, why in left_out],
        "warnings": damage.lines,
    }

    def write(folder: Path) -> None:
        (folder / SAFE).mkdir()
        for name, one in named.items():
            one.write(folder / SAFE / name)
        write_json(folder / IMPORT, content)

    def show() -> None:
        warn("import", damage.lines)
        for name, one in list(named.items())[:_SHOWN]:
            print(f"{name}: {one.source.format}, {one.track.name}: {one.text}")
        warn("import", [f"{path}, {who}, left out: {why}" for path, who, why in left_out[:_SHOWN]])
        if max(len(found), len(left_out)) > _SHOWN:
            print(f"{len(found)} imported, {len(left_out)} left out; {IMPORT} has all of them")

    behind = f" --scenario {arguments.scenario}" if arguments.scenario else ""
    following = f"next: skd assess --safe {out.path / SAFE} --safe-count {len(found)}{behind}"
    return finish(arguments, content, show, saved=(out.save(write), following))


def _list(arguments: argparse.Namespace, damage: Damage) -> int:
    """Say what files hold; return the exit code."""
    held = {}
    for files in files_in(arguments.paths, damage)[0]:
        name = str(files[0] if len(files) == 1 else files[0].parent)
        held[name] = [one.as_dict() for one in listing(files, damage, arguments.topics)]

    def show() -> None:
        for path, every in held.items():
            rows = []
            for one in every:
                rate, gaps = "", ""
                if one["rate"] is not None:
                    rate, gaps = f"{one['rate']:.3g}", f"{one['gaps']} (step ≤ {one['longest_step']:.2f} s)"
                ends = ("" if one[key] is None else f"{one[key]:.2f}" for key in ("begins", "ends"))
                name, form, frame, why = (escape(one[key]) for key in ("name", "form", "frame", "why"))
                rows.append([name, form, str(one["count"]), rate, gaps, *ends, frame, why])
            heads = ("who", "form", "positions", "a second", "gaps", "from", "to", "frame", "not read because")
            print_table(narrow_table(path, heads, rows))
        warn("import", damage.lines)

    return finish(arguments, {"files": held, "warnings": damage.lines}, show)


def _imported(
    paths: Sequence[Path],
    request: ImportRequest,
    frame: RecordingFrame | None,
    scenario: Scenario | None,
    damage: Damage,
) -> tuple[list[ImportedTrajectory], list[tuple[Path, str, str]]]:
    """Return the trajectories that can be used, and of the others file, name and why they cannot."""
    found: list[ImportedTrajectory] = []
    compared = []
    files, exported = files_in(paths, damage)
    kamikaze = "a kamikaze or a run along φ, which is no safe trajectory"
    left_out = [(path, "its adversary", kamikaze) for path in exported]
    for source in (source for one in files for source in read_sources(one, request, damage)):
        try:
            one = trajectory_of(source, frame, request.longest_gap, scenario)
            compared.append(np.column_stack([one.places, one.times]) if scenario is None else at_ticks(one, scenario))
        except UnusableError as error:
            left_out.append((source.path, source.found.name, str(error)))
            continue
        found.append(one)
        for note in one.track.notes:
            damage.warn(f"{one.track.where}: {note}")
    again = dict(recordings.repeated(compared, moved=False))  # drawn ones may be the same; --safe refuses them
    for index, first in again.items():
        source = found[index].source
        left_out.append((source.path, source.found.name, recordings.duplicate_of(str(found[first].source.path))))
    return [one for index, one in enumerate(found) if index not in again], left_out


def _file_names(found: Sequence[ImportedTrajectory]) -> list[str]:
    """Return a name of each trajectory's file, no two alike, none that leads elsewhere."""
    names: dict[str, None] = {}
    for one in found:
        stem = re.sub(r"[^\w.-]", "_", one.source.stem, flags=re.ASCII).lstrip(".")[:100] or "track"
        name, number = stem, 1
        while f"{name}.csv" in names:
            number += 1
            name = f"{stem}_{number}"
        names[f"{name}.csv"] = None
    return list(names)
