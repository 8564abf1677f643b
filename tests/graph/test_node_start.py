"""A node that is told to end while it is being made ends quietly; any other failure is said."""

from __future__ import annotations

import contextlib
import os
import signal
import time

import pytest
import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions, get_current_signal_handlers_options
from skd_sim.ros.support import run_node


def swallow_an_interrupt() -> None:
    """Do as code of others does that loses a signal: numba while LLVM works, or a bare `except`."""
    with contextlib.suppress(KeyboardInterrupt):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(10.0)


def test_an_end_during_the_start_is_no_error() -> None:
    def make() -> Node:
        swallow_an_interrupt()
        raise RuntimeError("not compiled")

    assert run_node(make, []) == 0


def test_a_signal_that_a_callback_swallows_ends_the_node_all_the_same() -> None:
    def make() -> Node:
        node = rclpy.create_node("node")
        node.create_timer(0.01, swallow_an_interrupt, clock=Clock(clock_type=ClockType.STEADY_TIME))
        return node

    assert run_node(make, []) == 0


def test_signals_are_not_listened_to_by_a_thread_of_rclpy() -> None:
    """It would shut down what the node's own thread takes apart at the same time."""
    seen = []

    def make() -> Node:
        seen.append(get_current_signal_handlers_options())
        raise ValueError

    assert run_node(make, []) == 2
    assert seen == [SignalHandlerOptions.NO]


def test_a_failure_during_the_start_is_said() -> None:
    def make() -> Node:
        raise RuntimeError("no such device")

    with pytest.raises(RuntimeError, match="no such device"):
        run_node(make, [])
    assert not rclpy.ok()
