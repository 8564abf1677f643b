"""Results say what they are of: by a schema, and by what ran, when and where."""

from __future__ import annotations

import json
import subprocess
from datetime import UTC, datetime
from pathlib import Path

from cli_support import SMALL
from common import assert_valid
from skd_evaluator.provenance import git_revision


def content(folder: Path) -> dict[str, object]:
    return json.loads((folder / "assessment.json").read_text(encoding="utf-8"))


def test_an_assessment_says_what_ran(skd_here, here, monkeypatch):
    monkeypatch.syspath_prepend(here)
    begin = datetime.now(UTC).replace(microsecond=0)
    command = ["assess", *SMALL, "-p", "curve:=true", "--margin-limit", "20", "--safe", "good.csv", "--objective"]
    done = skd_here(
        *command, "deviation", "--adversary-model", "generic", "--controller", "my_cars:Fine", "--out", "out dir"
    )
    assert done.returncode == 0, done.stderr
    result = content(here / "out dir")
    assert_valid(result)
    assert done.stdout.splitlines()[-1].startswith(f"{result['seconds']:.1f} s; results in out dir; --details")
    said = result["provenance"]
    assert begin <= datetime.fromisoformat(said["date"]) <= datetime.now(UTC)
    assert said["command"].startswith("skd assess --safe-count 1 ")
    assert "--out 'out dir'" in said["command"]
    assert Path(said["folder"]) == here
    assert [one["path"] for one in said["controller_files"]] == [str(here / "my_cars.py")]
    assert said["car_model_sha256"] is None


def test_git_revision_is_of_the_checkout_that_the_code_is_in(tmp_path, monkeypatch):
    code = tmp_path / "package" / "code.py"
    code.parent.mkdir()
    code.write_text("1\n")
    assert git_revision(code) is None  # nobody's checkout

    def git(*words: str) -> str:
        identity = ["-c", "user.name=n", "-c", "user.email=e", "-c", "commit.gpgsign=false"]
        return subprocess.run(
            ["git", "-C", tmp_path, *identity, *words], check=True, capture_output=True, text=True
        ).stdout

    git("init", "-q")
    assert git_revision(code) is None  # an installation inside of one
    git("add", ".")
    git("commit", "-qm", "first")
    monkeypatch.setenv("GIT_DIR", "/nowhere")  # as inside a hook
    first = git_revision(code)
    monkeypatch.delenv("GIT_DIR")
    assert first == {"revision": git("rev-parse", "HEAD").strip(), "modified": False}
    code.write_text("2\n")
    assert git_revision(code) == {**first, "modified": True}
