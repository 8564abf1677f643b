"""Recorded pedestrians: scenario `vci_lat_uni` of the CITR dataset (Yang et al. 2019, arXiv 1902.00487).

A golf cart drives along a straight line while eight pedestrians cross it from one side; 8 clips. Per clip
there are two files, in one frame of reference: `<clip>_traj_ped_filtered.csv` with id, frame, label, x_est,
y_est, vx_est, vy_est (m, m/s) and `<clip>_traj_veh_filtered.csv` with id, frame, label, x_est, y_est,
psi_est, vel_est (m, rad, m/s). The dataset states no licence: the project ships this reader, none
of the data.

The paper calls the scenario "Lateral Interaction (Unilateral)".
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from skd_sim.controllers.basic import PAPER_MULTIPLIERS
from skd_sim.errors import UsageError
from skd_sim.scenario.road import right_and_along
from skd_sim.scenario.scenario import Scenario, check_trajectory
from skd_sim.world.contact import first_contact, to_car_frame
from skd_sim.world.state import FloatArray, IntArray, Trajectory

from skd_adversary.crossing.road_users import PEDESTRIAN
from skd_adversary.safe_trajectories import recordings

FRAME_RATE: Final = 29.97
"""Frames per second of the recordings."""

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
    recordings.check_once((f"{folder}: {clip.name}/{one.id}", one.positions) for clip in clips for one in clip.tracks)
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
    values, lines = recordings.read_table(path, columns)
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
        recordings.check_motion(frames / FRAME_RATE, positions, velocities, lines[rows], path, share)
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
    return recordings.in_car_frame(clip.cart.positions, track.positions).positions


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
            points = recordings.resample(track.frames / FRAME_RATE, world_frame(clip, track), scenario.time_step)
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
    if recordings.too_fast(track.frames / FRAME_RATE, track.positions, fastest):
        return f"faster than {fastest:g} m/s"
    if (track.frames[-1] - track.frames[0]) / FRAME_RATE > scenario.horizon:
        return "longer than the scenario's horizon"
    frames = clip.cart.frames
    if len(np.intersect1d(track.frames, frames)) == 0:
        return "no frame in common with the cart"
    if max(frames[0] - track.frames[0], track.frames[-1] - frames[-1]) > recordings.LONGEST_HOLE * FRAME_RATE:
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
