"""A result folder appears whole or not at all."""

from pathlib import Path

import pytest
from cli_support import names
from skd_evaluator.assessment.files.result_folder import MANIFEST, ResultFolder, write_json
from skd_evaluator.report.presentation import with_scratch
from skd_sim.errors import AssessmentError, UsageError


def fill(folder: Path) -> None:
    write_json(folder / "assessment.json", {"skd": 1.0})
    (folder / "part").mkdir()
    (folder / "part" / "episodes.npz").write_bytes(b"new")


def old_results(folder: Path) -> None:
    folder.mkdir()
    (folder / "assessment.json").write_text("old")
    (folder / "left_over.txt").write_text("old")


def content(folder: Path) -> dict[str, str]:
    files = [path for path in folder.rglob("*") if path.is_file() and path.name != MANIFEST]
    return {str(path.relative_to(folder)): path.read_text() for path in files}


def test_new_folder_appears_with_its_parents(tmp_path):
    out = ResultFolder(tmp_path / "a" / "b" / "out")
    assert names(tmp_path / "a" / "b") == ["out"]  # it is taken, and nothing else is there
    assert content(tmp_path) == {}
    out.write(fill)
    assert set(content(tmp_path)) == {"a/b/out/assessment.json", "a/b/out/part/episodes.npz"}


def test_nothing_is_seen_before_all_is_written(tmp_path):
    def look(folder: Path) -> None:
        fill(folder)
        assert folder.parent == tmp_path  # the same file system, or it could not be renamed
        assert names(tmp_path / "out") == []

    ResultFolder(tmp_path / "out").write(look)
    assert names(tmp_path) == ["out"]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, OSError])
def test_failure_leaves_the_old_results(tmp_path, error):
    old_results(tmp_path / "out")
    before = content(tmp_path)

    def fail(folder: Path) -> None:
        fill(folder)
        raise error

    with pytest.raises(error):
        ResultFolder(tmp_path / "out", overwrite=True).write(fail)
    assert content(tmp_path) == before
    assert names(tmp_path) == ["out"]


@pytest.mark.parametrize("overwrite", [False, True])
def test_foreign_folder_file_and_current_folder_are_refused(tmp_path, monkeypatch, overwrite):
    (tmp_path / "foreign").mkdir()
    (tmp_path / "foreign" / "photo.jpg").touch()
    (tmp_path / "empty").mkdir()
    monkeypatch.chdir(tmp_path / "empty")
    for out, message in (
        (tmp_path / "foreign", "holds no SKD results"),
        (tmp_path / "foreign" / "photo.jpg", "is a file"),
        (tmp_path / "foreign" / "photo.jpg" / "out", "cannot be written"),
        (Path(), "current folder"),
    ):
        with pytest.raises(UsageError, match=message):
            ResultFolder(out, overwrite=overwrite)
    assert content(tmp_path) == {"foreign/photo.jpg": ""}


def test_what_was_taken_and_not_written_is_given_back(tmp_path):
    out = ResultFolder(tmp_path / "a" / "b" / "out")
    del out
    assert names(tmp_path) == []
    (tmp_path / "empty").mkdir()
    out = ResultFolder(tmp_path / "empty")
    del out
    assert names(tmp_path) == ["empty"]  # it was there before
    ResultFolder(tmp_path / "empty").write(fill)


def logs_of_failed_work(path: Path, *, overwrite: bool = False) -> Path:
    """Fail in work that prints, and return by which name its log was found meanwhile."""
    work = ResultFolder(path, overwrite=overwrite).scratch()
    scratch = work.__enter__()
    (scratch.logs / "node.log").write_text("all that it said")
    assert (scratch.folder / "logs" / "node.log").exists()
    error = AssessmentError("a node is gone")
    assert not work.__exit__(AssessmentError, error, error.__traceback__)
    return scratch.logs / "node.log"


def test_logs_of_work_that_failed_stay_where_they_were(tmp_path):
    for _ in range(2):  # and are in nobody's way
        log = logs_of_failed_work(tmp_path / "out")
        assert log == tmp_path / "out" / "logs" / "node.log"
        assert log.read_text() == "all that it said"
        assert names(tmp_path) == ["out"]
    out = ResultFolder(tmp_path / "out")
    with out.scratch() as scratch:
        (scratch.logs / "node.log").write_text("new")
        out.write(with_scratch(scratch.folder, fill))
    assert log.read_text() == "new"
    assert not (tmp_path / "out" / "logs").is_symlink()
    old = content(tmp_path / "out")
    assert logs_of_failed_work(tmp_path / "out", overwrite=True) == tmp_path / "out.logs" / "node.log"
    assert logs_of_failed_work(tmp_path / "out", overwrite=True) == tmp_path / "out.logs-2" / "node.log"
    assert content(tmp_path / "out") == old


@pytest.mark.parametrize("there", ["nothing", "empty", "results"])
def test_second_run_is_told_at_once(tmp_path, there):
    if there == "empty":
        (tmp_path / "out").mkdir()
    if there == "results":
        old_results(tmp_path / "out")
    first = ResultFolder(tmp_path / "out", overwrite=True)
    with pytest.raises(UsageError, match=r"--out .*out: another run is about to write there; give another folder"):
        ResultFolder(tmp_path / "out", overwrite=True)
    first.write(fill)
    with pytest.raises(UsageError, match="already holds results"):
        ResultFolder(tmp_path / "out")
    assert set(content(tmp_path / "out")) == {"assessment.json", "part/episodes.npz"}
