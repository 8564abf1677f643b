"""What the launch files share: arguments, the graph's processes, and how the launch ends."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, EmitEvent, LogInfo, OpaqueFunction, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.events.process import ProcessExited
from launch.launch_context import LaunchContext
from launch.launch_description import LaunchDescription
from launch_ros.actions import Node
from skd_sim.options.car_under_test import EXTERNAL, CarUnderTest
from skd_sim.options.options import SimulatorOptions, options_of

from skd_evaluator.assessment.options import CampaignOptions, EvaluatorOptions

SIMULATOR, EVALUATOR = "vehicle_simulator", "evaluator"
_TRUE, _FALSE = ("true", "1", "yes", "on"), ("false", "0", "no", "off")


@dataclass(frozen=True)
class Argument:
    """A launch argument.

    Attributes:
        name: name of the argument, and of the parameter that it sets, where it sets one.
        default: value by default, whose type is that of the argument.
        description: what the argument means, with its unit.
        nodes: nodes whose parameter it sets; none: it changes the launch itself.
        choices: texts allowed; any by default.
    """

    name: str
    default: Any
    description: str
    nodes: tuple[str, ...] = (EVALUATOR,)
    choices: tuple[str, ...] = ()

    def declaration(self) -> DeclareLaunchArgument:
        """Return what `ros2 launch --show-args` shows."""
        default = str(self.default).lower() if isinstance(self.default, bool) else str(self.default)
        options = {"choices": list(self.choices)} if self.choices else {}
        return DeclareLaunchArgument(self.name, default_value=default, description=self.description, **options)

    def value(self, text: str) -> Any:
        """Return the argument's value in the type of its default.

        Raises:
            ValueError: the text is not of that type.
        """
        kind = type(self.default)
        try:
            if kind is bool:
                return {**dict.fromkeys(_TRUE, True), **dict.fromkeys(_FALSE, False)}[text.strip().lower()]
            return kind(text)
        except (KeyError, ValueError):
            wanted = {bool: "true or false", int: "a whole number", float: "a number"}[kind]
            raise ValueError(f"launch argument {self.name} must be {wanted}, got {text!r}") from None


COMMON = (
    Argument("use_builtin_controller", True, "false: the car under test is a node that you start yourself", nodes=()),
    Argument("scenario", "", "name of a scenario, or a YAML file; empty: the one that suits the safe trajectories"),
    Argument("record", True, "keep a recording (a bag) of every episode"),
    Argument("out", "", "folder for the results; empty: skd_results/<task>-<time>"),
    Argument("overwrite", False, "replace the results in out"),
    Argument(
        "params_file", "", "YAML file with parameters of any of the nodes; they win over the other arguments", nodes=()
    ),
    Argument("rviz", False, "show the crossing in RViz", nodes=()),
    Argument(
        "end_launch", True, "the launch ends with the evaluator, and fails with it or with another node", nodes=()
    ),
)


def option_arguments(launch: str) -> tuple[Argument, ...]:
    """Return the arguments by which the options of campaign and graph are given to a launch file, by its name."""
    tables = {SIMULATOR: (SimulatorOptions,), EVALUATOR: (CampaignOptions, EvaluatorOptions)}
    known = {node: {one.name: one for table in those for one in options_of(table)} for node, those in tables.items()}
    found = known[EVALUATOR] | known[SIMULATOR]
    told = {name: tuple(node for node, names in known.items() if name in names) for name in found}
    return tuple(
        Argument(name, one.plain_default, one.text, told[name], one.texts)
        for name, one in found.items()
        if launch in one.launches
    )


def graph_description(task: str, own: Sequence[Argument] = ()) -> LaunchDescription:
    """Return the launch of the whole graph for one task of the evaluator.

    Args:
        task: value of the evaluator's parameter of that name.
        own: the task's own arguments, beside the options of a campaign.
    """
    arguments = (*own, *option_arguments(task), *COMMON)
    return LaunchDescription(
        [
            *[argument.declaration() for argument in arguments],
            OpaqueFunction(function=_start, args=[task, arguments]),
        ]
    )


def _start(context: LaunchContext, task: str, arguments: Sequence[Argument]) -> list[Any]:
    values = {argument.name: argument.value(context.launch_configurations[argument.name]) for argument in arguments}
    builtin = values["use_builtin_controller"] and not CarUnderTest(values["controller"]).is_external
    if not builtin:
        values["controller"] = EXTERNAL

    def node(package: str, name: str) -> Node:
        chosen = {argument.name: values[argument.name] for argument in arguments if name in argument.nodes}
        if name == EVALUATOR:
            chosen["task"] = task
        parameters: list[Any] = [str(Path(get_package_share_directory(package), "config", f"{name}.yaml")), chosen]
        if values["params_file"]:
            parameters.append(values["params_file"])
        return Node(package=package, executable=name, name=name, parameters=parameters, output="screen")

    evaluator = node("skd_evaluator", EVALUATOR)
    others = [node("skd_sim", SIMULATOR), node("skd_adversary", "adversary")]
    if builtin:
        others.append(node("skd_sim", "car_controller"))
    started: list[Any] = [*others, evaluator]
    if values["end_launch"]:
        ends = {evaluator: _on_evaluator_exit, **dict.fromkeys(others, _on_other_exit)}
        started[:0] = [RegisterEventHandler(OnProcessExit(target_action=one, on_exit=end)) for one, end in ends.items()]
    if values["rviz"]:
        view = str(Path(get_package_share_directory("skd_evaluator"), "rviz", "skd.rviz"))
        started.append(Node(package="rviz2", executable="rviz2", arguments=["-d", view], output="screen"))
    return started


def _on_evaluator_exit(event: ProcessExited, context: LaunchContext) -> list[Any]:
    if context.is_shutdown:
        return []
    reason = f"evaluator ended with exit code {event.returncode}"
    if event.returncode == 0:
        return [LogInfo(msg=reason), EmitEvent(event=Shutdown(reason=reason))]
    # A launch has no exit code of its own: only an error makes `ros2 launch` end with 1.
    raise RuntimeError(reason)


def _on_other_exit(event: ProcessExited, context: LaunchContext) -> None:
    if not context.is_shutdown:
        raise RuntimeError(f"{event.process_name} ended with exit code {event.returncode}")
