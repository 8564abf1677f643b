"""One short text for all that an episode specifies, so that two are compared without looking at each of their parts."""

from __future__ import annotations

import functools
import hashlib
import json

import numpy as np

from skd_sim.choices.options import EpisodeOptions, options_of
from skd_sim.encounter.scenario import Scenario
from skd_sim.episode.episode import Episode


def episode_digest(episode: Episode, campaign: str, start: int) -> str:
    """Return the SHA-256, in hexadecimal digits, of all that decides how an episode goes, and of which one it is.

    Args:
        episode: the specification.
        campaign: name of its campaign.
        start: stamp of its tick 0, ns.
    """
    phi = episode.safe_trajectory
    said = {
        "campaign": campaign,
        "start": start,
        "episode_id": episode.episode_id,
        "seed": episode.seed,
        "mode": int(episode.mode),
        "scenario": _text(episode.scenario),
        "options": {one.name: one.plain(getattr(episode, one.name)) for one in options_of(EpisodeOptions)},
        "safe_trajectory": None if phi is None else [phi.name, phi.time_step, phi.positions.shape],
    }
    digest = hashlib.sha256(json.dumps(said, sort_keys=True).encode())
    if phi is not None:
        digest.update(np.ascontiguousarray(phi.positions, np.float64).tobytes())
    return digest.hexdigest()


@functools.lru_cache(maxsize=64)
def _text(scenario: Scenario) -> str:
    """Return a scenario as text; a campaign has the same one over and over."""
    return json.dumps(scenario.as_dict(), sort_keys=True)
