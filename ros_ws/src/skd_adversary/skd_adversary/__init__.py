"""The adversary: a POMDP planner, and the kamikazes that it plans.

What stands in `__all__` is for users and stays where it is; modules below may move.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from skd_sim.public import exported

if TYPE_CHECKING:
    from skd_adversary.planning.belief import ParticleBelief as ParticleBelief
    from skd_adversary.planning.closed_loop import play as play
    from skd_adversary.planning.model_check import check_model as check_model
    from skd_adversary.planning.options import PlannerOptions as PlannerOptions
    from skd_adversary.planning.planner import Planner as Planner
    from skd_adversary.planning.pomdp import Pomdp as Pomdp

__all__ = [
    "ParticleBelief",
    "Planner",
    "PlannerOptions",
    "Pomdp",
    "check_model",
    "play",
]

_WHERE = {
    "ParticleBelief": "skd_adversary.planning.belief",
    "Planner": "skd_adversary.planning.planner",
    "PlannerOptions": "skd_adversary.planning.options",
    "Pomdp": "skd_adversary.planning.pomdp",
    "check_model": "skd_adversary.planning.model_check",
    "play": "skd_adversary.planning.closed_loop",
}
__getattr__, __dir__ = exported(__name__, _WHERE)
