"""skd campaign: cells, failures, interrupts and resumption."""

import csv
import json
import shutil
import signal
import subprocess
import sys
import textwrap
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_support import names, one_line
from common import PATIENCE, assert_valid, refused, wait_until
from report_support import edit
from skd_evaluator.assessment.files.episode_store import FILE_NAME, EpisodeStore
from skd_evaluator.assessment.files.verification import verify
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.extensions.campaign import results
from skd_evaluator.extensions.campaign.campaign import CampaignFolder
from skd_evaluator.extensions.campaign.cells import make_cells, read_campaign
from skd_sim import Mode
from skd_sim.errors import OutOfReachError

SIZES = {"safe_count": 1, "kamikaze_count": 2, "collision_runs": 3, "simulations": 20, "objective": "deviation"}
SIZES |= {"margin_limit": 8, "behaviour": "none"}
OPTIONS = [word for key, value in SIZES.items() for word in (f"--{key.replace('_', '-')}", str(value))]
TWO = """
cars:
  - controller: basic
sweep: {multiplier: [0.75, 1.0]}
"""


def write(here: Path, text: str, name: str = "campaign.yaml", **more: Any) -> Path:
    defaults = f"defaults: {json.dumps({**SIZES, 'safe': 'good.csv', **more})}\n"
    (here / name).write_text(defaults + textwrap.dedent(text))
    return here / name


def figures(folder: Path) -> dict[str, Any]:
    content = json.loads((folder / "assessment.json").read_text())
    assert_valid(content)
    return {key: value for key, value in content.items() if key not in ("seconds", "provenance")}


def campaign(here: Path, out: str = "out") -> dict[str, Any]:
    return dict(json.loads((here / out / "campaign.json").read_text()))


def stored(here: Path, out: str = "out") -> int:
    store = EpisodeStore(here / out / FILE_NAME)
    try:
        return store.count()
    finally:
        store.close()


class MainThreadPopen(subprocess.Popen):
    """A program that a thread starts would wait for the end of a worker that another thread forks at that moment."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        assert threading.current_thread() is threading.main_thread()
        super().__init__(*arguments, **named)


def test_each_cell_is_what_assess_gives(here, skd_here, monkeypatch):
    write(here, TWO)
    monkeypatch.setattr(subprocess, "Popen", MainThreadPopen)
    done = skd_here("campaign", "campaign.yaml", "--out", "out", "--workers", "2", "--json")
    assert done.returncode == 0, done.stderr
    rows = json.loads(done.stdout)["cells"]
    assert [row["name"] for row in rows] == ["basic-C0.75", "basic-C1"]
    assert rows == campaign(here)["cells"]
    for row, multiplier in zip(rows, ("0.75", "1.0"), strict=True):
        cell = here / "out" / row["name"]
        words = ["assess", *OPTIONS, "--safe", "good.csv", "--multiplier", multiplier, "--workers", "1"]
        assert skd_here(*words, "--out", row["name"]).returncode == 0
        assert names(cell) == names(here / row["name"])
        assert (cell / "episodes.npz").read_bytes() == (here / row["name"] / "episodes.npz").read_bytes()
        assert figures(cell) == figures(here / row["name"])
        for name in ("margin", "deviation"):
            assert row[name] == figures(cell)[name] is not None
        assert (row["adversary_model"], row["ranking_objective"]) == ("exact", "deviation")
        with np.load(cell / "episodes.npz") as arrays:
            assert row["episodes"] == (arrays["mode"] != Mode.SAFE).sum()
    with (here / "out" / "campaign.csv").open(newline="") as file:
        table = list(csv.DictReader(file))
    assert [float(line["skd"]) for line in table] == [row["skd"] for row in rows]
    assert [line["adversary_model"] for line in table] == ["exact", "exact"]
    assert campaign(here)["planned_refusal"] == ""
    assert names(here / "out") == [".lock", "basic-C0.75", "basic-C1", "campaign.csv", "campaign.json", "cells.json"]
    assert skd_here("report", "out", "--out", "report.html").returncode == 0
    # What is done is left alone, and a campaign that is done has nothing to do but to remove what was of use till then.
    (here / "out" / FILE_NAME).write_bytes(b"left by one that was killed after its last cell")
    assert skd_here("campaign", "campaign.yaml", "--out", "out", "--resume").returncode == 0
    assert not (here / "out" / FILE_NAME).exists()
    before = (here / "out" / "basic-C1" / "assessment.json").stat().st_mtime_ns
    shutil.rmtree(here / "out" / "basic-C0.75")
    again = skd_here("campaign", "campaign.yaml", "--out", "out", "--workers", "1", "--resume")
    assert again.returncode == 0
    assert "1 of 2 cells done" in again.stderr
    assert (here / "out" / "basic-C1" / "assessment.json").stat().st_mtime_ns == before
    assert figures(here / "out" / "basic-C0.75") == figures(here / "basic-C0.75")


def test_what_would_be_run_is_said_without_running_it(here, skd_here):
    write(here, TWO, curve=True)
    done = skd_here("campaign", "campaign.yaml", "--dry-run", "--json")
    content = json.loads(done.stdout)
    assert [(row["name"], row["episodes"]) for row in content["cells"]] == [("basic-C0.75", 9), ("basic-C1", 9)]
    assert (content["episodes"], content["most"]) == (18, 22)
    assert "2 cells, 18 episodes" in skd_here("campaign", "campaign.yaml", "--dry-run").stdout
    assert names(here) == ["campaign.yaml", "good.csv", "my_cars.py"]


def test_a_cell_that_fails_costs_no_other(here, skd_here, monkeypatch):
    monkeypatch.syspath_prepend(here)
    write(here, "cars: [{controller: my_cars:Raises}, {controller: my_cars:Fine}]", adversary_model="generic")
    done = skd_here("campaign", "campaign.yaml", "--out", "out", "--workers", "1")
    assert done.returncode == 1
    assert "my_cars-Raises: failed: " in done.stderr
    assert "ZeroDivisionError" in done.stderr
    assert [row["state"] for row in campaign(here)["cells"]] == ["failed", "done"]
    assert "assessment.json" in names(here / "out" / "my_cars-Fine")
    assert not (here / "out" / "my_cars-Raises").exists()
    # Put right, it is another car: what it did before does not count for it.
    one_line(skd_here("campaign", "campaign.yaml", "--out", "out"), 2, "--out out", "--resume")
    (here / "my_cars.py").write_text((here / "my_cars.py").read_text().replace("1 / 0", "0.0"))
    refused = skd_here("campaign", "campaign.yaml", "--out", "out", "--resume")
    one_line(refused, 2, "--out out", f"{here / 'my_cars.py'}", "of a car has changed", "give another --out")
    done = skd_here("campaign", "campaign.yaml", "--out", "out", "--overwrite", "--workers", "1")
    assert done.returncode == 0
    assert [row["state"] for row in campaign(here)["cells"]] == ["done", "done"]


WAITS = """
import sys
from skd_evaluator.extensions.campaign import campaign
from skd_evaluator.start import skd

campaign._FAREWELL = 10_000.0
sys.exit(skd())
"""
"""`skd`, which would never end if it waited for a cell that has not begun."""


@pytest.fixture
def begun(here: Path) -> Iterator[subprocess.Popen[str]]:
    """A campaign that is at work, with some episodes stored."""
    write(here, "sweep: {seed: [0, 1]}", kamikaze_count=200, simulations=2000)
    command = [sys.executable, "-c", WAITS, "campaign", "campaign.yaml", "--out", "out", "--workers", "1"]
    process = subprocess.Popen(command, cwd=here, stderr=subprocess.PIPE, text=True)
    wal = here / "out" / f"{FILE_NAME}-wal"
    wait_until(lambda: process.poll() is not None or (wal.exists() and wal.stat().st_size > 20_000))
    yield process
    process.kill()
    process.wait()


def test_an_interrupted_campaign_says_how_to_go_on(here, begun, skd_here):
    one_line(skd_here("campaign", "campaign.yaml", "--out", "out", "--resume"), 2, "another campaign is running there")
    begun.send_signal(signal.SIGINT)
    _, said = begun.communicate(timeout=PATIENCE)
    assert begun.returncode == 130, said
    first = said.splitlines()[-1]
    assert "interrupted; 0 of 2 cells done, and " in first
    assert first.endswith("; go on with: skd campaign campaign.yaml --out out --workers 1 --resume")
    kept = stored(here)
    assert f"and {kept} episodes of the others kept" in first
    assert kept > 0
    assert [row["state"] for row in campaign(here)["cells"]] == ["open", "open"]
    # Whatever makes it another campaign is said, and nothing is lost by it.
    for text, part in (
        ("sweep: {seed: [0, 1, 2]}", "cell basic-C1_seed=2 has come"),
        ("sweep: {seed: [0]}", "cell basic-C1_seed=1 has gone"),
        ("sweep: {seed: [0, 1]}\ncars: [{particles: 9}]", "particles of cell basic-C1_seed=0 has changed from 0 to 9"),
        (
            "sweep: {seed: [0, 1]}\ncars: [{scenario.eta_max: 4}]",
            "scenario.eta_max of cell basic-C1_seed=0 has changed from 5.0 to 4.0",
        ),
    ):
        write(here, text, kamikaze_count=200, simulations=2000)
        one_line(skd_here("campaign", "campaign.yaml", "--out", "out", "--resume"), 2, part, "give another --out")
    (here / "good.csv").write_text("t,x,y\n0,-3,0\n2.1,3,0\n")
    write(here, "sweep: {seed: [0, 1]}", kamikaze_count=200, simulations=2000)
    refused = skd_here("campaign", "campaign.yaml", "--out", "out", "--resume")
    one_line(refused, 2, "safe_trajectories of cell basic-C1_seed=0 has changed")
    assert stored(here) == kept


class Fleeting(InProcessRunner):
    """What is gone after two episodes, as a cluster may be."""

    def run(self, episodes):
        yield from super().run(episodes[:2])
        raise OutOfReachError("the Dask scheduler tcp://nowhere:8786 is gone")


def test_a_cluster_that_is_gone_ends_the_campaign_and_fails_no_cell(here, skd_here, monkeypatch):
    write(here, TWO, kamikaze_count=3)
    monkeypatch.setattr(results, "runner_of", lambda _arguments, **_more: Fleeting(1))
    done = skd_here("campaign", "campaign.yaml", "--workers", "1", "--out", "out")
    go_on = "go on with: skd campaign campaign.yaml --workers 1 --out out --resume"
    one_line(done, 1, "tcp://nowhere:8786 is gone; 0 of 2 cells done, and 2 episodes of the others kept", go_on)
    assert stored(here) == 2
    assert [row["state"] for row in campaign(here)["cells"]] == ["open", "open"]


def test_a_damaged_store_or_result_is_said(here, skd_here):
    write(here, TWO)
    assert skd_here("campaign", "campaign.yaml", "--out", "out", "--workers", "1").returncode == 0
    assert verify(here / "out").fine
    whole = (here / "out" / "basic-C1" / "episodes.npz").read_bytes()
    resume = ("campaign", "campaign.yaml", "--out", "out", "--resume", "--workers", "1")
    edit(here / "out" / "basic-C1", {"seconds": 1})
    (problem,) = verify(here / "out").problems
    assert "cell basic-C1: assessment.json is not the file that the row is of" in problem
    one_line(skd_here(*resume), 2, "basic-C1/assessment.json: is not what was written", "--resume makes it again")
    shutil.rmtree(here / "out" / "basic-C1")
    shutil.copytree(here / "out" / "basic-C0.75", here / "out" / "basic-C1")
    one_line(skd_here(*resume), 2, "is not what was written")
    shutil.rmtree(here / "out" / "basic-C1")
    (here / "out" / FILE_NAME).write_bytes(b"\0" * 5000)
    one_line(skd_here(*resume), 1, FILE_NAME, "damaged", "delete it")
    (here / "out" / FILE_NAME).unlink()
    assert skd_here(*resume).returncode == 0
    assert (here / "out" / "basic-C1" / "episodes.npz").read_bytes() == whole


def test_what_a_folder_may_be(here, skd_here):
    write(here, TWO)
    (here / "mine").mkdir()
    (here / "mine" / "letter.txt").write_text("dear")
    for words, part in (
        (["--out", "mine"], "holds no campaign (letter.txt)"),
        (["--out", "mine", "--overwrite"], "holds no campaign (letter.txt)"),
        (["--out", "good.csv"], "is a file"),
        (["--resume"], "--resume needs --out"),
        (["--out", "x", "--resume", "--overwrite"], "give one of them"),
    ):
        one_line(skd_here("campaign", "campaign.yaml", *words), 2, part)
    assert names(here / "mine") == ["letter.txt"]
    assert not (here / "x").exists()


CAR = """
from pathlib import Path
from the_law import decide
class Car:
    def __init__(self): self.gain = float(Path(__file__).with_name("weights.bin").read_text())
    def reset(self, scenario, rng): pass
    def command(self, car, adversary): return decide(self.gain)
"""


CHANGES = {"weights.bin": "2", "the_law.py": "def decide(gain): return gain\n", "nets/new.bin": "1"}


@pytest.mark.parametrize(("name", "text"), [*CHANGES.items(), ("weights.bin", None)])
def test_another_car_behind_the_same_module_is_refused(here, monkeypatch, name, text):
    monkeypatch.syspath_prepend(str(here))
    (here / "read_car.py").write_text(CAR)
    (here / "the_law.py").write_text("def decide(gain): return -gain\n")
    (here / "weights.bin").write_text("1")
    (here / "nets").mkdir()
    write(here, "cars: [{controller: 'read_car:Car'}]", adversary_model="generic")
    combinations = read_campaign(here / "campaign.yaml")
    cells = make_cells(combinations)
    CampaignFolder(here / "out", cells).close()
    CampaignFolder(here / "out", cells, resume=True).close()
    monkeypatch.setattr("skd_evaluator.extensions.campaign.cells.check_car", lambda _values, scenario, **_how: scenario)
    CampaignFolder(here / "out", make_cells(combinations), resume=True).close()  # what it has written is no other car
    if text is None:
        (here / name).unlink()
    else:
        (here / name).write_text(text)
    how = "gone" if text is None else "come" if name == "nets/new.bin" else "changed"
    with refused(f"file {here / name} of a car has {how} since this campaign began"):
        CampaignFolder(here / "out", make_cells(combinations), resume=True)
