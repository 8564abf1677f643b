"""Work in a process beside this one: files are left of it, and whether it was done."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

import pytest
from skd_evaluator.campaign.run.beside import Beside


def test_what_is_done_is_on_disk_and_said(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    def work() -> None:
        os.write(1, b"nobody is to read this")
        (tmp_path / "number").write_text(str(os.getpid()))

    with Beside(work) as beside:
        assert beside.wait()
        assert not beside.wait()  # there is nothing to wait for any more
    assert int((tmp_path / "number").read_text()) != os.getpid()
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("how", ["raises", "exits", "is killed"])
def test_work_that_failed_is_said_to_have(how: str, capfd: pytest.CaptureFixture[str]) -> None:
    def work() -> None:
        if how == "raises":
            raise ValueError("no")
        if how == "exits":
            sys.exit(0)
        os.kill(os.getpid(), 9)

    with Beside(work) as beside:
        assert not beside.wait()
    assert capfd.readouterr() == ("", "")


def test_it_ends_with_its_block() -> None:
    begin = time.monotonic()
    beside = Beside(lambda: time.sleep(1000.0))
    child = beside._child
    assert child is not None
    with pytest.raises(KeyboardInterrupt), beside:
        raise KeyboardInterrupt
    with pytest.raises(ProcessLookupError):
        os.kill(child, 0)
    assert time.monotonic() - begin < 500.0
