"""A message between two nodes, as `skd doctor` sends it."""

from __future__ import annotations

import pytest
from skd_evaluator.cli import doctor


def test_a_message_arrives(domain: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    found = {one.name: one for one in doctor._ros(round_trip=True)}
    assert found["round trip"].state == doctor.FINE
    assert "ackermann_msgs" in found["ROS 2 packages"].text


def test_nodes_that_do_not_start_are_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RMW_IMPLEMENTATION", "rmw_of_nobody")
    (broken,) = doctor._ros(round_trip=True)
    assert broken.state == doctor.BROKEN
