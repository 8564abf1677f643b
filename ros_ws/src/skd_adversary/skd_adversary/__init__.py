"""The adversary: a POMDP planner, and the kamikazes that it plans.

What stands in `__all__` is for users and stays where it is; modules below may move.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from skd_sim.public import exported

if TYPE_CHECKING:
    from skd_adversary.pomdp.belief import ParticleBelief as ParticleBelief
    from skd_adversary.pomdp.closed_loop import play as play
    from skd_adversary.pomdp.model_check import check_model as check_model
    from skd_adversary.pomdp.options import PlannerOptions as PlannerOptions
    from skd_adversary.pomdp.planner import Planner as Planner
    from skd_adversary.pomdp.pomdp import Pomdp as Pomdp

__all__ = [
    "ParticleBelief",
    "Planner",
    "PlannerOptions",
    "Pomdp",
    "check_model",
    "play",
]

_WHERE = {
    "ParticleBelief": "skd_adversary.pomdp.belief",
    "Planner": "skd_adversary.pomdp.planner",
    "PlannerOptions": "skd_adversary.pomdp.options",
    "Pomdp": "skd_adversary.pomdp.pomdp",
    "check_model": "skd_adversary.pomdp.model_check",
    "play": "skd_adversary.pomdp.closed_loop",
}
__getattr__, __dir__ = exported(__name__, _WHERE)
