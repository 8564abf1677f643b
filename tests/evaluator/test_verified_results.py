"""`skd verify`: what it says of results, sweeps and their files."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from cli_support import one_line
from edited_results import change_array, edit
from skd_evaluator.campaign.store.manifest import MANIFEST, Held, hold, write_manifests
from skd_evaluator.campaign.store.stored_result import read_result
from skd_evaluator.campaign.store.verification import verify
from skd_sim.errors import UsageError


def test_a_result_has_a_manifest_of_all_its_files(sweep):
    for folder in (sweep, sweep / "synthetic" / "C_1"):
        lines = (folder / MANIFEST).read_text().splitlines()
        said = {line[66:]: line[:64] for line in lines}
        files = [path for path in folder.rglob("*") if path.is_file() and path != folder / MANIFEST]
        assert said == {
            path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in files
        }


def test_verify_says_which_figures_agree(result, skd_here):
    done = skd_here("verify", str(result))
    assert done.returncode == 0
    assert "fine" in done.stdout
    assert "figures recomputed, and as said" in done.stdout
    assert "margin_converged" in done.stdout  # cannot be had from the folder
    assert "can have happened" in done.stdout
    found = json.loads(skd_here("verify", str(result), "--json").stdout)
    (one,) = found["results"]
    assert found["fine"]
    assert "skd" in one["agree"]
    assert one["contradict"] == one["problems"] == one["files"]["changed"] == []


def test_verify_says_which_do_not(result, skd_here):
    edit(result, lambda figures: figures.update(skd=9.9, collision_rate=0.123), "rewritten")
    done = skd_here("verify", str(result))
    assert done.returncode == 1
    assert "contradicted: skd is 9.9, its episodes give" in done.stdout
    assert "contradicted: collision_rate is 0.123" in done.stdout
    assert "NOT FINE" in done.stdout


def test_verify_says_which_files_changed(result, skd_here):
    (result / "trajectories.png").write_bytes(b"another")
    (result / "vulnerability.png").unlink()
    (result / "notes.txt").write_text("mine")
    done = skd_here("verify", str(result))
    assert done.returncode == 1
    for line in ("trajectories.png: changed", "vulnerability.png: gone", "notes.txt: not of this result"):
        assert line in done.stdout


def test_verify_finds_an_episode_that_cannot_have_happened(result, skd_here):
    def change(values: np.ndarray) -> np.ndarray:
        return np.where(np.isfinite(values), values + 1e-9, values)

    change_array(result, "car", change)  # too little for any figure
    read_result(result)
    done = skd_here("verify", str(result))
    assert done.returncode == 1 or "did not run in SKD's own world" in done.stdout


def test_verify_reads_sweeps_older_results_and_says_what_is_none(sweep, result, skd_here, here):
    assert skd_here("verify", str(sweep)).stdout.count(": fine") == 3
    (result / MANIFEST).unlink()
    older = skd_here("verify", str(result))
    assert older.returncode == 0
    assert f"no {MANIFEST}" in older.stdout
    (here / "nothing").mkdir()
    one_line(skd_here("verify", "nothing"), 2, "holds no assessment.json")
    one_line(skd_here("verify", "nowhere"), 2, "no such folder")
    (result / "assessment.json").write_text("[" * 1000)
    assert "wrong: " in skd_here("verify", str(result)).stdout


def test_verify_holds_a_sweep_against_its_cars(sweep, tmp_path):
    shutil.copytree(sweep, tmp_path / "sweep")
    path, table = tmp_path / "sweep" / "sweep.json", tmp_path / "sweep" / "sweep.csv"
    assert verify(tmp_path / "sweep").fine
    content = json.loads(path.read_text())
    content["rows"][0]["margin"] = 4.9
    path.write_text(json.dumps(content))
    write_manifests(tmp_path / "sweep")
    problems = verify(tmp_path / "sweep").problems
    assert [line.partition(": ")[2].partition(" is 4.9")[0] for line in problems[:1]] == ["synthetic, C_0.5: margin"]
    assert f"{table}, line 2: margin is" in problems[1]


@pytest.mark.parametrize("line", ["x", f"{'0' * 64}  ../a", f"{'0' * 64}  /a", f"{'0' * 64}  a\n{'0' * 64}  a"])
def test_a_manifest_that_is_none_is_refused(result, line):
    (result / MANIFEST).write_text(line)
    with pytest.raises(UsageError, match=MANIFEST):
        read_result(result)


# --- surrogate safety measures


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda text: text.replace(",collision,0,0,", ",collision,0.25,0,", 1), "line 2: clearance is 0.25"),
        (lambda text: text.rsplit("\n", 2)[0] + "\n", "has other columns or rows"),
        (lambda text: text.replace("headway", "headroom"), "has other columns or rows"),
        (lambda text: text.replace(text.splitlines()[1], text.splitlines()[1] + ","), "the number of its cells"),
    ],
)
def test_verify_finds_surrogate_measures_that_do_not_follow(result, change, says):
    path = result / "surrogate_measures.csv"
    text = path.read_text(encoding="utf-8")
    path.write_text(change(text), encoding="utf-8")
    write_manifests(result)
    (problem,) = verify(result).problems
    assert says in problem
    path.write_text(text, encoding="utf-8")
    write_manifests(result)
    assert verify(result).fine


def test_a_result_that_goes_while_it_is_verified_is_not_fine(result, monkeypatch):
    """Its files had been held against the manifest, and its figures, which were not there any more, against nothing."""

    def hold_and_lose(folder: Path, manifest: dict[str, str]) -> Held:
        found = hold(folder, manifest)
        (folder / "assessment.json").unlink()
        return found

    monkeypatch.setattr("skd_evaluator.campaign.store.verification.hold", hold_and_lose)
    found = verify(result)
    assert not found.fine
    assert "assessment.json: cannot be read" in found.problems[0]
