"""A node that is told to end while it is being made ends quietly; any other failure is said."""

from __future__ import annotations

import pytest
import rclpy
from rclpy.node import Node
from skd_sim.nodes.support import run_node


def test_an_end_during_the_start_is_no_error() -> None:
    def make() -> Node:
        rclpy.shutdown()
        raise RuntimeError("publisher's context is invalid")

    assert run_node(make, []) == 0


def test_a_failure_during_the_start_is_said() -> None:
    def make() -> Node:
        raise RuntimeError("no such device")

    with pytest.raises(RuntimeError, match="no such device"):
        run_node(make, [])
    assert not rclpy.ok()
