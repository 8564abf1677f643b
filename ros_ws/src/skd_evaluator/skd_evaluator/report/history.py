"""Assessments under a folder, and how a figure of a car has changed from one to the next: `skd list`."""

from __future__ import annotations

import itertools
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.markup import escape
from rich.table import Table
from skd_sim.errors import UsageError
from skd_sim.inputs.files import read_json, real_path

from skd_evaluator.assessment.compare.comparison import NOT_COMPARED, Comparison, compare
from skd_evaluator.assessment.figure_table import AT_THE_TOP
from skd_evaluator.assessment.files.assessment_json import ASSESSMENT, understood
from skd_evaluator.assessment.files.result_folder import check_unchanged
from skd_evaluator.assessment.files.results import StoredResult, assessments_below
from skd_evaluator.files import UNFINISHED, check_folder
from skd_evaluator.metrics.aborted import NOT_CREDIBLE, in_one_line, not_credible
from skd_evaluator.metrics.margins import open_search
from skd_evaluator.provenance import code_of_car
from skd_evaluator.report.formats import TERMINAL
from skd_evaluator.report.terminal import bounded_cell, narrow_table

SHORT = 7  # digits of a commit
_LARGE = ("vulnerability_curve", "objectives", "risk", "surrogate_measures", "clustering", "measures")
"""Entries that no row is of, and nine tenths of a file: of thousands of results they are not kept."""
_ROW = (
    "margin", "margin_ci95", "nominal_collision_rate", "nominal_collision_rate_ci95", "deviation", "skd", "risk_1",
    "time_lost", "time_lost_ci95", "seed", "safe",
)  # fmt: skip


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
        return str(self.figures["car"])

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
        return {
            **{"folder": str(self.folder), "car": self.car, "scenario": self.scenario, "date": self.date},
            "revision": self.revision,
            "safe_count": len(self.figures["per_safe_trajectory"]),
            "trials": self.figures.get("margin_trials"),
            "margin_converged": self.figures.get("margin_converged"),
            **{key: self.figures.get(key) for key in _ROW},
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
    unread: list[Run] = []
    for folder in folders:
        check_folder(folder)
        for place in assessments_below(folder, lambda path, why: unread.append(Run(path, {}, why))):
            found.setdefault(real_path(place), read_run(place))
    found.update((one.folder, one) for one in unread)
    return list(found.values())


def unfinished_below(folders: Sequence[Path]) -> list[Path]:
    """Return the folders under some whose assessment was interrupted, or is running."""
    found = {str(path).removesuffix(UNFINISHED) for one in folders for path in one.rglob(f"*{UNFINISHED}")}
    return sorted(map(Path, found))


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


def trends_of(results: Sequence[StoredResult], figure: str) -> tuple[list[dict[str, Any]], list[str]]:
    """Return how each car has changed in each scenario, as JSON has it, and what to know of each result, a line each.

    Each result is compared with the one before. All verdicts of a car together are to be right with 95 %: each has
    Bonferroni's share. Verdicts go by margin and risk, whichever figure is followed.

    Args:
        results: in any order.
        figure: key of the figure that is followed.
    """
    groups: dict[tuple[str, str], list[tuple[Run, StoredResult]]] = {}
    runs = [(Run(one.folder, one.figures), one) for one in results]
    for run, one in sorted(runs, key=lambda pair: (pair[0].date, str(pair[0].folder))):
        groups.setdefault((run.car, run.scenario), []).append((run, one))
    found, lines = [], []
    for (car, scenario), mine in sorted(groups.items()):
        confidence = 1.0 - 0.05 / max(1, len(mine) - 1)
        later = [compare(one, other, confidence) for (_, one), (_, other) in itertools.pairwise(mine)]
        rows = [_trend_row(*pair, figure, change) for pair, change in zip(mine, [None, *later], strict=True)]
        found.append({"car": car, "scenario": scenario, "figure": figure, "confidence": confidence, "runs": rows})
        lines += [_first_of(row["lines"]) for row in rows if row["lines"] and later]
    return found, lines


def _first_of(lines: Sequence[str]) -> str:
    """Return what matters most, and how much more there is."""
    first = min(lines, key=lambda line: NOT_CREDIBLE not in line)
    return f"{first} ({len(lines) - 1} more: --json)" if len(lines) > 1 else first


def _trend_row(run: Run, result: StoredResult, figure: str, compared: Comparison | None) -> dict[str, Any]:
    change = None if compared is None else compared.differences.get(figure)
    verdict = "" if compared is None else compared.verdict if change else NOT_COMPARED
    return {
        "folder": str(run.folder),
        "date": run.date,
        "revision": run.revision,
        "value": run.figures.get(figure),
        "ci95": run.figures.get(f"{figure}_ci95"),
        "margin_converged": run.figures.get("margin_converged"),
        "verdict": verdict,
        "credible": not run.not_credible,
        "difference": None if change is None else change.value,
        "difference_interval": None if change is None else change.interval,
        "lines": [*result.remarks, *([] if compared is None else compared.lines())],
    }


_number = TERMINAL.number


def runs_table(runs: Sequence[Run]) -> Table:
    """Return the table of assessments that could be read, a row each; those with a remark are marked.

    A scenario that all have stands in its title.
    """
    parent = _common_parent([run.folder for run in runs])
    title = f"Assessments in {escape(str(parent))}, as they are written"
    several = len({run.scenario for run in runs}) > 1
    rows = [
        (
            f"{escape(os.path.relpath(run.folder, parent))}{'[red]*[/]' if run.remark or run.warnings else ''}",
            escape(run.car),
            *([escape(run.scenario)] * several),
            bounded_cell(run.figures, _number(run.figures["margin"])),
            _number(run.figures["margin_ci95"], 2),
            TERMINAL.share(run.figures["nominal_collision_rate"]),
            str(len(run.figures["per_safe_trajectory"])),
            _minute(run.date),
        )
        for run in runs
    ]
    heads = ("margin\n(m)", "95 %,\nby φ", "nominal\ncoll.", "φ", "date\n(UTC)")
    title += "" if several else f"; scenario {escape(runs[0].scenario)}"
    return narrow_table(title, ("folder", "car", *(["scenario"] * several), *heads), rows, whole=True)


def _common_parent(folders: Sequence[Path]) -> Path:
    """Return the folder that holds those of all assessments: what is left of their names tells them apart."""
    parents = [one.parent for one in folders]
    if len({parent.is_absolute() for parent in parents}) > 1:
        parents = [parent.absolute() for parent in parents]
    return Path(os.path.commonpath(parents) or ".")


def _minute(date: str) -> str:
    return date[:16].replace("T", " ")


def trend_table(trend: Mapping[str, Any]) -> Table:
    """Return the table of how a car has changed, one of `trends_of`, the earliest result first."""
    figure = AT_THE_TOP[trend["figure"]]
    parent = _common_parent([Path(row["folder"]) for row in trend["runs"]])
    by = ",\nby φ" if figure.by_phi else ""
    heads = ["date\n(UTC)", "code of\nthe car", figure.heading.replace(" (", "\n("), f"95 %{by}"]
    heads += ["against the\none before", "difference", f"{100.0 * trend['confidence']:.3g} %{by}", "folder"]
    scale, rows = figure.kind.scale, []
    for row in trend["runs"]:
        value, change = row["value"], row["difference"]
        interval, around = (one and [scale * end for end in one] for one in (row["ci95"], row["difference_interval"]))
        said = _number(None if value is None else scale * value)
        cells = [_minute(row["date"]), row["revision"] or "unknown"]
        cells += [bounded_cell(row if figure.key == "margin" else {}, said), _number(interval, 2)]
        cells.append(f"[bold]{row['verdict']}[/]{'' if row['credible'] else '[red] not credible[/]'}")
        cells += ["", ""] if change is None else [f"{scale * change:+.3f}", _number(around)]
        rows.append([*cells, escape(os.path.relpath(row["folder"], parent))])
    title = f"{escape(trend['car'])} in {escape(trend['scenario'])}: {figure.label}; in {escape(str(parent))}"
    return narrow_table(title, heads, rows)
