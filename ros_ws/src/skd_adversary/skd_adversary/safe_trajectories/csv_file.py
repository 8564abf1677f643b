"""A safe trajectory from a plain csv file with the columns t, x, y."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from skd_sim.arrays import FloatArray, IntArray
from skd_sim.errors import UsageError
from skd_sim.scenario.scenario import Scenario, check_way, start_clearance
from skd_sim.world.episode import Episode, Mode
from skd_sim.world.state import Trajectory

from skd_adversary.crossing.road_users import road_user_named
from skd_adversary.safe_trajectories.table import read_table, resample, too_fast

_COLUMNS = {"t": 1e12, "x": 1e6, "y": 1e6}


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
        UsageError: the file cannot be read, lacks a column, holds something that is not a finite number, has
            times that do not increase, fewer than two points, a duration under one time step or over the
            horizon, moves faster than its kind can, does not cross the car's path to the side of its destination, or
            starts where the car does.
    """
    path = Path(path)
    values, lines = read_table(path, _COLUMNS)
    return safe_trajectory(values[:, 0], values[:, 1:], scenario, path, lines)


def safe_trajectory(
    times: FloatArray, positions: FloatArray, scenario: Scenario, path: Path, lines: IntArray
) -> Trajectory:
    """Return a trajectory, checked and resampled as `read_csv_trajectory` says.

    Args:
        times: n times, s.
        positions: n × 2, m, in the world frame.
        scenario: gives time step, horizon and the car's path.
        path: file that they are from, for its name and for messages.
        lines: line of the file in which each is, for messages.

    Raises:
        UsageError: it is no safe trajectory.
    """
    if len(times) < 2:
        raise UsageError(f"{path}: {_points(len(times))}; a safe trajectory needs at least two points")
    wrong = np.flatnonzero(np.diff(times) <= 0.0)
    if len(wrong):
        before, at = wrong[0], wrong[0] + 1
        got = f"{times[at]:.15g} after {times[before]:.15g}"
        raise UsageError(f"{path}, line {lines[at]}: t must increase strictly, got {got}")
    user = road_user_named(scenario.adversary.kind)
    found = too_fast(times, positions, user.fastest)
    if found:
        raise UsageError(
            f"{path}, line {lines[found[0]]}: {found[1]}; a {user.name} moves at most {user.fastest:g} m/s: are t in "
            "s, and x and y in m, without jumps?"
        )
    duration = float(times[-1] - times[0])
    if duration > scenario.horizon:
        raise UsageError(
            f"{path}, line {lines[-1]}: lasts {duration:g} s, longer than the scenario's horizon of "
            f"{scenario.horizon:g} s"
        )
    trajectory = Trajectory(resample(times, positions, scenario.time_step), scenario.time_step, path.stem)
    if len(trajectory) < 2:
        raise UsageError(
            f"{path}, line {lines[-1]}: lasts {duration:g} s, less than one time step of "
            f"{scenario.time_step:g} s; a safe trajectory needs at least two points"
        )
    _check_path(trajectory, scenario, path)
    return trajectory


def _points(count: int) -> str:
    return "1 point" if count == 1 else f"{count} points"


def _check_path(trajectory: Trajectory, scenario: Scenario, path: Path) -> None:
    """Refuse one that never enters the car's path where it has to cross it, and one that starts inside the car."""
    crosses = scenario.adversary.destination_x is not None
    try:
        if crosses or scenario.car.meet_safe_trajectory:
            scenario.end.entry_time(trajectory)
        check_way(scenario, trajectory)
    except UsageError as error:
        raise UsageError(f"{path}: {error}") from error
    (first, _), (last, _) = (scenario.end.place(x, y) for x, y in trajectory.positions[[0, -1]].tolist())
    eastward = scenario.end.crossing > 0.0
    if crosses and (last < first) == eastward and last != first:
        if scenario.road.straight:
            walks, towards = ("West", "East") if eastward else ("East", "West")
            raise UsageError(
                f"{path}: walks {walks}, from x = {first:.3g} to {last:.3g} m; the adversary crosses towards the "
                f"{towards}: mirror it, x to −x"
            )
        before, after = ("right", "left") if eastward else ("left", "right")
        raise UsageError(
            f"{path}: crosses the road from {before} to {after}, from {first:.3g} to {last:.3g} m to the right of its "
            f"centre line; the adversary crosses from {after} to {before}: turn the order of its points round"
        )
    episode = Episode(scenario, Mode.REPLAY, 0, 0, safe_trajectory=trajectory)
    x, y = episode.start
    if start_clearance(scenario, x, y, episode.start_gap) <= scenario.adversary.reach:
        raise UsageError(
            f"{path}: starts at ({x:g}, {y:g}) m, where the car starts, with its front "
            f"{episode.start_gap:g} m before the crossing line; a safe trajectory starts outside the car's "
            f"path, {'|x| >' if scenario.road.straight else 'off the centre line by more than'} "
            f"{scenario.path_edge:g} m"
        )
