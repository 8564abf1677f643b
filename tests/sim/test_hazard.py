from __future__ import annotations

import json
from dataclasses import replace
from importlib import resources

import numpy as np
import pytest
from scipy.stats import binom
from skd_sim.controllers.cal import (
    GAP,
    segment,
    shipped_network,
)
from skd_sim.scenario.road import HEADING_NORTH
from skd_sim.scenario.scenario import Obstacle, load_scenario
from skd_sim.world.sensors import PlanarLaser
from skd_sim.world.state import AdversaryState, CarState
from train_hazard_network import digest, generate_scenes, probabilities_of

CROSSING = load_scenario("crossing")
FRESH_SEED = 20_240_607  # of no training


# --- the label


# --- perception


def scene(car: CarState, adversary: AdversaryState, *obstacles: Obstacle) -> tuple[PlanarLaser, CarState]:
    assert CROSSING.sensor is not None
    perfect = replace(CROSSING.sensor, range_noise=0.0, dropout=0.0)
    return PlanarLaser(replace(CROSSING, sensor=perfect, obstacles=obstacles), 0, 0), car


def test_objects_are_parted_and_measured():
    car = CarState(0.0, -12.0, HEADING_NORTH, 5.0)
    laser, _ = scene(car, AdversaryState(0, 0, 0, 0), Obstacle(3.5, -2.0, HEADING_NORTH, 4.0, 1.8))
    scan = laser.scan(car, AdversaryState(-1.0, 0.0, 0.0, 0.0), 0)
    objects = segment(scan.ranges, scan.angle_min, scan.angle_increment, GAP)
    assert len(objects) == 2
    parked, walker = objects[np.argsort(objects[:, 1])]
    distance = 12.0 - CROSSING.car.front
    # Only the near side of the disc is seen; what is found is its centre.
    np.testing.assert_allclose(walker[:2], [distance, 1.0], atol=0.03)
    assert walker[2] == pytest.approx(0.5, abs=0.05)
    assert parked[2] > 1.8


# --- the shipped network


def test_the_shipped_record_is_of_the_shipped_weights():
    folder = resources.files("skd_sim") / "controllers"
    record = json.loads((folder / "hazard_network.json").read_text(encoding="utf-8"))
    assert digest(shipped_network()) == record["weights"]["sha256"]
    strict = {row["threshold"]: row for row in record["held_out"]["detection"]}[0.9]
    assert strict["recall"] >= 0.99
    assert strict["precision"] >= 0.95
    for name in ("hazard_network.json", "hazard_network.npz"):
        assert len((folder / name).read_bytes()) < 200_000


def test_the_shipped_network_on_new_crossings():
    """Recall 0.99 and precision 0.95 on crossings drawn here, within what chance allows (0.1 %)."""
    scenes = generate_scenes(CROSSING, range(1000), FRESH_SEED)
    alarm, course = probabilities_of(shipped_network(), scenes) > 0.9, scenes.course & scenes.visible
    assert course.sum() > 1000
    assert (alarm & course).sum() >= binom.ppf(0.001, course.sum(), 0.99)
    assert (alarm & scenes.course).sum() >= binom.ppf(0.001, alarm.sum(), 0.95)
