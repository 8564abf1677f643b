from __future__ import annotations

from skd_sim.world.episode import Role


def test_roles_keep_their_numbers() -> None:
    assert {role.name: role.value for role in Role} == {
        "CAR": 0,
        "START": 1,
        "SENSOR": 2,
        "PLANNER": 3,
        "CONTROLLER": 4,
        "SCAN": 5,
        "PROBE": 6,
        "ORDER": 9,
        "WALKER": 10,
        "RISK": 11,
    }
