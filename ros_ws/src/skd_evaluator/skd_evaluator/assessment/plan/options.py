"""The options of a campaign: those of its episodes, and how many it has. Light: every command begins with it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from skd_sim.options.options import EpisodeOptions, option

from skd_evaluator.metrics import behaviour

SYNTHETIC = "synthetic"
OWN = "own"
"""As synthetic, but against the car under test itself, as far as the adversary knows it."""
RECORDED = "bags"
"""What results of recordings have in its place: φ of the recorded episodes, in whatever simulator they ran."""
MAXIMUM_ABORTED = 0.05
"""Share of episodes that may be aborted before an assessment counts as failed."""
MOST_WORKERS = 1024
DEFAULT_MARGIN_LIMIT = 512
WALKERS, NO_BEHAVIOUR = behaviour.WALKERS, behaviour.NO_BEHAVIOUR
GENERATED = (SYNTHETIC, OWN, WALKERS)
"""Sources of as many φ as are asked for."""
_CAMPAIGN: Any = {"metavar": "N", "commands": ("assess", "sweep"), "launches": ("assessment",)}


@dataclass(frozen=True, kw_only=True)
class CampaignOptions(EpisodeOptions):
    """The table of a campaign's options."""

    safe: str = option(
        SYNTHETIC,
        "where the safe trajectories come from: synthetic (planned by an adversary that avoids a basic car), own (by "
        "one that avoids the car under test), walkers (drawn from the behaviour model walkers: straight crossings that "
        "differ in pace, start, drift and hesitation, and that the same basic car does not hit), regulatory (what the "
        "scenario's section protocol prescribes for a test's target), or a path of recorded ones: the folder of CITR's "
        "vci_lat_uni, a csv file with columns t, x, y, or a folder of such files. If the car hits in more than 95 "
        "percent of the runs along a trajectory, a warning names it: it is not safe with this car",
        metavar="SOURCE",
        group="car and test",
        commands=("assess", "episode", "drive"),
    )
    safe_count: int = option(20, "how many safe trajectories (φ) there are", low=1, high=65_535, **_CAMPAIGN)
    kamikaze_count: int = option(
        25,
        "how many kamikazes are planned for each safe trajectory",
        low=1,
        high=1_000_000,
        **{**_CAMPAIGN, "commands": (*_CAMPAIGN["commands"], "ncap")},
    )
    collision_runs: int = option(
        500,
        "in how many runs the adversary just follows a safe trajectory: how often it is hit is the contact rate",
        low=1,
        high=10_000_000,
        **_CAMPAIGN,
    )
    seed: int = option(
        0,
        "number from which every random draw follows: the same seed gives the same results",
        low=0,
        high=2**63 - 1,
        metavar="N",
        commands=("assess", "sweep", "episode", "probe", "ncap", "reference", "drive"),
    )


@dataclass(frozen=True, kw_only=True)
class AssessmentOptions:
    """The table of what an assessment computes beside planned kamikazes."""

    margin_limit: int = option(
        DEFAULT_MARGIN_LIMIT,
        "how many candidate trajectories the search for the margin may drive in each trial. The search doubles the "
        "number until the mean hardly changes. 0: no margin. The margin of the basic car is exact and needs no search",
        low=0,
        high=1_000_000,
        metavar="N",
        commands=("assess", "sweep", "replay", "ncap", "reference"),
    )
    behaviour: str = option(
        WALKERS,
        "how people walk who do not try to be hit; the risk R(s) says how likely the front of the moving car hits "
        "them. walkers (pedestrians who cross in front of a slow vehicle), a file that skd behaviour fit has written, "
        "or none: then no risk is computed",
        metavar="NAME",
        commands=("assess", "sweep", "episode"),
    )
    risk_runs: int | None = option(
        None,
        "how many crossings the risk is estimated from at each scale s",
        int,
        low=1,
        high=10_000_000,
        metavar="N",
        commands=("assess", "sweep"),
        unset="2000 for the basic car, 500 for any other, 100 through the node graph; but at most four times "
        "--collision-runs, and through the node graph at most as many",
    )
    risk_subset: bool = option(
        False,
        "use subset simulation wherever the crossings show fewer than 50 hits, whatever the car. For the basic car "
        "that is always done; for others it takes 16000 crossings or more at each scale",
        commands=("assess", "sweep"),
    )
    curve: bool = option(
        False,
        "also plan kamikazes that may bend φ only up to a limit, for several limits: each gives a point in the picture "
        "of the vulnerability curve (vulnerability.png)",
        commands=("assess",),
    )
