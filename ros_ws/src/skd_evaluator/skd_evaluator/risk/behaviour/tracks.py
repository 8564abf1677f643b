"""Tracked people from files, as a behaviour model is fitted to them: recordings of CITR, csv files, recorded φ."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from skd_adversary.safe_trajectories.citr import FRAME_RATE, is_citr, read_clips, world_frame
from skd_adversary.safe_trajectories.table import read_table, resample
from skd_sim.arrays import FloatArray
from skd_sim.errors import UsageError
from skd_sim.geometry.trajectory import Trajectory

from skd_evaluator.bags.reader import read_bags
from skd_evaluator.bags.validation import Damage
from skd_evaluator.campaign.store.stored_episodes import EPISODES, read_episodes

TIME_STEP: Final = 0.3
"""s; that of every shipped scenario."""
SHORTEST: Final = 11
"""Places of a track at the least: the longest horizon of a residual, and the velocity before it."""
_COLUMNS: Final = {"t": 1e12, "x": 1e6, "y": 1e6}


@dataclass(frozen=True, eq=False)
class Tracked:
    """Somebody who was tracked.

    Attributes:
        recording: in which; tracks of one recording are held out together.
        name: of the track.
        positions: at ticks of `TIME_STEP`, n × 2, m: x along the way that people intend, y across it.
    """

    recording: str
    name: str
    positions: FloatArray


def read_tracks(paths: Sequence[Path], damage: Damage) -> list[Tracked]:
    """Read tracks: a folder of CITR, csv files with columns t, x, y or folders of them, bags or results with their φ.

    Raises:
        UsageError: there is no such file, one cannot be read, or there is no track long enough in it.
    """
    found = [one for path in paths for one in _tracks_of(path, damage)]
    enough = [one for one in found if len(one.positions) >= SHORTEST]
    if not enough:
        raise UsageError(
            f"{paths[0]}: no track of at least {(SHORTEST - 1) * TIME_STEP:g} s in it; {len(found)} shorter ones"
        )
    return enough


def _tracks_of(path: Path, damage: Damage) -> list[Tracked]:
    if not path.exists():
        raise UsageError(f"{path}: cannot be read: No such file or directory")
    if path.is_dir() and is_citr(path):
        return [
            Tracked(
                clip.name, f"{clip.name}/{one.id}", resample(one.frames / FRAME_RATE, world_frame(clip, one), TIME_STEP)
            )
            for clip in read_clips(path)
            for one in clip.tracks
        ]
    files = sorted(path.glob("*.csv")) if path.is_dir() else [path] if path.suffix.lower() == ".csv" else []
    if files:
        return [_of_csv(file) for file in files]
    return _recorded_phi(path, damage)


def _of_csv(path: Path) -> Tracked:
    values, lines = read_table(path, _COLUMNS)
    wrong = np.flatnonzero(np.diff(values[:, 0]) <= 0.0)
    if len(values) < 2 or len(wrong):
        line = lines[wrong[0] + 1] if len(wrong) else 1
        raise UsageError(f"{path}, line {line}: a track needs at least two rows, and t must increase strictly")
    return Tracked(path.stem, path.stem, resample(values[:, 0], values[:, 1:], TIME_STEP))


def _recorded_phi(path: Path, damage: Damage) -> list[Tracked]:
    """Return the safe trajectories of a result or of bags, each once."""
    if (path / EPISODES).is_file():
        stored = read_episodes(path)
        names = stored.further.get("safe_name", np.array([f"φ {one}" for one in range(len(stored.safe))])).tolist()
        phis = [Trajectory(one, stored.time_step, name) for one, name in zip(stored.safe, names, strict=True)]
    else:
        recorded = [one.log.episode.safe_trajectory for one in read_bags([path], damage).episodes]
        phis = [phi for phi in recorded if phi is not None]
    found: dict[bytes, Tracked] = {}
    for phi in phis:
        positions = resample(np.arange(len(phi), dtype=np.float64) * phi.time_step, phi.positions, TIME_STEP)
        name = phi.name or f"φ {len(found)}"
        found.setdefault(phi.positions.tobytes(), Tracked(name.split("/", maxsplit=1)[0], name, positions))
    return list(found.values())
