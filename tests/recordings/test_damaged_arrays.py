"""`skd fit` on an episodes.npz that is damaged."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from common import run_skd
from skd_evaluator.assessment.files.result_folder import MANIFEST
from skd_evaluator.bags.checks import not_credible_beside
from skd_evaluator.metrics.aborted import NOT_CREDIBLE

Arrays = dict[str, np.ndarray[Any, Any]]
Refused = Callable[..., str]


@pytest.fixture(scope="module")
def probe(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("logs") / "probe"
    arguments = ("--multiplier", 0.75, "--episodes", 24, "--workers", 1)
    assert run_skd("probe", *arguments, "--out", folder) == 0
    return folder


@pytest.fixture(scope="module")
def assessed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("logs") / "assessed"
    size = ("--safe-count", 2, "--kamikaze-count", 3, "--collision-runs", 6, "--simulations", 40, "--workers", 1)
    assert run_skd("assess", *size, "--out", folder) == 0
    return folder


@pytest.fixture(params=["probe", "assessed"])
def copy(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A copy whose manifest is gone, as whoever changes a file on purpose removes it."""
    made = Path(shutil.copytree(request.getfixturevalue(request.param), tmp_path / "copy"))
    (made / MANIFEST).unlink()
    return made


@pytest.fixture
def refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Refused:
    def check(*arguments: object) -> str:
        capsys.readouterr()
        assert run_skd("fit", *arguments, "--out", tmp_path / "model") == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith("skd fit: error: ")
        assert not (tmp_path / "model").exists()
        return line

    return check


def edited(folder: Path, edit: Callable[[Arrays], object]) -> Path:
    file = folder / "episodes.npz"
    with np.load(file) as archive:
        arrays = {name: archive[name] for name in archive.files}
    edit(arrays)
    np.savez_compressed(file, **arrays)
    return file


def put(name: str, value: float) -> Callable[[Arrays], object]:
    """Put a value into the last row of a column."""
    return lambda arrays: arrays[name].__setitem__((-1,) * arrays[name].ndim, value)


def test_what_is_right_is_read(copy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_skd("fit", edited(copy, lambda arrays: None), "--json", "--out", tmp_path / "model") == 0
    said = capsys.readouterr()
    assert "left out" not in said.err
    with np.load(copy / "episodes.npz") as arrays:
        assert json.loads(said.out)["logs"] == int((arrays["mode"] != 0).sum())


def test_what_is_not_credible_is_so_for_who_learns_from_it(
    copy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for path in (path for path in map(copy.joinpath, ("probe.json", "assessment.json")) if path.exists()):
        path.write_text(
            json.dumps({**json.loads(path.read_text()), "warnings": [f"{NOT_CREDIBLE}it counts", "harmless"]})
        )
    assert run_skd("fit", copy, "--json", "--out", tmp_path / "model") == 0
    said = [line for line in capsys.readouterr().err.splitlines() if "it counts" in line or "harmless" in line]
    assert said == [f"skd fit: warning: {copy / 'episodes.npz'}: {NOT_CREDIBLE}it counts"]
    for name in ("assessment", "probe"):
        (tmp_path / f"{name}.json").write_text(json.dumps({"warnings": [f"{NOT_CREDIBLE}{name}"]}))
    assert not_credible_beside([tmp_path / "bags" / name / "0.mcap" for name in "ab"]) == [
        f"{NOT_CREDIBLE}probe",
        f"{NOT_CREDIBLE}assessment",
    ]
    assert not_credible_beside([tmp_path / "0.mcap", tmp_path / "none" / "bags" / "0.mcap"]) == []


@pytest.mark.parametrize("name", ["episodes.npz", "probe.json"])
def test_what_the_manifest_knows_otherwise_is_refused(probe: Path, tmp_path: Path, refused: Refused, name: str) -> None:
    changed = Path(shutil.copytree(probe, tmp_path / "changed"))
    (changed / name).write_bytes((changed / name).read_bytes() + b" ")
    assert f"{name}: is not what was written: its SHA-256 is another than in {MANIFEST}" in refused(changed)


def changed(name: str, change: Callable[[Any], Any]) -> Callable[[Arrays], object]:
    return lambda arrays: arrays.update({name: change(arrays[name])})


@pytest.mark.parametrize(
    ("edit", "part"),
    [
        (changed("car", lambda car: car[:-1]), "do not go together"),
        (changed("time_step", lambda step: step * np.nan), "time step"),
        (changed("offsets", lambda offsets: offsets[::-1].copy()), "do not go together"),
        (changed("mode", lambda mode: mode + 7), "episodes.npz"),
        (lambda arrays: arrays.pop("car"), "KeyError: 'car'"),
        (put("positions", -1e9), "episodes.npz"),
        (put("impact_speed", -1e9), "episodes.npz"),
    ],
)
def test_columns_that_cannot_be(copy: Path, refused: Refused, edit: Callable[[Arrays], object], part: str) -> None:
    line = refused(edited(copy, edit))
    assert part in line
    assert "episodes.npz" in line


def test_what_is_damaged_can_be_left_out(copy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = edited(copy, put("car", -1e5))
    assert run_skd("fit", file, "--skip-damaged", "--json", "--out", tmp_path / "model") == 0
    said = capsys.readouterr()
    assert "left out" in said.err
    with np.load(file) as arrays:
        assert json.loads(said.out)["logs"] == int((arrays["mode"] != 0).sum()) - 1
