"""The world: states, trajectories, contact, cars, sensors, and the tick; episodes, their log and random draws."""

from __future__ import annotations

from typing import TYPE_CHECKING

from skd_sim.public import exported

if TYPE_CHECKING:
    from skd_sim.world.episode import Episode as Episode
    from skd_sim.world.episode import EpisodeLog as EpisodeLog
    from skd_sim.world.episode import Mode as Mode
    from skd_sim.world.episode import Outcome as Outcome

__all__ = ["Episode", "EpisodeLog", "Mode", "Outcome"]

_WHERE = {
    "Episode": "skd_sim.world.episode",
    "EpisodeLog": "skd_sim.world.episode",
    "Mode": "skd_sim.world.episode",
    "Outcome": "skd_sim.world.episode",
}
__getattr__, __dir__ = exported(__name__, _WHERE)
