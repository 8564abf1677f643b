"""At a first run the searches for the margin compile beside the planners, in a process that leaves nothing behind."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest
from common import wait_until
from skd_evaluator.assessment.stages import margin as ahead
from skd_evaluator.assessment.stages.margin import margins_compiled_in_background


@pytest.fixture
def compiled_by(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A file with the processes that have compiled: to compile takes half a minute."""
    found = tmp_path / "processes"
    found.touch()

    def note() -> None:
        with found.open("a") as file:
            file.write(f"{os.getpid()}\n")

    monkeypatch.setattr(ahead, "warm_up_margins", note)
    monkeypatch.setattr(ahead, "available_workers", lambda: 2)
    return found


def test_another_process_compiles_first(compiled_by: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ahead, "is_kept", lambda _kernel: False)
    with margins_compiled_in_background() as load:
        wait_until(compiled_by.read_text, "the other process")
        load()
    first, second = map(int, compiled_by.read_text().split())
    assert second == os.getpid() != first
    with pytest.raises(ProcessLookupError):
        os.kill(first, 0)


def test_it_ends_with_what_failed(monkeypatch: pytest.MonkeyPatch, compiled_by: Path) -> None:
    begun: list[int] = []
    fork = os.fork
    monkeypatch.setattr(ahead, "is_kept", lambda _kernel: False)
    monkeypatch.setattr(ahead, "warm_up_margins", lambda: time.sleep(1000.0))
    monkeypatch.setattr(os, "fork", lambda: begun.append(child := fork()) or child)
    with pytest.raises(KeyboardInterrupt), margins_compiled_in_background():
        raise KeyboardInterrupt
    with pytest.raises(ProcessLookupError):
        os.kill(begun[0], 0)


def test_it_ends_with_the_one_that_began_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(ahead, "is_kept", lambda _kernel: False)
    monkeypatch.setattr(ahead, "available_workers", lambda: 2)
    monkeypatch.setattr(ahead, "warm_up_margins", lambda: time.sleep(1000.0))
    number = tmp_path / "number"
    if (parent := os.fork()) == 0:
        with margins_compiled_in_background():
            children = Path(f"/proc/self/task/{os.getpid()}/children").read_text()
            number.with_suffix(".part").write_text(children)
            number.with_suffix(".part").rename(number)
            time.sleep(1000.0)
    wait_until(number.exists, "the process that compiles")
    (child,) = map(int, number.read_text().split())
    os.kill(parent, signal.SIGKILL)
    os.waitpid(parent, 0)

    def has_ended() -> bool:
        status = Path(f"/proc/{child}/status")
        return not status.exists() or "State:\tZ" in status.read_text()  # where nobody waits for orphans

    wait_until(has_ended, "its end")
