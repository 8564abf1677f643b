"""Logging: levels, format and filters."""

from __future__ import annotations

import re
from collections.abc import Iterator

import pytest
from rosless.clock import ROSClock
from rosless.logging import LoggingSeverity, get_logger
from rosless.time import Time

from rosless import logging


@pytest.fixture(autouse=True)
def fresh_levels() -> Iterator[None]:
    logging.clear_config()
    yield
    logging.clear_config()


def test_format(capfd: pytest.CaptureFixture[str]) -> None:
    get_logger("ns.car").info("hello {name}")
    out, err = capfd.readouterr()
    assert out == ""
    assert re.fullmatch(r"\[INFO\] \[\d+\.\d{9}\] \[ns\.car\]: hello \{name\}\n", err)


def test_the_format_can_be_chosen(capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RCUTILS_CONSOLE_OUTPUT_FORMAT", "{severity}|{name}|{message}")
    monkeypatch.setenv("RCUTILS_LOGGING_USE_STDOUT", "1")
    get_logger("car").error("broken")
    assert capfd.readouterr().out == "ERROR|car|broken\n"


def test_levels_are_inherited(capfd: pytest.CaptureFixture[str]) -> None:
    parent, child = get_logger("a"), get_logger("a.b")
    assert not child.debug("hidden")
    parent.set_level(LoggingSeverity.DEBUG)
    assert child.debug("shown")
    child.set_level(LoggingSeverity.FATAL)
    assert not child.error("hidden")
    assert parent.get_child("b") is child
    logging.set_logger_level("", LoggingSeverity.ERROR)
    assert not get_logger("other").warn("hidden")
    assert get_logger("other").get_effective_level() == LoggingSeverity.ERROR
    assert capfd.readouterr().err.count("shown") == 1


def test_filters() -> None:
    logger = get_logger("car")
    assert [logger.info("a", once=True) for _ in range(3)] == [True, False, False]
    assert [logger.info("a", skip_first=True) for _ in range(3)] == [False, True, True]
    assert [logger.info("a", throttle_duration_sec=60.0) for _ in range(3)] == [True, False, False]
    clock = ROSClock()
    clock._set_ros_time_is_active(True)
    shown = []
    for seconds in (1, 2, 3, 4, 5, 1, 2):
        clock.set_ros_time_override(Time(seconds=seconds))
        shown.append(logger.info("a", throttle_duration_sec=2.0, throttle_time_source_type=clock))
    assert shown == [True, False, True, False, True, True, False]
    with pytest.raises(TypeError):
        logger.info("a", loud=True)
