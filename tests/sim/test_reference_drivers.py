"""Reference drivers against published figures, limits worked out by hand, and what they do beside pedestrians."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from skd_sim.controllers import reference_drivers
from skd_sim.controllers.controller import make_controller, with_control_period
from skd_sim.controllers.reference_drivers import IdmConstants, RelativeState, idm_acceleration
from skd_sim.options.car_and_adversary import REFERENCE_DRIVERS
from skd_sim.scenario.scenario import changed_scenario, load_scenario
from skd_sim.world.state import AdversaryState, CarState, Scene

KMH = 1.0 / 3.6
LENGTH, WIDTH, ASIDE = 4.3, 1.9, 1.6
SIDEWAYS = (0.3, 0.6, 0.9, 1.2, 1.5, 1.8)
LOW, HIGH = range(4, 60, 5), range(5, 120, 10)
SAFE = "......"
JRC = {
    ("fsm", 40, 20): "..xxxx",
    ("fsm", 60, 10): ".....x ....xx ...xxx ..xxxx ..xxxx .xxxxx",
    ("fsm", 60, 40): "..xxxx",
    ("fsm", 130, 70): "...... ...xxx ..xxxx .xxxxx",
    ("cc_driver", 40, 20): "..xxxx .xxxxx x.....",
    ("cc_driver", 60, 10): ".....x ....xx ...xxx ..xxxx ..xxxx .xxxxx .xxxxx .x.... x.....",
    ("cc_driver", 130, 70): "...... ...xxx ..xxxx .xxxxx .xxxxx .xxxxx .xxxxx xxxxxx xxxxxx xxxxxx xxxxxx xxxxxx",
    ("rss", 40, 20): ".xxxxx",
    ("rss", 60, 10): ".....x ....xx ...xxx ..xxxx .xxxxx",
    ("rss", 60, 40): ".xxxxx",
    ("rss", 130, 70): "...... ...xxx ..xxxx .xxxxx",
    ("reg157", 40, 20): "..xxxx .xxx.. .x.... ...... x.....",
    ("reg157", 60, 10): ".....x ....xx ...xxx ..xxxx ..xxxx .xxxxx .xxx.. .x.... .x....",
    ("reg157", 60, 40): "..xxxx .xxx.. .x.... ...... x.....",
    ("reg157", 130, 70): "...... ...xxx ..xxxx ..xxxx .xxx.. .x.... ...... ...... x.....",
}
"""Collisions in cut-ins by the JRC's public code (commit 01b05c2), by driver, speed of the car and of the other (km/h).

A row for each first distance, a column for each speed to the side (m/s); rows without a collision at the end are left
out. The careful driver perceives after 0.375 m and 0.4 s there, as the regulation says."""


def crashes(name: str, speed: float, other: float, distance: float, sideways: float, period: float = 0.1) -> bool:
    """Step a cut-in as the public code does: speeds are kept, and change at once."""
    changes = {"car.start_speed": speed * KMH, "car.front": 0.5 * LENGTH, "car.rear": 0.5 * LENGTH, "car.width": WIDTH}
    changes |= {"adversary.length": LENGTH, "adversary.width": WIDTH, "adversary.speed": 40.0, "horizon": 30.0}
    scenario = changed_scenario("cut_in", changes)
    driver = make_controller(name)
    driver.reset(scenario, np.random.default_rng(0))
    v = speed * KMH
    along, x, y = period * v, period * sideways - (ASIDE + WIDTH), distance + LENGTH + period * other * KMH
    start = CarState(0.0, 0.0, 0.5 * math.pi, v)
    driver.command(start, Scene(start, AdversaryState(-(ASIDE + WIDTH), 1e4, 0.0, v, 0.5 * math.pi)))  # in its lane
    for _ in range(160):
        gap = y - along - LENGTH
        if abs(gap + LENGTH) < LENGTH and abs(x) < WIDTH:
            return True
        moves = sideways if x < 0.0 else 0.0
        car = CarState(0.0, along, 0.5 * math.pi, v)
        command = driver.command(car, Scene(car, AdversaryState(x, y, moves, other * KMH, 0.5 * math.pi)))
        v = max(0.0, v + period * float(command))
        along, x, y = along + period * v, x + period * moves, y + period * other * KMH
    return False


@pytest.mark.parametrize(("name", "speed", "other"), JRC)
def test_a_driver_collides_in_the_cut_ins_in_which_the_published_code_does(name, speed, other):
    """All but one cell: the published careful driver keeps its reduced speed for ever, and ours resumes."""
    distances = LOW if speed < 100 else HIGH
    expected = (JRC[name, speed, other].split() + [SAFE] * 12)[: len(distances)]
    found = [[crashes(name, speed, other, distance, aside) for aside in SIDEWAYS] for distance in distances]
    differ = sum(
        one != (cell == "x")
        for row, cells in zip(found, expected, strict=True)
        for one, cell in zip(row, cells, strict=True)
    )
    assert differ <= (name == "cc_driver")


def test_drivers_rank_in_cut_ins_as_in_the_literature():
    """Mattas et al. 2022: who anticipates (FSM, RSS by its distances) avoids most, the regulation's driver least."""
    count = {
        name: sum(crashes(name, 60, 10, distance, aside) for distance in LOW for aside in SIDEWAYS)
        for name in ("fsm", "rss", "reg157", "cc_driver")
    }
    assert max(count["fsm"], count["rss"]) < count["reg157"] < count["cc_driver"]


def situation(gap: float, speed: float, lead: float = 0.0, **more: float) -> RelativeState:
    calm = {"length": 9.0, "aside": -1.0, "closing": 0.0, "strayed": 0.0}
    return RelativeState(gap=gap, speed=speed, lead=lead, **(calm | more))


def made(name: str):
    driver = make_controller(name)
    driver.reset(load_scenario("cut_in"), np.random.default_rng(0))
    return driver


@pytest.mark.parametrize(
    ("name", "speed", "lead", "distance"),
    [
        ("reg157", 20.0, 10.0, 10.0 * (10.0 / 12.0 + 0.35 + 0.1)),  # 5.2.5.2, and one period
        ("cc_driver", 20.0, 10.0, 2.0 * 10.0),  # a time to collision of 2 s
        ("rss", 20.0, 10.0, 20.0 * 0.75 + 1.5 * 0.75**2 + 22.25**2 / 12.0 - 100.0 / 12.0),  # definition 1
        ("fsm", 20.0, 0.0, 20.0 * 0.75 + 400.0 / 8.0 + 2.0 + 2.0),  # PFS begins
        ("aeb_berkeley", 20.0, 5.0, 15.0 * 1.2 + 3.0 * 1.2**2),
        ("aeb_mazda", 20.0, 8.0, 0.5 * (400.0 / 6.0 - 64.0 / 8.0) + 2.0 + 12.0 * 0.6 + 5.0),
        ("aeb_honda", 30.0, 20.0, 15.0 + 0.75 * 7.8 - 0.125 * 7.8),  # who leads drives longer than 1.5 s
        ("aeb_honda", 20.0, 5.0, 30.0 - 0.5 * 7.8 - 25.0 / 15.6),
    ],
)
def test_a_law_begins_at_the_published_distance(name, speed, lead, distance):
    law = made(name)
    assert law.is_critical(situation(distance - 1e-6, speed, lead))
    assert not law.is_critical(situation(distance + 1e-3, speed, lead))
    assert not law.is_critical(situation(distance, speed, lead, aside=20.0))


def test_the_two_cases_of_the_honda_formula_meet():
    law = made("aeb_honda")
    assert law.distance(30.0, 11.7 - 1e-9) == pytest.approx(law.distance(30.0, 11.7))


def test_the_careful_driver_brakes_as_the_regulation_says():
    """0.375 m and 0.4 s until it has perceived, 0.75 s until it brakes, 0.774 g within 0.6 s."""
    law = made("cc_driver")
    over = 0.375 + 0.4 * 1.5
    assert not law.is_critical(situation(10.0, 20.0, aside=1.0, closing=1.5, strayed=over - 0.01))
    assert law.is_critical(situation(10.0, 20.0, aside=1.0, closing=1.5, strayed=over))
    car = CarState(0.0, 0.0, 0.5 * math.pi, 20.0)
    commands = [law.command(car, Scene(car, AdversaryState(0.0, 20.0, 0.0, 0.0, 0.5 * math.pi))) for _ in range(16)]
    assert commands[:8] == [-0.4] * 8  # a released pedal
    assert np.diff(commands[8:13]) == pytest.approx([-1.265] * 4)
    assert commands[-1] == pytest.approx(-0.774 * 9.81)
    assert commands.index(commands[-1]) == 8 + 6  # 0.6 s, in steps of 0.1 s


def test_the_intelligent_driver_settles_at_the_published_gap():
    """At the speed of who leads the gap is (s₀ + v·T)/√(1 − (v/v₀)⁴)."""
    gap = (2.0 + 20.0 * 1.6) / math.sqrt(1.0 - (20.0 / 33.0) ** 4)
    assert idm_acceleration(20.0, 33.0, gap, 0.0) == pytest.approx(0.0, abs=1e-12)
    assert idm_acceleration(0.0, 33.0, math.inf, 0.0) == 0.73


STOP = [*(name for name in REFERENCE_DRIVERS if name != "aeb_honda"), "eidm", "krauss", "f1tenth", "nav2_monitor"]


@pytest.mark.parametrize("name", STOP)
def test_a_driver_stops_for_a_pedestrian_far_ahead_and_goes_on_without(name):
    """Honda's brake begins 1.5 s before the collision, and makes it weaker."""
    driver = make_controller(name)
    scenario = with_control_period(load_scenario("crossing"), driver.control_period, name)
    driver.reset(scenario, np.random.default_rng(0))
    y, speed, free = -60.0, scenario.car.start_speed, AdversaryState(-30.0, 0.0, 0.0, 0.0)
    for person in (AdversaryState(0.0, 0.0, 0.0, 0.0), free):
        for _ in range(300):
            car = CarState(0.0, y, 0.5 * math.pi, speed)
            after = max(0.0, speed + 0.1 * float(driver.command(car, Scene(car, person))))
            y, speed = y + 0.05 * (speed + after), after
            assert person is free or y + scenario.car.front < 0.0
        assert speed == pytest.approx(scenario.car.start_speed if person is free else 0.0, abs=0.3)


@pytest.mark.parametrize(
    ("name", "speed", "gap", "lead", "expected"),
    [
        ("krauss", 10.0, 30.0, 10.0, 2.6),  # 10 + (27.5 − 10)/(10/4.5 + 1) is more than it can reach
        ("krauss", 10.0, 12.0, 10.0, 10.0 * (-0.5 / (10.0 / 4.5 + 1.0))),
        ("krauss", 10.0, 3.0, 0.0, -9.0),
        ("eidm", 10.0, 1e9, 0.0, 1.4 * (1.0 - 0.6**4)),
        ("eidm", 10.0, 10.0, 10.0, None),
        ("nav2_monitor", 10.0, 2.9, 0.0, -100.0),
        ("nav2_monitor", 10.0, 15.0, 0.0, 10.0 * (7.5 - 10.0)),
        ("nav2_monitor", 10.0, 90.0, 0.0, 1.0),
    ],
)
def test_a_law_accelerates_as_published(name, speed, gap, lead, expected):
    driver = made(name)
    driver._desired = 10.0 / 0.6
    if expected is None:  # equation 2.6 where the heuristic is 0
        plain = idm_acceleration(speed, 10.0 / 0.6, gap, 0.0, IdmConstants(1.5, 1.4, 2.0, 2.0))
        expected = 0.01 * plain + 0.99 * 2.0 * math.tanh(plain / 2.0)
    assert driver._answer(speed, [situation(gap, speed, lead)]) == pytest.approx(expected)


def test_the_brake_of_f1tenth_begins_a_second_before_what_stands_ahead():
    law = made("f1tenth")
    assert law.is_critical(situation(9.99, 10.0, 5.0))
    assert not law.is_critical(situation(10.01, 10.0))
    assert not law.is_critical(situation(0.5, 10.0, aside=4.0))  # a beam to the side hardly gets shorter


@pytest.mark.parametrize("policy", ["broad", "narrow"])
def test_a_learned_policy_is_its_network(policy):
    """Against the product of matrices; and an output of −1 is full braking, of 1 the acceleration of who resumes."""
    driver = reference_drivers.LearnedPolicy()
    driver.policy = policy
    seen = reference_drivers.features(situation(12.0, 8.0, 0.5, aside=0.7, closing=1.5))
    values = np.array([12.0 / 20.0, 0.7 / 3.0, 1.0, 0.2, 0.6])
    assert seen == pytest.approx(values)
    layers = json.loads(reference_drivers.WEIGHTS.read_text(encoding="utf-8"))[policy]
    assert [len(one["bias"]) for one in layers] == [16, 16, 1]
    for place, one in enumerate(layers):
        values = values @ np.array(one["weights"]) + one["bias"]
        values = values if place == 2 else np.maximum(values, 0.0)
    assert driver._output(seen) == pytest.approx(values[0])
    assert [reference_drivers.acceleration_of(one) for one in (-5.0, -1.0, 1.0, 5.0)] == [-8.0, -8.0, 1.0, 1.0]


def test_drivers_see_everybody():
    """In cut_out the car stands behind the one that leaves."""
    scenario = load_scenario("cut_out")
    driver = make_controller("aeb_mazda")
    driver.reset(scenario, np.random.default_rng(0))
    car, adversary = CarState(0.0, -20.0, 0.5 * math.pi, 10.0), AdversaryState(-40.0, 0.0, 0.0, 0.0, 0.5 * math.pi)
    near = tuple(one._replace(x=0.0, y=-5.0) for one in scenario.others_at(0))
    assert near
    assert driver.command(car, Scene(car, adversary, near)) == -6.0
