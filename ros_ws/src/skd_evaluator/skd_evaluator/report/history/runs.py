"""Assessments under a folder, as they are written: found and read quickly, and not computed anew."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from skd_sim.errors import UsageError
from skd_sim.inputs.files import folders_in, read_json, real_path

from skd_evaluator.assessment.files.assessment_json import ASSESSMENT, understood
from skd_evaluator.assessment.files.result_folder import check_unchanged
from skd_evaluator.files import PREFIX
from skd_evaluator.metrics.credibility import in_one_line, not_credible
from skd_evaluator.metrics.margins import open_search
from skd_evaluator.provenance import code_of_car
from skd_evaluator.report.terminal import car_name

SHORT = 7  # digits of a commit
_LARGE = ("vulnerability_curve", "objectives", "risk", "surrogate_measures", "clustering", "measures")
"""Entries that no row is of, and nine tenths of a file: of thousands of results they are not kept."""


@dataclass(frozen=True)
class Run:
    """An assessment, as its file says.

    Attributes:
        folder: its folder.
        figures: content of its assessment.json, under the keys of today, without its largest entries.
        remark: what is wrong with its files, in a few words; empty: nothing.
    """

    folder: Path
    figures: Mapping[str, Any]
    remark: str = ""

    @property
    def car(self) -> str:
        """Name of the car."""
        return car_name(self.figures)

    @property
    def scenario(self) -> str:
        """Name of the scenario."""
        return str(self.figures["scenario"]["name"])

    @property
    def date(self) -> str:
        """When it began, UTC, as `2026-01-31T12:00:00Z`; empty where it is not known."""
        return str((self.figures.get("provenance") or {}).get("date") or "")

    @property
    def revision(self) -> str:
        """Commit of the car's code, shortened, with `+` where files differed from it; empty where it is not known."""
        git = code_of_car(self.figures)
        return "" if not git else f"{git['revision'][:SHORT]}{'+' if git['modified'] else ''}"

    @property
    def not_credible(self) -> list[str]:
        """Why its figures are not credible, a line each."""
        return not_credible(self.figures.get("warnings") or ())

    @property
    def warnings(self) -> list[str]:
        """Its own warnings, and that its margin is an upper bound, a line each."""
        return [*in_one_line(self.figures.get("warnings") or ()), *open_search(self.figures)]

    def as_dict(self) -> dict[str, Any]:
        """Return the row of `skd list --json`."""
        keys = (
            "margin",
            "margin_ci95",
            "nominal_collision_rate",
            "nominal_collision_rate_ci95",
            "deviation",
            "skd",
            "risk_1",
            "seed",
            "safe",
        )
        return {
            "folder": str(self.folder),
            "car": self.car,
            "scenario": self.scenario,
            "date": self.date,
            "revision": self.revision,
            "safe_count": len(self.figures["per_safe_trajectory"]),
            "trials": self.figures.get("margin_trials"),
            "margin_converged": self.figures.get("margin_converged"),
            **{key: self.figures.get(key) for key in keys},
            "remark": self.remark,
            "credible": not self.not_credible,
            "warnings": self.warnings,
        }


def find_runs(folders: Sequence[Path]) -> list[Run]:
    """Return every assessment in or under folders; one whose files cannot be read is there with a remark alone.

    Raises:
        UsageError: a folder is not there.
    """
    found: dict[Path, Run] = {}
    for folder in folders:
        if not folder.is_dir():
            raise UsageError(f"{folder}: is no folder")
        unread: list[Run] = []
        for place in _places(folder, unread):
            found.setdefault(real_path(place), read_run(place))
        found.update((one.folder, one) for one in unread)
    return list(found.values())


def _places(folder: Path, unread: list[Run]) -> Iterator[Path]:
    """Yield the folders that hold an assessment, in the order of their names; hidden ones are left out."""
    for path, inside, files in folders_in(folder, lambda path, why: unread.append(Run(path, {}, why))):
        inside[:] = sorted(name for name in inside if not name.startswith((".", PREFIX)))
        if ASSESSMENT in files:
            yield path


def read_run(folder: Path) -> Run:
    """Return an assessment; one that cannot be understood has only a remark."""
    path = folder / ASSESSMENT
    try:
        content = read_json(path)
        with understood(path):
            run = Run(folder, {key: value for key, value in content.items() if key not in _LARGE})
            run.as_dict()  # it is found here that something is missing
    except UsageError as error:
        return Run(folder, {}, str(error).removeprefix(f"{path}: "))
    try:
        known = check_unchanged(folder, (ASSESSMENT,))
    except UsageError:
        return Run(folder, run.figures, "changed since it was written")
    return run if known else Run(folder, run.figures, "has no manifest")
