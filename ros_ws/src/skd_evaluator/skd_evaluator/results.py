"""Results on disk: a folder that appears whole or not at all."""

from __future__ import annotations

import errno
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from skd_sim.episode import EpisodeLog, Outcome
from skd_sim.errors import UsageError

from skd_evaluator.assessment import Assessment
from skd_evaluator.version import version

MARKERS = ("assessment.json", "sweep.json", "episode.json", "probe.json", "car_model.yaml")
"""A folder with one of these holds results of ours."""
_PREFIX = ".skd-"  # of temporary folders


class ResultFolder:
    """An output folder, checked before the work and written after it, under a temporary name and then renamed."""

    def __init__(self, path: Path, *, overwrite: bool = False) -> None:
        """Check that `path` can be written; nothing is left on disk by that.

        Raises:
            UsageError: it cannot, or it holds something already.
        """
        self.path = path
        try:
            self._target = path.resolve()  # of a link, the folder behind it is replaced
            _check(self._target, f"--out {path}", overwrite=overwrite)
        except OSError as error:
            raise UsageError(f"--out {path}: cannot be written ({error.strerror}); give another") from error

    @contextmanager
    def scratch(self) -> Iterator[Path]:
        """Yield a temporary folder on the same file system for what grows during the work; gone afterwards."""
        temporary = self._temporary()
        try:
            temporary.joinpath("logs").mkdir()
            yield temporary
        finally:
            shutil.rmtree(temporary, ignore_errors=True)

    def write(self, fill: Callable[[Path], None]) -> None:
        """Let `fill` write into a temporary folder beside the target and put it in the target's place."""
        target = self._target
        temporary = self._temporary()
        replaced = temporary.with_name(temporary.name + ".old")
        try:
            temporary.chmod(0o777 & ~_umask())
            fill(temporary)
            if target.exists():
                target.rename(replaced)
            temporary.rename(target)
            shutil.rmtree(replaced, ignore_errors=True)
        except BaseException:
            if replaced.exists() and not target.exists():
                replaced.rename(target)
            shutil.rmtree(replaced, ignore_errors=True)
            shutil.rmtree(temporary, ignore_errors=True)
            raise

    def _temporary(self) -> Path:
        self._target.parent.mkdir(parents=True, exist_ok=True)
        return Path(tempfile.mkdtemp(prefix=_PREFIX, dir=self._target.parent))


def _check(target: Path, option: str, *, overwrite: bool) -> None:
    """Refuse a target that is no folder, holds something, or cannot be replaced or made (OSError)."""
    if target.exists():
        if not target.is_dir():
            raise UsageError(f"{option}: is a file; give a folder")
        if any(target.iterdir()):
            if not any((target / marker).exists() for marker in MARKERS):
                raise UsageError(f"{option}: is not empty and holds no SKD results; give a new folder")
            if not overwrite:
                raise UsageError(f"{option}: already holds results; add --overwrite to replace them")
        if target.is_mount() or Path.cwd().is_relative_to(target):
            raise UsageError(f"{option}: is a mount point or the current folder; give a new folder inside it")
        if not os.access(target, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    elif len(target.name.encode()) > os.pathconf("/", "PC_NAME_MAX"):
        raise OSError(errno.ENAMETOOLONG, os.strerror(errno.ENAMETOOLONG))
    ancestor = next(folder for folder in target.parents if folder.exists())
    Path(tempfile.mkdtemp(prefix=_PREFIX, dir=ancestor)).rmdir()


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write JSON; NaN and infinity are refused, for JSON has none."""
    path.write_text(json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8")


def write_assessment(folder: Path, assessment: Assessment) -> None:
    """Write assessment.json and episodes.npz."""
    write_json(folder / "assessment.json", assessment.as_dict())
    write_episodes(folder / "episodes.npz", assessment)


def write_episodes(path: Path, assessment: Assessment) -> None:
    """Write every trajectory of an assessment, so that all is recomputable.

    Trajectory k is rows offsets[k] … offsets[k+1] − 1 of `positions` (world frame, m). Per trajectory: `mode` (0 safe,
    1 kamikaze, 2 replay), `safe_index` (row of φ), `outcome`, `episode_id`, `impact_time` (s), `impact_speed` (m/s);
    `car` has the same rows as `positions` (x, y in m, speed in m/s; nan for φ). Rows are states at ticks; ψ ends at the
    contact, a share impact_time / time_step − (rows − 2) of the way from its last but one position to its last. Where
    the floor was asked for, `floor` (m) is that of the trajectory's episode; nan for those that are no pair of SKD or
    have none.
    """
    positions: list[np.ndarray[Any, Any]] = []
    car: list[np.ndarray[Any, Any]] = []
    rows: list[tuple[int, int, int, int, float, float]] = []
    for index, trajectory in enumerate(assessment.safe):
        positions.append(trajectory.positions)
        car.append(np.full((len(trajectory), 3), np.nan))
        rows.append((0, index, 2, 0, np.nan, np.nan))

    def add(log: EpisodeLog, index: int) -> None:
        positions.append(log.pedestrian)
        car.append(log.car)
        spec = log.episode
        rows.append((int(spec.mode), index, int(log.outcome), spec.episode_id, log.impact_time, log.impact_speed))

    for index, kamikaze in enumerate(assessment.kamikaze):
        for log in kamikaze.logs:
            add(log, index)
    floor = _floor_by_row(assessment)
    extra: dict[str, Any] = {} if floor is None else {"floor": floor}
    for run, log in enumerate(assessment.replays):
        add(log, run % len(assessment.safe))
    mode, safe_index, outcome, episode_id, impact_time, impact_speed = zip(*rows, strict=True)
    np.savez_compressed(
        path,
        positions=np.concatenate(positions),
        car=np.concatenate(car),
        offsets=np.cumsum([0, *map(len, positions)], dtype=np.int64),
        mode=np.array(mode, np.int8),
        safe_index=np.array(safe_index, np.int32),
        outcome=np.array(outcome, np.int8),
        episode_id=np.array(episode_id, np.int64),
        impact_time=np.array(impact_time),
        impact_speed=np.array(impact_speed),
        time_step=np.array(assessment.plan.scenario.time_step),
        **extra,
    )


def _floor_by_row(assessment: Assessment) -> np.ndarray[Any, np.dtype[np.float64]] | None:
    """Return the floor of each trajectory in the order of episodes.npz; none where it was not asked for."""
    if assessment.floors is None:
        return None
    groups = [np.full(len(assessment.safe), np.nan)]
    taken = 0
    for kamikaze, row in zip(assessment.kamikaze, assessment.skd.per_safe_trajectory, strict=True):
        group = np.full(len(kamikaze.logs), np.nan)
        group[row.kept] = assessment.floors[taken : taken + row.pairs]
        taken += row.pairs
        groups.append(group)
    return np.concatenate([*groups, np.full(len(assessment.replays), np.nan)])


def episode_summary(log: EpisodeLog) -> dict[str, Any]:
    """Return the content of episode.json."""
    spec = log.episode
    collided = log.outcome == Outcome.COLLISION
    return {
        "outcome": log.outcome.name.lower(),
        "reason": log.reason,
        "mode": spec.mode.name.lower(),
        "controller": spec.controller,
        "multiplier": spec.multiplier if spec.controller == "basic" else None,
        "seed": spec.seed,
        "episode_id": spec.episode_id,
        "ticks": len(log.pedestrian) - 1,
        "impact_time": log.impact_time if collided else None,
        "impact_speed": log.impact_speed if collided else None,
        "scenario": spec.scenario.as_dict(),
        "version": version(),
    }
