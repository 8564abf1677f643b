"""Who gets the path of the wheels' libraries: every program of ours, and nobody else."""

import os
import subprocess
import sys

import pytest
from common import PATIENCE
from hypothesis import given
from hypothesis import strategies as st
from skd_evaluator.assessment.options import GraphOptions
from skd_evaluator.ros import session
from skd_evaluator.ros.processes import CONTROLLER, graph_programs
from skd_sim.errors import UsageError
from skd_sim.options.car_and_adversary import CarUnderTest
from skd_sim.ros_environment.installation import (
    GUARD,
    foreign_variables,
    is_sourced,
    library_folders,
    message_variables,
    node_variables,
)

pytestmark = pytest.mark.skipif(is_sourced(), reason="a ROS 2 is sourced, so no wheels are used")
PATH = "LD_LIBRARY_PATH"
names = st.text(st.characters(codec="ascii", exclude_characters="\0=:"), min_size=1, max_size=8)
paths = st.lists(names.map(lambda name: f"/opt/{name}"), max_size=3).map(os.pathsep.join)


@given(environment=st.dictionaries(names, names, max_size=4), own=paths)
def test_what_is_added_can_be_taken_away(environment, own):
    before = {**environment, PATH: own} if own else environment
    ours = node_variables(before)
    assert ours[GUARD] == "1"
    assert ours[PATH].split(os.pathsep)[: len(library_folders())] == library_folders()
    assert foreign_variables(ours) == foreign_variables(before) == {k: v for k, v in before.items() if k != GUARD}
    assert node_variables(ours) == ours


def test_a_controller_that_is_not_ours_inherits_neither():
    options = GraphOptions(controller_command="my_stack --fast")
    programs = graph_programs(
        options, CarUnderTest("external"), node_variables({"PATH": "/usr/bin", PATH: "/opt/stack/lib"}), composed=False
    )
    theirs = programs[CONTROLLER].environment
    assert theirs[PATH] == "/opt/stack/lib"
    assert GUARD not in theirs
    assert theirs["PATH"].split(os.pathsep)[1:] == ["/usr/bin"]
    for name in ("vehicle_simulator", "adversary"):
        assert programs[name].environment[PATH].startswith(library_folders()[0])


def python(program: str, **changes: str | None) -> subprocess.CompletedProcess[str]:
    environment = {**foreign_variables(os.environ), **changes}
    command = [sys.executable, "-c", program]
    chosen = {name: value for name, value in environment.items() if value is not None}
    return subprocess.run(command, env=chosen, capture_output=True, text=True, timeout=PATIENCE)


def test_a_process_begins_anew_only_where_it_has_to():
    begun = "from skd_sim.ros_environment.installation import enter_ros; print('begun')"
    program = f"{begun}; enter_ros(); import rclpy; print('there')"
    assert python(program, **{GUARD: "1"}).stdout == "begun\nbegun\nthere\n"
    assert python(program, **node_variables({})).stdout == "begun\nthere\n"


def test_a_plain_python_of_the_environment_can_import_it():
    """A user's own script, started by nobody of ours."""
    assert python("import rclpy, skd_msgs.msg; print(rclpy.__name__)").stdout == "rclpy\n"


def test_messages_of_a_user_are_found_and_a_program_begins_anew_only_once(tmp_path):
    """Whatever order the variables have come to: a program that compares them with its own must find them the same."""
    bare = {"PATH": "/bin", "LD_LIBRARY_PATH": "/theirs"}
    assert message_variables(bare, None) == bare
    first = message_variables(bare, tmp_path)
    assert first["LD_LIBRARY_PATH"].split(":") == [str(tmp_path / "lib"), "/theirs"]
    assert first["PYTHONPATH"].startswith(str(tmp_path))
    assert message_variables(first, tmp_path) == first
    begun = node_variables(first)
    assert node_variables(message_variables(begun, tmp_path)) == begun


def test_security_that_the_wheels_do_not_have(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every node would fail with a traceback of its own."""
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    for name in ("ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_PYTHON_CHECK_FIELDS"):
        monkeypatch.setenv(name, os.environ.get(name, ""))  # which it may set
    monkeypatch.setattr(session, "ensure_ros", lambda: None)
    monkeypatch.setattr(session, "is_sourced", lambda _variables: False)
    with pytest.raises(UsageError, match="ROS_SECURITY_ENABLE=true needs security libraries"):
        session.prepare_ros(GraphOptions())
