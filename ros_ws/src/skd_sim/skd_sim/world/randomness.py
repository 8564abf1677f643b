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
    ORDER = 9
    WALKER = 10
    RISK = 11


def generator(campaign_seed: int, episode_id: int, role: Role, *part: int) -> np.random.Generator:
    """Return the generator of one role in one episode, or of a numbered part of it, such as a tick."""
    sequence = np.random.SeedSequence(campaign_seed, spawn_key=(episode_id, int(role), *part))
    return np.random.Generator(np.random.PCG64(sequence))


def controller_seed(campaign_seed: int, episode_id: int) -> bytes:
    """Return the seed of what a controller under test draws: a SHA-256 digest from which neither number can be read.

    The id says whether somebody tries to be hit.
    """
    return hashlib.sha256(f"{campaign_seed} {episode_id} {int(Role.CONTROLLER)}".encode()).digest()


def controller_generator(seed: bytes) -> np.random.Generator:
    """Return the generator that a controller under test is handed, of a `controller_seed`."""
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(int.from_bytes(seed))))
