"""Road users keep to the documented limits of their kind, by an oracle that shares nothing with their models."""

from __future__ import annotations

import pytest
from road_user_limits import BODIES, beyond, straight, tally, with_kind
from skd_sim.encounter.kinds import ROAD_USERS
from skd_sim.encounter.known_scenarios import SCENARIOS
from skd_sim.encounter.protocol.target import regulatory_trajectories
from skd_sim.encounter.scenario import load_scenario

ROUNDING = 1e-6
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
