"""`skd doctor`: what is there, what is missing and for what."""

import json
from typing import Any

import pytest
from skd_evaluator.cli.commands import doctor
from skd_evaluator.cli.main import main

ANSWER = {"packages": {"rclpy": True, "tf2_ros": False}, "middleware": "rmw_fastrtps_cpp", "round_trip": 0.2}


@pytest.fixture(autouse=True)
def ready(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "is_ready", lambda: True)
    monkeypatch.setattr(doctor, "is_sourced", lambda: False)


def of_ros(answer: dict[str, Any]) -> dict[str, doctor.Finding]:
    return {one.name: one for one in doctor._ros(round_trip=True, ask=lambda: answer)}


def test_here_all_that_is_needed_is_there(capsys):
    assert main(["doctor", "--no-round-trip"]) == 0
    assert "All that SKD needs is there" in capsys.readouterr().out
    assert main(["doctor", "--no-round-trip", "--json"]) == 0
    found = {one["name"]: one for one in json.loads(capsys.readouterr().out)["findings"]}
    assert {one["state"] for one in found.values()} <= {doctor.FINE, doctor.ABSENT}
    assert f"numpy {__import__('numpy').__version__}" in found["packages"]["text"]


def test_what_is_needed_and_missing_is_an_error(capsys, monkeypatch):
    monkeypatch.setattr(doctor, "PACKAGES", ("numpy", "a_package_that_nobody_has"))
    assert main(["doctor", "--no-round-trip"]) == 1
    captured = capsys.readouterr()
    assert "!! packages: a_package_that_nobody_has cannot be imported: cd " in captured.out
    assert captured.err.startswith("skd doctor: packages")


def test_without_ros_nothing_is_installed(monkeypatch):
    monkeypatch.setattr(doctor, "is_ready", lambda: False)
    (found,) = doctor._ros(round_trip=True, ask=lambda: pytest.fail("nodes are started"))
    assert found.state == doctor.ABSENT


def test_packages_and_the_round_trip():
    found = of_ros(ANSWER)
    assert found["ROS 2 packages"].text == "rclpy"
    assert found["further packages"].text.startswith("tf2_ros; ")
    assert found["round trip"].state == doctor.FINE
    lost = of_ros({**ANSWER, "round_trip": None})
    assert lost["round trip"].state == doctor.BROKEN
    (dead,) = of_ros({"error": "ImportError: librcl.so"}).values()
    assert dead.state == doctor.BROKEN
    assert "librcl.so" in dead.text
