"""The car model: what the adversary learns of a car before it is assessed.

Probes show how the car reacts, a model is made of them, kamikazes that plan with it show more, and a better model is
made. The episodes are the same for every campaign of the same car and scenario, whatever its seed, its φ and its
budget, so that a model can be kept, and none of their draws is one of a campaign's.

A model is kept under a digest of all that it follows from: the files of the car, the command that starts it, the
scenario, how the graph is run, and SKD itself. Where its files are not known, none is kept. SKD cannot see what a
controller reads elsewhere, from the environment or from a server: if that changes, delete the file.

How long kamikazes should wait is tried against the car itself. The search knows what it would see next, and so
overrates what waiting gains; but with a car that can be hit while it creeps, too much haste costs as much. Of a car
that evades, a model that predicts where it goes and one that takes it to be in its lane are tried.
"""

from __future__ import annotations

import datetime
import hashlib
import importlib.metadata
import json
import os
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from skd_adversary.car_models.car_model_file import FittedCar, car_model_text, fitted_car
from skd_adversary.car_models.fit import learn_car
from skd_adversary.car_models.observations import RecordedEpisode, observe
from skd_adversary.crossing.cars import FOREST_WAITING_REWARD, WAITING_REWARD
from skd_sim.errors import AssessmentError, UsageError
from skd_sim.inputs.files import folders_in, read_json
from skd_sim.options.car_and_adversary import DEFAULT_OBJECTIVES, SIMULATORS, AdversaryModel, CarUnderTest, Objective
from skd_sim.options.options import options_of
from skd_sim.scenario.road import HEADING_NORTH, right_and_along, road_pose
from skd_sim.scenario.scenario import Scenario, scenario_from_dict
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Mode, Outcome
from skd_sim.world.state import Trajectory

from skd_evaluator.assessment.assessment import Assessment
from skd_evaluator.assessment.context import Context, Progress, Runner, run_episodes, silent, stage
from skd_evaluator.assessment.files.episodes_npz import EPISODES, read_episodes
from skd_evaluator.assessment.files.result_folder import check_unchanged
from skd_evaluator.assessment.options import OF_NO_RESULT, GraphOptions
from skd_evaluator.assessment.plan import EpisodeGroup, Plan, episode_id, probe_episodes
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories
from skd_evaluator.bags.checks import SUMMARIES, Damage, LocatedLog, accept, not_credible_beside
from skd_evaluator.bags.files import holds_recordings, is_recording
from skd_evaluator.bags.read import read_bags
from skd_evaluator.files import keep
from skd_evaluator.metrics.aborted import not_credible
from skd_evaluator.metrics.deviation import deviation
from skd_evaluator.metrics.measures import pair_of
from skd_evaluator.provenance import code_digests, environment
from skd_evaluator.version import version

PROBES: Final = 300
"""Episodes that show how the car reacts: as good as 1,000."""
TRIALS: Final = 150
"""Episodes of kamikazes who plan with what the probes showed, in order to learn where they will go."""
SAFE: Final = 15
"""Number of φ from which they start."""

_LEARNING = threading.Lock()  # cells of a campaign that rate the same car learn it once


def needs_learning(plan: Plan) -> bool:
    """Return whether the car of a plan is to be learned first."""
    return plan.resolved_adversary_model == AdversaryModel.LEARNED and not plan.car_model


@stage(10)  # before all, for φ of source `own` are planned with it
def run(context: Context, assessment: Assessment) -> Assessment:
    """Return the assessment with the model of the car with which kamikazes plan, if they have to learn one."""
    runner = context.workers if context.graph is None else context.runner
    graph = graph_settings(context.graph)
    return replace(assessment, plan=learned(assessment.plan, runner, context.progress, say=context.say, graph=graph))


def graph_settings(graph: GraphOptions | None) -> dict[str, Any] | None:
    """Return what results depend on of how the node graph runs, as plain data; None: episodes run in process."""
    if graph is None:
        return None
    return {one.name: getattr(graph, one.name) for one in options_of(GraphOptions) if one.name not in OF_NO_RESULT}


def learned(
    plan: Plan,
    runner: Runner,
    progress: Progress = silent,
    *,
    say: Callable[[str], None] = lambda _line: None,
    graph: Mapping[str, Any] | None = None,
) -> Plan:
    """Return the plan after its adversary has learned the car; the same plan unless it has to learn.

    Args:
        plan: what is to be assessed.
        runner: runs the episodes; it has been started.
        progress: called with how far the work is.
        say: called with one line: what was done, and how to do without it.
        graph: how the node graph is run, as plain data; None: episodes run in process.

    Raises:
        AssessmentError: none of the probes could be run to its end.
    """
    if not needs_learning(plan):
        return plan
    with _LEARNING:
        file = model_file(plan, graph)
        text = None if file is None else kept_model(file)
        if file is not None and text is not None:
            line = f"the car was learned before, on {day_of(file)} with the same files, kept in {file}"
        else:
            begin = time.perf_counter()
            text = car_model_text(learn(plan, runner, progress, runner if graph is None else InProcessRunner(1)))
            seconds = f"{time.perf_counter() - begin:.0f} s"
            line = f"learned the car from {PROBES} probes and {TRIALS} trials of kamikazes in {seconds}"
            if file is None:
                line += ", not kept: its files are not known"
            # Unless files of the car have changed since it began to be learned.
            elif model_file(plan, graph) == file and keep(file, text.encode()):
                line += f", kept in {file}"
    say(f"{line}; --adversary-model generic does without")
    return replace(plan, car_model=text)


def learn(plan: Plan, runner: Runner, progress: Progress = silent, of_reference: Runner | None = None) -> FittedCar:
    """Return what probes and own trials show of a plan's car; neither its seed nor its φ matter.

    Args:
        plan: what is to be rated.
        runner: runs the episodes; it has been started.
        progress: called with how far the work is.
        of_reference: runs episodes of the reference car, in process; by default the same runner.

    Raises:
        AssessmentError: none of the probes could be run to its end.
    """
    probes = [
        replace(one, simulator=plan.simulator)
        for one in probe_episodes(
            plan.scenario, PROBES, seed=SEED, controller=plan.controller, multiplier=plan.multiplier
        )
    ]
    recordings = _recordings(runner, probes, "learning the car: probes", progress)
    observed = observe(recordings)
    plan = replace(plan, steers=plan.steers or observed.evades)
    first = learn_car(observed, version=version(), folds=1)
    safe = _starts(plan.scenario, of_reference or runner)
    trials = own_trials(plan, car_model_text(first), safe, TRIALS)
    recordings += _recordings(runner, trials, "learning the car: trials", progress)
    observed = observe(recordings)
    tried = []
    for data in (observed, observed.in_lane) if observed.evades else (observed,):
        car = learn_car(data, version=version(), folds=2)
        tried.append(with_waiting_reward(plan, car, safe, runner, progress))
    return min(tried, key=lambda one: one[1])[0]


def _starts(scenario: Scenario, runner: Runner) -> list[Trajectory]:
    """Return φ to start from: synthetic ones of the scenario, those of the reference car."""
    try:
        return safe_trajectories(Plan(scenario, seed=SEED, safe_count=SAFE), runner)
    except UsageError as error:
        raise AssessmentError(f"the car cannot be learned: {error}; give --adversary-model generic") from error


def _recordings(
    runner: Runner, episodes: Sequence[EpisodeSpec], label: str, progress: Progress
) -> list[RecordedEpisode]:
    return [recording_of(log) for log in finished(runner, episodes, label, progress)]


SEED: Final = 2_718_281_828
"""Of every draw; no campaign's, unless it is asked for."""


def own_trials(
    plan: Plan,
    car_model: str,
    safe: Sequence[Trajectory],
    count: int,
    *,
    begin: int = 0,
    objectives: Sequence[Objective] = DEFAULT_OBJECTIVES,
) -> list[EpisodeSpec]:
    """Return kamikazes that plan with a model; the objectives take turns.

    Args:
        plan: the plan of the assessment, whose car they meet.
        car_model: the model of the car with which they plan, as an episode carries it.
        safe: φ, from which they start in turn.
        count: how many kamikazes there are.
        begin: number of the first; trials of the same number have their draws in common.
        objectives: the objectives of the kamikazes.
    """
    return [
        EpisodeSpec(
            plan.scenario,
            Mode.KAMIKAZE,
            SEED,
            episode_id(EpisodeGroup.LEARNING, number % len(safe), number // len(safe)),
            safe_trajectory=safe[number % len(safe)],
            controller=plan.controller,
            multiplier=plan.multiplier,
            simulator=plan.simulator,
            car_model=car_model,
            objective=objectives[number // len(safe) % len(objectives)],
            steers=plan.steers,
        )
        for number in range(begin, begin + count)
    ]


def finished(runner: Runner, episodes: Sequence[EpisodeSpec], label: str, progress: Progress) -> list[EpisodeLog]:
    """Run episodes; return the logs of those that were not aborted, in order.

    Raises:
        AssessmentError: all of them were aborted.
    """
    found: list[EpisodeLog] = []
    reason = ""
    for log in run_episodes(runner, episodes, label, progress):
        if log.outcome == Outcome.ABORTED:
            reason = log.reason
        else:
            found.append(log)
    if not found:
        what = label.rpartition(": ")[2]
        raise AssessmentError(f"the car cannot be learned: all {len(episodes)} {what} were aborted ({reason})")
    return found


CHOICES: Final = (FOREST_WAITING_REWARD, WAITING_REWARD, -0.4)
"""m of deviation for each step after φ's end."""
WAITING_TRIALS: Final = 60
"""Trials with each choice, which have their draws in common."""
_FIRST: Final = 100  # number of each φ's first trial, beyond those that the car is learned from
_ENOUGH: Final = 0.98  # of the trials hit: what is left to be gained is not in the waiting


def with_waiting_reward(
    plan: Plan, car: FittedCar, safe: Sequence[Trajectory], runner: Runner, progress: Progress
) -> tuple[FittedCar, float]:
    """Return a learned car with the waiting reward by which kamikazes stray least, and how far they do, m.

    One that fails counts as η_max.

    If nearly all are hit with the reward that this kind of model has, it is kept, and nothing else is tried.

    Args:
        plan: the plan of the assessment, whose car it is.
        car: the learned car.
        safe: φ, from which they start in turn.
        runner: runs the episodes; it has been started.
        progress: called with how far the work is.

    Raises:
        AssessmentError: all trials with one of the choices were aborted.
    """
    usual = WAITING_REWARD if car.forest is None else FOREST_WAITING_REWARD
    best, least = usual, np.inf
    for choice in (usual, *(one for one in CHOICES if one != usual)):
        model = car_model_text(replace(car, waiting_reward=choice))
        trials = own_trials(
            plan, model, safe, WAITING_TRIALS, begin=_FIRST * len(safe), objectives=(Objective.DEVIATION,)
        )
        logs = finished(runner, trials, "learning the car: waiting trials", progress)
        mean = float(np.mean([_strayed(log) for log in logs]))
        if mean < least:
            best, least = choice, mean
        if choice == usual and np.mean([log.hit for log in logs]) >= _ENOUGH:
            break
    return replace(car, waiting_reward=best), least


def _strayed(log: EpisodeLog) -> float:
    """Return the deviation of a trial, m; η_max where it did not hit."""
    episode = log.episode
    assert episode.safe_trajectory is not None
    if not log.hit:
        return episode.scenario.eta_max
    pair = pair_of(log)
    found = deviation(episode.safe_trajectory.positions, pair.psi.positions, pair.duration)
    return min(found, episode.scenario.eta_max)


def kept_models() -> Path:
    """Return the folder of the models: `skd/car_models` in the user's cache (XDG_CACHE_HOME)."""
    cache = os.environ.get("XDG_CACHE_HOME") or ""
    base = Path(cache) if Path(cache).is_absolute() else Path.home() / ".cache"
    return base / "skd" / "car_models"


def model_file(plan: Plan, graph: Mapping[str, Any] | None) -> Path | None:
    """Return where the model of a plan's car is kept, or would be; None if not all that says which car it is is known.

    Args:
        plan: what is to be assessed.
        graph: how the node graph is run, with the command that starts the car's node; None: in process.
    """
    command = (graph or {}).get("controller_command") or ""
    others = [SIMULATORS.target(plan.simulator)] if plan.simulator not in SIMULATORS.own else []
    files = code_digests(plan.car, command, others)
    if files is None:
        return None
    with suppress(importlib.metadata.PackageNotFoundError):
        graph = {**(graph or {}), "scikit-learn": importlib.metadata.version("scikit-learn")}
    follows_from = {
        "controller": plan.controller,
        "multiplier": plan.car.stated_multiplier,
        "simulator": plan.simulator,
        "scenario": plan.scenario.as_dict(),
        "graph": dict(graph or {}),
        "files": files,
        "environment": dict(environment()),
    }
    found = hashlib.sha256(json.dumps(follows_from, sort_keys=True).encode())
    return kept_models() / f"{found.hexdigest()[:32]}.json"


def day_of(file: Path) -> str:
    """Return the day (UTC) of which a model is that is kept; empty where there is none."""
    with suppress(OSError, OverflowError):
        return datetime.datetime.fromtimestamp(file.stat().st_mtime, datetime.UTC).date().isoformat()
    return ""


def kept_model(file: Path) -> str | None:
    """Return the text of a model that is kept; None where there is none, or none that can be read."""
    with suppress(ValueError, UsageError, OSError):
        text = file.read_text(encoding="utf-8")
        fitted_car(text)
        return text
    return None


def recording_of(log: EpisodeLog) -> RecordedEpisode:
    """Return what an episode's log says about the car."""
    scenario = log.episode.scenario
    # The fit sees every road as a straight one: offsets across it, distances along it.
    line = scenario.road.line
    walked, driven = (right_and_along(line, places[:, :2]) for places in (log.adversary, log.car))
    turned = [heading - road_pose(line, s)[2] for heading, s in zip(log.car[:, 2], driven[:, 1], strict=True)]
    heading = log.car[:, 2] if scenario.road.straight else HEADING_NORTH + np.angle(np.exp(1j * np.array(turned)))
    car = np.column_stack([driven, heading, log.car[:, 3]])
    return RecordedEpisode(walked, car, scenario.time_step, scenario.car.front, scenario.car.rear)


def read_recordings(paths: Sequence[Path], damage: Damage | None = None) -> list[RecordedEpisode]:
    """Return every recorded episode of `paths`: bag folders, files of recordings, episodes.npz, or folders of them.

    An episodes.npz with bags below its folder is not read, for they hold every episode. An episode that is found twice
    counts once.

    Args:
        paths: files and folders in which to look.
        damage: takes note of what is left out and what is to be said; by default whatever is damaged is refused.

    Raises:
        UsageError: a path cannot be read, or holds neither; the logs are of several controllers; or something is
            damaged and must not be left out.
    """
    damage = damage or Damage()
    found: dict[tuple[bytes, bytes], RecordedEpisode] = {}
    cars: dict[str, Path] = {}
    for path in paths:
        for car, recording in _recorded(path, damage):
            cars.setdefault(car, path)
            found.setdefault((recording.adversary.tobytes(), recording.car.tobytes()), recording)
    if len(cars) > 1:
        (one, first), (other, second) = list(cars.items())[:2]
        where = f"both in {first}" if first == second else f"in {first} and in {second}"
        raise UsageError(f"the logs are of several cars: {one} and {other}, {where}; fit them apart")
    return list(found.values())


def _recorded(path: Path, damage: Damage) -> Iterator[tuple[str, RecordedEpisode]]:
    """Yield (controller, recording) of every episode below a path."""
    if not path.exists():
        raise UsageError(f"{path}: no such file or folder")
    if path.is_dir():
        arrays, bags = _arrays_below(path, damage), holds_recordings(path)
        if not bags and not arrays:
            raise UsageError(f"{path}: holds neither recordings nor {EPISODES}; record some with skd probe")
    else:
        bags, arrays = is_recording(path), [path] if path.suffix == ".npz" else []
        if not bags and not arrays:
            raise UsageError(f"{path}: give {EPISODES}, a recording, or a folder of them")
    if bags:
        for line in not_credible_beside(path.rglob("*.mcap*") if path.is_dir() else [path]):
            damage.warn(f"{path}: {line}")
        for episode in read_bags([path], damage).episodes:
            log = episode.log
            yield log.episode.car.label, recording_of(log)
    for file in arrays:
        yield from _read_npz(file, damage)


def _arrays_below(folder: Path, damage: Damage) -> list[Path]:
    """Return each episodes.npz at or below a folder that has no bags below its own."""
    holding = {
        path
        for path, _, files in folders_in(folder, lambda path, why: damage.leave_out(f"{path}: {why}"))
        if EPISODES in files
    }
    return [path / EPISODES for path in sorted(holding) if not holds_recordings(path)]


def _car_of(path: Path) -> tuple[EpisodeSpec, list[str]]:
    """Return what all episodes of an episodes.npz share, from the summary in its folder, and why it is not credible."""
    file = next((path.parent / name for name in SUMMARIES if (path.parent / name).exists()), None)
    if file is None:
        raise UsageError(f"{path}: has no {' or '.join(SUMMARIES)} beside it, which says what car it was")
    try:
        content = read_json(file)
        controller, multiplier = str(content["controller"]), content["multiplier"]
        if multiplier is None and not CarUnderTest(controller).has_multiplier:
            multiplier = 1.0
        model = (content.get("options") or {}).get("adversary_model")
        spec = EpisodeSpec(
            scenario_from_dict(content["scenario"], str(file)),
            Mode.SAFE,
            int(content["seed"]),
            0,
            controller=controller,
            multiplier=float(multiplier),
            adversary_model=AdversaryModel(model) if model else None,
        )
        return spec, not_credible(content.get("warnings") or ())
    except (OSError, ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        raise UsageError(f"{file}: does not say what car it was ({' '.join(str(error).split())})") from error


def _read_npz(path: Path, damage: Damage) -> Iterator[tuple[str, RecordedEpisode]]:
    """Yield (controller, recording) of every episode in an episodes.npz that can have happened."""
    try:
        check_unchanged(path.parent, [path.name, *(name for name in SUMMARIES if (path.parent / name).exists())])
        car, reasons = _car_of(path)
        logs = _logs_in(path, car)
    except UsageError as error:
        damage.leave_out(str(error))
        return
    for line in reasons:
        damage.warn(f"{path}: {line}")
    for one in accept([LocatedLog(log, str(path), str(path)) for log in logs], damage):
        yield one.log.episode.car.label, recording_of(one.log)


def _logs_in(path: Path, car: EpisodeSpec) -> list[EpisodeLog]:
    """Return the episodes of an episodes.npz, of an assessment or of a probe."""
    stored, step = read_episodes(path.parent, path.name), car.scenario.time_step
    if stored.time_step != step:
        raise UsageError(f"{path}: its time step is {stored.time_step:g} s, that of its scenario {step:g} s")
    try:
        return stored.logs(car)
    except (ValueError, LookupError) as error:
        raise UsageError(f"{path}: {' '.join(str(error).split())}") from error
