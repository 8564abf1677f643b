"""Episodes: their specification and log, time stamps, random draws, and reasons for aborts."""

from __future__ import annotations

from typing import TYPE_CHECKING

from skd_sim.public import exported

if TYPE_CHECKING:
    from skd_sim.episode.episode import Episode as Episode
    from skd_sim.episode.episode import EpisodeLog as EpisodeLog
    from skd_sim.episode.episode import Mode as Mode
    from skd_sim.episode.episode import Outcome as Outcome

__all__ = ["Episode", "EpisodeLog", "Mode", "Outcome"]

_WHERE = {
    "Episode": "skd_sim.episode.episode",
    "EpisodeLog": "skd_sim.episode.episode",
    "Mode": "skd_sim.episode.episode",
    "Outcome": "skd_sim.episode.episode",
}
__getattr__, __dir__ = exported(__name__, _WHERE)
