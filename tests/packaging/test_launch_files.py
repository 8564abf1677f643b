"""What the launch files declare and which nodes they start; `launch` itself is tried in test_image.py where it is."""

from __future__ import annotations

import ast
from typing import Any

import pytest
from packaging_support import NODES, SOURCE, STEERING, settings
from skd_evaluator.ros.launch_support import _PACKAGES, arguments_of, text_of, values_and_nodes

OWN = {
    "episode": {"mode", "trial"},
    "assessment": {"safe_count", "kamikaze_count", "collision_runs", "maximum_distance"},
}


def nodes(task: str, **given: str) -> dict[str, dict[str, Any]]:
    """Return the parameters of the nodes that a launch with these arguments starts, by name."""
    texts = {name: text_of(one.plain_default) for name, (one, _) in arguments_of(task).items()}
    assert set(given) <= set(texts)
    return values_and_nodes(task, texts | given)[1]


@pytest.mark.parametrize("task", OWN)
def test_arguments_set_parameters_that_exist(task):
    arguments = arguments_of(task)
    assert OWN[task] <= set(arguments)
    assert {name for name, (_, nodes) in arguments.items() if not nodes} == STEERING
    for name, (argument, names) in arguments.items():
        for node in names:
            setting = settings(node)[name]
            assert (argument.plain_default, argument.texts) == (setting.plain_default, setting.texts), name
            assert type(argument.plain_default) is type(setting.plain_default), name
            assert {type(choice) for choice in argument.texts} <= {str}, "shown as they are written"


@pytest.mark.parametrize("task", OWN)
def test_every_node_is_started_with_the_arguments(task):
    found = nodes(task, seed="7", pacing="real_time", record="false", multiplier="0.5")
    assert set(found) == set(NODES)
    for name, chosen in found.items():
        assert _PACKAGES[name] == NODES[name][0]
        assert set(chosen) <= set(settings(name))
    evaluator = found["evaluator"]
    assert [evaluator[name] for name in ("task", "seed", "record", "multiplier")] == [task, 7, False, 0.5]
    assert found["vehicle_simulator"]["pacing"] == "real_time"


@pytest.mark.parametrize("given", [{"use_builtin_controller": "false"}, {"controller": "external"}])
def test_external_controller_is_left_to_the_user(given):
    found = nodes("assessment", command_type="twist", **given)
    assert set(found) == set(NODES) - {"car_controller"}
    assert found["evaluator"]["controller"] == "external"
    assert found["evaluator"]["command_type"] == found["vehicle_simulator"]["command_type"] == "twist"


def test_a_wrong_argument_is_said():
    with pytest.raises(ValueError, match="launch argument seed must be a whole number, got 'seven'"):
        nodes("episode", seed="seven")


@pytest.mark.parametrize("task", OWN)
def test_each_task_has_a_launch_file(task):
    text = (SOURCE / "skd_evaluator" / "launch" / f"{task}.launch.py").read_text(encoding="utf-8")
    (call,) = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Call)]
    assert ast.unparse(call) == f"graph_description('{task}')"
