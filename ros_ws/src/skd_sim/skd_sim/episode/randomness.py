"""Random generators: one per role and episode, derived from the campaign's seed and from nothing else.

`SeedSequence(campaign_seed, spawn_key=(episode_id, role))` makes an episode's draws independent of the number of
workers and of the order in which episodes run. There is no global random state.
"""

from __future__ import annotations

import hashlib
from enum import IntEnum

import numpy as np


class Role(IntEnum):
    """Who draws. Values are part of the reproducibility contract: never renumber."""

    CAR = 0
    START = 1
    SENSOR = 2
    PLANNER = 3
    CONTROLLER = 4
    SCAN = 5
    PROBE = 6
    FLOOR = 7
    ITSELF = 8
    ORDER = 9
    WALKER = 10
    RISK = 11


def generator(campaign_seed: int, episode_id: int, role: Role, *part: int) -> np.random.Generator:
    """Return the generator of one role in one episode, or of a numbered part of it, such as a tick."""
    sequence = np.random.SeedSequence(campaign_seed, spawn_key=(episode_id, int(role), *part))
    return np.random.Generator(np.random.PCG64(sequence))


def controller_generator(campaign_seed: int, episode_id: int, *, own: bool) -> np.random.Generator:
    """Return the generator that a controller under test is handed.

    Args:
        campaign_seed: of the campaign.
        episode_id: of the episode.
        own: whether the controller is SKD's. A user's gets a generator from which neither number can be read back,
            for the id says whether somebody tries to be hit: its seed is a SHA-256 digest of both.
    """
    if own:
        return generator(campaign_seed, episode_id, Role.CONTROLLER)
    digest = hashlib.sha256(f"{campaign_seed} {episode_id} {int(Role.CONTROLLER)}".encode()).digest()
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(int.from_bytes(digest))))
