"""Recorded episodes from wherever they are: bags, or the episodes.npz of an assessment or of a probe."""

from __future__ import annotations

import itertools
import json
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from skd_adversary.car_fit import Recording
from skd_sim.episode import EpisodeLog
from skd_sim.errors import UsageError
from skd_sim.scenario import Scenario, scenario_from_dict

from skd_evaluator.bags.reader import read_episodes

EPISODES = "episodes.npz"
_SCENARIO_FILES = ("probe.json", "assessment.json")


def recording_of(log: EpisodeLog) -> Recording:
    """Return what an episode's log says about the car."""
    scenario = log.episode.scenario
    return Recording(log.pedestrian, log.car, scenario.time_step, scenario.car.front, scenario.car.rear)


def read_recordings(paths: Sequence[Path]) -> list[Recording]:
    """Return every recorded episode of `paths`: bag folders, .mcap files, episodes.npz, or folders of them.

    A folder with bags is read from its bags, for they hold every episode.

    Raises:
        UsageError: a path cannot be read, or holds neither.
    """
    recordings: list[Recording] = []
    for path in paths:
        if not path.exists():
            raise UsageError(f"{path}: no such file or folder")
        if path.is_dir() and not any(path.rglob("*.mcap")):
            files = sorted(path.rglob(EPISODES))
            if not files and not any(path.rglob("*.mcap.zstd")):
                raise UsageError(f"{path}: holds neither .mcap files nor {EPISODES}; record some with skd probe")
            if files:
                for file in files:
                    recordings += _read_npz(file)
                continue
        if path.suffix == ".npz":
            recordings += _read_npz(path)
        else:
            recordings += [recording_of(episode.log) for episode in read_episodes([path])]
    return recordings


def _scenario_beside(path: Path) -> Scenario:
    for name in _SCENARIO_FILES:
        file = path.parent / name
        if file.exists():
            try:
                content: Any = json.loads(file.read_text(encoding="utf-8"))
                return scenario_from_dict(content["scenario"], str(file))
            except (OSError, ValueError, KeyError, TypeError) as error:
                raise UsageError(f"{file}: holds no scenario ({' '.join(str(error).split())})") from error
    raise UsageError(f"{path}: has no {' or '.join(_SCENARIO_FILES)} beside it, which says what car it was")


def _read_npz(path: Path) -> list[Recording]:
    try:
        with np.load(path, allow_pickle=False) as arrays:
            positions, car, offsets = (arrays[name] for name in ("positions", "car", "offsets"))
            time_step = float(arrays["time_step"])
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise UsageError(f"{path}: is no episodes.npz of ours ({' '.join(str(error).split())})") from error
    scenario = _scenario_beside(path)
    found = []
    for first, last in itertools.pairwise(offsets):
        driven = car[first:last]
        if np.isfinite(driven).all():  # safe trajectories have no car
            found.append(Recording(positions[first:last], driven, time_step, scenario.car.front, scenario.car.rear))
    return found


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
