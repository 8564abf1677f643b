"""Recorded episodes from wherever they are: bags, or the episodes.npz of an assessment or of a probe."""

from __future__ import annotations

import itertools
import json
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from skd_adversary.car_fit import Recording
from skd_sim.episode import EpisodeLog
from skd_sim.errors import UsageError
from skd_sim.scenario import Scenario, scenario_from_dict

from skd_evaluator.bags.reader import read_episodes

EPISODES = "episodes.npz"
_SUMMARIES = ("probe.json", "assessment.json")


def recording_of(log: EpisodeLog) -> Recording:
    """Return what an episode's log says about the car."""
    scenario = log.episode.scenario
    return Recording(log.pedestrian, log.car, scenario.time_step, scenario.car.front, scenario.car.rear)


def read_recordings(paths: Sequence[Path]) -> list[Recording]:
    """Return every recorded episode of `paths`: bag folders, .mcap files, episodes.npz, or folders of them.

    An episodes.npz with bags below its folder is not read, for they hold every episode. An episode that is found twice
    counts once.

    Raises:
        UsageError: a path cannot be read, or holds neither; or the logs are of several controllers.
    """
    found: dict[tuple[bytes, bytes], Recording] = {}
    cars: dict[str, Path] = {}
    for path in paths:
        for car, recording in _recorded(path):
            cars.setdefault(car, path)
            found.setdefault((recording.pedestrian.tobytes(), recording.car.tobytes()), recording)
    if len(cars) > 1:
        (one, first), (other, second) = list(cars.items())[:2]
        where = f"both in {first}" if first == second else f"in {first} and in {second}"
        raise UsageError(f"the logs are of several cars: {one} and {other}, {where}; fit them apart")
    return list(found.values())


def _recorded(path: Path) -> Iterator[tuple[str, Recording]]:
    """Yield (controller, recording) of every episode below a path."""
    if not path.exists():
        raise UsageError(f"{path}: no such file or folder")
    if path.is_dir():
        arrays = [file for file in sorted(path.rglob(EPISODES)) if not any(file.parent.rglob("*.mcap"))]
        bags = any(path.rglob("*.mcap")) or (not arrays and any(path.rglob("*.mcap.zstd")))
        if not bags and not arrays:
            raise UsageError(f"{path}: holds neither .mcap files nor {EPISODES}; record some with skd probe")
    else:
        bags, arrays = path.suffix != ".npz", [path] if path.suffix == ".npz" else []
        if bags and not path.name.endswith((".mcap", ".mcap.zstd")):
            raise UsageError(f"{path}: give {EPISODES}, an .mcap file, or a folder of them")
    if bags:
        for episode in read_episodes([path]):
            log = episode.log
            yield _car_name(log.episode.controller, log.episode.multiplier), recording_of(log)
    for file in arrays:
        yield from _read_npz(file)


def _car_name(controller: str, multiplier: float | None) -> str:
    """Return how a car is told from another."""
    return f"basic, C = {multiplier:g}" if controller == "basic" and multiplier is not None else controller


def _said_beside(path: Path) -> tuple[Scenario, str]:
    """Return the scenario and the car that an episodes.npz is of, from the summary in its folder."""
    for name in _SUMMARIES:
        file = path.parent / name
        if file.exists():
            try:
                content: Any = json.loads(file.read_text(encoding="utf-8"))
                scenario = scenario_from_dict(content["scenario"], str(file))
                return scenario, _car_name(str(content["controller"]), content["multiplier"])
            except (OSError, ValueError, KeyError, TypeError) as error:
                raise UsageError(f"{file}: does not say what car it was ({' '.join(str(error).split())})") from error
    raise UsageError(f"{path}: has no {' or '.join(_SUMMARIES)} beside it, which says what car it was")


def _read_npz(path: Path) -> Iterator[tuple[str, Recording]]:
    try:
        with np.load(path, allow_pickle=False) as arrays:
            positions, car, offsets = (arrays[name] for name in ("positions", "car", "offsets"))
            time_step = float(arrays["time_step"])
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise UsageError(f"{path}: is no {EPISODES} of ours ({' '.join(str(error).split())})") from error
    scenario, name = _said_beside(path)
    for first, last in itertools.pairwise(offsets):
        driven = car[first:last]
        if np.isfinite(driven).all():  # safe trajectories have no car
            yield (
                name,
                Recording(positions[first:last], driven, time_step, scenario.car.front, scenario.car.rear),
            )


def write_logs(path: Path, logs: Sequence[EpisodeLog]) -> None:
    """Write logs as episodes.npz: the columns of `results.write_episodes`, as far as there is no φ to speak of."""
    np.savez_compressed(
        path,
        positions=np.concatenate([log.pedestrian for log in logs]),
        car=np.concatenate([log.car for log in logs]),
        offsets=np.cumsum([0, *(len(log.pedestrian) for log in logs)], dtype=np.int64),
        mode=np.array([int(log.episode.mode) for log in logs], np.int8),
        outcome=np.array([int(log.outcome) for log in logs], np.int8),
        episode_id=np.array([log.episode.episode_id for log in logs], np.int64),
        impact_time=np.array([log.impact_time for log in logs]),
        impact_speed=np.array([log.impact_speed for log in logs]),
        time_step=np.array(logs[0].episode.scenario.time_step),
    )
