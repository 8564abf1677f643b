"""The file of a report is there whole or not at all, and nothing else is."""

from __future__ import annotations

from pathlib import Path

import pytest
from skd_evaluator.cli.commands import report
from skd_evaluator.errors import AssessmentError
from skd_evaluator.temporary_folders import _machine


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
