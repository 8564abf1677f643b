from __future__ import annotations

import itertools
import math

import numpy as np
from skd_sim.world.episode import Role, generator


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


def test_streams_differ_and_are_uncorrelated() -> None:
    n = 4000
    keys = itertools.product((0, 1), (0, 1), (Role.CAR, Role.SENSOR, Role.PLANNER))
    streams = np.array([generator(*key).random(n) for key in keys])
    assert len({stream.tobytes() for stream in streams}) == 12
    correlation = np.corrcoef(streams)[np.triu_indices(12, 1)]
    # Under independence √n·r is standard normal; 4.5 is its 0.0007 % point, for 66 pairs.
    assert np.abs(correlation).max() * math.sqrt(n) < 4.5
