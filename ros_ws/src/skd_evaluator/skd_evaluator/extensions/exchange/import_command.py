"""`skd import`: ways of others as safe trajectories."""

from __future__ import annotations

import argparse
import math
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from skd_adversary.safe_trajectories.recordings import duplicate_of, repeated
from skd_sim.arrays import FloatArray
from skd_sim.errors import UsageError
from skd_sim.scenario.road_user import ROAD_USERS
from skd_sim.scenario.scenario import Scenario, load_scenario

from skd_evaluator.assessment.files.result_folder import write_json
from skd_evaluator.cli.arguments import result_folder
from skd_evaluator.cli.output import print_json
from skd_evaluator.extensions.exchange.imports import (
    ImportedTrajectory,
    ImportRequest,
    UnusableError,
    as_safe_trajectory,
    entry,
    files_in,
    read_sources,
    trajectory_of,
)
from skd_evaluator.extensions.exchange.options import BY_CAR
from skd_evaluator.extensions.exchange.scene import IMPORT
from skd_evaluator.extensions.fusion.track import RecordingFrame
from skd_evaluator.version import version

SAFE = "safe"
"""Folder of the ways, in that of the result."""
_SHOWN = 20


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    ROAD_USERS.target(arguments.kind)  # that there is such a kind
    scenario = None if arguments.scenario is None else load_scenario(arguments.scenario)
    frame = None if arguments.frame == BY_CAR else _frame(*arguments.frame)
    asked = ImportRequest(arguments.road_user, arguments.car, arguments.kind, frame is None, arguments.map_frame)
    out = result_folder(arguments)
    ways, left_out = _taken(arguments, asked, frame, scenario)
    if not ways:
        raise UsageError(_why_none(left_out))
    names = _names(ways)
    content: dict[str, Any] = {
        "import": 1,
        "skd": version(),
        "scenario": arguments.scenario,
        "files": [entry(way, f"{SAFE}/{name}") for way, name in zip(ways, names, strict=True)],
        "left_out": [{"source": str(path), "road_user": name, "why": why} for path, name, why in left_out],
    }

    def write(folder: Path) -> None:
        (folder / SAFE).mkdir()
        for way, name in zip(ways, names, strict=True):
            way.write(folder / SAFE / name)
        write_json(folder / IMPORT, content)

    problem = out.save(write)
    if arguments.json:
        print_json(content)
    else:
        for way, name in list(zip(ways, names, strict=True))[:_SHOWN]:
            print(f"{name}: {way.source.format}, {way.source.found.name}: {way.look.text}")
        if len(ways) > _SHOWN:
            print(f"and {len(ways) - _SHOWN} more")
        for line in _said_of(left_out):
            print(f"skd import: warning: {line}", file=sys.stderr)
        if not problem:
            behind = f" --scenario {arguments.scenario}" if arguments.scenario else ""
            print(f"next: skd assess --safe {out.path / SAFE} --safe-count {len(ways)}{behind}")
    if problem:
        print(f"skd import: {problem}", file=sys.stderr)
    return 1 if problem else 0


def _frame(x: float, y: float, degrees: float) -> RecordingFrame:
    return RecordingFrame(x, y, math.radians(degrees))


def _taken(
    arguments: argparse.Namespace, asked: ImportRequest, frame: RecordingFrame | None, scenario: Scenario | None
) -> tuple[list[ImportedTrajectory], list[tuple[Path, str, str]]]:
    """Return the ways that can be used, and of the others file, name and why they cannot."""
    ways: list[ImportedTrajectory] = []
    read: list[FloatArray] = []
    left_out: list[tuple[Path, str, str]] = []
    files, beside = files_in(arguments.paths)
    left_out += [(path, "its adversary", "a kamikaze or a run along φ, which is no safe trajectory") for path in beside]
    for path in files:
        for source in read_sources(path, asked):
            try:
                way = trajectory_of(source, frame, arguments.longest_gap, scenario)
                read.append(
                    np.column_stack([way.places, way.times]) if scenario is None else as_safe_trajectory(way, scenario)
                )
                ways.append(way)
            except UnusableError as error:
                left_out.append((path, source.found.name, str(error)))
    again = dict(repeated(read, moved=False))  # drawn ways may be the same; --safe refuses them
    left_out += [
        (ways[index].source.path, ways[index].source.found.name, duplicate_of(str(ways[first].source.path)))
        for index, first in again.items()
    ]
    return [way for index, way in enumerate(ways) if index not in again], left_out


def _said_of(left_out: Sequence[tuple[Path, str, str]]) -> list[str]:
    """Return what is said of ways that are left out: those that differ in words with digits alone in one line."""
    alike: dict[str, list[tuple[Path, str, str]]] = {}
    for one in left_out:
        alike.setdefault(re.sub(r"\S*\d\S*", "…", one[2]), []).append(one)
    found = []
    for (path, name, why), *rest in alike.values():
        more = f" and {len(rest)} more, see {IMPORT}," if rest else ""
        found.append(f"{path}, {name},{more} left out: {why}")
    return found


def _why_none(left_out: Sequence[tuple[Path, str, str]]) -> str:
    path, name, why = left_out[0]
    more = f" (and {len(left_out) - 1} more are left out)" if len(left_out) > 1 else ""
    return f"{path}, {name}: {why}{more}: no way is left"


def _names(ways: Sequence[ImportedTrajectory]) -> list[str]:
    """Return a name of each way's file, no two alike, none that leads elsewhere."""
    found: list[str] = []
    for way in ways:
        stem = re.sub(r"[^\w.-]", "_", way.source.stem, flags=re.ASCII).lstrip(".")[:100] or "way"
        name, number = stem, 1
        while f"{name}.csv" in found:
            number += 1
            name = f"{stem}_{number}"
        found.append(f"{name}.csv")
    return found
