"""The options of a campaign: those of its episodes, and how many it has. Light: every command begins with it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from skd_sim.choices.options import EpisodeOptions, option

SYNTHETIC = "synthetic"
OWN = "own"
"""As synthetic, but against the car under test itself, as far as the adversary knows it."""
DEFAULT_MARGIN_LIMIT = 1024
MARGIN_LIMIT_TEXT = (
    "how many ticks of the car the search for the margin may simulate in each attempt, at most. It doubles its budget "
    "until the mean changes by less than 2 percent. With 0 there is no margin. The basic car's margin is exact and "
    "needs no search"
)
_CAMPAIGN: Any = {"metavar": "N", "commands": ("assess", "sweep"), "launches": ("assessment",)}


@dataclass(frozen=True, kw_only=True)
class CampaignOptions(EpisodeOptions):
    """The table of a campaign's options."""

    safe: str = option(
        SYNTHETIC,
        "safe trajectories: synthetic, own (as synthetic, but against this car), or a path: CITR vci_lat_uni folder, "
        "csv file (t, x, y) or folder of them. One that is hit in more than 95 percent of the runs along it is named: "
        "with this car it is not safe",
        metavar="SOURCE",
        group="car and test",
        commands=("assess", "episode"),
    )
    safe_count: int = option(20, "how many safe trajectories φ there are", low=1, high=65_535, **_CAMPAIGN)
    kamikaze_count: int = option(
        25, "how many kamikazes are planned for each safe trajectory", low=1, high=1_000_000, **_CAMPAIGN
    )
    collision_runs: int = option(
        500,
        "how many runs the car makes against an adversary that follows the safe trajectories",
        low=1,
        high=10_000_000,
        **_CAMPAIGN,
    )
    seed: int = option(
        0,
        "seed of every random draw: the same seed gives the same results",
        low=0,
        high=2**63 - 1,
        metavar="N",
        commands=("assess", "sweep", "episode", "probe"),
    )
