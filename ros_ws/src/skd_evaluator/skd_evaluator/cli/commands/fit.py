"""`skd fit`: the predictive model of a car from recorded episodes, or with --people how people walk, from tracks."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from skd_sim.errors import UsageError

from skd_evaluator.cli.arguments import Parser, result_folder
from skd_evaluator.cli.output import finish

BEHAVIOUR = "behaviour.png"


def add(parser: Parser) -> None:
    """Learn a model of a car from recorded episodes, or of how people walk.

    Estimate how a car brakes from recorded episodes, and write car_model.yaml for skd assess --car-model. With --people
    fit tracks of people, check the model on people held out, and write behaviour.yaml for skd assess --behaviour.
    """
    parser.set_defaults(group="research")
    text = "a bag folder, an .mcap file, episodes.npz, or a folder of them. With --people: CITR, or csv with t, x, y"
    parser.add_paths("PATH", text)
    people = parser.add_argument_group("people")
    people.add_flag("--people", "fit a behaviour model to tracks of people, not a model of a car")
    people.add_value("--name", "what it is called", default="fitted", metavar="NAME")
    people.add_value("--kind", "the kind of road user", default="pedestrian", metavar="KIND")
    parser.add_skip_damaged()
    parser.add_output()


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    return _fit_people(arguments) if arguments.people else _fit_car(arguments)


def _fit_car(arguments: argparse.Namespace) -> int:
    from skd_adversary.car_models.car_model_file import FILE_NAME, car_model_data, write_car_model
    from skd_adversary.car_models.fit import learn_car
    from skd_adversary.car_models.observations import observe

    from skd_evaluator.assessment.stages.car_model import read_recordings
    from skd_evaluator.bags.checks import Damage
    from skd_evaluator.cli.assessment import say_damage
    from skd_evaluator.report import fit
    from skd_evaluator.report.terminal import print_table
    from skd_evaluator.version import version

    begin = time.perf_counter()
    out = result_folder(arguments)
    damage = Damage(skip=arguments.skip_damaged)
    recordings = read_recordings(arguments.paths, damage)
    say_damage("fit", damage)
    car = learn_car(observe(recordings), version=version())
    data = {**car_model_data(car), "forest": car.forest is not None}

    def show() -> None:
        print(f"{data['logs']} logs, {data['ticks']} ticks, {data['braking_ticks']} of them braking")
        print_table(fit.car_table(car, data))
        for line in fit.unidentified(data):
            print(line)
        if data["families"]:
            print_table(fit.family_table(data))
        if data["predictions"]:
            print_table(fit.prediction_table(data))
        if data["predictions"] or data["forest"]:
            by = "a forest of recorded ticks" if data["forest"] else "the law above"
            evades = ", which say where it evades to, too" if car.forest is not None and car.forest.evades else ""
            print(f"The adversary predicts the car by {by}{evades}")
        if held_out := data["calibration"]:
            p_value = held_out["p_value"]
            chance = f"p = {p_value:.3f}" if p_value >= fit.CONTRADICTED else f"p < {fit.CONTRADICTED:g}"
            print(
                f"Held-out ticks against their prediction: {held_out['ticks']} ticks,\n"
                f"Kolmogorov-Smirnov distance {held_out['statistic']:.3f}, {chance}"
            )

    saved = out.save(lambda folder: write_car_model(folder / FILE_NAME, car)), f"model in {out.path / FILE_NAME}"
    return finish(arguments, data, show, fit.car_model_warnings(data), saved=saved, since=begin)


def _fit_people(arguments: argparse.Namespace) -> int:
    from skd_sim.scenario.road_user import ROAD_USERS

    from skd_evaluator.assessment.files.result_folder import write_json
    from skd_evaluator.bags.checks import Damage
    from skd_evaluator.cli.assessment import say_damage
    from skd_evaluator.metrics.behaviour.model import FILE_NAME, write_behaviour
    from skd_evaluator.report.fit import behaviour_table, save_behaviour, validation_table
    from skd_evaluator.report.progress import progress_bar
    from skd_evaluator.report.terminal import print_table
    from skd_evaluator.risk.behaviour.fit import HORIZONS, LEAST_TRACKS, QUANTILES, behaviour_of, fit_behaviour
    from skd_evaluator.risk.behaviour.tracks import TIME_STEP, WITHIN, folds_of, read_tracks, validate

    begin = time.perf_counter()
    if arguments.kind not in ROAD_USERS:
        raise UsageError(f"--kind must be one of {', '.join(ROAD_USERS.names())}; got {arguments.kind!r:.40}")
    out = result_folder(arguments)
    damage = Damage(skip=arguments.skip_damaged)
    tracks = read_tracks(arguments.paths, damage, arguments.kind)
    say_damage("fit", damage)
    by, folds = folds_of(tracks)
    left = min(len(folds) - folds.count(fold) for fold in set(folds))
    if left < LEAST_TRACKS:
        held = f"{len(tracks)} tracks, of which {left} are left when those of one {by} are held out"
        raise UsageError(f"{held}; a behaviour model needs at least {LEAST_TRACKS}")
    with progress_bar(quiet=arguments.quiet) as progress:
        validation = validate(tracks, lambda done, of: progress("fits without a part", done, of))
        fit = fit_behaviour([one.positions for one in tracks], TIME_STEP)
    recordings = len({one.recording for one in tracks})
    source = f"fitted to {fit.tracks} tracks of {recordings} recordings"
    behaviour = behaviour_of(fit, arguments.name, arguments.kind, source, source)

    def write(folder: Path) -> None:
        write_behaviour(folder / FILE_NAME, behaviour)
        write_json(folder / "validation.json", validation.as_dict())
        walked = [one.positions for one in tracks]
        tables = (validation.recorded, validation.predicted)
        save_behaviour(folder / BEHAVIOUR, walked, validation.example, HORIZONS, QUANTILES, tables)

    def show() -> None:
        print(f"{fit.tracks} tracks of {recordings} recordings, {fit.steps} ticks")
        print_table(behaviour_table(behaviour))
        print_table(validation_table(validation.as_dict(), WITHIN))

    saved = out.save(write), f"behaviour model in {out.path / FILE_NAME}, picture in {BEHAVIOUR}"
    off = f"{100.0 * validation.worst:.0f} % off, more than {100.0 * WITHIN:.0f} %"
    why = "they walk otherwise than the others, or than the model can"
    warnings = [f"a quantile of people held out is {off}: {why}"] if validation.worst > WITHIN else []
    content = {**behaviour.as_dict(), "validation": validation.as_dict()}
    return finish(arguments, content, show, warnings, saved=saved, since=begin)
