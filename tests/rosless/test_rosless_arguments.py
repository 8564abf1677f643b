"""--ros-args, parameter files and remapping."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosless.parameters import yaml_values

from rosless import arguments


def parse(*args: str) -> arguments.Arguments:
    return arguments.parse(["program", "--ros-args", *args])


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1", 1), ("-7", -7), ("+3", 3), ("0x1F", 31), ("010", 8), ("1.0", 1.0), ("-.5", -0.5),
        ("1e3", 1000.0), ("true", True), ("False", False), ("yes", True), ("off", False), ("abc", "abc"),
        ("1.2.3", "1.2.3"),
        ("'1'", "1"), ('"true"', "true"), ("!!str 5", "5"), ("", ""), ("/scan", "/scan"), ("a b", "a b"),
        ("[1, 2]", [1, 2]), ("[1.0, 2.5]", [1.0, 2.5]), ("[a, 'b c']", ["a", "b c"]),
        ("[true, off]", [True, False]),
        ("[]", []), (".inf", math.inf), ("-.INF", -math.inf), ("08", 8.0),
    ],
)  # fmt: skip
def test_values_are_typed_as_ros_types_them(text: str, value: Any) -> None:
    parsed = yaml_values.parse(text)
    assert parsed == value
    assert type(parsed) is type(value)


@given(st.floats(allow_nan=False))
def test_floats_survive_the_command_line(value: float) -> None:
    text = repr(value).replace("inf", ".inf")
    assert yaml_values.parse(text) == value


@given(st.integers(-(2**63), 2**63 - 1))
def test_integers_survive_the_command_line(value: int) -> None:
    assert yaml_values.parse(str(value)) == value


@pytest.mark.parametrize("text", ["[1, a]", "[1, 2.0]", "{a: 1}", "[[1]]", "[1", "a: b"])
def test_values_that_are_none_are_refused(text: str) -> None:
    with pytest.raises(arguments.InvalidROSArgsError, match="speed"):
        parse("-p", f"speed:={text}")


def test_parameters_go_to_the_nodes_that_they_name() -> None:
    parsed = parse("-p", "a:=1", "-p", "car:b:=2.0", "--param", "a:=3")
    assert parsed.parameters_for("/car") == {"a": 3, "b": 2.0}
    assert parsed.parameters_for("/other") == {"a": 3}


@pytest.mark.parametrize(
    ("pattern", "name", "fits"),
    [
        ("/**", "/a/b", True), ("/*", "/a", True), ("/*", "/a/b", False), ("car", "/car", True),
        ("car", "/ns/car", False), ("/**/car", "/car", True), ("/**/car", "/ns/x/car", True),
        ("/ns/*", "/ns/car", True), ("/ns/*", "/other/car", False), ("/ns/car", "/ns/car2", False),
    ],
)  # fmt: skip
def test_node_patterns(pattern: str, name: str, fits: bool) -> None:
    assert yaml_values.node_name_matches(pattern, name) is fits


FILE = """
/**:
  ros__parameters:
    use_sim_time: true
    gains: [0.5, 1.5]
    planner:
      depth: 4
      rollout: {steps: 10, name: "7"}
car:
  ros__parameters:
    gains: [9.0]
ns:
  car:
    ros__parameters:
      who: nested
/ns/car:
  ros__parameters:
    mode: absolute
"""


def test_parameter_files(tmp_path: Path) -> None:
    path = tmp_path / "parameters.yaml"
    path.write_text(FILE)
    parsed = parse("--params-file", str(path), "-p", "planner.depth:=5")
    common = {
        "use_sim_time": True,
        "planner.depth": 5,
        "planner.rollout.steps": 10,
        "planner.rollout.name": "7",
    }
    assert parsed.parameters_for("/car") == {**common, "gains": [9.0]}
    assert parsed.parameters_for("/ns/car") == {
        **common,
        "gains": [0.5, 1.5],
        "who": "nested",
        "mode": "absolute",
    }


@pytest.mark.parametrize("text", ["car: 1", "ros__parameters: {a: 1}", "car: {ros__parameters: [1]}", "a: [", "- 1"])
def test_bad_parameter_files_are_refused_with_their_name(tmp_path: Path, text: str) -> None:
    path = tmp_path / "parameters.yaml"
    path.write_text(text)
    with pytest.raises(arguments.InvalidROSArgsError, match=r"parameters\.yaml"):
        parse("--params-file", str(path))


def test_a_missing_parameter_file_is_named() -> None:
    with pytest.raises(arguments.InvalidROSArgsError, match=r"/nowhere\.yaml"):
        parse("--params-file", "/nowhere.yaml")


def test_remaps_of_topics() -> None:
    parsed = parse("-r", "chatter:=/other", "-r", "car:odom:=odometry", "--remap", "~/in:=out", "-r", "/a/b:=c")
    assert parsed.topic("/chatter", "car", "/") == "/other"
    assert parsed.topic("/ns/chatter", "car", "/ns") == "/other"
    assert parsed.topic("/chatter", "car", "/ns") is None
    assert parsed.topic("/odom", "car", "/") == "/odometry"
    assert parsed.topic("/odom", "bus", "/") is None
    assert parsed.topic("/ns/car/in", "car", "/ns") == "/ns/out"
    assert parsed.topic("/a/b", "car", "/ns") == "/ns/c"


def test_the_first_matching_remap_wins() -> None:
    assert parse("-r", "a:=b", "-r", "a:=c").topic("/a", "n", "/") == "/b"


def test_service_and_topic_remaps_can_be_told_apart() -> None:
    parsed = parse("-r", "rosservice://a:=b", "-r", "rostopic://a:=c")
    assert parsed.topic("/a", "n", "/") == "/c"
    assert parsed.topic("/a", "n", "/", is_service=True) == "/b"


def test_names_and_namespaces_of_nodes() -> None:
    parsed = parse("-r", "__node:=one", "-r", "__ns:=/space")
    assert parsed.node_name("x") == "one"
    assert parsed.namespace("/", "one") == "/space"
    specific = parse("-r", "x:__node:=one", "-r", "one:__ns:=/space")
    assert specific.node_name("y") == "y"
    assert specific.node_name("x") == "one"
    assert specific.namespace("/", "one") == "/space"


@pytest.mark.parametrize("args", [["-r", "a"], ["-r"], ["-p", "a=1"], ["--log-level", "loud"], ["-r", "__ns:=space"]])
def test_malformed_arguments_are_refused(args: list[str]) -> None:
    with pytest.raises(Exception, match=r"a remap must|needs a value|a parameter must|--log-level must|namespace"):
        parse(*args)


def test_unknown_arguments_are_refused() -> None:
    with pytest.raises(arguments.UnknownROSArgsError, match="--speed"):
        parse("--speed", "3")


def test_removing_ros_arguments_keeps_the_programs_own() -> None:
    args = ["prog", "--mine", "--ros-args", "-r", "a:=b", "--", "--also-mine", "--ros-args", "-p", "c:=1"]
    assert arguments.remove_ros_args(args) == ["prog", "--mine", "--also-mine"]


@pytest.mark.parametrize("text", ["-p a:=1 -r x:=y", "--ros-args -p a:=1 -r x:=y", "--ros-args -p a:=1 -r x:=y --"])
def test_arguments_from_the_environment_come_first(monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    monkeypatch.setenv("ROSLESS_ARGS", text)
    parsed = arguments.parse_with_environment(["prog", "mine", "--ros-args", "-p", "a:=2", "-r", "x:=z"])
    assert parsed.parameters_for("/n") == {"a": 2}
    assert parsed.topic("/x", "n", "/") == "/y"
    monkeypatch.setenv("ROSLESS_ARGS", "-p 'name:=two words' -p b:=1")
    parsed = arguments.parse_with_environment(["prog", "--flag-of-its-own"])
    assert parsed.parameters_for("/n") == {"name": "two words", "b": 1}


def test_log_levels() -> None:
    assert parse("--log-level", "debug", "--log-level", "car:=WARN").log_levels == {
        "": "DEBUG",
        "car": "WARN",
    }
