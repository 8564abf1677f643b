"""What the launch files share: arguments, the graph's processes, and how the launch ends."""

from __future__ import annotations

from collections.abc import Callable
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
from skd_sim.options.options import Option, SimulatorOptions, option, options_of
from skd_sim.ros.support import descriptor_of

from skd_evaluator.assessment.options import CampaignOptions, EvaluatorOptions, TaskOptions

SIMULATOR, EVALUATOR = "vehicle_simulator", "evaluator"
_TRUE, _FALSE = ("true", "1", "yes", "on"), ("false", "0", "no", "off")


@dataclass(frozen=True)
class _LaunchOptions:
    """The table of the arguments that change the launch itself."""

    use_builtin_controller: bool = option(True, "false: the car under test is a node that you start yourself")
    params_file: str = option("", "YAML file with parameters of any of the nodes; they win over the other arguments")
    rviz: bool = option(False, "show the crossing in RViz")
    end_launch: bool = option(True, "the launch ends with the evaluator, and fails with it or with another node")


TABLES: dict[str, tuple[Callable[..., Any], ...]] = {
    EVALUATOR: (TaskOptions, CampaignOptions, EvaluatorOptions),
    SIMULATOR: (SimulatorOptions,),
    "": (_LaunchOptions,),
}
"""By the node whose parameters the arguments set; without one: the launch itself."""


def arguments_of(task: str) -> dict[str, tuple[Option, tuple[str, ...]]]:
    """Return the arguments of a task's launch file by name: the option, and the nodes whose parameter it sets."""
    found: dict[str, tuple[Option, tuple[str, ...]]] = {}
    for node, tables in TABLES.items():
        for one in (one for table in tables for one in options_of(table) if task in one.launches):
            found[one.name] = one, (*found.get(one.name, (one, ()))[1], *filter(None, [node]))
    return found


def _declaration(one: Option) -> DeclareLaunchArgument:
    """Return what `ros2 launch --show-args` shows."""
    default = one.plain_default
    text = str(default).lower() if isinstance(default, bool) else str(default)
    choices = {"choices": list(one.texts)} if one.texts else {}
    return DeclareLaunchArgument(one.name, default_value=text, description=descriptor_of(one).description, **choices)


def _value(one: Option, text: str) -> Any:
    """Return an argument's value in the type of its default.

    Raises:
        ValueError: the text is not of that type.
    """
    kind = one.plain_kind
    try:
        if kind is bool:
            return {**dict.fromkeys(_TRUE, True), **dict.fromkeys(_FALSE, False)}[text.strip().lower()]
        return kind(text)
    except (KeyError, ValueError):
        kinds = {bool: "true or false", int: "a whole number", float: "a number"}[kind]
        raise ValueError(f"launch argument {one.name} must be {kinds}, got {text!r}") from None


def graph_description(task: str) -> LaunchDescription:
    """Return the launch of the whole graph for one task of the evaluator, the value of its parameter of that name."""
    declared = [_declaration(one) for one, _ in arguments_of(task).values()]
    return LaunchDescription([*declared, OpaqueFunction(function=_start, args=[task])])


def _start(context: LaunchContext, task: str) -> list[Any]:
    arguments = arguments_of(task)
    values = {name: _value(one, context.launch_configurations[name]) for name, (one, _) in arguments.items()}
    builtin = values["use_builtin_controller"] and not CarUnderTest(values["controller"]).is_external
    if not builtin:
        values["controller"] = EXTERNAL

    def node(package: str, name: str) -> Node:
        chosen = {key: values[key] for key, (_, nodes) in arguments.items() if name in nodes}
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
