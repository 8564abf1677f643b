"""Assessments under a folder, and how a figure of a car has changed from one to the next.

All verdicts of a car together are to be right with 95 %: each has Bonferroni's share.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

from rich.markup import escape
from rich.table import Table
from skd_sim.errors import UsageError
from skd_sim.inputs.files import folders_in, read_json, real_path

from skd_evaluator.assessment.figure_table import AT_THE_TOP, Kind
from skd_evaluator.assessment.files.assessment_json import ASSESSMENT, understood
from skd_evaluator.assessment.files.result_folder import check_unchanged
from skd_evaluator.files import PREFIX
from skd_evaluator.metrics.aborted import in_one_line, not_credible
from skd_evaluator.metrics.margins import open_search
from skd_evaluator.metrics.statistics import Interval
from skd_evaluator.provenance import code_of_car
from skd_evaluator.report.formats import TERMINAL
from skd_evaluator.report.terminal import bounded_cell, car_name, narrow_table

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


FIGURES = ("margin", "deviation", "skd", "nominal_collision_rate", "risk_1")
"""Figures that can be followed."""


class Compared(Protocol):
    """What is said of a result beside another one, as `skd_evaluator.assessment.compare` has it."""

    @property
    def differences(self) -> Mapping[str, Any]:
        """Second less first, by figure."""

    def verdict_beside(self, figure: str) -> str:
        """Return what is said of the second car beside a figure."""

    def lines(self) -> list[str]:
        """Return everything that has to be said beside the verdict, a line each."""


@dataclass(frozen=True)
class Step:
    """An assessment among those of its car.

    Attributes:
        run: the assessment.
        value: the figure; None where it is not known.
        interval: its 95 % interval, by φ; None where there is none.
        verdict: what is said of the car beside the assessment before; empty for the first. It goes by margin and risk,
            whichever figure is followed, and is *not compared* where that figure is not.
        difference: of the figure from the one before; None where it is not compared.
        difference_interval: interval of the difference.
        lines: what has to be said beside the verdict, a line each.
    """

    run: Run
    value: float | None
    interval: Interval | None
    verdict: str = ""
    difference: float | None = None
    difference_interval: Interval | None = None
    lines: tuple[str, ...] = ()


@dataclass(frozen=True)
class Trend:
    """How a car has changed in a scenario.

    Attributes:
        car: name of the car.
        scenario: name of the scenario.
        figure: key of the figure.
        steps: the assessments, the earliest first.
        confidence: of each verdict.
    """

    car: str
    scenario: str
    figure: str
    steps: tuple[Step, ...]
    confidence: float

    @property
    def label(self) -> str:
        """What the figure is called."""
        return AT_THE_TOP[self.figure].label

    def as_dict(self) -> dict[str, Any]:
        """Return the entry of trend.json."""
        return {
            "car": self.car,
            "scenario": self.scenario,
            "figure": self.figure,
            "confidence": self.confidence,
            "runs": [
                {
                    "folder": str(step.run.folder),
                    "date": step.run.date,
                    "revision": step.run.revision,
                    "value": step.value,
                    "ci95": step.interval,
                    "verdict": step.verdict,
                    "credible": not step.run.not_credible,
                    "difference": step.difference,
                    "difference_interval": step.difference_interval,
                    "lines": list(step.lines),
                }
                for step in self.steps
            ],
        }


def trends_of(
    runs: Sequence[Run], figure: str, compare: Callable[[Run, Run, float], Compared | None] | None = None
) -> list[Trend]:
    """Return a trend for each car and scenario, in the order of their names.

    Args:
        runs: the assessments, in any order.
        figure: key of the figure that is followed.
        compare: compares the second with the first, with a confidence; None: nothing is compared.
    """
    groups: dict[tuple[str, str], list[Run]] = {}
    for run in sorted(runs, key=lambda one: (one.date, str(one.folder))):
        groups.setdefault((run.car, run.scenario), []).append(run)
    found = []
    for (car, scenario), mine in sorted(groups.items()):
        confidence = 1.0 - 0.05 / max(1, len(mine) - 1)
        steps = [_step(mine[0], figure)]
        for before, run in itertools.pairwise(mine):
            steps.append(_step(run, figure, None if compare is None else compare(before, run, confidence)))
        found.append(Trend(car, scenario, figure, tuple(steps), confidence))
    return found


def _step(run: Run, figure: str, compared: Compared | None = None) -> Step:
    step = Step(run, run.figures.get(figure), run.figures.get(f"{figure}_ci95"))
    if compared is None:
        return step
    step = replace(step, verdict=compared.verdict_beside(figure), lines=tuple(compared.lines()))
    change = compared.differences.get(figure)
    return step if change is None else replace(step, difference=change.value, difference_interval=change.interval)


_UNKNOWN = "unknown"
"""Commit of code that is in no checkout."""
_number, _interval = TERMINAL.number, TERMINAL.interval


def runs_table(runs: Sequence[Run]) -> Table:
    """Return the table of assessments that could be read, a row each; those with a remark are marked."""
    parent = common_parent(runs)
    table = narrow_table(f"Assessments in {escape(str(parent))}, as they are written")
    table.add_column("folder", overflow="fold")
    table.add_column("car", overflow="fold")
    table.add_column("scenario", overflow="fold")
    for name in ("margin\n(m)", "95 %,\nby φ", "nominal\ncollisions", "φ"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("code of\nthe car", no_wrap=True)
    table.add_column("date\n(UTC)")
    for run in runs:
        table.add_row(
            f"{escape(os.path.relpath(run.folder, parent))}{'[red]*[/]' if run.remark or run.warnings else ''}",
            escape(run.car),
            escape(run.scenario),
            bounded_cell(run.figures, _number(run.figures["margin"])),
            _interval(run.figures["margin_ci95"], 2),
            TERMINAL.share(run.figures["nominal_collision_rate"]),
            str(len(run.figures["per_safe_trajectory"])),
            run.revision or _UNKNOWN,
            day(run.date),
        )
    return table


def common_parent(runs: Sequence[Run]) -> Path:
    """Return the folder that holds those of all assessments: what is left of their names tells them apart."""
    parents = [run.folder.parent for run in runs]
    if len({parent.is_absolute() for parent in parents}) > 1:
        parents = [parent.absolute() for parent in parents]
    return Path(os.path.commonpath(parents) or ".")


def scaled(interval: Sequence[float] | None, scale: float) -> list[float] | None:
    """Return an interval in the unit in which it is shown."""
    return None if interval is None else [scale * end for end in interval]


def day(date: str) -> str:
    """Return a date to the minute, as a table has it."""
    return date[:16].replace("T", " ")


def trend_table(trend: Trend, kind: Kind) -> Table:
    """Return the table of how a car has changed, the earliest result first."""
    together = f"{100.0 * trend.confidence:.3g} %"
    unit, scale = kind.unit, kind.scale
    parent = common_parent([step.run for step in trend.steps])
    table = narrow_table(f"{escape(trend.car)} in {escape(trend.scenario)}: {trend.label}; in {escape(str(parent))}")
    table.add_column("date\n(UTC)")
    table.add_column("code of\nthe car", no_wrap=True)
    table.add_column(f"{trend.label}\n({unit})" if unit else trend.label, justify="right")
    table.add_column("95 %,\nby φ", justify="right", no_wrap=True)
    table.add_column("beside the\none before")
    for name in ("by so\nmuch", f"{together},\nby φ"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("folder", overflow="fold")
    for step in trend.steps:
        change = ("", "")
        if step.difference is not None:
            change = f"{scale * step.difference:+.3f}", _interval(scaled(step.difference_interval, scale))
        table.add_row(
            day(step.run.date),
            step.run.revision or _UNKNOWN,
            bounded_cell(
                step.run.figures if trend.figure == "margin" else {},
                _number(None if step.value is None else scale * step.value),
            ),
            _interval(scaled(step.interval, scale), 2),
            f"[bold]{step.verdict}[/]{'[red] not credible[/]' if step.run.not_credible else ''}",
            *change,
            escape(os.path.relpath(step.run.folder, parent)),
        )
    return table
