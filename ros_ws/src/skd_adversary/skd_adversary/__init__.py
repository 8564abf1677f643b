"""The adversary: a POMDP planner, and the kamikazes that it plans.

What stands in `__all__` is for users and stays where it is; modules below may move.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from skd_sim.public import exported

if TYPE_CHECKING:
    from skd_adversary.planning.belief import ParticleBelief as ParticleBelief
    from skd_adversary.planning.general.closed_loop import play as play
    from skd_adversary.planning.general.model_check import check_model as check_model
    from skd_adversary.planning.general.observed_values import with_observed_leaves as with_observed_leaves
    from skd_adversary.planning.general.pft_dpw import PftDpw as PftDpw
    from skd_adversary.planning.general.pomcpow import Pomcpow as Pomcpow
    from skd_adversary.planning.options import PlannerOptions as PlannerOptions
    from skd_adversary.planning.planner import Planner as Planner
    from skd_adversary.planning.pomdp import Pomdp as Pomdp

__all__ = [
    "ParticleBelief",
    "PftDpw",
    "Planner",
    "PlannerOptions",
    "Pomcpow",
    "Pomdp",
    "check_model",
    "play",
    "with_observed_leaves",
]

_WHERE = {
    "ParticleBelief": "skd_adversary.planning.belief",
    "PftDpw": "skd_adversary.planning.general.pft_dpw",
    "Planner": "skd_adversary.planning.planner",
    "PlannerOptions": "skd_adversary.planning.options",
    "Pomcpow": "skd_adversary.planning.general.pomcpow",
    "Pomdp": "skd_adversary.planning.pomdp",
    "check_model": "skd_adversary.planning.general.model_check",
    "play": "skd_adversary.planning.general.closed_loop",
    "with_observed_leaves": "skd_adversary.planning.general.observed_values",
}
__getattr__, __dir__ = exported(__name__, _WHERE)
