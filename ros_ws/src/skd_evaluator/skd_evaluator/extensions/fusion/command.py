"""`skd fuse`: what the physical car does by few physical and many simulated trials; how many it takes; calibration."""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from skd_sim.errors import UsageError

from skd_evaluator.cli.arguments import Parser, frame_place, positive_number, real_number, result_folder
from skd_evaluator.cli.output import finish

if TYPE_CHECKING:
    from skd_evaluator.extensions.fusion.calibration import Recorded, SimulatorCalibration
    from skd_evaluator.extensions.fusion.estimate import Mean
    from skd_evaluator.extensions.fusion.fusion import FusedFigure
    from skd_evaluator.extensions.fusion.recordings import TrialRecorder
    from skd_evaluator.extensions.fusion.trials import Simulated

CALIBRATED = ("delay", "deceleration", "friction", "sensor_range")
"""Names of the simulator's parameters: see `calibration.PARAMETERS`."""
FUSED = ("clearance", "required_deceleration", "hit", "margin")
"""Names of the figures that are fused: see `trials.FIGURES`."""


def add_fuse(parser: Parser) -> None:
    """Few trials on a proving ground and many simulated ones: rate the physical car, calibrate the simulator.

    Estimate clearance, required deceleration, nominal collision rate and margin of the physical car over all safe
    trajectories φ. Where simulated trials predict physical ones of the same φ, simulations of further φ make the
    intervals narrower. Else the physical trials stand alone (docs/proving_ground.md).
    """
    parser.set_defaults(group="research", rare=True)
    text = "folder of an assessment, or a table of simulated trials. With --width also an earlier fusion"
    parser.add_value("simulated", text, type=Path, metavar="SIMULATED")
    text = "table of physical trials, or the folder of its trials.csv (docs/proving_ground.md has the columns)"
    parser.add_value("physical", text, type=Path, nargs="?", metavar="PHYSICAL")
    text = "how often you look at the results, at most: the intervals then hold at all looks together"
    parser.add_count("--looks", 1, 100, text, default=1)  # `metrics.statistics.sequential.MOST_LOOKS`
    planning = parser.add_argument_group("planning")
    text = "without PHYSICAL: say how many trials it takes until the 95 %% interval is so wide, in the figure's unit"
    planning.add_value("--width", text, type=positive_number, metavar="W")
    planning.add_value("--figure", "the figure that is planned for", choices=FUSED, default="margin")
    text = "how well the simulator is expected to predict from φ to φ (default: as an earlier fusion found)"
    planning.add_value("--correlation", text, type=real_number(0.0, 0.999), metavar="R")
    read = parser.add_argument_group("recordings")
    text = "the car in bags: topic, /tf:FRAME or TOPIC:ID, or its id in tables (default: /ego/odometry, car)"
    read.add_value("--car", text, metavar="NAME")
    text = "the road user, named as --car (default: /adversary/odometry, other)"
    read.add_value("--road-user", text, metavar="NAME")
    text = "origin (m) and direction of the scenario's frame map in that of the recordings (default: 0,0,0)"
    read.add_value("--frame", text, type=frame_place, default=(0.0, 0.0, 0.0), metavar="X,Y,DEGREES")
    text = "how far ahead of the car's reference point in the scenario its tracked point is, m"
    read.add_value("--reference", text, type=real_number(-20.0, 20.0), default=0.0, metavar="M")
    text = "how far the tracked road user may be off its φ; a trial beyond is refused"
    read.add_value("--path-tolerance", text, type=real_number(0.0, 5.0, above=True), default=0.5, metavar="M")
    text = "greatest difference of the car's start in a physical and a simulated trial of one timing"
    read.add_value("--gap-tolerance", text, type=real_number(0.0, 20.0, above=True), default=0.5, metavar="M")
    calibration = parser.add_argument_group("calibration")
    text = "estimate delay and deceleration of the brake, friction and sensor range of the simulator instead"
    calibration.add_flag("--calibrate", text)
    text = f"what may be calibrated: {', '.join(CALIBRATED)} (default: all of which the trials say something)"
    calibration.add_value("--parameters", text, nargs="+", choices=CALIBRATED, metavar="NAME")
    calibration.add_workers()
    parser.add_output()


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    if arguments.calibrate and arguments.physical is None:
        raise UsageError("--calibrate needs PHYSICAL, the table of physical trials")
    if (arguments.physical is None) == (arguments.width is None):
        raise UsageError("give PHYSICAL, the table of trials, or --width, to plan how many there are to be")
    work = _plan if arguments.width is not None else _calibrate if arguments.calibrate else _fuse
    return work(arguments)


def _recorder(simulated: Simulated, arguments: argparse.Namespace) -> TrialRecorder | None:
    """Return what reads recordings of trials on simulated φ; None where road and shapes are not known."""
    from skd_evaluator.bags.tracks import RecordingFrame
    from skd_evaluator.extensions.fusion.recordings import TrialRecorder

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


def _fuse(arguments: argparse.Namespace) -> int:
    from skd_evaluator.assessment.files.result_folder import write_json
    from skd_evaluator.extensions.fusion.fusion import RESULT, fuse
    from skd_evaluator.extensions.fusion.recordings import overruled
    from skd_evaluator.extensions.fusion.trials import read_simulated, read_trials, table_in
    from skd_evaluator.report.terminal import narrow_table, print_table

    out = result_folder(arguments)
    simulated, table = read_simulated(arguments.simulated), table_in(arguments.physical)
    recorder = _recorder(simulated, arguments)
    trials = read_trials(table, None if recorder is None else recorder.measured)
    fusion = fuse(trials, simulated.trials, looks=arguments.looks, tolerance=arguments.gap_tolerance)
    figures, warnings = fusion.figures, [*simulated.remarks, *overruled(trials), *fusion.left_out]
    warnings += [] if recorder is None else recorder.damage.lines
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
        if not problem:
            print(f"results in {out.path}")

    notes = [f"{one.figure.text}: {note}" for one in figures for note in one.notes]
    return finish(arguments, content, show, [*warnings, *notes], [problem])


def _row(one: FusedFigure) -> list[str]:
    """Return the row of a figure in the table of all."""
    single, both, says = _mean_text(one, one.alone), "—", "—"
    if one.with_simulator is not None:
        both = _mean_text(one, one.with_simulator)
        says = f"{'yes' if one.predicts else 'no'} ({one.line.p_value:.2g})"
    return [
        f"{one.figure.text} ({one.figure.unit})" if one.figure.unit else one.figure.text,
        single if one.predicts else f"[bold]{single}[/]",
        f"[bold]{both}[/]" if one.predicts else both,
        "—" if one.line.correlation is None else f"{one.line.correlation:.2f}",
        says,
        str(one.saved),
        f"{one.gap.mean:+.2f}",
    ]


def _mean_text(one: FusedFigure, mean: Mean) -> str:
    low, high = mean.interval
    if one.figure.is_rate:
        return f"{100 * mean.value:.0f} % [{100 * low:.0f}, {100 * high:.0f}]"
    return f"{mean.value:.2f} [{low:.2f}, {high:.2f}]"


def _sentence(one: FusedFigure) -> str:
    """Return what may be said of the physical car, with what it rests on."""
    from skd_evaluator.report.formats import counted

    pairs, value, (low, high), unit = one.pairs, one.stands.value, one.stands.interval, one.figure.unit
    name, figure = f"mean {one.figure.text}", f"{value:.2f} {unit}"
    interval = f"{low:.2f} to {high:.2f} {unit}"
    if one.figure.is_rate:
        name, figure, interval = one.figure.text, f"{100 * value:.0f} %", f"{100 * low:.0f} to {100 * high:.0f} %"
    trials = f"{counted(pairs.trials.size, 'physical trial')} on {len(pairs.names)} φ"
    begin = f"Over all φ the {name} of the physical car is {figure}, with a 95 % interval from {interval}; by {trials}"
    if not one.predicts:
        return f"{begin} alone, for {one.why_alone}."
    saved = f"The simulator predicts it, and saved {counted(one.saved, 'physical trial')}."
    return f"{begin} and simulations of {pairs.population.size} φ. {saved}"


def _gap_lines(one: FusedFigure) -> Iterator[str]:
    """Yield what is to be said of the gap between simulated and physical."""
    from skd_sim.inputs.files import one_line

    gap, unit = one.gap, f" {one.figure.unit}" if one.figure.unit else ""
    span = "" if gap.interval is None else f" [{gap.interval[0]:+.2f}, {gap.interval[1]:+.2f}]"
    yield f"physical less simulated: {gap.mean:+.2f}{unit}{span} on average of {len(one.pairs.names)} φ"
    worst = int(abs(gap.by_phi).argmax())
    yield f"largest on {one_line(one.pairs.names[worst])}: {gap.by_phi[worst]:+.2f}{unit}"
    trends = (("with the simulated figure", gap.by_simulated), ("from trial to trial", gap.by_order))
    for what, trend in () if one.figure.is_rate else trends:  # a single hit has a trend
        if trend is not None and trend.p_value < 0.05:
            low, high = trend.interval
            yield f"the gap changes {what}: slope {trend.slope:+.3g} [{low:+.3g}, {high:+.3g}]"


# --- how many trials it takes


def _plan(arguments: argparse.Namespace) -> int:
    """Say how many trials a width takes, alone and with the simulator; return the exit code."""
    from skd_evaluator.extensions.fusion.estimate import trials_for_width
    from skd_evaluator.extensions.fusion.fusion import planning_basis
    from skd_evaluator.extensions.fusion.trials import FIGURES
    from skd_evaluator.report.terminal import narrow_table, print_table

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
        unit = f" {figure.unit}" if figure.unit else ""
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


def _calibrate(arguments: argparse.Namespace) -> int:
    from skd_sim.inputs.yaml_file import to_yaml
    from skd_sim.options.car_under_test import CarUnderTest

    from skd_evaluator.assessment.files.result_folder import write_json
    from skd_evaluator.assessment.run.workers import available_workers, check_controller
    from skd_evaluator.extensions.fusion.calibration import RESULT, SCENARIO, calibrated, calibration_of
    from skd_evaluator.extensions.fusion.trials import read_simulated, table_in
    from skd_evaluator.report.terminal import narrow_table, print_table

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
    found = calibration_of(world, car, trials, arguments.parameters, arguments.workers or available_workers())
    best = replace(calibrated(world, found.values), name=f"{world.name}_calibrated")
    content = {
        "simulated": simulated.source,
        "physical": str(arguments.physical),
        "trials": len(trials),
        "phi": len({one.phi for one in trials}),
        **found.as_dict(),
        "sentences": list(_calibration_sentences(found)),
        "warnings": [*simulated.remarks, *found.warnings, *recorder.damage.lines],
    }

    def write(where: Path) -> None:
        (where / SCENARIO).write_text(to_yaml(best.as_dict()), encoding="utf-8")
        write_json(where / RESULT, content)

    def show() -> None:
        start, rows = calibrated(world, {}), []
        for one in found.estimates:
            parameter, estimate = one.parameter, ("—", one.reason or "")
            if one.interval is not None:
                estimate = f"{one.value:.3g}", f"[{one.interval[0]:.3g}, {one.interval[1]:.3g}]"
            name = f"{parameter.text} ({parameter.unit})" if parameter.unit else parameter.text
            rows.append((name, f"{parameter.of(start):.3g}", *estimate))
        heads = ("", "scenario", "estimate", "95 %\ninterval")
        print_table(narrow_table("The simulator by the physical trials", heads, rows))
        print(*content["sentences"], sep="\n")
        seconds = f"{time.perf_counter() - begin:.1f} s"
        print(seconds if problem else f"{seconds}; the calibrated scenario is {out.path / SCENARIO}")

    problem = out.save(write)
    return finish(arguments, content, show, content["warnings"], [problem])


def _recorded(recorder: TrialRecorder, table: Path) -> list[Recorded]:
    """Return the trials of a table, each at the simulator's times."""
    from skd_evaluator.extensions.fusion.calibration import recorded
    from skd_evaluator.extensions.fusion.recordings import track_of
    from skd_evaluator.extensions.fusion.trials import PhysicalTrial, read_trials

    found: list[Recorded] = []

    def keep(path: Path, trial: PhysicalTrial) -> PhysicalTrial:
        scene = recorder.laid(path, trial)
        found.append(recorded(recorder.scenario, scene, trial.phi, trial.where))
        return replace(trial, track=track_of(scene))

    if len(read_trials(table, keep)) > len(found):
        raise UsageError(f"{table}: a trial without a recording says nothing of how the car went: give each a file")
    return found


def _calibration_sentences(found: SimulatorCalibration) -> Iterator[str]:
    for one in found.identified:
        assert one.interval is not None
        value, low, high = map(one.parameter.shown, (one.value, *one.interval))
        yield f"The {one.parameter.text} is {value}, with a 95 % interval from {low} to {high}."
    off = f"Simulated cars are {found.after:.2f} m from where recorded ones were (root mean square)"
    yield f"{off}; with the scenario's own values {found.before:.2f} m."
