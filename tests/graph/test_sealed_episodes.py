"""A car under test does not learn from the graph whether it is attacked, along which φ, and by which seed."""

from __future__ import annotations

import json
import shlex
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from graph_support import HERE, skd
from skd_msgs.msg import Episode
from skd_sim.errors import UsageError
from skd_sim.messages.seal import KEY_SIZE, SEALED_MODE, Seal

_SAFE_TRAJECTORY = 3  # id of its marker


def assessed(folder: Path, safe: Path, *options: str) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Assess a car that listens; return the result and what it has heard.

    Ten episodes are over in a second, before it has found both nodes that send receipts.
    """
    heard = folder / "heard.jsonl"
    command = shlex.join([sys.executable, f"{HERE}/listening_car.py", str(heard)])
    finished = skd(
        *("assess", "--graph", "--knowledge", "nothing", "--controller", "external", "--controller-command", command),
        *("--safe", safe, "--safe-count", 1, "--kamikaze-count", 6, "--collision-runs", 40, "--simulations", 100),
        *("--objective", "deformation", "--margin-limit", 0, "--behaviour", "none", "--out", folder / "out", *options),
    )
    assert finished.code in (0, 1), finished.lines
    assert (folder / "out").exists(), finished.err
    lines = [json.loads(line) for line in heard.read_text().splitlines()]
    return json.loads((folder / "out" / "assessment.json").read_text()), lines


@pytest.fixture(scope="module")
def sealed(tmp_path_factory: pytest.TempPathFactory, safe: Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    return assessed(tmp_path_factory.mktemp("sealed"), safe)


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory, safe: Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    return assessed(tmp_path_factory.mktemp("told"), safe, "--open-episodes")


def test_nothing_tells(sealed: tuple[dict[str, Any], list[dict[str, Any]]]) -> None:
    _, heard = sealed
    episodes = [line for line in heard if line["what"] == "episode"]
    assert len(episodes) >= 10
    for line in episodes:
        assert line["mode"] == SEALED_MODE
        assert not any(line["telling"])
        assert "seed" not in line["campaign"]
        assert line["scenario"]  # what a car may know
    assert not any(line["telling"] != [0] for line in heard if line["what"] == "receipt")
    # Two nodes that took an episode for the same say the same; what two episodes have in common is not to be seen.
    said = [line["specification"] for line in heard if line["what"] == "receipt"]
    assert max(Counter(said).values()) == 2
    markers = [line["ids"] for line in heard if line["what"] == "markers"]
    assert markers
    assert not any(_SAFE_TRAJECTORY in ids for ids in markers)
    figures = Counter(line["what"] for line in heard)
    assert figures["/skd/clearance"] > 10  # which follows from the odometries
    assert figures["/skd/deformation"] == figures["/skd/believed_car"] == 0


def test_who_listens_gains_nothing(
    sealed: tuple[dict[str, Any], list[dict[str, Any]]], told: tuple[dict[str, Any], list[dict[str, Any]]]
) -> None:
    """Where all is said openly it stops for each kamikaze, and is hit by none; else it drives on and is hit."""
    result, heard = told
    assert {line["mode"] for line in heard if line["what"] == "episode"} == {
        Episode.MODE_KAMIKAZE,
        Episode.MODE_REPLAY,
    }
    assert any(_SAFE_TRAJECTORY in line["ids"] for line in heard if line["what"] == "markers")
    strayed, speeds = (
        [line["value"] for line in heard if line["what"] == name] for name in ("/skd/deformation", "/skd/believed_car")
    )
    assert min(strayed) == 0.0 < max(strayed)
    assert all(0.0 <= speed < 15.0 for speed in speeds)
    assert len(speeds) > 10
    assert result["deformation_success_rate"] == 0.0
    assert sealed[0]["deformation_success_rate"] == 1.0


def test_the_order_tells_nothing(told: tuple[dict[str, Any], list[dict[str, Any]]]) -> None:
    """Kamikazes do not all come before the runs along φ, as they would in one of nine million orders."""
    modes = [line["mode"] for line in told[1] if line["what"] == "episode"]
    assert modes != sorted(modes)


def test_only_the_key_opens() -> None:
    message = Episode(mode=Episode.MODE_KAMIKAZE, campaign="c", seed=7, episode_id=2**60, scenario="{}")
    seal = Seal(bytes(range(KEY_SIZE)))
    shut = seal.shut(message)
    assert seal.open(shut) == message
    assert (shut.mode, shut.seed, shut.episode_id, shut.campaign) == (SEALED_MODE, 0, 0, "c")
    assert seal.shut(message).sealed != shut.sealed  # the same twice does not look the same
    with pytest.raises(UsageError, match="has not the evaluator's key"):
        Seal(bytes(KEY_SIZE)).open(shut)
    with pytest.raises(UsageError, match="has not the evaluator's key"):
        seal.open(message)
    shut.sealed[20] ^= 1
    with pytest.raises(UsageError, match="has not the evaluator's key"):
        seal.open(shut)
    with pytest.raises(UsageError, match="--open-episodes"):
        Seal().open(shut)
    assert Seal().open(Seal().shut(message)) is message


def test_the_scenario_that_the_car_is_told_stands_openly_and_the_other_one_sealed() -> None:
    seal, message = Seal(bytes(KEY_SIZE)), Episode(scenario="no noise")
    shut = seal.shut(message, "as always")
    assert (shut.scenario, seal.open(shut).scenario) == ("as always", "no noise")
    assert seal.shut(message).scenario == "no noise"
