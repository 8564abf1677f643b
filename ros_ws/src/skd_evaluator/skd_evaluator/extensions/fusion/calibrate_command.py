"""`skd fuse --calibrate`: a simulated world in which simulated cars go as recorded ones."""

from __future__ import annotations

import argparse
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
from skd_evaluator.cli.output import finish
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
    folder = arguments.simulated
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
    trials = _recorded(recorder, world, table_in(arguments.physical))
    calibration = _calibrated(world, car, trials, arguments.parameters, arguments.workers or available_workers())
    if calibration.after > POOR:
        raise UsageError(
            f"with the best parameters simulated cars are {calibration.after:.2f} m (root mean square) from where "
            f"recorded ones were, more than {POOR:g} m: it is another car, or other software"
        )
    best = replace(calibrated(world, calibration.values), name=f"{world.name}_calibrated")
    content = {
        "simulated": simulated.source,
        "physical": str(arguments.physical),
        "trials": len(trials),
        "phi": len({one.phi for one in trials}),
        "parameters": {
            one.parameter.name: {
                "place": one.parameter.place,
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
        "sentences": _sentences(calibration),
        "warnings": [*simulated.remarks, *_warnings(calibration), *recorder.damage.lines],
    }

    def write(where: Path) -> None:
        (where / SCENARIO).write_text(to_yaml(best.as_dict()), encoding="utf-8")
        write_json(where / RESULT, content)

    def show() -> None:
        print_table(_table(calibration, calibrated(world, {})))
        print(*content["sentences"], sep="\n")
        seconds = f"{time.perf_counter() - begin:.1f} s"
        print(seconds if problem else f"{seconds}; the calibrated scenario is {out.path / SCENARIO}")

    problem = out.save(write)
    return finish(arguments, content, show, content["warnings"], [problem])


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
    if absent := [one for one in names or () if one not in known]:
        raise UsageError(f"{absent[0]} cannot be calibrated: scenario {world.name} has no sensor")
    start = {name: PARAMETERS[name].of(calibrated(world, {})) for name in known}
    numbers = list(dict.fromkeys(one.phi for one in trials))
    with InProcessRunner(workers, isolated=not car.is_own) as runner:
        runner.start()

        def off(values: Mapping[str, float]) -> list[np.ndarray]:
            scenario = calibrated(world, values)
            drives = [ReplayedDrive(one, scenario, car.controller, car.multiplier) for one in trials]
            return list(runner.map(off_by, drives))

        try:
            free = [name for name in known if not names or name in names]
            return estimated(off, start, free, [numbers.index(one.phi) for one in trials])
        except ValueError as error:
            raise UsageError(str(error)) from error


def _warnings(calibration: SimulatorCalibration) -> list[str]:
    found = [
        f"{one.parameter.text} is at the end of its range, {one.parameter.shown(one.value)}"
        for one in calibration.told
        if one.value in one.parameter.range
    ]
    return found if calibration.told else ["the trials say nothing of the simulator's parameters"]


def _sentences(calibration: SimulatorCalibration) -> list[str]:
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


def _table(calibration: SimulatorCalibration, begun: Scenario) -> Table:
    """Return the table of all parameters."""
    rows = []
    for one in calibration.estimates:
        name = f"{one.parameter.text} ({one.parameter.unit})" if one.parameter.unit else one.parameter.text
        found = ("—", one.reason)
        if one.interval is not None:
            found = f"{one.value:.3g}", f"[{one.interval[0]:.3g}, {one.interval[1]:.3g}]"
        rows.append((name, f"{one.parameter.of(begun):.3g}", *found))
    return narrow_table("The simulator by the physical trials", ("", "scenario", "estimate", "95 %\ninterval"), rows)
