"""Rows of the tables of encounters × cars, kept in a file, so that the same command goes on where one ended."""

from __future__ import annotations

import argparse
import json
import math
import resource
from collections.abc import Callable
from pathlib import Path
from typing import Any

from skd_evaluator.cli.arguments import whole_number
from skd_sim.encounter.known_scenarios import SCENARIOS

Row = dict[str, Any]


def add_table_options(parser: argparse.ArgumentParser, attempts: int, of_what: str) -> None:
    """Add the options that all of these tables have; by default there are so many attempts, of what is said."""
    number: dict[str, Any] = {"type": whole_number(1), "metavar": "N"}
    parser.add_argument("--encounters", nargs="+", default=list(SCENARIOS.own), metavar="NAME")
    parser.add_argument("--safe", **number, default=5, help="φ of each encounter, at most")
    parser.add_argument("--attempts", **number, default=attempts, help=of_what)
    parser.add_argument(
        "--margin-limit", **number, default=512, help="ticks of the car, for each attempt with a margin"
    )
    parser.add_argument("--workers", **number, default=1)
    parser.add_argument("--most-minutes", type=float, default=math.inf, metavar="MIN", help="of processor time")
    parser.add_argument("--out", type=Path, metavar="FILE", help="JSON of all rows")


class KeptRows:
    """Rows by encounter and car.

    Attributes:
        rows: by name of the encounter and of the car.
    """

    def __init__(self, path: Path | None, most_minutes: float) -> None:
        """Read those that a file has, if there is one; none is begun after so much processor time, minutes."""
        self._path, self._most = path, most_minutes
        there = path is not None and path.is_file()
        self.rows: dict[str, dict[str, Row]] = json.loads(path.read_text(encoding="utf-8")) if path and there else {}

    def row(self, name: str, car: str, compute: Callable[[], Row]) -> Row | None:
        """Return a row, computed and kept if there was none; None if there is no time left for it."""
        of_encounter = self.rows.get(name, {})
        if car not in of_encounter:
            if _processor_minutes() > self._most:
                return None
            of_encounter = self.rows.setdefault(name, {})
            of_encounter[car] = compute()
            if self._path is not None:
                self._store(self._path)
        return of_encounter[car]

    def _store(self, path: Path) -> None:
        """Write all rows by one rename."""
        partial = path.with_name(f"{path.name}.partial")
        partial.write_text(json.dumps(self.rows, indent=1, ensure_ascii=False), encoding="utf-8")
        partial.replace(path)


def _processor_minutes() -> float:
    """Return the processor time of this process and of those that have ended, minutes."""
    both = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in both) / 60.0
