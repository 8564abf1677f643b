"""An assessment in which the car runs into a car ahead: that counts, and is said."""

from __future__ import annotations

import copy
import json
from pathlib import Path

import yaml
from cli_support import skd
from skd_sim.scenario.scenario import load_scenario

STOPPING = {
    "kind": "car",
    "length": 4.0,
    "width": 1.7,
    "start_heading": 1.5707963,
    "way": [{"time": 0.0, "x": 0.0, "y": 0.0}, {"time": 2.4, "x": 0.0, "y": 12.0}],  # and stands there
}


def behind(folder: Path) -> None:
    data = copy.deepcopy(load_scenario("crossing").as_dict())
    data["others"] = [STOPPING]
    data["adversary"]["start_x"] = -6.0  # crosses behind the car ahead
    (folder / "behind.yaml").write_text(yaml.safe_dump(data), encoding="utf-8")


COUNTS = ("--safe-count", "2", "--kamikaze-count", "3", "--collision-runs", "10", "--simulations", "60")


def test_a_car_that_brakes_for_the_adversary_alone_runs_into_the_car_ahead(tmp_path: Path) -> None:
    behind(tmp_path)
    done = skd("assess", "--multiplier", "0", "--scenario", "behind.yaml", *COUNTS, "--out", "out", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "episodes the car ran into others[0], a car, and not into the adversary" in done.stderr
    result = json.loads((tmp_path / "out" / "assessment.json").read_text(encoding="utf-8"))
    assert result["contact_rate"] == 1.0
    assert result["margin"] < 0.01
    verified = skd("verify", "out", cwd=tmp_path)
    assert verified.returncode == 0, verified.stderr
