"""The file of a report is there whole or not at all, and nothing else is."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest
from skd_evaluator.cli.commands import report
from skd_evaluator.errors import AssessmentError
from skd_evaluator.files import begin_command, what_is_in_place
from skd_evaluator.temporary_folders import _machine, remove


def test_what_a_killed_report_has_left_goes_with_the_next(tmp_path: Path) -> None:
    """A temporary file was nobody's: no run could tell that its process had died."""
    left = tmp_path / f".skd-{_machine()}-1-99999999999-abc"
    left.mkdir()
    (left / "out.html").write_text("<html>")
    report._write(tmp_path / "out.html", "whole", overwrite=True)
    assert [path.name for path in tmp_path.iterdir()] == ["out.html"]
    assert (tmp_path / "out.html").read_text() == "whole"


def test_a_file_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(AssessmentError, match=r"--out .*/file/out.html: nothing was written: "):
        report._write(tmp_path / "file" / "out.html", "whole", overwrite=True)


def test_what_cannot_be_finished_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", fails)
    with pytest.raises(AssessmentError, match="nothing was written: No space left on device"):
        report._write(tmp_path / "out.html", "whole", overwrite=True)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("links", [True, False])
def test_of_two_reports_at_once_the_second_does_not_replace_the_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, links: bool
) -> None:
    if not links:  # on some file systems: there the name is taken as it was

        def refused(*_: object) -> None:
            raise PermissionError(1, "Operation not permitted")

        monkeypatch.setattr(Path, "hardlink_to", refused)
    report._write(tmp_path / "out.html", "first", overwrite=False)
    if links:
        with pytest.raises(AssessmentError, match="nothing was written: File exists"):
            report._write(tmp_path / "out.html", "second", overwrite=False)
    assert [path.name for path in tmp_path.iterdir()] == ["out.html"]
    assert (tmp_path / "out.html").read_text() == "first"


def test_an_interrupt_after_it_is_written_does_not_say_that_nothing_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begin_command()
    link = Path.hardlink_to

    def interrupted(self: Path, target: Path) -> None:
        link(self, target)
        raise KeyboardInterrupt

    monkeypatch.setattr(Path, "hardlink_to", interrupted)
    with pytest.raises(KeyboardInterrupt):
        report._write(tmp_path / "out.html", "whole", overwrite=False)
    assert what_is_in_place() == f"results are in {tmp_path / 'out.html'}"
    assert [path.name for path in tmp_path.iterdir()] == ["out.html"]


def test_an_interrupt_while_a_folder_is_removed_leaves_nothing_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "folder" / "inside").mkdir(parents=True)
    removed, times = shutil.rmtree, []

    def once(*words: Any, **named: Any) -> None:
        times.append(0)
        if len(times) == 1:
            raise KeyboardInterrupt
        removed(*words, **named)

    monkeypatch.setattr(shutil, "rmtree", once)
    with pytest.raises(KeyboardInterrupt):
        remove(tmp_path / "folder")
    assert list(tmp_path.iterdir()) == []
