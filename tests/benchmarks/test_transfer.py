"""The benchmark of several worlds: the φ that it hands out, what a world's name means, and its table."""

from __future__ import annotations

import argparse
import json

import numpy as np
import pytest
import transfer
from cars.catalogue import CARS
from skd_adversary.safe_trajectories.sources import read_csv_trajectory
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories
from skd_sim.scenario.scenario import load_scenario

CARS_HERE = [car for car in CARS if car.label in ("basic, C = 0.75", "basic, C = 1.5")]


def test_a_world_is_a_simulator_and_the_dynamics_of_its_car():
    assert transfer.world("world").scenario == load_scenario("crossing")
    heavy = transfer.world("world/multi_body")
    assert (heavy.simulator, heavy.scenario.car.dynamics) == ("world", "multi_body")
    assert heavy.scenario.sensor.mount_ahead == heavy.scenario.car.front
    assert transfer.world("elsewhere").simulator == "elsewhere"
    with pytest.raises(ValueError, match="the dynamics of a car are basic, multi_body"):
        transfer.world("world/rail")


def test_phi_are_the_same_to_the_last_bit_when_they_are_read(tmp_path):
    transfer.write_phi(tmp_path / "phi", 2, 0)
    with InProcessRunner(1) as runner:
        expected = safe_trajectories(Plan(load_scenario("crossing"), safe_count=2), runner)
    files = sorted((tmp_path / "phi").iterdir())
    for scenario in ("crossing", "crossing_multi_body"):
        read = [read_csv_trajectory(file, load_scenario(scenario)) for file in files]
        assert all(
            np.allclose(one.positions, other.positions, atol=1e-12) for one, other in zip(read, expected, strict=True)
        )


def test_cars_are_rated_in_a_world_once_and_stand_in_the_table(tmp_path, capsys):
    arguments = argparse.Namespace(
        out=tmp_path, safe_count=2, kamikaze_count=1, adversary_model="generic", margin_limit=64, seed=0, workers=1
    )
    worlds = [transfer.world("world")]
    table = transfer.rated(CARS_HERE, worlds, arguments)
    careless, careful = table["world"].values()
    assert careless.mean("margin") < careful.mean("margin")
    assert careless.multiplier.value <= 0.75 < 1.5 <= careful.multiplier.value
    alike = transfer.agreements({"one": table["world"], "other": table["world"]})
    assert alike["one", "other"]["margin"].tau == 1.0
    transfer.show(table, alike)
    assert "| basic, C = 1.5 |" in capsys.readouterr().out
    json.dumps(transfer.as_dict(table, alike))
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("assessment.json")}
    transfer.rated(CARS_HERE, worlds, arguments)
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("assessment.json")} == before
