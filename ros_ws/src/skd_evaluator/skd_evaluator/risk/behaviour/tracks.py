"""Tracked people from files (CITR, csv, recorded φ), and whether a model holds for people whom it has not seen."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from skd_adversary.safe_trajectories.recordings import LONGEST_HOLE, check_once, read_table, resample
from skd_adversary.safe_trajectories.sources import FRAME_RATE, check_track, is_citr, read_clips, world_frame
from skd_sim.errors import UsageError
from skd_sim.world.state import FloatArray, Trajectory

from skd_evaluator.assessment.files.episodes_npz import EPISODES, read_episodes
from skd_evaluator.bags.checks import Damage
from skd_evaluator.bags.read import read_bags
from skd_evaluator.metrics.behaviour.model import normals_of
from skd_evaluator.risk.behaviour.fit import (
    HORIZONS,
    LEAST_TRACKS,
    QUANTILES,
    fit_behaviour,
    padded,
    quantile_table,
    simulated,
)

TIME_STEP: Final = 0.3
"""s; that of every shipped scenario."""
SHORTEST: Final = 11
"""Places of a track at the least: the longest horizon of a residual, and the velocity before it."""
LONGEST: Final = 1000
"""Places of a track at the most: five minutes. Groups of people are simulated of that length."""
_STANDS, _GOES, _ASIDE = 0.5, 2.0, 0.5
"""m up to which a track goes nowhere, and from which on it has a direction; and cosine of the angle to x of one that
goes along."""
_DRAWN = 1e-3
"""m, median of the residuals, below which tracks are drawn and not tracked: no sensor is so steady."""
_COLUMNS: Final = {"t": 1e12, "x": 1e6, "y": 1e6}


@dataclass(frozen=True, eq=False)
class Tracked:
    """A person who was tracked.

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
        damage: takes note of episodes that are damaged.
        kind: of road user; says how fast one can be.

    Raises:
        UsageError: there is no such file, one cannot be read, there is no track long enough in it, or one that
            no person can have gone, has holes, is there twice, or does not go along x, as those of most have to.
    """
    phis: dict[bytes, Tracked] = {}
    named = [(f"{path}: {one.name}", one) for path in paths for one in _tracks_of(path, damage, kind, phis)]
    found = [one for _, one in named]
    enough = [one for one in found if len(one.positions) >= SHORTEST]
    if not enough:
        raise UsageError(
            f"{paths[0]}: no track of at least {(SHORTEST - 1) * TIME_STEP:g} s; {len(found)} shorter ones"
        )
    _check_directions(enough)
    if quantile_table(padded([one.positions for one in enough]), TIME_STEP).min() < _DRAWN:
        raise UsageError(f"{paths[0]}: most of its tracks go straight on at one pace, as no tracked person does")
    check_once((name, one.positions) for name, one in named)
    return enough


def _check_directions(tracks: Sequence[Tracked]) -> None:
    """Refuse tracks that do not go along x: to a model they are people who head anywhere."""
    for one in tracks:
        if np.hypot(*(one.positions - one.positions[0]).T).max() < _STANDS:
            raise UsageError(f"{one.name}: stands all the time, so its intended trajectory is not known; leave it out")
    off = [(one, one.positions[-1] - one.positions[0]) for one in tracks]
    going = [(one, by) for one, by in off if np.hypot(*by) >= _GOES]
    aside = [one for one, by in going if by[0] < _ASIDE * np.hypot(*by)]
    if 2 * len(aside) > len(going):
        count = f"{len(aside)} of {len(going)} tracks"
        raise UsageError(f"{aside[0].name}: goes aside or back, as {count} do; x must grow along the way intended")


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
    times = values[:, 0]
    check_track(times, values[:, 1:], kind, path, lines)
    hole = int(np.argmax(np.diff(times)))
    if times[hole + 1] - times[hole] > LONGEST_HOLE + 1e-9:
        pause = f"{times[hole + 1] - times[hole]:.3g} s after the line before, more than {LONGEST_HOLE:g} s"
        raise UsageError(f"{path}, line {lines[hole + 1]}: {pause}: is t in s?")
    if times[-1] - times[0] > LONGEST * TIME_STEP:
        raise UsageError(f"{path}: lasts {times[-1] - times[0]:.4g} s, more than {LONGEST * TIME_STEP:g} s; cut it")
    return Tracked(path.stem, path.stem, resample(times, values[:, 1:], TIME_STEP))


def _recorded_phi(path: Path, damage: Damage, known: dict[bytes, Tracked]) -> list[Tracked]:
    """Return the safe trajectories of a result or of bags, each once, and none that is known: cars share them."""
    if (path / EPISODES).is_file():
        stored = read_episodes(path)
        names = stored.further.get("safe_name", np.array([f"φ {one}" for one in range(len(stored.safe))])).tolist()
        trajectories = [Trajectory(one, stored.time_step, name) for one, name in zip(stored.safe, names, strict=True)]
    else:
        recorded = [one.log.episode.safe_trajectory for one in read_bags([path], damage).episodes]
        trajectories = [phi for phi in recorded if phi is not None]
    count = len(known)
    for phi in trajectories:
        positions = resample(np.arange(len(phi), dtype=np.float64) * phi.time_step, phi.positions, TIME_STEP)
        name = phi.name or f"φ {len(known)}"
        known.setdefault(phi.positions.tobytes(), Tracked(name.split("/", maxsplit=1)[0], name, positions))
    return list(known.values())[count:]


FOLDS: Final = 4
WITHIN: Final = 0.2
"""Of the recorded quantiles, within which a model counts as holding."""
_COPIES = 32  # simulated persons for each one held out
_SEED = 712


@dataclass(frozen=True, eq=False)
class Validation:
    """Quantiles of the residual of constant velocity of people held out, as recorded and as predicted for them.

    Attributes:
        recorded: horizons × quantiles, m.
        predicted: the same by models that were fitted without them, m.
        by: what was held out together: `recording` or `person`.
        folds: number of parts that were held out, one after the other.
        example: some simulated tracks, by the last model.
    """

    recorded: FloatArray
    predicted: FloatArray
    by: str
    folds: int
    example: FloatArray

    @property
    def worst(self) -> float:
        """Greatest relative difference of a quantile."""
        return float(np.max(np.abs(self.predicted / self.recorded - 1.0)))

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain data."""
        rows = [
            {"horizon": horizon, "quantile": quantile, "recorded": float(mine), "predicted": float(theirs)}
            for horizon, ours, others in zip(HORIZONS, self.recorded, self.predicted, strict=True)
            for quantile, mine, theirs in zip(QUANTILES, ours, others, strict=True)
        ]
        return {"held_out_by": self.by, "folds": self.folds, "worst": self.worst, "residuals": rows}


def folds_of(tracks: Sequence[Tracked]) -> tuple[str, list[int]]:
    """Return by what tracks are held out, and for each of them in which fold; recordings take turns."""
    recordings = sorted({one.recording for one in tracks})
    if len(recordings) < 2:
        return "person", [number % min(FOLDS, len(tracks)) for number in range(len(tracks))]
    fold = {name: number % min(FOLDS, len(recordings)) for number, name in enumerate(recordings)}
    return "recording", [fold[one.recording] for one in tracks]


def validate(tracks: Sequence[Tracked], progress: Callable[[int, int], None] = lambda _done, _of: None) -> Validation:
    """Fit a model without each part of the tracks in turn, and compare its prediction with that part.

    Raises:
        ValueError: too few tracks are left without one part.
    """
    by, folds = folds_of(tracks)
    count = max(folds) + 1
    predicted: list[FloatArray] = []
    example = np.empty((0, 0, 2))
    for number in range(count):
        kept = [one.positions for one, fold in zip(tracks, folds, strict=True) if fold != number]
        if len(kept) < LEAST_TRACKS:
            raise ValueError(f"{len(kept)} tracks are left when a {by} is held out; {LEAST_TRACKS} are needed")
        lengths = [len(one.positions) for one, fold in zip(tracks, folds, strict=True) if fold == number]
        fit = fit_behaviour(kept, TIME_STEP, intervals=False)
        rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(_SEED, spawn_key=(number,))))
        normals = rng.standard_normal((_COPIES * len(lengths), normals_of(max(lengths) - 1)))
        example = simulated(fit.values, lengths * _COPIES, fit.speed, TIME_STEP, normals)
        predicted += [track[np.isfinite(track[:, 0])] for track in example]
        progress(number + 1, count)
    recorded = quantile_table(padded([one.positions for one in tracks]), TIME_STEP)
    return Validation(recorded, quantile_table(padded(predicted), TIME_STEP), by, count, example)
