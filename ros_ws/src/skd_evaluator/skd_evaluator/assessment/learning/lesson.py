"""What the adversary learns of a car before it is rated: probes, a model, trials with that model, a better model.

The episodes are the same for every campaign of the same car and scenario, whatever its seed, its φ and its budget, so
that a model can be kept (`kept_models`), and none of their draws is one of a campaign's.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from skd_adversary.car_models import RecordedEpisode, learn_car, observe
from skd_adversary.car_models.car_model_file import FittedCar, car_model_text
from skd_sim.errors import UsageError
from skd_sim.options.adversary import Knowledge
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.episode import Episode
from skd_sim.world.state import Trajectory

from skd_evaluator.assessment.learning.kept_models import day_of, files_of, folder_of, keep_model, kept_model
from skd_evaluator.assessment.learning.trials import SEED, finished, own_trials
from skd_evaluator.assessment.learning.waiting import with_waiting_reward
from skd_evaluator.assessment.plan.plan import EpisodeRunner, Plan, Progress, safe_trajectories
from skd_evaluator.assessment.plan.probe import probe_episodes
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.bags.car_logs import recording_of
from skd_evaluator.errors import AssessmentError
from skd_evaluator.version import version

PROBES: Final = 300
"""Episodes that show how the car reacts: as good as 1,000."""
TRIALS: Final = 150
"""Episodes of kamikazes who plan with what the probes showed, in order to learn where they will go."""
SAFE: Final = 15
"""Number of φ from which they start."""

_LEARNING = threading.Lock()  # cells of a campaign that rate the same car learn it once


@dataclass(frozen=True)
class Lesson:
    """What was learned, and from what.

    Attributes:
        text: the model as text, as an episode carries it.
        folder: folder in which the model is kept; None: it is not kept.
        fresh: whether it was learned just now.
        seconds: wall-clock time that it took.
        compared: with what a model that was learned before goes, or why none is kept, in words.
    """

    text: str
    folder: Path | None
    fresh: bool
    seconds: float
    compared: str = ""

    def line(self) -> str:
        """Return what a user should know, in one line."""
        where = f", {self.compared}" if self.compared else ""
        where += "" if self.folder is None else f", kept in {self.folder}"
        done = f"{PROBES} probes and {TRIALS} trials of kamikazes in {self.seconds:.0f} s"
        said = f"learned the car from {done}{where}" if self.fresh else f"the car was learned before{where}"
        return f"{said}; --knowledge nothing does without"


def needs_learning(plan: Plan) -> bool:
    """Return whether the car of a plan is to be learned first."""
    return plan.knows == Knowledge.LEARNED and not plan.car_model


def learned(
    plan: Plan,
    runner: EpisodeRunner,
    progress: Progress = lambda *_told: None,
    *,
    say: Callable[[str], None] = lambda _line: None,
    command: str | None = None,
    graph: Mapping[str, Any] | None = None,
) -> Plan:
    """Return the plan after its adversary has learned the car; the same plan unless it has to learn.

    Args:
        plan: what is to be rated.
        runner: runs the episodes; it has been started.
        progress: called with how far the work is.
        say: called with one line: what was done, and how to do without it.
        command: command that starts the car's own node, if it has one.
        graph: how the node graph is run, as plain data; None: episodes run in process.

    Raises:
        AssessmentError: none of the probes could be run to its end.
    """
    if not needs_learning(plan):
        return plan
    with _LEARNING:
        lesson = _lesson(plan, runner, progress, command, graph)
    say(lesson.line())
    return replace(plan, car_model=lesson.text)


def _lesson(
    plan: Plan,
    runner: EpisodeRunner,
    progress: Progress,
    command: str | None,
    graph: Mapping[str, Any] | None,
) -> Lesson:
    begin = time.perf_counter()
    folder, files = folder_of(plan, command, graph), files_of(plan, command)
    known = None if folder is None else kept_model(folder, plan.scenario)
    if known is not None:
        same = f"on {day_of(folder)} with the same files" if folder else ""
        same += " (all that its command names)" if plan.car.is_external else ""
        return Lesson(known, folder, fresh=False, seconds=0.0, compared=same)
    car = lesson_of(plan, runner, progress, runner if graph is None else InProcessRunner(1))
    # Unless files of the car have changed since it began to be learned.
    kept = folder is not None and folder_of(plan, command, graph) == folder and keep_model(folder, car)
    seconds = time.perf_counter() - begin
    why_not = files.why_not and f"and keeps no model of it because {files.why_not}"
    return Lesson(car_model_text(car), folder if kept else None, fresh=True, seconds=seconds, compared=why_not)


def lesson_of(
    plan: Plan,
    runner: EpisodeRunner,
    progress: Progress = lambda *_told: None,
    of_reference: EpisodeRunner | None = None,
) -> FittedCar:
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
    recordings = _recordings(runner, probes, "probes", progress)
    first, _ = learn_car(observe(recordings), version=version(), folds=1)
    safe = _starts(plan.scenario, of_reference or runner)
    trials = own_trials(plan, car_model_text(first), safe, TRIALS)
    recordings += _recordings(runner, trials, "trials to learn from", progress)
    car, _ = learn_car(observe(recordings), version=version(), folds=2)
    return with_waiting_reward(plan, car, safe, runner, progress)


def _starts(scenario: Scenario, runner: EpisodeRunner) -> list[Trajectory]:
    """Return φ to start from: synthetic ones of the scenario, those of the reference car."""
    try:
        return safe_trajectories(Plan(scenario, seed=SEED, safe_count=SAFE), runner)
    except UsageError as error:
        raise AssessmentError(
            f"the car cannot be learned: {error}; give --knowledge nothing, or --car-model"
        ) from error


def _recordings(
    runner: EpisodeRunner, episodes: Sequence[Episode], label: str, progress: Progress
) -> list[RecordedEpisode]:
    return [recording_of(log) for log in finished(runner, episodes, label, progress)]
