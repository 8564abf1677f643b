"""Results on disk: a folder that appears whole or not at all."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from skd_sim.episode import EpisodeLog
from skd_sim.errors import UsageError

from skd_evaluator.assessment import Assessment

MARKERS = ("assessment.json", "sweep.json")
"""A folder with one of these holds results of ours."""


class ResultFolder:
    """An output folder, checked before the work and written after it, under a temporary name and then renamed."""

    def __init__(self, path: Path, *, overwrite: bool = False) -> None:
        """Check that `path` can be written.

        Raises:
            UsageError: it cannot, or it holds something already.
        """
        self.path = path
        if path.exists() and not path.is_dir():
            raise UsageError(f"--out {path}: is a file; give a folder")
        if path.is_dir() and any(path.iterdir()):
            ours = any((path / marker).exists() for marker in MARKERS)
            if not ours:
                raise UsageError(f"--out {path}: is not empty and holds no SKD results; give a new folder")
            if not overwrite:
                raise UsageError(f"--out {path}: already holds results; add --overwrite to replace them")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            probe = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
            probe.rmdir()
            if path.is_dir() and not os.access(path, os.W_OK | os.X_OK):
                raise PermissionError(13, "Permission denied")
        except OSError as error:
            raise UsageError(f"--out {path}: cannot be written ({error.strerror}); give another") from error

    def write(self, fill: Callable[[Path], None]) -> None:
        """Let `fill` write into a temporary folder beside the target and put it in the target's place."""
        temporary = Path(tempfile.mkdtemp(prefix=f".{self.path.name}.", dir=self.path.parent))
        try:
            temporary.chmod(0o777 & ~_umask())
            fill(temporary)
            replaced: Path | None = None
            if self.path.exists():
                replaced = temporary.with_name(temporary.name + ".old")
                self.path.rename(replaced)
            temporary.rename(self.path)
            if replaced is not None:
                shutil.rmtree(replaced)
        except BaseException:
            shutil.rmtree(temporary, ignore_errors=True)
            raise


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write JSON; NaN and infinity are refused, for JSON has none."""
    path.write_text(
        json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8"
    )


def write_assessment(folder: Path, assessment: Assessment) -> None:
    """Write assessment.json and episodes.npz."""
    write_json(folder / "assessment.json", assessment.as_dict())
    write_episodes(folder / "episodes.npz", assessment)


def write_episodes(path: Path, assessment: Assessment) -> None:
    """Write every trajectory of an assessment, so that all is recomputable.

    Trajectory k is rows offsets[k] … offsets[k+1] − 1 of `positions` (world frame, m). Per trajectory: `mode` (0 safe,
    1 kamikaze, 2 replay), `safe_index` (row of φ), `outcome`, `episode_id`, `impact_time` (s), `impact_speed` (m/s);
    `car` has the same rows as `positions` (x, y in m, speed in m/s; nan for φ).
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
        rows.append(
            (int(spec.mode), index, int(log.outcome), spec.episode_id, log.impact_time, log.impact_speed)
        )

    for index, kamikaze in enumerate(assessment.kamikaze):
        for log in kamikaze.logs:
            add(log, index)
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
    )
