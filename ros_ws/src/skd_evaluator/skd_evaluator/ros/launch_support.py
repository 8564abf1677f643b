"""What the launch files share: arguments, the graph's nodes with their parameters, and how the launch ends.

`launch` is imported where it is needed: it is not on the package index, and arguments are looked at without it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skd_sim.options.car_and_adversary import EXTERNAL, CarUnderTest
from skd_sim.options.options import Option, SimulatorOptions, option, options_of
from skd_sim.ros.support import descriptor_of

from skd_evaluator.assessment.options import CampaignOptions, EvaluatorOptions, TaskOptions

if TYPE_CHECKING:
    from launch.events.process import ProcessExited
    from launch.launch_context import LaunchContext
    from launch.launch_description import LaunchDescription

SIMULATOR, CONTROLLER, ADVERSARY, EVALUATOR = "vehicle_simulator", "car_controller", "adversary", "evaluator"
_PACKAGES = {SIMULATOR: "skd_sim", CONTROLLER: "skd_sim", ADVERSARY: "skd_adversary", EVALUATOR: "skd_evaluator"}
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


def text_of(value: Any) -> str:
    """Return a default as a launch argument has it."""
    return str(value).lower() if isinstance(value, bool) else str(value)


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


def values_and_nodes(task: str, texts: Mapping[str, str]) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    """Return the values of a task's arguments, and the parameters of each node that is started, by its name.

    Raises:
        ValueError: the text of an argument is not of its type.
    """
    arguments = arguments_of(task)
    values = {name: _value(one, texts[name]) for name, (one, _) in arguments.items()}
    nodes: dict[str, dict[str, Any]] = {SIMULATOR: {}, ADVERSARY: {}, CONTROLLER: {}, EVALUATOR: {"task": task}}
    if not values["use_builtin_controller"] or CarUnderTest(values["controller"]).is_external:
        values["controller"] = EXTERNAL
        del nodes[CONTROLLER]
    for name, (_, names) in arguments.items():
        for node in names:
            nodes[node][name] = values[name]
    return values, nodes


def graph_description(task: str) -> LaunchDescription:
    """Return the launch of the whole graph for one task of the evaluator, the value of its parameter of that name."""
    from launch.actions import DeclareLaunchArgument, OpaqueFunction
    from launch.launch_description import LaunchDescription

    declared = [
        DeclareLaunchArgument(
            one.name,
            default_value=text_of(one.plain_default),
            description=descriptor_of(one).description,
            **({"choices": list(one.texts)} if one.texts else {}),
        )
        for one, _ in arguments_of(task).values()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=_start, args=[task])])


def _start(context: LaunchContext, task: str) -> list[Any]:
    from ament_index_python.packages import get_package_share_directory
    from launch.actions import RegisterEventHandler
    from launch.event_handlers import OnProcessExit
    from launch_ros.actions import Node

    values, nodes = values_and_nodes(task, context.launch_configurations)
    started: list[Any] = []
    for name, chosen in nodes.items():
        package = _PACKAGES[name]
        parameters: list[Any] = [str(Path(get_package_share_directory(package), "config", f"{name}.yaml")), chosen]
        if values["params_file"]:
            parameters.append(values["params_file"])
        node = Node(package=package, executable=name, name=name, parameters=parameters, output="screen")
        if values["end_launch"]:
            end = _on_evaluator_exit if name == EVALUATOR else _on_other_exit
            started.append(RegisterEventHandler(OnProcessExit(target_action=node, on_exit=end)))
        started.append(node)
    if values["rviz"]:
        view = str(Path(get_package_share_directory("skd_evaluator"), "rviz", "skd.rviz"))
        started.append(Node(package="rviz2", executable="rviz2", arguments=["-d", view], output="screen"))
    return started


def _on_evaluator_exit(event: ProcessExited, context: LaunchContext) -> list[Any]:
    from launch.actions import EmitEvent, LogInfo
    from launch.events import Shutdown

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
