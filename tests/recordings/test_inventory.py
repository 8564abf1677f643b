"""Replay accounts for all that it was given, damaged results included."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from bag_forge import Sent, write_mcap
from common import run_skd
from skd_evaluator.assessment.files.result_folder import MANIFEST, write_manifests
from skd_evaluator.assessment.files.results import read_result
from skd_evaluator.bags.checks import not_credible_beside
from skd_evaluator.metrics.aborted import NOT_CREDIBLE

Refused = Callable[..., str]
Replay = Callable[..., Any]


@pytest.fixture
def bags(sent: list[list[Sent]], tmp_path: Path) -> Path:
    for number, one in enumerate(sent):
        bag = tmp_path / "bags" / f"{number:02}"
        write_mcap(bag / f"{number:02}.mcap", one)
        (bag / "metadata.yaml").write_text(
            f"rosbag2_bagfile_information:\n  version: 9\n  relative_file_paths:\n    - {number:02}.mcap\n  files: []\n"
        )
    return tmp_path / "bags"


@pytest.mark.parametrize("name", ["04.mcap.gz", "04.mcap.active"])
def test_what_cannot_be_read_is_named(bags: Path, refused: Refused, replay: Replay, name: str) -> None:
    (bags / "04" / "04.mcap").rename(bags / "04" / name)
    (bags / "04" / "metadata.yaml").unlink()
    said = refused(bags)
    assert f"{name}: is " in said
    assert said.endswith("--skip-damaged leaves it out")
    (line,) = replay(bags, "--skip-damaged").result["left_out"]
    assert name in line


def test_a_file_that_is_packed_as_a_whole_says_the_same(bags: Path, replay: Replay) -> None:
    plain, file = replay(bags), bags / "04" / "04.mcap"
    file.with_suffix(".mcap.zstd").write_bytes(zstandard.compress(file.read_bytes()))
    both = replay(bags)  # the one that was unpacked is read
    file.unlink()
    packed = replay(bags)
    assert (packed.err, packed.episodes, both.episodes) == ("", plain.episodes, plain.episodes)


@pytest.mark.parametrize("inline", [False, True])
def test_a_file_that_metadata_names_and_is_gone(bags: Path, refused: Refused, replay: Replay, inline: bool) -> None:
    split = bags / "04" / "metadata.yaml"
    names = "[04.mcap, 04_1.mcap]" if inline else "\n    - 04.mcap\n    - 04_1.mcap"
    split.write_text(f"rosbag2_bagfile_information:\n  relative_file_paths: {names}\n")
    assert "metadata.yaml: names 04_1.mcap, which is not there" in refused(bags)
    (line,) = replay(bags, "--skip-damaged").result["left_out"]
    assert "04_1.mcap" in line


def test_last_bags_that_are_gone_are_known_by_their_manifest(bags: Path, refused: Refused, replay: Replay) -> None:
    """Of a campaign that lacks the last runs of every φ alike, nothing else tells."""
    night = bags.parent / "night"
    night.mkdir()
    bags.rename(night / "bags")
    write_manifests(night)
    for path in (night, night / "bags"):
        assert replay(path).err == ""
    last = sorted((night / "bags").iterdir())[-2:]
    for folder in last:
        shutil.rmtree(folder)
    for path in (night, night / "bags"):
        assert f"{last[0].name}.mcap: is in {MANIFEST}, and is not there" in refused(path)
        done = replay(path, "--skip-damaged")
        assert len([line for line in done.result["left_out"] if MANIFEST in line]) == 2
    (night / "bags" / "00" / "00.mcap").write_bytes((night / "bags" / "01" / "01.mcap").read_bytes())
    assert "00.mcap: is not what was written" in refused(night)


def test_results_of_incomplete_recordings_follow_from_what_there_was(logs, sent, recorded, replay) -> None:
    """Runs and φ are told by their numbers: what is missing moves none to the place of another."""
    first_run = next(place for place, log in enumerate(logs) if log.episode.mode == 2)
    parts = {
        "without a run": [one for place, one in enumerate(sent) if place != first_run],
        "second φ": [one for one, log in zip(sent, logs, strict=True) if log.episode.episode_id >> 32 & 0xFFFF == 1],
    }
    for name, episodes in parts.items():
        done = replay(recorded(episodes, name))
        assert done.code == 0, done.err
        own = [f"{done.path}: {line}" for line in done.result["warnings"]]
        assert list(read_result(done.path).remarks) == own


@pytest.fixture(
    scope="module",
    params=[
        ("probe", "--multiplier", 0.75, "--episodes", 24),
        ("assess", "--safe-count", 2, "--kamikaze-count", 3, "--collision-runs", 6, "--simulations", 40),
    ],
    ids=["probe", "assessed"],
)
def made(request, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("logs") / "made"
    assert run_skd(*request.param, "--workers", 1, "--out", folder) == 0
    (folder / MANIFEST).unlink()  # as whoever changes a file on purpose removes it
    return folder


@pytest.fixture
def copy(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "copy"))


def test_what_is_not_credible_is_so_for_who_learns_from_it(copy, tmp_path, capsys):
    for path in (path for path in map(copy.joinpath, ("probe.json", "assessment.json")) if path.exists()):
        content = json.loads(path.read_text())
        path.write_text(json.dumps({**content, "warnings": [f"{NOT_CREDIBLE}it counts", "harmless"]}))
    assert run_skd("fit", copy, "--json", "--out", tmp_path / "model") == 0
    said = [line for line in capsys.readouterr().err.splitlines() if "it counts" in line or "harmless" in line]
    assert said == [f"skd fit: warning: {copy / 'episodes.npz'}: {NOT_CREDIBLE}it counts"]
    for name in ("assessment", "probe"):
        (tmp_path / f"{name}.json").write_text(json.dumps({"warnings": [f"{NOT_CREDIBLE}{name}"]}))
    bags = [tmp_path / "bags" / name / "0.mcap" for name in "ab"]
    assert not_credible_beside(bags) == [f"{NOT_CREDIBLE}probe", f"{NOT_CREDIBLE}assessment"]
    assert not_credible_beside([tmp_path / "0.mcap", tmp_path / "none" / "bags" / "0.mcap"]) == []


def test_what_is_damaged_can_be_left_out(copy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = copy / "episodes.npz"
    with np.load(file) as archive:
        arrays = dict(archive)
    arrays["car"][-1, -1] = -1e5
    np.savez_compressed(file, **arrays)
    assert run_skd("fit", file, "--skip-damaged", "--json", "--out", tmp_path / "model") == 0
    said = capsys.readouterr()
    assert "left out" in said.err
    with np.load(file) as arrays:
        assert json.loads(said.out)["logs"] == int((arrays["mode"] != 0).sum()) - 1
