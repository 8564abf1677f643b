"""What holds for all tests.

A suite that a shell started in the background ignores SIGINT, and so would every program that a test interrupts.
Hypothesis tries the same examples in each run and does not mind how long one takes; new ones are tried with
`--hypothesis-profile=explore`.

Tests of whole node graphs wait for other processes on a machine whose load nobody knows. One that fails is run once
more and stands in the summary as RERUN; what fails twice fails.
"""

from __future__ import annotations

import signal
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

settings.register_profile("explore", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("same", settings.get_profile("explore"), derandomize=True)
settings.load_profile("same")

_GRAPHS = tuple(Path(__file__).resolve().parent / name for name in ("graph", "packaging"))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Let a test of whole node graphs fail once."""
    for item in items:
        if any(item.path.is_relative_to(folder) for folder in _GRAPHS):
            item.add_marker(pytest.mark.flaky(reruns=1))
