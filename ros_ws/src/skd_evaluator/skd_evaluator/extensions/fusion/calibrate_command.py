"""`skd fuse --calibrate`: a simulated world in which simulated cars go as recorded ones."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.table import Table
from skd_sim.errors import UsageError
from skd_sim.inputs.yaml_file import to_yaml
from skd_sim.options.car_under_test import CarUnderTest
from skd_sim.scenario.scenario import Scenario

from skd_evaluator.assessment.files.result_folder import write_json
from skd_evaluator.assessment.run.workers import InProcessRunner, available_workers, check_controller
from skd_evaluator.cli.arguments import result_folder
from skd_evaluator.cli.output import print_json
from skd_evaluator.extensions.fusion.calibration import (
    PARAMETERS,
    POOR,
    Recorded,
    ReplayedDrive,
    SimulatorCalibration,
    calibrated,
    estimated,
    off_by,
    recorded,
)
from skd_evaluator.extensions.fusion.fuse_command import recorder_of
from skd_evaluator.extensions.fusion.recordings import TrialRecorder, track_of
from skd_evaluator.extensions.fusion.trials import PhysicalTrial, read_simulated, read_trials, table_in
from skd_evaluator.report.terminal import narrow_table, print_table

RESULT, SCENARIO = "simulator.json", "simulator.yaml"


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    if arguments.physical is None:
        raise UsageError("--calibrate needs PHYSICAL, the table of physical trials")
    begin = time.perf_counter()
    folder, physical = arguments.simulated, arguments.physical
    out = result_folder(arguments)
    simulated = read_simulated(folder)
    if simulated.scenario is None:
        raise UsageError(f"{folder}: must be the folder of an assessment")
    figures = simulated.figures
    stated = figures["multiplier"]  # which only a car that has one states
    car = CarUnderTest(str(figures["controller"]), CarUnderTest.multiplier if stated is None else float(stated))
    if car.is_external:
        raise UsageError(f"{folder}: its car ran as a node, and cannot drive the trials again in process")
    world = replace(simulated.scenario, control_period=check_controller(car, simulated.scenario).control_period)
    recorder = recorder_of(simulated, arguments)
    assert recorder is not None
    trials = _recorded(recorder, world, table_in(physical))
    workers = arguments.workers or available_workers()
    calibration = _calibrated(world, car, trials, arguments.parameters, workers)
    if calibration.after > POOR:
        raise UsageError(
            f"nothing is said of the simulator: with the best parameters simulated cars are {calibration.after:.2f} m "
            f"(root mean square) from where recorded ones were, more than {POOR:g} m; it is another car or other "
            "software, or one that decides otherwise by the noise of the recordings"
        )
    best = replace(calibrated(world, calibration.values), name=f"{world.name}_calibrated")
    warnings = [*simulated.remarks, *warnings_of(calibration), *recorder.damage.lines]
    content = {
        "simulated": simulated.source,
        "physical": str(physical),
        "trials": len(trials),
        "phi": len({one.phi for one in trials}),
        "parameters": {
            one.parameter.name: {
                "place": ".".join(one.parameter.place),
                "unit": one.parameter.unit,
                "value": one.value,
                "ci95": one.interval and list(one.interval),
                "standard_error": one.error,
                "reason": one.reason or None,
            }
            for one in calibration.estimates
        },
        "covariance": calibration.covariance.tolist(),
        "degrees_of_freedom": calibration.freedom,
        "places_off_before": calibration.before,
        "places_off_after": calibration.after,
        "places_off_by_trial": calibration.by_trial.tolist(),
        "sentences": sentences(calibration),
        "warnings": warnings,
    }

    def write(where: Path) -> None:
        text = to_yaml(best.as_dict())
        (where / SCENARIO).write_text(text, encoding="utf-8")
        write_json(where / RESULT, content)

    problem = out.save(write)
    if arguments.json:
        print_json(content)
    else:
        print_table(parameter_table(calibration, world))
        for line in content["sentences"]:
            print(line)
        seconds = f"{time.perf_counter() - begin:.1f} s"
        print(seconds if problem else f"{seconds}; the calibrated scenario is {out.path / SCENARIO}")
    for line in warnings:
        print(f"skd fuse --calibrate: warning: {line}", file=sys.stderr)
    if problem:
        print(f"skd fuse --calibrate: {problem}", file=sys.stderr)
    return 1 if problem else 0


def _recorded(recorder: TrialRecorder, world: Scenario, table: Path) -> list[Recorded]:
    found: list[Recorded] = []

    def keep(path: Path, trial: PhysicalTrial) -> PhysicalTrial:
        scene = recorder.laid(path, trial)
        found.append(recorded(world, scene, trial.phi, trial.where))
        return replace(trial, track=track_of(scene))

    trials = read_trials(table, keep)
    if len(found) < len(trials):
        raise UsageError(f"{table}: a trial without a recording says nothing of how the car went: give each a file")
    return found


def _calibrated(
    world: Scenario, car: CarUnderTest, trials: Sequence[Recorded], names: Sequence[str] | None, workers: int
) -> SimulatorCalibration:
    known = [name for name, one in PARAMETERS.items() if not one.sensing or world.sensor is not None]
    if names and (absent := [one for one in names if one not in known]):
        raise UsageError(f"{absent[0]} cannot be calibrated: scenario {world.name} has no sensor")
    start = {name: PARAMETERS[name].of(calibrated(world, {})) for name in known}
    with InProcessRunner(workers, isolated=not car.is_own) as runner:
        runner.start()

        def off(values: Mapping[str, float]) -> list[np.ndarray]:
            scenario = calibrated(world, values)
            return list(
                runner.map(off_by, [ReplayedDrive(one, scenario, car.controller, car.multiplier) for one in trials])
            )

        numbers = list(dict.fromkeys(one.phi for one in trials))
        free = [name for name in known if not names or name in names]
        try:
            return estimated(off, start, free, [numbers.index(one.phi) for one in trials])
        except ValueError as error:
            raise UsageError(str(error)) from error


def warnings_of(calibration: SimulatorCalibration) -> list[str]:
    """Return what a reader should know before believing a calibration."""
    found = [
        f"{one.parameter.text} is at the end of its range, {one.parameter.shown(one.value)}"
        for one in calibration.told
        if one.value in one.parameter.range
    ]
    if not calibration.told:
        found.append("the trials say nothing of the simulator's parameters")
    return found


def sentences(calibration: SimulatorCalibration) -> list[str]:
    """Return what may be said, a sentence each."""
    said = [
        f"The {one.parameter.text} is {one.parameter.shown(one.value)}, with a 95 % interval from "
        f"{one.parameter.shown(one.interval[0])} to {one.parameter.shown(one.interval[1])}."
        for one in calibration.told
        if one.interval is not None
    ]
    said.append(
        f"Simulated cars are {calibration.after:.2f} m from where recorded ones were (root mean square); with the "
        f"scenario's own values {calibration.before:.2f} m."
    )
    return said


def parameter_table(calibration: SimulatorCalibration, world: Scenario) -> Table:
    """Return the table of all parameters."""
    table = narrow_table("The simulator by the physical trials")
    for name in ("", "scenario", "estimate", "95 %\ninterval"):
        table.add_column(name, justify="right" if name else "left")
    begun = calibrated(world, {})
    for one in calibration.estimates:
        name = f"{one.parameter.text} ({one.parameter.unit})" if one.parameter.unit else one.parameter.text
        own = f"{one.parameter.of(begun):.3g}"
        if one.interval is None:
            table.add_row(name, own, "—", one.reason)
        else:
            table.add_row(name, own, f"{one.value:.3g}", f"[{one.interval[0]:.3g}, {one.interval[1]:.3g}]")
    return table
