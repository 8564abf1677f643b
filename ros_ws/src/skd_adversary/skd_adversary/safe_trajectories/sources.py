"""Safe trajectories φ that need no episode: csv files, recordings of the CITR dataset, a regulator's test.

CITR (Yang et al. 2019, arXiv 1902.00487), scenario `vci_lat_uni`, "Lateral Interaction (Unilateral)" in the paper: a
golf cart drives along a straight line while eight pedestrians cross it from one side; 8 clips. Per clip there are two
files, in one frame of reference: `<clip>_traj_ped_filtered.csv` with id, frame, label, x_est, y_est, vx_est, vy_est (m,
m/s) and `<clip>_traj_veh_filtered.csv` with id, frame, label, x_est, y_est, psi_est, vel_est (m, rad, m/s). The dataset
states no licence: the project ships this reader, none of the data.
"""

from __future__ import annotations

import logging
import math
import re
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from skd_sim.controllers.basic import PAPER_MULTIPLIERS
from skd_sim.errors import UsageError
from skd_sim.scenario.protocol import regulatory_trajectories
from skd_sim.scenario.road import right_and_along
from skd_sim.scenario.scenario import Scenario, check_trajectory, start_clearance
from skd_sim.scenario.scenario_file import REGULATORY
from skd_sim.world.contact import first_contact, to_car_frame
from skd_sim.world.episode import EpisodeSpec, Mode
from skd_sim.world.state import FloatArray, IntArray, Trajectory

from skd_adversary.crossing.road_users import PEDESTRIAN, road_user_named
from skd_adversary.safe_trajectories.recordings import (
    LONGEST_HOLE,
    check_motion,
    check_once,
    in_car_frame,
    read_table,
    resample,
    too_fast,
)

_log = logging.getLogger(__name__)  # whose warnings Python prints by default
_MOST_NAMED = 5
_COLUMNS = {"t": 1e12, "x": 1e6, "y": 1e6}


def load_safe_trajectories(source: str | Path, scenario: Scenario, count: int) -> list[Trajectory]:
    """Load `count` safe trajectories.

    Of n usable ones, in the order of file name (CITR: clip, then id), those at the indices
    round(linspace(0, n − 1, count)) are taken, the middle one for a count of 1. What is not used is logged.

    Args:
        source: a csv file (see `read_csv_trajectory`), a folder of csv files, or one of the CITR dataset,
            which is recognised by its file names; or `REGULATORY`.
        scenario: gives the time step and the car's path, and the protocol of a regulatory source.
        count: how many, ≥ 1.

    Raises:
        UsageError: no such file or folder, a malformed file in it, or too few usable trajectories.
    """
    if count < 1:
        raise UsageError(f"the number of safe trajectories must be at least 1, got {count}")
    path = Path(source)
    usable, dropped = _selection(path, scenario)
    if len(usable) < count:
        counts = Counter(reason for _, reason in dropped).most_common()
        reasons = ", ".join(f"{number} × {reason}" for reason, number in counts)
        others = f"; {len(dropped)} dropped ({reasons})" if dropped else ""
        raise UsageError(f"{path}: {len(usable)} usable safe trajectories where {count} were requested{others}")
    last = len(usable) - 1
    taken = [last // 2] if count == 1 else np.rint(np.linspace(0, last, count)).astype(int).tolist()
    by_reason: dict[str, list[str]] = {}
    for index, trajectory in enumerate(usable):
        if index not in taken:
            by_reason.setdefault("not requested", []).append(trajectory.name)
    for name, reason in dropped:
        by_reason.setdefault(re.sub(r"\d+(\.\d+)?", "…", reason), []).append(name)
    if by_reason:
        unused = "; ".join(f"{reason}: {_listed(names)}" for reason, names in by_reason.items())
        _log.warning("%s: %d of %d used; %s", path, count, len(usable) + len(dropped), unused)
    return [usable[index] for index in taken]


def _listed(names: list[str]) -> str:
    more = f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
    return ", ".join(names[:_MOST_NAMED]) + more


def count_safe_trajectories(source: str | Path, scenario: Scenario) -> int:
    """Return how many usable safe trajectories there are; see `load_safe_trajectories`.

    Raises:
        UsageError: no such file or folder, or a malformed file in it.
    """
    return len(_selection(Path(source), scenario).usable)


def _selection(path: Path, scenario: Scenario) -> Selection:
    if str(path) == REGULATORY:
        found = regulatory_trajectories(scenario)
        for one in found:
            check_trajectory(scenario, one)
        return Selection(found, [])
    try:
        if not path.is_dir():
            return Selection([read_csv_trajectory(path, scenario)], [])
        if is_citr(path):
            return select(read_clips(path), scenario)
        entries = sorted(entry for entry in path.iterdir() if not entry.name.startswith("."))
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror or error}") from error
    files = [entry for entry in entries if entry.suffix.lower() == ".csv" and entry.is_file()]
    if not files:
        raise UsageError(f"{path}: no csv file in this folder")
    found = [read_csv_trajectory(file, scenario) for file in files]
    check_once([(str(file), one.positions) for file, one in zip(files, found, strict=True)], moved=False)
    return Selection(found, [(entry.name, "no csv file") for entry in entries if entry not in files])


def read_csv_trajectory(path: str | Path, scenario: Scenario) -> Trajectory:
    """Read a trajectory and resample it linearly to the scenario's time step.

    The file has a header with t, x and y: s, m, m, in the world frame (x East, the crossing direction;
    y North; the lane is centred on x = 0, the crossing line is near y = 0). t may start anywhere and need not
    be uniform.

    Args:
        path: path of the csv file.
        scenario: gives time step, horizon and the car's path.

    Returns:
        The trajectory (n × 2, m), named after the file.

    Raises:
        UsageError: the file cannot be read, or see `safe_trajectory`.
    """
    path = Path(path)
    if not path.exists():  # a misspelt name of a kind looks like a path, too
        raise UsageError(f"{path}: no such file or folder for --safe, nor one of synthetic, own, walkers, regulatory")
    values, lines = read_table(path, _COLUMNS)
    return safe_trajectory(values[:, 0], values[:, 1:], scenario, path, lines)


def check_track(times: FloatArray, positions: FloatArray, kind: str, path: Path, lines: IntArray) -> None:
    """Refuse a track of fewer than two points, whose times do not increase, or that is too fast for its kind.

    Arguments are those of `safe_trajectory`, with the kind of road user.

    Raises:
        UsageError: it is so.
    """
    if len(times) < 2:
        raise UsageError(f"{path}: {len(times)} points; a track needs at least two points")
    wrong = np.flatnonzero(np.diff(times) <= 0.0)
    if len(wrong):
        before, at = wrong[0], wrong[0] + 1
        got = f"{times[at]:.15g} after {times[before]:.15g}"
        raise UsageError(f"{path}, line {lines[at]}: t must increase strictly, got {got}")
    user = road_user_named(kind)
    found = too_fast(times, positions, user.fastest)
    if found:
        limit = f"a {user.name} moves at most {user.fastest:g} m/s: are t in s, and x and y in m, without jumps?"
        raise UsageError(f"{path}, line {lines[found[0]]}: {found[1]}; {limit}")


def safe_trajectory(
    times: FloatArray, positions: FloatArray, scenario: Scenario, path: Path, lines: IntArray
) -> Trajectory:
    """Return a recorded trajectory, checked and resampled to the scenario's time step.

    Args:
        times: n times, s.
        positions: n × 2, m, in the world frame.
        scenario: gives time step, horizon and the car's path.
        path: file that they are from, for its name and for messages.
        lines: line of the file in which each is, for messages.

    Raises:
        UsageError: times do not increase, it has fewer than two points, lasts less than one time step or longer than
            the horizon, moves faster than its kind can, does not cross the car's path to the side of its destination,
            or starts where the car does.
    """
    check_track(times, positions, scenario.adversary.kind, path, lines)
    duration = float(times[-1] - times[0])
    trajectory = Trajectory(resample(times, positions, scenario.time_step), scenario.time_step, path.stem)
    if duration > scenario.horizon or len(trajectory) < 2:
        limit = (
            f"longer than the scenario's horizon of {scenario.horizon:g} s"
            if duration > scenario.horizon
            else f"less than one time step of {scenario.time_step:g} s; a safe trajectory needs at least two points"
        )
        raise UsageError(f"{path}, line {lines[-1]}: lasts {duration:g} s, {limit}")
    _check_path(trajectory, scenario, path)
    return trajectory


def _check_path(trajectory: Trajectory, scenario: Scenario, path: Path) -> None:
    """Refuse one that never enters the car's path where it has to cross it, and one that starts inside the car."""
    crosses = scenario.adversary.destination_x is not None
    try:
        if crosses or scenario.car.meet_safe_trajectory:
            scenario.end.entry_time(trajectory)
        check_trajectory(scenario, trajectory)
    except UsageError as error:
        raise UsageError(f"{path}: {error}") from error
    (first, _), (last, _) = (scenario.end.place(x, y) for x, y in trajectory.positions[[0, -1]].tolist())
    eastward = scenario.end.crossing > 0.0
    if crosses and (last < first) == eastward and last != first:
        sides = ("West", "East") if scenario.road.straight else ("left", "right")
        goes, towards = sides if eastward else sides[::-1]
        way = f"walks {goes}, from x = {first:.3g} to {last:.3g} m off the centre line"
        raise UsageError(f"{path}: {way}; the adversary crosses towards the {towards}: mirror it")
    episode = EpisodeSpec(scenario, Mode.REPLAY, 0, 0, safe_trajectory=trajectory)
    x, y = episode.start
    if start_clearance(scenario, x, y, episode.start_gap) <= scenario.adversary.reach:
        raise UsageError(f"{path}: starts at ({x:g}, {y:g}) m, where the car starts; start it farther aside")


# --- recordings of the CITR dataset

FRAME_RATE: Final = 29.97
"""Frames per second of the """

CART_FRONT: Final = 1.0
"""Recorded cart ahead of its centre, m."""
CART_REAR: Final = 1.2
"""Recorded cart behind its centre, m."""
CART_HALF_WIDTH: Final = 0.6
"""Recorded cart to each side, m."""

PEDESTRIAN_SUFFIX: Final = "_traj_ped_filtered.csv"
VEHICLE_SUFFIX: Final = "_traj_veh_filtered.csv"
_CLIP_PREFIX: Final = "unidirection_"

_KEYS: Final = {"id": 1e6, "frame": 1e9}
_PEDESTRIAN_COLUMNS: Final = {**_KEYS, "x_est": 1e6, "y_est": 1e6, "vx_est": 1e3, "vy_est": 1e3}
_VEHICLE_COLUMNS: Final = {**_KEYS, "x_est": 1e6, "y_est": 1e6, "psi_est": 1e6, "vel_est": 1e3}
_LEAST_DRIVE: Final = 0.5
"""A cart that moved less, m, has no driving direction."""
_OFF_STATED: Final = 0.35, 0.5
"""Share by which a pedestrian's and the cart's track may differ from the stated velocities; the dataset's are 0.1 and
0.36 off, the cart's filter being slow."""


class ClipTrack(NamedTuple):
    """A pedestrian or the cart as recorded, in the dataset's frame.

    Attributes:
        id: its number within the clip.
        frames: n frame numbers, strictly increasing, at FRAME_RATE per second.
        positions: n × 2, of its centre, m.
        headings: n, rad, counter-clockwise from x; 0 of pedestrians, who are discs.
    """

    id: int
    frames: IntArray
    positions: FloatArray
    headings: FloatArray


class Clip(NamedTuple):
    """One recording, in the dataset's frame.

    Attributes:
        name: name of the files, without suffix and without `unidirection_`.
        cart: the vehicle.
        tracks: the pedestrians, by id.
    """

    name: str
    cart: ClipTrack
    tracks: list[ClipTrack]


class Selection(NamedTuple):
    """Usable trajectories, and why the others are not: (name, reason) each."""

    usable: list[Trajectory]
    dropped: list[tuple[str, str]]


def is_citr(path: str | Path) -> bool:
    """Return whether this is a readable folder that holds files named like the dataset's."""
    try:
        return any(entry.name.endswith((PEDESTRIAN_SUFFIX, VEHICLE_SUFFIX)) for entry in Path(path).iterdir())
    except OSError:
        return False


def read_clips(path: str | Path) -> list[Clip]:
    """Read all clips of a folder, by name.

    Raises:
        UsageError: no such folder, no files of the dataset in it, one of a clip's two files is missing, or a
            file is malformed, or has a track that cannot be, or one twice: one line that names the
            file and, where there is one, the line number.
    """
    folder = Path(path)
    if not folder.is_dir():
        raise UsageError(f"{folder}: is not a folder of the CITR dataset")
    pedestrians = _by_clip(folder, PEDESTRIAN_SUFFIX)
    vehicles = _by_clip(folder, VEHICLE_SUFFIX)
    if not pedestrians and not vehicles:
        raise UsageError(f"{folder}: no files *{PEDESTRIAN_SUFFIX} and *{VEHICLE_SUFFIX} of the CITR dataset")
    for clip in sorted(pedestrians.keys() ^ vehicles.keys()):
        here, absent = (PEDESTRIAN_SUFFIX, VEHICLE_SUFFIX)[:: 1 if clip in pedestrians else -1]
        raise UsageError(f"{folder / (clip + here)}: its partner {clip}{absent} is missing")
    clips = [_read_clip(clip, pedestrians[clip], vehicles[clip]) for clip in sorted(pedestrians)]
    check_once((f"{folder}: {clip.name}/{one.id}", one.positions) for clip in clips for one in clip.tracks)
    return clips


def _by_clip(folder: Path, suffix: str) -> dict[str, Path]:
    return {entry.name.removesuffix(suffix): entry for entry in folder.glob(f"*{suffix}")}


def _read_clip(clip: str, pedestrian_file: Path, vehicle_file: Path) -> Clip:
    vehicles = _tracks(vehicle_file, _VEHICLE_COLUMNS, _OFF_STATED[1])
    if len(vehicles) != 1:
        raise UsageError(f"{vehicle_file}: one vehicle expected, got {len(vehicles)}")
    if np.ptp(vehicles[0].positions, axis=0).max() < _LEAST_DRIVE:
        raise UsageError(f"{vehicle_file}: the vehicle does not drive, so there is no driving direction")
    people = _tracks(pedestrian_file, _PEDESTRIAN_COLUMNS, _OFF_STATED[0])
    if not people:
        raise UsageError(f"{pedestrian_file}: no pedestrian in it")
    return Clip(clip.removeprefix(_CLIP_PREFIX), vehicles[0], people)


def _tracks(path: Path, columns: Mapping[str, float], share: float) -> list[ClipTrack]:
    """Return the tracks of a file by id; ids and frames are whole, frames increase, velocities are the positions'."""
    values, lines = read_table(path, columns)
    for row, column in np.argwhere(values[:, : len(_KEYS)] % 1.0 != 0.0).tolist():
        name = list(_KEYS)[column]
        raise UsageError(f"{path}, line {lines[row]}: {name} must be whole, got {values[row, column]:g}")
    found = []
    for id_ in np.unique(values[:, 0]).tolist():
        rows = np.flatnonzero(values[:, 0] == id_)
        frames, positions, (first, second) = values[rows, 1], values[rows, 2:4], values[rows, 4:].T
        wrong = np.flatnonzero(np.diff(frames) <= 0.0)
        if len(wrong):
            raise UsageError(f"{path}, line {lines[rows[wrong[0] + 1]]}: frame of id {id_:.0f} must increase strictly")
        headings, velocities = np.zeros(len(rows)), values[rows, 4:]
        if columns is _VEHICLE_COLUMNS:  # heading and speed
            headings, velocities = first, np.column_stack([np.cos(first), np.sin(first)]) * second[:, None]
        check_motion(frames / FRAME_RATE, positions, velocities, lines[rows], path, share)
        found.append(ClipTrack(int(id_), frames.astype(np.int64), positions, headings))
    return found


def world_frame(clip: Clip, track: ClipTrack) -> FloatArray:
    """Return a recorded walk in the world frame, as the cart's track has it (`in_car_frame`).

    Args:
        clip: the clip, which has the cart.
        track: one pedestrian of the clip.

    Returns:
        n × 2 positions (East, North), m, at the track's frames.
    """
    return in_car_frame(clip.cart.positions, track.positions).positions


def touches_cart(clip: Clip, track: ClipTrack, radius: float) -> bool:
    """Return whether the pedestrian's disc (radius, m) touched the recorded cart in the frames they share.

    Swept between frames, so nothing is missed; where one of them lacks a frame, its neighbours are joined.
    """
    cart = clip.cart
    _, mine, theirs = np.intersect1d(track.frames, cart.frames, assume_unique=True, return_indices=True)
    seen = [
        to_car_frame(*map(float, (*track.positions[i], *cart.positions[j], cart.headings[j])))
        for i, j in zip(mine, theirs, strict=True)
    ]
    return any(
        math.isfinite(first_contact(before, after, (CART_FRONT, CART_REAR, CART_HALF_WIDTH), radius))
        for before, after in zip(seen[:-1] if len(seen) > 1 else seen, seen[1:] or seen, strict=True)
    )


def select(clips: list[Clip], scenario: Scenario) -> Selection:
    """Convert the tracks that cross the lane, and were safe against the recorded cart, to safe trajectories.

    The whole recorded track is kept, resampled to the scenario's time step from its first frame on.

    Args:
        clips: the recorded clips.
        scenario: gives time step, horizon, the edge of the car's path and the pedestrian's radius.

    Returns:
        Trajectories, by clip and id, with names like `yeild_01/3`, and the names and reasons of the others.
    """
    selection = Selection([], [])
    for clip in clips:
        for track in clip.tracks:
            name = f"{clip.name}/{track.id}"
            points = resample(track.frames / FRAME_RATE, world_frame(clip, track), scenario.time_step)
            points[:, 0] *= scenario.end.crossing
            reason = _unusable(clip, track, points, scenario)
            if reason:
                selection.dropped.append((name, reason))
            else:
                selection.usable.append(Trajectory(points, scenario.time_step, name))
    return selection


def _unusable(clip: Clip, track: ClipTrack, points: FloatArray, scenario: Scenario) -> str:
    """Return why a track is no safe trajectory; empty where it is one."""
    edge = scenario.path_edge
    across = scenario.end.crossing * right_and_along(scenario.road.line, points)[:, 0]
    if across[0] >= -edge:
        return "starts in the car's path"
    if across[-1] <= edge:
        return "ends before the far side"
    fastest = PEDESTRIAN.fastest  # these are
    if too_fast(track.frames / FRAME_RATE, track.positions, fastest):
        return f"faster than {fastest:g} m/s"
    if (track.frames[-1] - track.frames[0]) / FRAME_RATE > scenario.horizon:
        return "longer than the scenario's horizon"
    frames = clip.cart.frames
    if len(np.intersect1d(track.frames, frames)) == 0:
        return "no frame in common with the cart"
    if max(frames[0] - track.frames[0], track.frames[-1] - frames[-1]) > LONGEST_HOLE * FRAME_RATE:
        return "seen while the cart is not, which it may have touched"
    if touches_cart(clip, track, scenario.adversary.reach):
        return "touches the recorded cart"
    trajectory = Trajectory(points, scenario.time_step)
    try:
        check_trajectory(scenario, trajectory)
    except UsageError:
        return "runs into an obstacle"
    gap = scenario.car.start_speed * scenario.end.entry_time(trajectory)
    needed = max(PAPER_MULTIPLIERS) * scenario.car.safe_distance
    if scenario.car.meet_safe_trajectory and gap < needed:
        # Cars of different C would all brake from the start, and could not be told apart.
        return f"enters the car's path so early that the car would start {gap:.1f} m off, less than {needed:.1f} m"
    return ""
