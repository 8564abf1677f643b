"""Tracked people from files, as a behaviour model is fitted to them: recordings of CITR, csv files, recorded φ."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from skd_adversary.crossing.road_users import road_user_named
from skd_adversary.safe_trajectories.citr import FRAME_RATE, is_citr, read_clips, world_frame
from skd_adversary.safe_trajectories.csv_file import read_table, resample, too_fast
from skd_adversary.safe_trajectories.tracks import LONGEST_HOLE, check_once
from skd_sim.arrays import FloatArray
from skd_sim.errors import UsageError
from skd_sim.world.state import Trajectory

from skd_evaluator.assessment.files.episodes_npz import EPISODES, read_episodes
from skd_evaluator.bags.checks import Damage
from skd_evaluator.bags.read import read_bags
from skd_evaluator.risk.behaviour.residuals import padded, quantile_table

TIME_STEP: Final = 0.3
"""s; that of every shipped scenario."""
SHORTEST: Final = 11
"""Places of a track at the least: the longest horizon of a residual, and the velocity before it."""
LONGEST: Final = 1000
"""Places of a track at the most: five minutes of somebody's way. Groups of people are simulated of that length."""
_STANDS, _GOES, _ASIDE = 0.5, 2.0, 0.5
"""m up to which a track goes nowhere, and from which on it has a direction; and cosine of the angle to x of one that
goes along."""
_DRAWN = 1e-3
"""m, median of the residuals, below which tracks are drawn and not tracked: no sensor is so steady."""
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


def read_tracks(paths: Sequence[Path], damage: Damage, kind: str = "pedestrian") -> list[Tracked]:
    """Read tracks: a folder of CITR, csv files with columns t, x, y or folders of them, bags or results with their φ.

    Args:
        paths: where they are.
        damage: told of episodes that are damaged.
        kind: of road user; says how fast one can be.

    Raises:
        UsageError: there is no such file, one cannot be read, there is no track long enough in it, or one that nobody
            can have gone, has holes, is there twice, or does not go along x, as those of most have to.
    """
    phis: dict[bytes, Tracked] = {}
    named = [(f"{path}: {one.name}", one) for path in paths for one in _tracks_of(path, damage, kind, phis)]
    found = [one for _, one in named]
    enough = [one for one in found if len(one.positions) >= SHORTEST]
    if not enough:
        raise UsageError(
            f"{paths[0]}: no track of at least {(SHORTEST - 1) * TIME_STEP:g} s in it; {len(found)} shorter ones"
        )
    _check_directions(enough)
    if quantile_table(padded([one.positions for one in enough]), TIME_STEP).min() < _DRAWN:
        raise UsageError(
            f"{paths[0]}: most of its tracks go straight on at one pace to the millimetre, as nobody does who was "
            "tracked: safe trajectories that were made by rule say nothing of people"
        )
    check_once((name, one.positions) for name, one in named)
    return enough


def _check_directions(tracks: Sequence[Tracked]) -> None:
    """Refuse tracks that do not go along x: to a model they are people who head anywhere."""
    for one in tracks:
        if np.hypot(*(one.positions - one.positions[0]).T).max() < _STANDS:
            raise UsageError(f"{one.name}: stands all the time, so nobody knows what way is intended; leave it out")
    off = [(one, one.positions[-1] - one.positions[0]) for one in tracks]
    going = [(one, by) for one, by in off if np.hypot(*by) >= _GOES]
    aside = [one for one, by in going if by[0] < _ASIDE * np.hypot(*by)]
    if 2 * len(aside) > len(going):
        raise UsageError(
            f"{aside[0].name}: goes aside or back, as {len(aside)} of {len(going)} tracks do; x must be along the way "
            "that people intend, and grow: turn them round"
        )


def _tracks_of(path: Path, damage: Damage, kind: str, phis: dict[bytes, Tracked]) -> list[Tracked]:
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
        return [_of_csv(file, kind) for file in files]
    return _recorded_phi(path, damage, phis)


def _of_csv(path: Path, kind: str) -> Tracked:
    values, lines = read_table(path, _COLUMNS)
    wrong = np.flatnonzero(np.diff(values[:, 0]) <= 0.0)
    if len(values) < 2 or len(wrong):
        line = lines[wrong[0] + 1] if len(wrong) else 1
        raise UsageError(f"{path}, line {line}: a track needs at least two rows, and t must increase strictly")
    times = values[:, 0]
    found = too_fast(times, values[:, 1:], road_user_named(kind).fastest)
    if found:
        raise UsageError(f"{path}, line {lines[found[0]]}: {found[1]}: is t in s, are x and y in m, without jumps?")
    hole = int(np.argmax(np.diff(times)))
    if times[hole + 1] - times[hole] > LONGEST_HOLE + 1e-9:
        raise UsageError(
            f"{path}, line {lines[hole + 1]}: {times[hole + 1] - times[hole]:.3g} s after the line before, more than "
            f"{LONGEST_HOLE:g} s: is t in s? Cut a track where it has a hole"
        )
    if times[-1] - times[0] > LONGEST * TIME_STEP:
        raise UsageError(f"{path}: lasts {times[-1] - times[0]:.4g} s, more than {LONGEST * TIME_STEP:g} s; cut it")
    return Tracked(path.stem, path.stem, resample(values[:, 0], values[:, 1:], TIME_STEP))


def _recorded_phi(path: Path, damage: Damage, known: dict[bytes, Tracked]) -> list[Tracked]:
    """Return the safe trajectories of a result or of bags, each once, and none that is known: cars share them."""
    if (path / EPISODES).is_file():
        stored = read_episodes(path)
        names = stored.further.get("safe_name", np.array([f"φ {one}" for one in range(len(stored.safe))])).tolist()
        ways = [Trajectory(one, stored.time_step, name) for one, name in zip(stored.safe, names, strict=True)]
    else:
        recorded = [one.log.episode.safe_trajectory for one in read_bags([path], damage).episodes]
        ways = [phi for phi in recorded if phi is not None]
    count = len(known)
    for phi in ways:
        positions = resample(np.arange(len(phi), dtype=np.float64) * phi.time_step, phi.positions, TIME_STEP)
        name = phi.name or f"φ {len(known)}"
        known.setdefault(phi.positions.tobytes(), Tracked(name.split("/", maxsplit=1)[0], name, positions))
    return list(known.values())[count:]
