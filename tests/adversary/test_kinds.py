"""Road users keep to the documented limits of their kind, by an oracle that shares nothing with their models."""

from __future__ import annotations

import numpy as np
import pytest
from road_user_limits import BODIES, beyond, straight, tally, with_kind
from skd_adversary.crossing.road_users import BRAKE, BRAKE_LEFT, ridden, road_user_named, settled
from skd_sim.scenario.protocol import regulatory_trajectories
from skd_sim.scenario.road_user import ROAD_USERS
from skd_sim.scenario.scenario import load_scenario
from skd_sim.scenario.scenario_file import SCENARIOS

ROUNDING = 1e-6
WHEELED = [kind for kind, body in BODIES.items() if "length" in body]
PROTOCOLS = [name for name in SCENARIOS.own if load_scenario(name).protocol is not None]


def test_every_kind_has_documented_limits() -> None:
    assert set(BODIES) | {"pedestrian"} == set(ROAD_USERS.own)


@pytest.mark.parametrize("kind", BODIES)
def test_kamikazes_keep_to_the_limits_of_their_kind(kind: str) -> None:
    place = load_scenario("crossing" if "radius" in BODIES[kind] else "cyclist")
    scenario = with_kind(place, kind)
    outside, hits, worst = tally(scenario, straight(scenario), 24)
    assert (outside, worst <= ROUNDING) == (0, True)
    assert hits >= 12


@pytest.mark.parametrize("kind", WHEELED)
def test_nobody_who_has_braked_to_a_stand_turns_on_the_spot(kind: str) -> None:
    """Braking ends at no speed at all: 0.9 − 3 · 0.3 leaves 1e-16 m/s, which would turn by 30° a tick."""
    limits = road_user_named(kind).parameters(load_scenario("cyclist"))["own_limits"]
    for start in np.linspace(0.1, 6.0, 60).tolist():
        heading, speed = 0.5, start
        for _ in range(40):
            velocity = ridden(limits, heading, speed, BRAKE, 10.0, 0.3)
            heading, speed = settled(heading, *velocity)
        for _ in range(3):
            velocity = ridden(limits, heading, speed, BRAKE_LEFT, 10.0, 0.3)
            heading, speed = settled(heading, *velocity)
            assert velocity == (0.0, 0.0)
        assert heading == pytest.approx(0.5, abs=1e-12)


@pytest.mark.parametrize("name", PROTOCOLS)
def test_targets_of_protocols_do_what_their_kind_can(name: str) -> None:
    scenario = load_scenario(name)
    kind = scenario.adversary.kind
    for way in regulatory_trajectories(scenario):
        if kind in BODIES:
            assert (
                beyond(kind, way.positions, way.positions, scenario.time_step, scenario.adversary.first_heading)
                <= ROUNDING
            )
