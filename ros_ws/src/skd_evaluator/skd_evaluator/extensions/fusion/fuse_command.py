"""`skd fuse`: what the physical car does, from few physical and many simulated trials; or how many trials it takes."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from rich.table import Table
from skd_sim.errors import UsageError
from skd_sim.inputs.files import one_line, read_json
from skd_sim.inputs.model import YesNo, limits, read_model

from skd_evaluator.assessment.files.result_folder import write_json
from skd_evaluator.bags.tracks import RecordingFrame
from skd_evaluator.cli.arguments import result_folder
from skd_evaluator.cli.output import finish
from skd_evaluator.extensions.fusion.estimate import LEAST_PAIRS, Mean, trials_for_width
from skd_evaluator.extensions.fusion.fusion import FusedFigure, fuse
from skd_evaluator.extensions.fusion.recordings import TrialRecorder, overruled
from skd_evaluator.extensions.fusion.trials import (
    FIGURES,
    GAP_TOLERANCE,
    Simulated,
    read_simulated,
    read_trials,
    table_in,
)
from skd_evaluator.report.formats import counted
from skd_evaluator.report.terminal import narrow_table, print_table

RESULT = "fusion.json"
CORRELATIONS = (0.5, 0.7, 0.8, 0.9, 0.95)
_SMALL = 0.05  # p-value of a trend that is shown


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    if (arguments.physical is None) == (arguments.width is None):
        raise UsageError("give PHYSICAL, the table of trials, or --width, to plan how many there are to be")
    if arguments.width is not None:
        return _plan(arguments)
    out = result_folder(arguments)
    simulated = read_simulated(arguments.simulated)
    table = table_in(arguments.physical)
    recorder = recorder_of(simulated, arguments, arguments.gap_tolerance)
    trials = read_trials(table, None if recorder is None else recorder.measured)
    fusion = fuse(trials, simulated.trials, looks=arguments.looks, tolerance=arguments.gap_tolerance)
    figures, warnings = fusion.figures, [*simulated.remarks, *overruled(trials), *fusion.left_out]
    warnings += [] if recorder is None else recorder.damage.lines
    content = {
        "simulated": simulated.source,
        "physical": str(table),
        "looks": arguments.looks,
        "figures": {one.figure.key: one.as_dict() for one in figures},
        "sentences": [sentence(one) for one in figures],
        "warnings": warnings,
    }
    problem = out.save(lambda folder: write_json(folder / RESULT, content))

    def show() -> None:
        print_table(fusion_table(figures))
        for one in figures:
            print("\n  ".join([sentence(one), *gap_lines(one)]))
        if not problem:
            print(f"results in {out.path}")

    notes = [f"{one.figure.text}: {note}" for one in figures for note in one.notes]
    return finish(arguments, content, show, [*warnings, *notes], [problem])


@dataclass(frozen=True)
class _FusedBefore:
    """What planning reads of a figure in fusion.json."""

    deviation: Annotated[float, limits(0.0, 100.0, "in its unit")]
    simulated_phi: Annotated[int, limits(LEAST_PAIRS, 1e9, "φ")]
    trials: Annotated[int, limits(LEAST_PAIRS, 1e9, "trials")]
    predicts: YesNo
    correlation: Annotated[float, limits(-1.0, 1.0, "no unit")] = 0.0


def _plan(arguments: argparse.Namespace) -> int:
    """Say how many trials a width takes, alone and with the simulator; return the exit code."""
    figure, width = FIGURES[arguments.figure], arguments.width
    deviation, known, simulated, source, warnings = _planned_with(arguments.simulated, figure.key)
    if not deviation > 0.0:
        raise UsageError(f"{arguments.simulated}: {figure.text} is the same on every φ, so nothing can be planned")
    known = known if arguments.correlation is None else arguments.correlation
    shown = sorted({*CORRELATIONS, *(() if known is None else (known,))})
    alone = trials_for_width(width, deviation)
    rows = [(one, trials_for_width(width, deviation, one, simulated)) for one in shown]
    content = {
        "figure": figure.key,
        "width": width,
        "deviation": deviation,
        "correlation": known,
        "simulated_phi": simulated,
        "source": source,
        "physical_alone": alone,
        "with_simulator": [{"correlation": one, "trials": trials} for one, trials in rows],
    }

    def show() -> None:
        unit = f" {figure.unit}" if figure.unit else ""
        print(f"{figure.text}: standard deviation {deviation:.3f}{unit} from φ to φ; {source}")
        cells = [("physical trials alone", str(alone or "never"))]
        for one, trials in rows:
            row = f"with the simulator, where ρ = {one:.2f}", str(trials or "never")
            cells.append((f"[bold]{row[0]}[/]", f"[bold]{row[1]}[/]") if one == known else row)
        title = f"Physical trials, one on each φ, until the 95 % interval is {width:g}{unit} wide"
        print_table(narrow_table(title, ("", "trials"), cells))
        if known is None:
            print("how well the simulator predicts is known when at least 5 trials are fused: skd fuse")

    return finish(arguments, content, show, warnings)


def _planned_with(folder: Path, key: str) -> tuple[float, float | None, int, str, list[str]]:
    """Return deviation from φ to φ, correlation, number of simulated φ, where these are from, and warnings."""
    path = folder / RESULT
    if not path.exists():
        simulated = read_simulated(folder)
        every = ([one.values[key] for one in trials if key in one.values] for trials in simulated.trials.values())
        means = [float(np.mean(values)) for values in every if values]
        if len(means) < 2:
            raise UsageError(f"{folder}: has no {key} of two φ")
        source = f"as simulated in {folder}: the physical car may vary more"
        return float(np.std(means, ddof=1)), None, len(means), source, list(simulated.remarks)
    content: Any = read_json(path)
    try:
        entry = {name: content["figures"][key][name] for name in _FusedBefore.__annotations__}
        warnings = [one_line(str(line)) for line in content["warnings"]]
    except (KeyError, TypeError) as error:
        raise UsageError(f"{path}: has no {key} of skd fuse") from error
    found = read_model(
        _FusedBefore, {name: one for name, one in entry.items() if one is not None}, str(path), f"figures.{key}"
    )
    correlation = found.correlation if found.predicts else None
    source = f"by {counted(found.trials, 'physical trial')} in {folder}"
    return found.deviation, correlation, found.simulated_phi, source, warnings


def recorder_of(
    simulated: Simulated, arguments: argparse.Namespace, gap_tolerance: float = GAP_TOLERANCE
) -> TrialRecorder | None:
    """Return what reads recordings of trials on simulated φ; None where road and shapes are not known."""
    if simulated.scenario is None or simulated.safe is None:
        return None
    x, y, degrees = arguments.frame
    return TrialRecorder(
        simulated.scenario,
        simulated.safe,
        arguments.car,
        arguments.road_user,
        RecordingFrame(x, y, math.radians(degrees)),
        arguments.reference,
        arguments.path_tolerance,
        gap_tolerance,
    )


def fusion_table(figures: Sequence[FusedFigure]) -> Table:
    """Return the table of all figures."""
    rows = []
    for one in figures:
        both = "—" if one.with_simulator is None else mean_text(one, one.with_simulator)
        single = mean_text(one, one.alone)
        rows.append([
            f"{one.figure.text} ({one.figure.unit})" if one.figure.unit else one.figure.text,
            single if one.predicts else f"[bold]{single}[/]",
            f"[bold]{both}[/]" if one.predicts else both,
            "—" if one.line.correlation is None else f"{one.line.correlation:.2f}",
            "—" if one.with_simulator is None else f"{'yes' if one.predicts else 'no'} ({one.line.p_value:.2g})",
            str(one.saved),
            f"{one.gap.mean:+.2f}",
        ])  # fmt: skip
    heads = ("", "physical\nalone", "with the\nsimulator", "ρ", "predicts\n(p)", "trials\nsaved", "gap")
    return narrow_table("The physical car; what stands is bold", heads, rows)


def mean_text(one: FusedFigure, mean: Mean) -> str:
    """Return a mean with its interval."""
    low, high = mean.interval
    if one.figure.is_rate:
        return f"{100 * mean.value:.0f} % [{100 * low:.0f}, {100 * high:.0f}]"
    return f"{mean.value:.2f} [{low:.2f}, {high:.2f}]"


def sentence(one: FusedFigure) -> str:
    """Return what may be said of the physical car, with what it rests on."""
    pairs, (low, high) = one.pairs, one.stands.interval
    trials = f"{counted(pairs.trials.size, 'physical trial')} on {len(pairs.names)} φ"
    if one.figure.is_rate:
        figure = f"{100 * one.stands.value:.0f} %, with a 95 % interval from {100 * low:.0f} to {100 * high:.0f} %"
    else:
        unit = one.figure.unit
        figure = f"{one.stands.value:.2f} {unit}, with a 95 % interval from {low:.2f} to {high:.2f} {unit}"
    begin = f"Over all φ the {mean_of(one)} of the physical car is {figure}; by {trials}"
    if not one.predicts:
        return f"{begin} alone, for {one.why_alone}."
    return (
        f"{begin} and simulations of {pairs.population.size} φ. The simulator predicts it, and saved "
        f"{counted(one.saved, 'physical trial')}."
    )


def mean_of(one: FusedFigure) -> str:
    """Return the name of a figure's mean."""
    return one.figure.text if one.figure.is_rate else f"mean {one.figure.text}"


def gap_lines(one: FusedFigure) -> list[str]:
    """Return what is to be said of the gap between simulated and physical."""
    gap, unit = one.gap, f" {one.figure.unit}" if one.figure.unit else ""
    span = "" if gap.interval is None else f" [{gap.interval[0]:+.2f}, {gap.interval[1]:+.2f}]"
    found = [f"physical less simulated: {gap.mean:+.2f}{unit}{span} on average of {len(one.pairs.names)} φ"]
    worst = int(abs(gap.by_phi).argmax())
    found.append(f"largest on {one_line(one.pairs.names[worst])}: {gap.by_phi[worst]:+.2f}{unit}")
    if one.figure.is_rate:
        return found  # a single hit has a trend
    trends = (("with the simulated figure", gap.by_simulated), ("from trial to trial", gap.by_order))
    for what, trend in trends:
        if trend is not None and trend.p_value < _SMALL:
            found.append(
                f"the gap changes {what}: slope {trend.slope:+.3g} [{trend.interval[0]:+.3g}, {trend.interval[1]:+.3g}]"
            )
    return found
