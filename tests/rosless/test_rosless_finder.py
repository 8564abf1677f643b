"""How rosless comes in, and how it steps aside."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest
from rosless.interfaces import packages
from rosless_support import SOURCE


def run(text: str, *, first: Path | None = None, last: Path | None = None, **environment: str) -> str:
    """Run a program with directories before and behind everything else on the path."""
    prelude = f"""
        import sys
        sys.path.append({str(SOURCE)!r})
        {f"sys.path.insert(0, {str(first)!r})" if first else ""}
        import rosless.activate
        {f"sys.path.append({str(last)!r})" if last else ""}
    """
    clean = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "ROSLESS_MSG_PATH")}
    result = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(prelude) + textwrap.dedent(text)],
        env={**clean, **environment},
        capture_output=True,
        text=True,
        timeout=30,
    )
    return result.stdout + result.stderr


def make_real_rclpy(folder: Path) -> Path:
    (folder / "rclpy").mkdir(parents=True)
    (folder / "rclpy" / "__init__.py").write_text("REAL = True\n")
    return folder


def test_names_are_served_where_there_is_no_rclpy() -> None:
    out = run(
        """
        import rclpy, rclpy.node, rclpy.qos
        from rclpy.node import Node
        from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
        from rclpy.parameter import Parameter
        from rclpy.qos import QoSProfile, qos_profile_sensor_data, QoSDurabilityPolicy
        from rclpy.exceptions import ParameterNotDeclaredException
        from rclpy.clock import Clock, ClockType
        from rclpy.time import Time
        from rclpy.duration import Duration
        from rclpy.callback_groups import ReentrantCallbackGroup
        from rclpy.event_handler import PublisherEventCallbacks
        from rclpy.serialization import serialize_message
        from rclpy.logging import get_logger
        from rclpy.utilities import remove_ros_args
        from rcl_interfaces.msg import ParameterDescriptor, FloatingPointRange, ParameterType
        from rcl_interfaces.srv import GetParameters
        import nav_msgs.msg, builtin_interfaces.msg as builtin
        from geometry_msgs.msg import *
        assert Parameter.Type.DOUBLE.value == ParameterType.PARAMETER_DOUBLE
        assert nav_msgs.msg.Odometry().pose.pose == Pose() and builtin.Time().sec == 0
        assert rclpy.node.Node is Node and rclpy.ok() is False
        import pickle
        assert pickle.loads(pickle.dumps(Twist(linear=Vector3(x=2.0)))).linear.x == 2.0
        assert GetParameters.Request().names == []
        print(type(rclpy.__loader__).__name__)
        """
    )
    assert out.strip() == "_ServedLoader"


@pytest.mark.parametrize("where", ["first", "last"])
def test_a_real_rclpy_wins_wherever_it_is(tmp_path: Path, where: str) -> None:
    folder = make_real_rclpy(tmp_path / "ros")
    out = run(
        """
        import rclpy
        print(rclpy.REAL)
        for name in ("rclpy.node", "nav_msgs", "nav_msgs.msg", "skd_msgs.msg", "rcl_interfaces.msg"):
            try:
                __import__(name)
            except ModuleNotFoundError as error:
                print(error)
            else:
                print("served", name)
        """,
        **{where: folder},  # type: ignore[arg-type]
    )
    assert "served" not in out
    assert out.splitlines()[0] == "True"
    assert "No module named 'nav_msgs'" in out


def test_messages_are_not_served_beside_a_real_rclpy(tmp_path: Path) -> None:
    folder = make_real_rclpy(tmp_path / "ros")
    assert "No module named 'nav_msgs'" in run("import nav_msgs.msg", last=folder)


def test_a_real_message_package_wins(tmp_path: Path) -> None:
    (tmp_path / "nav_msgs").mkdir()
    (tmp_path / "nav_msgs" / "__init__.py").write_text("MINE = 1\n")
    assert run("import nav_msgs; print(nav_msgs.MINE)", last=tmp_path).strip() == "1"


def test_the_path_may_change_later(tmp_path: Path) -> None:
    folder = make_real_rclpy(tmp_path / "ros")
    out = run(
        f"""
        import std_msgs.msg
        sys.path.append({str(folder)!r})
        try:
            import geometry_msgs.msg
        except ModuleNotFoundError as error:
            print(error)
        """
    )
    assert "No module named 'geometry_msgs'" in out


def test_other_imports_fail_as_always() -> None:
    out = run(
        """
        for name in ("no_such_thing", "rclpy.no_such_thing", "nav_msgs.action", "nav_msgs.srv",
                     "nav_msgs.msg._nothing"):
            try:
                __import__(name)
            except ModuleNotFoundError as error:
                print("right", error)
        try:
            from nav_msgs.msg import Nothing
        except ImportError as error:
            print("right", error)
        """
    )
    assert out.count("right") == 6


def test_what_is_not_supported_says_so() -> None:
    out = run(
        """
        for name in ("rclpy.action", "rclpy.lifecycle"):
            try:
                __import__(name)
            except NotImplementedError as error:
                print("right", error)
        """
    )
    assert out.count("right rosless does not support") == 2


def test_it_can_be_switched_off() -> None:
    assert "No module named 'rclpy'" in run("import rclpy", ROSLESS_DISABLE="1")


def make_package(folder: Path) -> Path:
    package = folder / "my_msgs"
    (package / "msg").mkdir(parents=True)
    (package / "srv").mkdir()
    (package / "package.xml").write_text("<package/>")
    (package / "msg" / "Part.msg").write_text("uint8 RED=1\nstring NAME='a b'\nfloat64 size 2.5\nbool good true\n")
    (package / "msg" / "Whole.msg").write_text(
        "std_msgs/Header header\nPart[] parts\nPart one\nint32[3] three [1, 2, 3]\nstring<=5 short\n"
        "geometry_msgs/Quaternion[2] turns\nfloat32[] grow [0.5]\nstring word 'default'\n"
    )
    (package / "srv" / "Ask.srv").write_text("Part part\n---\nbool answer\n")
    return folder


CUSTOM = """
    from my_msgs.msg import Part, Whole
    from my_msgs.srv import Ask
    from rclpy.serialization import serialize_message, deserialize_message
    whole = Whole(parts=[Part(), Part(size=1.0)])
    assert (Part.RED, Part.NAME, Part().size, Part().good) == (1, "a b", 2.5, True)
    assert list(whole.three) == [1, 2, 3] and list(whole.grow) == [0.5] and whole.word == "default"
    assert whole.turns[1].w == 1.0
    assert deserialize_message(serialize_message(whole), Whole) == whole
    try:
        serialize_message(Whole(short="too long"))
    except TypeError as error:
        print(error)
    assert Ask.Request().part == Part() and Ask.Response().answer is False
"""


def test_custom_packages_are_found(tmp_path: Path) -> None:
    folder = make_package(tmp_path)
    out = run(CUSTOM, ROSLESS_MSG_PATH=f"/nowhere{os.pathsep}{folder}")
    assert out.strip() == "my_msgs/msg/Whole: member 'short' may have at most 5 bytes, got 8"


def test_a_workspace_on_the_path_is_no_obstacle(tmp_path: Path) -> None:
    # my_msgs and my_msgs/msg are namespace packages then, which the import system finds before rosless is
    # asked
    folder = make_package(tmp_path)
    out = run(CUSTOM, ROSLESS_MSG_PATH=str(folder), first=folder)
    assert out.strip().endswith("got 8")


def test_a_broken_definition_is_named(tmp_path: Path) -> None:
    folder = make_package(tmp_path)
    (folder / "my_msgs" / "msg" / "Broken.msg").write_text("float64 = 3 4\n")
    assert "Broken.msg is not a valid definition" in run("from my_msgs.msg import Part", ROSLESS_MSG_PATH=str(folder))


def test_the_list_of_standard_packages_is_complete() -> None:
    # In a process of its own: other tests of this one add packages.
    code = "from rosless.interfaces import definitions; print(*definitions.typestore().fielddefs)"
    in_typestore = {name.partition("/")[0] for name in run(code).split()}
    assert in_typestore - {"skd_msgs", "std_srvs"} <= packages.STANDARD_PACKAGES
    assert in_typestore | {"std_srvs"} >= packages.STANDARD_PACKAGES


def test_activation_is_cheap() -> None:
    out = run(
        """
        import subprocess, time
        heavy = {"numpy", "rosbags", "cyclonedds", "pathlib", "typing", "dataclasses"}
        del sys.modules["rosless.activate"]
        started = time.process_time()  # not by the clock: other programs may run on the same core
        import rosless.activate
        print(time.process_time() - started < 0.005)
        prelude = f"import sys; sys.path.append({sys.path[-1]!r}); import rosless.activate"
        code = f"{prelude}; print(sorted({heavy!r} & set(sys.modules)))"
        result = subprocess.run([sys.executable, "-S", "-c", code], capture_output=True, text=True)
        print(result.stdout.strip())
        """
    )
    assert out.split() == ["True", "[]"]
