"""Safe trajectories φ that need no episode: csv files, recordings of the CITR dataset, a regulator's test."""

from __future__ import annotations

import logging
import re
from collections import Counter
from pathlib import Path

import numpy as np
from skd_sim.errors import UsageError
from skd_sim.scenario.protocol import regulatory_trajectories
from skd_sim.scenario.scenario import Scenario, check_trajectory, start_clearance
from skd_sim.scenario.scenario_file import REGULATORY
from skd_sim.world.episode import EpisodeSpec, Mode
from skd_sim.world.state import FloatArray, IntArray, Trajectory

from skd_adversary.crossing.road_users import road_user_named
from skd_adversary.safe_trajectories.citr import Selection, is_citr, read_clips, select
from skd_adversary.safe_trajectories.recordings import check_once, read_table, resample, too_fast

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
        raise UsageError(
            f"{path}: cannot be read: no such file or folder, nor one of synthetic, own, walkers, regulatory"
        )
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
