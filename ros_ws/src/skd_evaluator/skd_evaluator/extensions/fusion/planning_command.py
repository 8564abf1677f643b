"""`skd fuse --width`: how many trials on a proving ground a wanted width takes, alone and with the simulator."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from rich.table import Table
from skd_sim.errors import UsageError
from skd_sim.inputs.files import read_json
from skd_sim.inputs.model import YesNo, limits, read_model
from skd_sim.inputs.yaml_file import short

from skd_evaluator.assessment.files.result_folder import MANIFEST, check_unchanged
from skd_evaluator.cli.output import print_json
from skd_evaluator.extensions.fusion.estimate import LEAST_PAIRS, trials_for_width
from skd_evaluator.extensions.fusion.trial import FIGURES, TrialFigure
from skd_evaluator.extensions.fusion.trial_sources import read_simulated
from skd_evaluator.report.terminal import counted, narrow_table, print_table

FUSION = "fusion.json"
CORRELATIONS = (0.5, 0.7, 0.8, 0.9, 0.95)


@dataclass(frozen=True)
class _Source:
    """What is planned with: deviation of the figure from φ to φ, correlation, simulated φ; and where they are from.

    What is to be said of those stands in `warnings`, a line each.
    """

    deviation: float
    correlation: float | None
    simulated: int
    text: str
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class _Fused:
    """What is read of a figure in fusion.json."""

    deviation: Annotated[float, limits(0.0, 100.0, "in its unit")]
    simulated_phi: Annotated[int, limits(LEAST_PAIRS, 1e9, "φ")]
    trials: Annotated[int, limits(LEAST_PAIRS, 1e9, "trials")]
    predicts: YesNo
    correlation: Annotated[float, limits(-1.0, 1.0, "no unit")] = 0.0


def run(arguments: argparse.Namespace) -> int:
    """Run the command with --width; return its exit code."""
    figure, source = FIGURES[arguments.figure], _source(arguments)
    known = source.correlation if arguments.correlation is None else arguments.correlation
    alone = trials_for_width(arguments.width, source.deviation)
    rows = [(one, trials_for_width(arguments.width, source.deviation, one, source.simulated)) for one in _shown(known)]
    content: dict[str, Any] = {
        "figure": figure.key,
        "width": arguments.width,
        "deviation": source.deviation,
        "correlation": known,
        "simulated_phi": source.simulated,
        "source": source.text,
        "physical_alone": alone,
        "with_simulator": [{"correlation": one, "trials": trials} for one, trials in rows],
    }
    for line in source.warnings:
        print(f"skd fuse: warning: {line}", file=sys.stderr)
    if arguments.json:
        print_json(content)
        return 0
    unit = f" {figure.unit}" if figure.unit else ""
    print(f"{figure.text}: standard deviation {source.deviation:.3f}{unit} from φ to φ; {source.text}")
    table = narrow_table(f"Physical trials, one on each φ, until the 95 % interval is {arguments.width:g}{unit} wide")
    for name in ("", "trials"):
        table.add_column(name, justify="right" if name else "left")
    table.add_row("physical trials alone", _count(alone))
    for one, trials in rows:
        _add(table, one, trials, chosen=one == known)
    print_table(table)
    if known is None:
        print("how well the simulator predicts is known when at least 5 trials are fused: skd fuse")
    return 0


def _add(table: Table, correlation: float, trials: int | None, *, chosen: bool) -> None:
    name, count = f"with the simulator, where ρ = {correlation:.2f}", _count(trials)
    table.add_row(*(f"[bold]{cell}[/]" if chosen else cell for cell in (name, count)))


def _count(trials: int | None) -> str:
    return "never" if trials is None else str(trials)


def _shown(known: float | None) -> tuple[float, ...]:
    return tuple(sorted({*CORRELATIONS, *(() if known is None else (known,))}))


def _source(arguments: argparse.Namespace) -> _Source:
    path: Path = arguments.simulated
    key = arguments.figure
    if (path / FUSION).exists():
        return _fused_source(path, key)
    simulated = read_simulated(path)
    means = [np.mean([one.values[key] for one in trials if key in one.values]) for trials in simulated.trials.values()
             if any(key in one.values for one in trials)]  # fmt: skip
    if len(means) < 2:
        raise UsageError(f"{path}: has no {key} of two φ")
    text = f"as simulated in {path}: the physical car may vary more"
    deviation = _positive(float(np.std(means, ddof=1)), path, FIGURES[key])
    return _Source(deviation, None, len(means), text, simulated.remarks)


def _fused_source(folder: Path, key: str) -> _Source:
    """Return what skd fuse found, as far as it is what it wrote, and can be.

    Raises:
        UsageError: it was changed, or has an entry that cannot be there.
    """
    path = folder / FUSION
    written = check_unchanged(folder, (FUSION,))
    content = read_json(path)
    figures = content.get("figures") if isinstance(content, Mapping) else None
    if not isinstance(figures, Mapping) or not figures:
        raise UsageError(f"{path}: no result of skd fuse: it has no figures")
    if key not in figures:
        raise UsageError(f"{folder}: has no {key} but {', '.join(figures)}")
    one, names = figures[key], [field.name for field in fields(_Fused)]
    known = {name: one[name] for name in names if one.get(name) is not None} if isinstance(one, Mapping) else one
    found = read_model(_Fused, known, str(path), f"figures.{key}")
    if found.predicts and not found.correlation > 0.0:
        raise UsageError(
            f"{path}: figures.{key} says that the simulator predicts it, and its correlation is {found.correlation:g}; "
            "it must be above 0"
        )
    warnings = content.get("warnings", [])
    if not isinstance(warnings, list) or not all(isinstance(line, str) for line in warnings):
        raise UsageError(f"{path}: warnings must be a list of texts, got {short(warnings)}")
    # A text may hold several lines, of which the others could pass for SKD's own.
    lines = [" ".join(line.split()) for line in warnings]
    if not written:
        lines.append(f"{folder}: has no {MANIFEST}: nothing says that {FUSION} is what skd fuse wrote")
    return _Source(
        _positive(found.deviation, folder, FIGURES[key]),
        found.correlation if found.predicts else None,
        found.simulated_phi,
        f"by {counted(found.trials, 'physical trial')} in {folder}",
        tuple(lines),
    )


def _positive(deviation: float, path: Path, figure: TrialFigure) -> float:
    if not deviation > 0.0:
        raise UsageError(f"{path}: {figure.text} is the same on every φ, so nothing can be planned with it")
    return deviation
