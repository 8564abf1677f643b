"""`skd drive --graph`: a node of a user's, an adversary in the terminal, and nothing left of either."""

from __future__ import annotations

import shlex
import sys
import uuid
from pathlib import Path

import pytest
from common import new_domain
from forked_skd import TOKEN
from graph_support import HERE, assert_all_gone, skd_command
from terminals import Terminal

VENDOR = shlex.join([sys.executable, str(Path(HERE).parents[1] / "examples/vendor_controller/vendor_controller.py")])
NODE = ("--graph", "--controller", "external", "--controller-command")


def test_a_node_is_driven_by_keys(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    token = uuid.uuid4().hex
    variables = {TOKEN: token, "ROS_DOMAIN_ID": str(new_domain()), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    terminal = Terminal(skd_command("drive", *NODE, VENDOR), **variables)
    terminal.wait_for("press a key to begin")
    terminal.press("s")
    terminal.wait_for(r"command [+-]\d")  # it hears the node
    terminal.wait_for(r"time [1-9]")
    assert "age of the command 0." in terminal.text
    terminal.press("r")
    terminal.wait_for(r"time 0\.\d s +speed 8")  # the next has begun, with the same processes
    terminal.press("q")
    assert terminal.finish() == 0
    assert_all_gone(token)
    assert list(tmp_path.iterdir()) == []
