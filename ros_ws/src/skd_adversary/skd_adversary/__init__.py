"""The adversary: a POMDP planner, and the kamikazes that it plans.

What stands in `__all__` is for users and stays where it is; modules below may move.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from skd_sim.public import exported

if TYPE_CHECKING:
    from skd_adversary.pomdp.belief import ParticleBelief as ParticleBelief
    from skd_adversary.pomdp.model import Pomdp as Pomdp
    from skd_adversary.pomdp.model import check_model as check_model
    from skd_adversary.pomdp.planner import Planner as Planner
    from skd_adversary.pomdp.planner import PlannerOptions as PlannerOptions
    from skd_adversary.pomdp.planner import play as play

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
    "PlannerOptions": "skd_adversary.pomdp.planner",
    "Pomdp": "skd_adversary.pomdp.model",
    "check_model": "skd_adversary.pomdp.model",
    "play": "skd_adversary.pomdp.planner",
}
__getattr__, __dir__ = exported(__name__, _WHERE)
