"""Where safe trajectories come from that are there before any episode: csv files, the CITR dataset, a regulator's test.

Synthetic ones are made by running safe episodes.
"""

from __future__ import annotations

import logging
import re
from collections import Counter
from pathlib import Path

import numpy as np
from skd_sim.errors import UsageError
from skd_sim.scenario.protocol import regulatory_trajectories
from skd_sim.scenario.scenario import Scenario, check_way
from skd_sim.scenario.scenario_file import REGULATORY
from skd_sim.world.state import Trajectory

from skd_adversary.safe_trajectories.citr import Selection, is_citr, read_clips, select
from skd_adversary.safe_trajectories.csv_file import read_csv_trajectory
from skd_adversary.safe_trajectories.tracks import check_once

_log = logging.getLogger(__name__)  # whose warnings Python prints where nobody has said otherwise
_MOST_NAMED = 5


def load_safe_trajectories(source: str | Path, scenario: Scenario, count: int) -> list[Trajectory]:
    """Load `count` safe trajectories.

    Of n usable ones, in the order of file name (CITR: clip, then id), those at the indices
    round(linspace(0, n − 1, count)) are taken: always the same ones, spread evenly over clips and
    pedestrians; the middle one for a count of 1. What of a folder is not used is said, as a warning of this module's
    logger.

    Args:
        source: a csv file (see `read_csv_trajectory`), a folder of csv files, or one of the CITR dataset,
            which is recognised by its file names; or `REGULATORY`.
        scenario: gives the time step and the car's path, and the protocol of a regulatory source.
        count: how many, ≥ 1.

    Raises:
        UsageError: no such file or folder, a malformed file in it, or fewer usable trajectories than asked
            for.
    """
    if count < 1:
        raise UsageError(f"the number of safe trajectories must be at least 1, got {count}")
    path = Path(source)
    usable, dropped = _selection(path, scenario)
    if len(usable) < count:
        counts = Counter(reason for _, reason in dropped).most_common()
        reasons = ", ".join(f"{number} × {reason}" for reason, number in counts)
        others = f"; {len(dropped)} dropped ({reasons})" if dropped else ""
        raise UsageError(
            f"{path}: {len(usable)} usable safe trajectories where {count} were asked for{others}; ask for "
            f"{'fewer' if usable else 'another source'}"
        )
    taken = _spread(len(usable), count)
    unused = [trajectory.name for index, trajectory in enumerate(usable) if index not in taken]
    if unused or dropped:
        told = [f"not asked for: {_listed(unused)}"] if unused else []
        by_reason: dict[str, list[str]] = {}
        for name, reason in dropped:
            by_reason.setdefault(re.sub(r"\d+(\.\d+)?", "…", reason), []).append(name)
        told += [f"{reason}: {_listed(names)}" for reason, names in by_reason.items()]
        _log.warning("%s: %d of %d used; %s", path, count, len(usable) + len(dropped), "; ".join(told))
    return [usable[index] for index in taken]


def _listed(names: list[str]) -> str:
    return ", ".join(names[:_MOST_NAMED]) + (
        f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
    )


def count_safe_trajectories(source: str | Path, scenario: Scenario) -> int:
    """Return how many usable safe trajectories there are; see `load_safe_trajectories`.

    Raises:
        UsageError: no such file or folder, or a malformed file in it.
    """
    return len(_selection(Path(source), scenario).usable)


def _selection(path: Path, scenario: Scenario) -> Selection:
    if str(path) == REGULATORY:
        ways = regulatory_trajectories(scenario)
        for way in ways:
            check_way(scenario, way)
        return Selection(ways, [])
    if not path.exists():  # a misspelt name of a kind looks like a path, too
        raise UsageError(
            f"{path}: cannot be read: No such file or folder; give synthetic, own, walkers, regulatory, or the path of "
            "one"
        )
    try:
        return _select(path, scenario)
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror or error}") from error


def _select(path: Path, scenario: Scenario) -> Selection:
    if not path.is_dir():
        return Selection([read_csv_trajectory(path, scenario)], [])
    if is_citr(path):
        return select(read_clips(path), scenario)
    entries = sorted(entry for entry in path.iterdir() if not entry.name.startswith("."))
    files = [entry for entry in entries if entry.suffix.lower() == ".csv" and entry.is_file()]
    if not files:
        raise UsageError(f"{path}: no csv file in this folder")
    others = [(entry.name, "no csv file") for entry in entries if entry not in files]
    found = [read_csv_trajectory(file, scenario) for file in files]
    check_once([(str(file), one.positions) for file, one in zip(files, found, strict=True)], moved=False)
    return Selection(found, others)


def _spread(available: int, count: int) -> list[int]:
    """Return `count` different indices below `available`, spread evenly."""
    if count == 1:
        return [(available - 1) // 2]
    return [int(index) for index in np.rint(np.linspace(0, available - 1, count))]
