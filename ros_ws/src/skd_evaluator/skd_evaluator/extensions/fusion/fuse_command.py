"""`skd fuse`: what the physical car does, from few physical trials and many simulated ones."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.table import Table
from skd_sim.errors import UsageError
from skd_sim.inputs.files import one_line

from skd_evaluator.assessment.files.result_folder import write_json
from skd_evaluator.cli.arguments import result_folder
from skd_evaluator.cli.output import print_json
from skd_evaluator.extensions.fusion import planning_command
from skd_evaluator.extensions.fusion.estimate import Mean
from skd_evaluator.extensions.fusion.fusion import FusedFigure, fuse
from skd_evaluator.extensions.fusion.track import RecordingFrame
from skd_evaluator.extensions.fusion.trial import GAP_TOLERANCE
from skd_evaluator.extensions.fusion.trial_sources import (
    Simulated,
    TrialRecorder,
    by_phi,
    overruled,
    read_simulated,
    read_trials,
    table_in,
)
from skd_evaluator.report.terminal import counted, narrow_table, print_table

RESULT, PICTURE = "fusion.json", "fusion.png"
_SMALL = 0.05  # p-value of a trend that is said


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    if (arguments.physical is None) == (arguments.width is None):
        raise UsageError("give PHYSICAL, the table of trials, or --width, to plan how many there are to be")
    if arguments.width is not None:
        return planning_command.run(arguments)
    out = result_folder(arguments)
    simulated = _simulated(arguments.simulated)
    table = table_in(arguments.physical)
    recorder = recorder_of(simulated, arguments, arguments.gap_tolerance)
    trials = read_trials(table, None if recorder is None else recorder.measured)
    fusion = fuse(trials, simulated.trials, looks=arguments.looks, tolerance=arguments.gap_tolerance)
    figures, warnings = fusion.figures, [*simulated.remarks, *overruled(trials), *fusion.left_out]
    content = {
        "simulated": simulated.source,
        "physical": str(table),
        "looks": arguments.looks,
        "figures": {one.figure.key: one.as_dict() for one in figures},
        "sentences": [sentence(one) for one in figures],
        "warnings": warnings,
    }

    def write(folder: Path) -> None:
        from skd_evaluator.extensions.fusion.picture import save_fusion  # slow to import, and needed only now

        write_json(folder / RESULT, content)
        save_fusion(folder / PICTURE, figures)

    problem = out.save(write)
    if arguments.json:
        print_json(content)
    else:
        print_table(fusion_table(figures))
        for one in figures:
            print(sentence(one))
            for line in gap_lines(one):
                print(f"  {line}")
        if not problem:
            print(f"results in {out.path}")
    notes = [f"{one.figure.text}: {note}" for one in figures for note in one.notes]
    for line in dict.fromkeys([*warnings, *notes]):
        print(f"skd fuse: warning: {line}", file=sys.stderr)
    if problem:
        print(f"skd fuse: {problem}", file=sys.stderr)
    return 1 if problem else 0


def _simulated(path: Path) -> Simulated:
    if path.is_dir():
        return read_simulated(path)
    return Simulated(str(path), by_phi(read_trials(table_in(path))))


def recorder_of(
    simulated: Simulated, arguments: argparse.Namespace, gap_tolerance: float = GAP_TOLERANCE
) -> TrialRecorder | None:
    """Return what reads recordings of trials on simulated φ; None where road and shapes are not known."""
    if simulated.scenario is None or simulated.safe is None:
        return None
    return TrialRecorder(
        simulated.scenario,
        simulated.safe,
        arguments.car,
        arguments.road_user,
        _frame(arguments.frame),
        arguments.reference,
        arguments.path_tolerance,
        gap_tolerance,
    )


def _frame(given: tuple[float, float, float] | None) -> RecordingFrame:
    x, y, degrees = given or (0.0, 0.0, 0.0)
    return RecordingFrame(x, y, math.radians(degrees))


def fusion_table(figures: Sequence[FusedFigure]) -> Table:
    """Return the table of all figures."""
    table = narrow_table("The physical car; what stands is bold")
    for name in ("", "physical\nalone", "with the\nsimulator", "ρ", "predicts\n(p)", "trials\nsaved", "gap"):
        table.add_column(name, justify="right" if name else "left")
    for one in figures:
        both = "—" if one.with_simulator is None else said(one, one.with_simulator)
        single = said(one, one.alone)
        table.add_row(
            f"{one.figure.text} ({one.figure.unit})" if one.figure.unit else one.figure.text,
            single if one.predicts else f"[bold]{single}[/]",
            f"[bold]{both}[/]" if one.predicts else both,
            "—" if one.line.correlation is None else f"{one.line.correlation:.2f}",
            "—" if one.with_simulator is None else f"{'yes' if one.predicts else 'no'} ({one.line.p_value:.2g})",
            str(one.saved),
            f"{one.gap.mean:+.2f}",
        )
    return table


def said(one: FusedFigure, mean: Mean) -> str:
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
