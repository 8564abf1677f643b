"""Which episodes of two assessments count as the same."""

from __future__ import annotations

import numpy as np
from identical_episodes import episodes
from skd_sim.episode.episode import Mode, Outcome

COLUMNS = {
    "mode": np.array([Mode.SAFE, Mode.KAMIKAZE, Mode.KAMIKAZE, Mode.REPLAY], dtype=np.int8),
    "objective": np.array(["", "deformation", "paper", ""]),
    "episode_id": np.array([0, 7, 7, 9]),
    "outcome": np.array([Outcome.ARRIVED, Outcome.COLLISION, Outcome.COLLISION, Outcome.ARRIVED], dtype=np.int8),
    "offsets": np.array([0, 2, 5, 7, 9]),
    "positions": np.arange(18.0).reshape(9, 2),
    "car": np.arange(27.0).reshape(9, 3),
}


def saved(folder, **changes):
    folder.mkdir()
    np.savez(folder / "episodes.npz", **{**COLUMNS, **changes})
    return episodes(folder)


def test_one_bit_one_outcome_or_one_tick_makes_another_episode(tmp_path):
    plain = saved(tmp_path / "plain")
    assert set(plain) == {(1, "deformation", 7), (1, "paper", 7), (2, "", 9)}  # nobody drives along a safe trajectory
    assert saved(tmp_path / "again") == plain
    car = COLUMNS["car"].copy()
    car[3, 1] = np.nextafter(car[3, 1], np.inf)
    outcome = COLUMNS["outcome"].copy()
    outcome[2] = Outcome.TIMEOUT
    changes = {
        "car": (car, (1, "deformation", 7)),
        "outcome": (outcome, (1, "paper", 7)),
        "offsets": (np.array([0, 2, 5, 7, 8]), (2, "", 9)),
    }
    for name, (value, key) in changes.items():
        other = saved(tmp_path / name, **{name: value})
        assert {one for one in plain if plain[one] != other[one]} == {key}
