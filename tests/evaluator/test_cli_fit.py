"""`skd probe`, `skd fit` and `--car-model` as their user meets them."""

import contextlib
import io
import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from common import run_skd as run
from skd_adversary.car_models.car_model_file import read_car_model


@pytest.fixture(scope="module")
def probe(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("probe") / "probe"
    assert run("probe", "--multiplier", "0.75", "--episodes", "60", "--workers", "1", "--out", folder) == 0
    return folder


@pytest.fixture(scope="module")
def model(probe) -> Path:
    """Of a car that the families describe: nothing is to be warned of."""
    folder = probe.parent / "model"
    with contextlib.redirect_stderr(io.StringIO()) as said:
        assert run("fit", probe, "--out", folder) == 0
    assert "warning" not in said.getvalue()
    return folder


def test_probe_leaves_logs(probe):
    summary = json.loads((probe / "probe.json").read_text())
    with np.load(probe / "episodes.npz") as arrays:
        assert len(arrays["offsets"]) - 1 == summary["episodes"] == 60
        assert arrays["car"].shape == (summary["ticks"] + 60, 3)
    assert sum(summary["outcomes"].values()) == 60


def test_fit_writes_the_model(model):
    data = yaml.safe_load((model / "car_model.yaml").read_text())
    trigger = data["parameters"]["trigger"]
    assert trigger["estimate"] == pytest.approx(0.75 * 9.9206349, rel=0.03)
    assert trigger["interval"][0] <= trigger["estimate"] <= trigger["interval"][1]
    assert data["measure"] == "distance"
    assert data["logs"] == 60


def test_a_car_that_no_family_describes_is_called_so(tmp_path, capsys):
    """cal brakes for any part of a tick."""
    cart = ("--scenario", "citr_crossing", "--episodes", "100")
    assert run("probe", "--controller", "cal", *cart, "--out", tmp_path / "probe") == 0
    assert run("fit", tmp_path / "probe", "--out", tmp_path / "cal") == 0
    err = capsys.readouterr().err
    assert "warning: held-out ticks contradict the model" in err
    assert "warning: deceleration_noise is 0.9, the end of its range" in err


def test_assess_with_the_model(model, tmp_path, capsys):
    out = tmp_path / "assessment"
    small = ["--safe-count", "1", "--kamikaze-count", "3", "--collision-runs", "4", "--simulations", "60"]
    arguments = ["assess", "--multiplier", "0.75", *small, "--safe", "own", "--workers", "1", "--json"]
    assert run(*arguments, "--car-model", model, "--out", out) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["pairs"] == 3
    assert result["car_model"]["chosen"] == "distance"
    assert result["per_safe_trajectory"][0]["name"].startswith("own/")
    # An assessment's own episodes can be fitted too: those of both objectives, and the runs along φ.
    episodes = sum(figures["trials"] for figures in result["objectives"].values()) + 4
    assert episodes >= 3 + 3 + 4
    assert run("fit", out, "--out", tmp_path / "refit", "--json") == 0
    assert json.loads(capsys.readouterr().out)["logs"] == episodes


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (["fit", "missing"], ["missing", "no such file"]),
        (["fit", "empty"], ["empty", "neither recordings nor episodes.npz"]),
        (["fit", "alone/episodes.npz"], ["probe.json or assessment.json beside it"]),
        (["assess", "--car-model", "missing.yaml"], ["missing.yaml", "cannot be read"]),
        (["probe", "--controller", "external"], ["add --graph"]),
        (["probe", "--pacing", "real_time"], ["--pacing is for the node graph", "add --graph"]),
        (["probe", "--graph", "--controller", "external", "-p", "reset:=restart"], ["needs --controller-command"]),
        (["probe", "--graph", "-p", "reset:=lifecycle"], ["reset lifecycle and lifecycle_nodes", "go together"]),
        (["episode", "-p", "command_type:=twist"], ["--command-type goes with --controller external"]),
        (["probe", "--controller", "cal", "--multiplier", "0.5"], ["--multiplier", "basic controller", "cal has none"]),
        (["fit", "list.yaml"], ["list.yaml", "give episodes.npz"]),
        (["assess", "--safe", "synthetik"], ["synthetik", "nor one of synthetic, own, walkers, regulatory"]),
        (["sweep", "--safe", "own"], ["--safe own goes with skd assess"]),
    ],
)
def test_bad_input_is_one_line(probe, tmp_path, monkeypatch, capsys, arguments, parts):
    for folder in ("empty", "alone"):
        (tmp_path / folder).mkdir()
    (tmp_path / "alone" / "episodes.npz").write_bytes((probe / "episodes.npz").read_bytes())
    (tmp_path / "list.yaml").write_text("- 1\n")
    monkeypatch.chdir(tmp_path)
    assert run(*arguments) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"skd {arguments[0]}: error: ")
    for part in parts:
        assert part in line
    assert not (tmp_path / "skd_results").exists()


def test_logs_of_several_cars_are_refused(probe, tmp_path, capsys):
    assert run("probe", "--multiplier", "1.1", "--episodes", "2", "--out", tmp_path / "other") == 0
    assert run("fit", probe, tmp_path / "other", "--out", tmp_path / "model") == 2
    err = capsys.readouterr().err
    assert "several cars: basic, C = 0.75 and basic, C = 1.1" in err
    assert not (tmp_path / "model").exists()


def test_an_episode_that_is_given_twice_counts_once(probe, model, tmp_path):
    assert run("fit", probe, probe / "episodes.npz", "--out", tmp_path / "twice") == 0
    assert (tmp_path / "twice" / "car_model.yaml").read_text() == (model / "car_model.yaml").read_text()


def test_a_model_of_another_car_is_refused(model, tmp_path, capsys):
    arguments = ("--car-model", model, "--scenario", "citr_crossing", "--out", tmp_path / "out")
    assert run("assess", *arguments) == 2
    assert "front is 2.25 m" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_of_a_car_that_evades_it_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    car = Path(__file__).parents[2] / "examples" / "evasive" / "evasive.py"
    lanes = ("--scenario", "oncoming_lane", "--controller", f"{car}:OtherLane")
    assert run("probe", *lanes, "--episodes", "24", "--workers", "1", "--out", tmp_path / "probe") == 0
    assert run("fit", tmp_path / "probe", "--out", tmp_path / "fit") == 0
    assert "by a forest of recorded ticks, which say where it evades to" in capsys.readouterr().out
    forest = read_car_model(tmp_path / "fit").forest
    assert forest.evades
