"""Results for a notebook: episodes as a table of pandas, trajectories as arrays of xarray with names and units."""

from __future__ import annotations

import importlib
from dataclasses import fields
from functools import cached_property
from typing import Any

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.errors import UsageError
from skd_sim.world.episode import Mode, Outcome

from skd_evaluator.assessment.files.episodes_npz import StoredEpisodes, read_episodes
from skd_evaluator.assessment.files.results import StoredResult


class Result(StoredResult):
    """An assessment read back, with its episodes as tables."""

    @cached_property
    def episodes(self) -> StoredEpisodes:
        """Every episode that the folder holds."""
        return read_episodes(self.folder)

    def to_dataframe(self) -> Any:
        """Return a pandas.DataFrame with a row for each episode: what it was, how it ended, how far it strayed.

        Columns: `episode_id`, `mode`, `objective`, `safe_index`, `outcome`, `hit`, `impact_time` (s), `impact_speed`
        (m/s), `deviation` (m; nan without a hit).

        Raises:
            UsageError: pandas is not installed.
        """
        episodes = self.episodes
        return _library("pandas").DataFrame(
            {
                "episode_id": episodes.episode_id,
                "mode": [Mode(int(one)).name.lower() for one in episodes.mode],
                "objective": episodes.objective.astype(str),
                "safe_index": episodes.safe_index,
                "outcome": [Outcome(int(one)).name.lower() for one in episodes.outcome],
                "hit": episodes.hit,
                "impact_time": episodes.impact_time,
                "impact_speed": episodes.impact_speed,
                "deviation": np.where(episodes.hit, episodes.deviation, np.nan),
            }
        )

    def to_xarray(self) -> Any:
        """Return the trajectories as an xarray.Dataset.

        `adversary` (episode, time, axis), `car` (episode, time, state) and `phi` (safe, time, axis). Times are those of
        ticks, s; positions m, the car's speed m/s; nan after an episode's end.

        Raises:
            UsageError: xarray is not installed.
        """
        xarray, episodes = _library("xarray"), self.episodes
        ticks = max(map(len, (*episodes.adversary, *episodes.safe)), default=0)
        arrays = {
            "adversary": (("episode", "time", "axis"), _padded(episodes.adversary, ticks, 2), {"units": "m"}),
            "car": (("episode", "time", "state"), _padded(episodes.car, ticks, 3), {"units": "m, m, m/s"}),
            "phi": (("safe", "time", "axis"), _padded(episodes.safe, ticks, 2), {"units": "m"}),
            "safe_index": (("episode",), episodes.safe_index),
        }
        coordinates = {
            "episode": episodes.episode_id,
            "time": ("time", episodes.time_step * np.arange(ticks), {"units": "s"}),
            "axis": ["x", "y"],
            "state": ["x", "y", "speed"],
        }
        return xarray.Dataset(arrays, coordinates, {"folder": str(self.folder)})


def result_of(stored: StoredResult) -> Result:
    """Return a result with the tables."""
    return Result(**{one.name: getattr(stored, one.name) for one in fields(stored)})


def _padded(trajectories: tuple[FloatArray, ...], ticks: int, width: int) -> FloatArray:
    found = np.full((len(trajectories), ticks, width), np.nan)
    for row, one in zip(found, trajectories, strict=True):
        row[: len(one)] = one
    return found


def _library(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        raise UsageError(f"this needs {name}: python -m pip install 'skd[notebook]'") from error
