"""The launch files: their arguments, what they start and how they end; with a stand-in for `launch` without ROS 2."""

from __future__ import annotations

import importlib.util
import sys
import types
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from packaging_support import NODES, SOURCE, STEERING, settings

LAUNCH = SOURCE / "skd_evaluator" / "launch"
OWN = {
    "episode": {"mode", "trial"},
    "assessment": {"safe_count", "kamikaze_count", "collision_runs", "maximum_distance"},
}


class Action:
    """Remembers how it was made; stands for every action, event and handler."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        self.arguments = arguments
        self.__dict__.update(options)


STAND_INS = {
    "launch": ("LaunchDescription",),
    "launch.actions": ("DeclareLaunchArgument", "EmitEvent", "LogInfo", "OpaqueFunction", "RegisterEventHandler"),
    "launch.event_handlers": ("OnProcessExit",),
    "launch.events": ("Shutdown",),
    "launch.events.process": ("ProcessExited",),
    "launch.launch_context": ("LaunchContext",),
    "launch.launch_description": ("LaunchDescription",),
    "launch_ros": (),
    "launch_ros.actions": ("Node",),
    "ament_index_python": (),
    "ament_index_python.packages": (),
}


@pytest.fixture
def support(monkeypatch: pytest.MonkeyPatch) -> types.ModuleType:
    """Module launch_support over stand-ins."""
    for name, members in STAND_INS.items():
        module = types.ModuleType(name)
        for member in members:
            setattr(module, member, type(member, (Action,), {}))
        monkeypatch.setitem(sys.modules, name, module)
    packages: Any = sys.modules["ament_index_python.packages"]
    packages.get_package_share_directory = lambda package: str(SOURCE / package)
    name = "skd_evaluator.ros.launch_support"
    monkeypatch.delitem(sys.modules, name, raising=False)
    module = importlib.import_module(name)
    monkeypatch.setitem(sys.modules, name, module)  # and gone again afterwards
    return module


def description(task: str) -> Any:
    """Return what a launch file describes."""
    spec = importlib.util.spec_from_file_location(task, LAUNCH / f"{task}.launch.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.generate_launch_description()


def started(task: str, **given: str) -> tuple[dict[str, Any], list[Any]]:
    """Return the nodes that a launch starts, by name, and everything else."""
    *declared, run = description(task).arguments[0]
    values = {argument.arguments[0]: argument.default_value for argument in declared}
    assert set(given) <= set(values)
    context = SimpleNamespace(launch_configurations=values | given, is_shutdown=False)
    actions = run.function(context, *run.args)
    nodes = {action.executable: action for action in actions if type(action).__name__ == "Node"}
    return nodes, [action for action in actions if type(action).__name__ != "Node"]


@pytest.mark.parametrize("task", OWN)
def test_arguments_set_parameters_that_exist(support, task):
    *declared, _ = description(task).arguments[0]
    arguments = support.arguments_of(task)
    assert [argument.arguments[0] for argument in declared] == list(arguments)
    assert all(argument.description for argument in declared)
    assert OWN[task] <= set(arguments)
    assert {name for name, (_, nodes) in arguments.items() if not nodes} == STEERING
    for name, (argument, nodes) in arguments.items():
        for node in nodes:
            setting = settings(node)[name]
            assert argument.plain_default == setting.plain_default, name
            assert type(argument.plain_default) is type(setting.plain_default), name
            assert argument.texts == setting.texts, name
            assert {type(choice) for choice in argument.texts} <= {str}, "shown as they are written"


@pytest.mark.parametrize("task", OWN)
def test_every_node_is_started_with_its_file_and_the_arguments(support, task):
    nodes, _ = started(task, seed="7", pacing="real_time", record="false", multiplier="0.5")
    assert set(nodes) == set(NODES)
    for name, node in nodes.items():
        file, chosen = node.parameters
        assert Path(file) == SOURCE / NODES[name][0] / "config" / f"{name}.yaml"
        assert Path(file).is_file()
        assert node.package == NODES[name][0]
        assert set(chosen) <= set(settings(name))
    evaluator = nodes["evaluator"].parameters[1]
    assert evaluator["task"] == task
    assert (evaluator["seed"], evaluator["record"], evaluator["multiplier"]) == (7, False, 0.5)
    assert nodes["vehicle_simulator"].parameters[1]["pacing"] == "real_time"


@pytest.mark.parametrize("given", [{"use_builtin_controller": "false"}, {"controller": "external"}])
def test_external_controller_is_left_to_the_user(support, given):
    nodes, _ = started("assessment", command_type="twist", **given)
    assert set(nodes) == set(NODES) - {"car_controller"}
    assert nodes["evaluator"].parameters[1]["controller"] == "external"
    assert nodes["evaluator"].parameters[1]["command_type"] == "twist"
    assert nodes["vehicle_simulator"].parameters[1]["command_type"] == "twist"


def test_launch_ends_with_the_evaluator(support):
    _, handlers = started("episode")
    exits = [handler.arguments[0] for handler in handlers]
    assert len(exits) == len(NODES)
    by_node = {handler.target_action.executable: handler.on_exit for handler in exits}
    running, ending = SimpleNamespace(is_shutdown=False), SimpleNamespace(is_shutdown=True)

    fine = by_node["evaluator"](SimpleNamespace(returncode=0), running)
    assert [type(action).__name__ for action in fine] == ["LogInfo", "EmitEvent"]
    with pytest.raises(RuntimeError, match="evaluator ended with exit code 2"):
        by_node["evaluator"](SimpleNamespace(returncode=2), running)
    with pytest.raises(RuntimeError, match="sim-1 ended with exit code -9"):
        by_node["vehicle_simulator"](SimpleNamespace(returncode=-9, process_name="sim-1"), running)
    for on_exit in by_node.values():
        assert not on_exit(SimpleNamespace(returncode=-2, process_name="any"), ending)
