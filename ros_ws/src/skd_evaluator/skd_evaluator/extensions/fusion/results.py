"""What `skd fuse` does and prints: the physical car, how many trials it takes, the calibrated simulator."""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from skd_sim.errors import UsageError
from skd_sim.inputs.files import one_line
from skd_sim.inputs.yaml_file import to_yaml
from skd_sim.options.car_and_adversary import CarUnderTest

from skd_evaluator.assessment.files.result_folder import write_json
from skd_evaluator.assessment.run.workers import available_workers, check_controller
from skd_evaluator.bags.tracks import RecordingFrame
from skd_evaluator.cli.arguments import result_folder
from skd_evaluator.cli.output import finish
from skd_evaluator.extensions.fusion import calibration
from skd_evaluator.extensions.fusion.estimate import Mean, trials_for_width
from skd_evaluator.extensions.fusion.fusion import RESULT, FusedFigure, fuse, planning_basis
from skd_evaluator.extensions.fusion.recordings import TrialRecorder, overruled, track_of
from skd_evaluator.extensions.fusion.trials import (
    FIGURES,
    PhysicalTrial,
    Simulated,
    read_simulated,
    read_trials,
    table_in,
)
from skd_evaluator.report.formats import counted
from skd_evaluator.report.terminal import narrow_table, print_table


def _recorder(simulated: Simulated, arguments: argparse.Namespace) -> TrialRecorder | None:
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
        arguments.gap_tolerance,
    )


# --- the physical car


def rate_car(arguments: argparse.Namespace) -> int:
    """Say what the physical car does; return the exit code."""
    out = result_folder(arguments)
    simulated, table = read_simulated(arguments.simulated), table_in(arguments.physical)
    recorder = _recorder(simulated, arguments)
    trials = read_trials(table, None if recorder is None else recorder.measured)
    figures, left_out = fuse(trials, simulated.trials, looks=arguments.looks, tolerance=arguments.gap_tolerance)
    damage = [] if recorder is None else recorder.damage.lines
    warnings = [*simulated.remarks, *overruled(trials), *left_out, *damage]
    content = {
        "simulated": simulated.source,
        "physical": str(table),
        "looks": arguments.looks,
        "figures": {one.figure.key: one.as_dict() for one in figures},
        "sentences": [_sentence(one) for one in figures],
        "warnings": warnings,
    }
    problem = out.save(lambda folder: write_json(folder / RESULT, content))

    def show() -> None:
        heads = ("", "physical\nalone", "with the\nsimulator", "ρ", "predicts\n(p)", "trials\nsaved", "gap")
        print_table(narrow_table("The physical car; what stands is bold", heads, list(map(_row, figures))))
        for one in figures:
            print("\n  ".join([_sentence(one), *_gap_lines(one)]))

    warnings = [*warnings, *(f"{one.figure.text}: {note}" for one in figures for note in one.notes)]
    return finish(arguments, content, show, warnings, saved=(problem, f"results in {out.path}"))


def _row(one: FusedFigure) -> list[str]:
    """Return the row of a figure in the table of all."""

    def text(mean: Mean) -> str:
        low, high = mean.interval
        if one.figure.is_rate:
            said = f"{100 * mean.value:.0f} % [{100 * low:.0f}, {100 * high:.0f}]"
        else:
            said = f"{mean.value:.2f} [{low:.2f}, {high:.2f}]"
        return f"[bold]{said}[/]" if mean is one.stands else said

    both, says = "—", "—"
    if one.with_simulator is not None:
        both, says = text(one.with_simulator), f"{'yes' if one.predicts else 'no'} ({one.line.p_value:.2g})"
    rho = "—" if one.line.correlation is None else f"{one.line.correlation:.2f}"
    return [one.figure.label, text(one.alone), both, rho, says, str(one.saved), f"{one.gap.mean:+.2f}"]


def _sentence(one: FusedFigure) -> str:
    """Return what may be said of the physical car, with what it rests on."""
    pairs, value, (low, high), unit = one.pairs, one.stands.value, one.stands.interval, one.figure.unit
    name, figure = f"mean {one.figure.text}", f"{value:.2f} {unit}"
    interval = f"{low:.2f} to {high:.2f} {unit}"
    if one.figure.is_rate:
        name, figure, interval = one.figure.text, f"{100 * value:.0f} %", f"{100 * low:.0f} to {100 * high:.0f} %"
    trials = f"{counted(pairs.trials.size, 'physical trial')} on {pairs.phi} φ"
    begin = f"Over all φ the {name} of the physical car is {figure}, with a 95 % interval from {interval}; by {trials}"
    if not one.predicts:
        return f"{begin} alone, for {one.why_alone}."
    saved = f"The simulator predicts it, and saved {counted(one.saved, 'physical trial')}."
    return f"{begin} and simulations of {pairs.population.size} φ. {saved}"


def _gap_lines(one: FusedFigure) -> Iterator[str]:
    """Yield what is to be said of the gap between simulated and physical."""
    gap, unit = one.gap, f" {one.figure.unit}".rstrip()
    span = "" if gap.interval is None else f" [{gap.interval[0]:+.2f}, {gap.interval[1]:+.2f}]"
    yield f"physical less simulated: {gap.mean:+.2f}{unit}{span} on average of {one.pairs.phi} φ"
    worst = int(abs(gap.by_phi).argmax())
    yield f"largest on {one_line(one.pairs.names[worst])}: {gap.by_phi[worst]:+.2f}{unit}"
    trends = (("with the simulated figure", gap.by_simulated), ("from trial to trial", gap.by_order))
    for what, trend in () if one.figure.is_rate else trends:  # a single hit has a trend
        if trend is not None and trend.p_value < 0.05:
            low, high = trend.interval
            yield f"the gap changes {what}: slope {trend.slope:+.3g} [{low:+.3g}, {high:+.3g}]"


# --- how many trials it takes


def plan_trials(arguments: argparse.Namespace) -> int:
    """Say how many trials a width takes, alone and with the simulator; return the exit code."""
    figure, width = FIGURES[arguments.figure], arguments.width
    basis = planning_basis(arguments.simulated, figure)
    known = basis.correlation if arguments.correlation is None else arguments.correlation
    alone = trials_for_width(width, basis.deviation)
    shown = sorted({0.5, 0.7, 0.8, 0.9, 0.95, *(() if known is None else (known,))})
    rows = [(one, trials_for_width(width, basis.deviation, one, basis.simulated_phi)) for one in shown]
    content = {
        "figure": figure.key,
        "width": width,
        "deviation": basis.deviation,
        "correlation": known,
        "simulated_phi": basis.simulated_phi,
        "source": basis.source,
        "physical_alone": alone,
        "with_simulator": [{"correlation": one, "trials": trials} for one, trials in rows],
    }

    def show() -> None:
        unit = f" {figure.unit}".rstrip()
        print(f"{figure.text}: standard deviation {basis.deviation:.3f}{unit} from φ to φ; {basis.source}")
        cells = [("physical trials alone", str(alone or "never"))]
        for one, trials in rows:
            row = f"with the simulator, where ρ = {one:.2f}", str(trials or "never")
            cells.append((f"[bold]{row[0]}[/]", f"[bold]{row[1]}[/]") if one == known else row)
        title = f"Physical trials, one on each φ, until the 95 % interval is {width:g}{unit} wide"
        print_table(narrow_table(title, ("", "trials"), cells))
        if known is None:
            print("how well the simulator predicts is known when at least 5 trials are fused: skd fuse")

    return finish(arguments, content, show, basis.warnings)


# --- calibration


def calibrate(arguments: argparse.Namespace) -> int:
    """Estimate the simulator's parameters by the trials; return the exit code."""
    begin, folder, out = time.perf_counter(), arguments.simulated, result_folder(arguments)
    simulated = read_simulated(folder)
    recorder = _recorder(simulated, arguments)
    if simulated.scenario is None or recorder is None:
        raise UsageError(f"{folder}: must be the folder of an assessment")
    stated = simulated.figures["multiplier"]  # which only a car that has one states
    car = CarUnderTest(
        str(simulated.figures["controller"]), CarUnderTest.multiplier if stated is None else float(stated)
    )
    if car.is_external:
        raise UsageError(f"{folder}: its car ran as a node, and cannot drive the trials again in process")
    world = replace(simulated.scenario, control_period=check_controller(car, simulated.scenario).control_period)
    trials = _recorded(recorder, table_in(arguments.physical))
    workers = arguments.workers or available_workers()
    found = calibration.calibration_of(world, car, trials, arguments.parameters, workers)
    best = replace(calibration.calibrated(world, found.values), name=f"{world.name}_calibrated")
    content = {
        "simulated": simulated.source,
        "physical": str(arguments.physical),
        "trials": len(trials),
        "phi": len({one.phi for one in trials}),
        **found.as_dict(),
        "sentences": list(found.sentences),
        "warnings": [*simulated.remarks, *found.warnings, *recorder.damage.lines],
    }

    def write(where: Path) -> None:
        (where / calibration.SCENARIO).write_text(to_yaml(best.as_dict()), encoding="utf-8")
        write_json(where / calibration.RESULT, content)

    def show() -> None:
        start, rows = calibration.calibrated(world, {}), []
        for one in found.estimates:
            estimate = "—", one.reason or ""
            if one.interval is not None:
                estimate = f"{one.value:.3g}", f"[{one.interval[0]:.3g}, {one.interval[1]:.3g}]"
            rows.append((one.parameter.label, f"{one.parameter.of(start):.3g}", *estimate))
        heads = ("", "scenario", "estimate", "95 %\ninterval")
        print_table(narrow_table("The simulator by the physical trials", heads, rows))
        print(*found.sentences, sep="\n")

    saved = out.save(write), f"the calibrated scenario is {out.path / calibration.SCENARIO}"
    return finish(arguments, content, show, content["warnings"], saved=saved, since=begin)


def _recorded(recorder: TrialRecorder, table: Path) -> list[calibration.Recorded]:
    """Return the trials of a table, each at the simulator's times."""
    found: list[calibration.Recorded] = []

    def keep(path: Path, trial: PhysicalTrial) -> PhysicalTrial:
        scene = recorder.laid(path, trial)
        found.append(calibration.recorded(recorder.scenario, scene, trial.phi, trial.where))
        return replace(trial, track=track_of(scene))

    if len(read_trials(table, keep)) > len(found):
        raise UsageError(f"{table}: a trial without a recording says nothing of how the car went: give each a file")
    return found
