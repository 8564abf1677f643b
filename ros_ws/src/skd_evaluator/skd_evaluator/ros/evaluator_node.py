"""Node `evaluator`: an assessment or an episode from parameters, for launch files and containers.

Exit code: 0 fine, 1 the assessment failed (or the episode was aborted), 2 wrong usage, 130 interrupted.
"""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

from rclpy.executors import ExternalShutdownException
from skd_sim.errors import AssessmentError, UsageError
from skd_sim.interruption import SIGNALS
from skd_sim.options.car_and_adversary import AdversaryModel, CarUnderTest, objectives_named
from skd_sim.options.options import CommandOptions, options_of, values_of
from skd_sim.ros.support import declare, run_node
from skd_sim.world.episode import Mode, Outcome

from skd_evaluator.assessment import from_options
from skd_evaluator.assessment.assessment import Assessment
from skd_evaluator.assessment.context import Context
from skd_evaluator.assessment.files.result_folder import ResultFolder
from skd_evaluator.assessment.options import CampaignOptions, EvaluatorOptions, TaskOptions, managed_nodes
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.workers import InProcessRunner, check_controller
from skd_evaluator.assessment.stages.car_model import learned
from skd_evaluator.assessment.stages.pipeline import compile_for_graph, run_stages
from skd_evaluator.assessment.stages.safe_trajectories import single_episode
from skd_evaluator.provenance import provenance
from skd_evaluator.report.presentation import episode_line, fill, fill_episode, with_scratch
from skd_evaluator.report.terminal import headline
from skd_evaluator.report.warnings import warnings_of, why_failed
from skd_evaluator.ros.evaluator import Evaluator
from skd_evaluator.ros.processes import campaign_name
from skd_evaluator.ros.stack import resetting

_INTERRUPTED = 130
TABLES = (TaskOptions, CampaignOptions, EvaluatorOptions)
"""Of its parameters; those of the car's commands are the same as the simulator's, for the record."""


class EvaluatorProcess(Evaluator):
    """The evaluator with what it is to do as parameters."""

    def __init__(self) -> None:
        """Declare parameters and check what can be checked before any work."""
        super().__init__()
        self._settings = declare(self, *TABLES)
        values = self._settings
        scenario = from_options.scenario_for(values["scenario"], values["safe"])
        self._objectives = objectives_named(values["objective"])
        self._plan = from_options.plan_of(
            self._adversary_model_of_one() if values["task"] == "episode" else values, scenario
        )
        car = self._plan.car
        if not car.is_external:
            clocked = check_controller(car, scenario)
        else:
            clocked = from_options.with_requested_period(scenario, values["control_period"] or None)
        self._plan = replace(self._plan, scenario=clocked)
        folder = Path(values["out"]).expanduser() if values["out"] else from_options.default_folder(values["task"])
        from_options.refuse_to_replace(folder, from_options.inputs_of(values))
        self._out = ResultFolder(folder, overwrite=values["overwrite"])

    def _adversary_model_of_one(self) -> dict[str, Any]:
        """Return the settings of a single episode, before which no car is learned.

        Raises:
            UsageError: the adversary is to know a model that is not named.
        """
        car = CarUnderTest(self._settings["controller"], self._settings["multiplier"])
        if self._settings["car_model"] or car.is_known:
            return self._settings
        if self._settings["adversary_model"] == AdversaryModel.LEARNED:
            raise UsageError("task episode learns no car: name a model with car_model, or leave out adversary_model")
        return {**self._settings, "adversary_model": str(AdversaryModel.GENERIC)}

    def work(self) -> int:
        """Do what the parameters ask for and return the exit code."""
        values, plan = self._settings, self._plan
        compile_for_graph(plan, self._objectives)
        names = managed_nodes(values["lifecycle_nodes"])
        try:
            with (
                self._out.scratch() as scratch,
                resetting(self.context, names, values["silence_limit"]) as reset,
                _undisturbed_cleaning(),
            ):
                self.begin_campaign(
                    campaign_name(plan.car),
                    record_to=scratch.folder / "bags" if values["record"] else None,
                    silence_limit=values["silence_limit"],
                    before_episode=reset,
                    commands=CommandOptions(**values_of(CommandOptions, values)),
                )
                return self._assess(scratch.folder) if values["task"] == "assessment" else self._run_one(scratch.folder)
        except OSError as error:
            raise AssessmentError(str(error)) from error
        except (KeyboardInterrupt, ExternalShutdownException):
            print("evaluator: interrupted; nothing was written", file=sys.stderr)  # the context may be gone: no logger
            return _INTERRUPTED

    def _assess(self, scratch: Path) -> int:
        begin = time.perf_counter()
        plan = self._learned()
        origin = provenance(sys.argv, plan.car)
        context = Context(
            self,
            InProcessRunner(1),
            self._objectives,
            progress=self._say_progress,
            repeats=False,
            fresh=lambda: nullcontext(self),
        )
        assessment = run_stages(context, Assessment(plan, provenance=origin))
        self.publish_assessment(assessment)
        assessment = replace(assessment, seconds=time.perf_counter() - begin)
        self._out.write(with_scratch(scratch, lambda folder: fill(folder, assessment)))
        for line in warnings_of(assessment):
            self.get_logger().warning(line)
        failures = why_failed(assessment, self._settings["max_aborted"] / 100.0)
        for why in failures:
            self.get_logger().error(f"{why}; results in {self._out.path}")
        if failures:
            return 1
        self.get_logger().info(f"{headline(assessment.as_dict())}; results in {self._out.path}")
        return 0

    def _run_one(self, scratch: Path) -> int:
        mode = Mode[self._settings["mode"].upper()]
        plan = replace(self._plan, safe_count=1)
        log = self.run_episode(single_episode(plan, mode, self._settings["trial"]))
        self._out.write(with_scratch(scratch, lambda folder: fill_episode(folder, log)))
        line = f"{episode_line(log)}; results in {self._out.path}"
        if log.outcome == Outcome.ABORTED:
            self.get_logger().error(f"{line}; {log.reason}")
            return 1
        self.get_logger().info(line)
        return 0

    def _learned(self) -> Plan:
        """Return the plan whose adversary knows of the car what it is to know."""
        say = self.get_logger().info
        if self._plan.car.is_external:  # it is not known which car it is: its model is not kept
            return learned(self._plan, self, self._say_progress, say=say)
        how = {"launched": True, **{one.name: str(self._settings[one.name]) for one in options_of(EvaluatorOptions)}}
        return learned(self._plan, self, self._say_progress, say=say, graph=how)

    def _say_progress(self, label: str, done: int, total: int) -> None:
        self.get_logger().info(f"{label}: {done} of {total}", throttle_duration_sec=5.0)


@contextmanager
def _undisturbed_cleaning() -> Iterator[None]:
    try:
        yield
    except (KeyboardInterrupt, ExternalShutdownException):
        for number in SIGNALS:
            signal.signal(number, signal.SIG_IGN)  # a second one must not disturb the cleaning up
        raise


def main(args: Sequence[str] | None = None) -> int:
    """Run the node to the end of its task."""
    return run_node(EvaluatorProcess, args, EvaluatorProcess.work, interrupted=_INTERRUPTED)


if __name__ == "__main__":
    raise SystemExit(main())
