"""The world on curved roads and with adversaries that are boxes."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import shapely
from shapely import affinity
from skd_sim.scenario.road import Part, Road, road_pose, road_position
from skd_sim.scenario.scenario import Scenario, load_scenario
from skd_sim.world.state import CarState
from skd_sim.world.world import World

STEP = 0.3
CROSSING = load_scenario("crossing")
TURN = Road(3.5, parts=(Part(40.0), Part(4.0 * math.pi, 8.0, "right"), Part(40.0)), origin=48.0)
BOX = replace(CROSSING.adversary, radius=None, length=1.8, width=0.6, kind="cyclist")


def make(scenario: Scenario, *, seed: int = 0, **changes: Any) -> World:
    streams = np.random.SeedSequence(seed).spawn(2)
    start, car = (np.random.default_rng(stream) for stream in streams)
    return World(scenario, start_rng=start, car_rng=car, **changes)


def test_on_a_curve_the_car_drives_as_far_and_as_fast_as_on_the_straight_road() -> None:
    straight, curved = make(CROSSING), make(replace(CROSSING, road=TURN))
    for tick in range(12):
        command = -3.5 if 4 <= tick < 6 else 0.0
        straight.step(command, (0.0, 0.0))
        curved.step(command, (0.0, 0.0))
        assert curved.car.speed == straight.car.speed
        s, left = road_position(TURN.line, curved.car.x, curved.car.y)
        assert (s, left) == pytest.approx((straight.car.y, 0.0), abs=1e-9)
        heading = road_pose(TURN.line, s)[2]
        assert math.remainder(curved.car.heading - heading, math.tau) == pytest.approx(0.0, abs=1e-8)


def polygon(car: CarState, scenario: Scenario) -> shapely.Polygon:
    size = scenario.car
    box = shapely.box(-size.rear, -size.half_width, size.front, size.half_width)
    turned = affinity.rotate(box, car.heading, origin=(0, 0), use_radians=True)
    return affinity.translate(turned, car.x, car.y)


def body(scenario: Scenario, x: float, y: float, velocity: tuple[float, float]) -> Any:
    adversary = scenario.adversary
    if adversary.radius is not None:
        return shapely.Point(x, y).buffer(adversary.radius, quad_segs=64)
    half_length, half_width = adversary.shape[1:]
    box = shapely.box(-half_length, -half_width, half_length, half_width)
    turned = affinity.rotate(box, math.atan2(velocity[1], velocity[0]), origin=(0, 0), use_radians=True)
    return affinity.translate(turned, x, y)


@pytest.mark.parametrize("shape", ["disc", "box"])
def test_first_contact_on_a_curve_against_polygons(shape: str) -> None:
    """Car and adversary as polygons at 400 moments of a tick, the car at its true pose on the arc."""
    adversary = CROSSING.adversary if shape == "disc" else BOX
    scenario = replace(CROSSING, road=TURN, adversary=adversary)
    quiet = replace(scenario, car=replace(scenario.car, speed_noise=0.0, acceleration_noise=0.0, start_gap_range=0.0))
    rng = np.random.default_rng(5)
    touched = 0
    for _ in range(40):
        gap = float(rng.uniform(0.0, 12.0))
        s = -gap - quiet.car.front
        speed = quiet.car.start_speed
        x, y, _ = road_pose(TURN.line, s + 3.0)
        place = (x + float(rng.uniform(-4.0, 4.0)), y + float(rng.uniform(-4.0, 4.0)))
        angle = float(rng.uniform(-math.pi, math.pi))
        velocity = (2.5 * math.cos(angle), 2.5 * math.sin(angle))
        distances = []
        for share in np.linspace(0.0, 1.0, 401):
            moved = (place[0] + STEP * share * velocity[0], place[1] + STEP * share * velocity[1])
            car = CarState(*road_pose(TURN.line, s + share * STEP * speed), speed)
            distances.append(polygon(car, quiet).distance(body(quiet, *moved, velocity)))
        if 0.0 < min(distances) < 2e-3:
            continue  # a graze, for which neither is exact enough
        contact = make(quiet, adversary_start=place, gap=gap).step(0.0, velocity)
        first = np.flatnonzero(np.array(distances) <= 0.0)
        assert (contact is not None) == (len(first) > 0)
        if contact is not None:
            assert contact.fraction == pytest.approx(first[0] / 400.0, abs=4e-3)
            touched += 1
    assert 5 <= touched <= 35  # both happen
