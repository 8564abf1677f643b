"""How a figure of a car has changed from assessment to assessment, each held against the one before.

All verdicts of a car together are to be right with 95 %: each has Bonferroni's share.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

from skd_evaluator.assessment.judge.figure_table import AT_THE_TOP
from skd_evaluator.metrics.statistics.statistics import Interval
from skd_evaluator.report.history.runs import Run

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
