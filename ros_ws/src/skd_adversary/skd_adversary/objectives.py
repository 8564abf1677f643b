"""The objectives that come with SKD: the model and the planner's options of each, by the name that kamikazes go by.

An installed package adds one of its own by an entry point of group `skd.objectives` that leads to an `ObjectiveKind`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from skd_sim.errors import UsageError
from skd_sim.objective import OBJECTIVES

from skd_adversary.deformation_kamikaze import deformation_kamikaze_pomdp
from skd_adversary.frechet_kamikaze import frechet_kamikaze_pomdp
from skd_adversary.kamikaze import kamikaze_pomdp
from skd_adversary.planning.planner import PlannerOptions
from skd_adversary.planning.pomdp import Pomdp


@dataclass(frozen=True)
class ObjectiveKind:
    """What kamikazes of an objective plan for, and how.

    Attributes:
        model: (scenario, car model, start=(x, y) in m, gap in m, path=φ as n × 2 in m, maximum_distance in m or None) →
            the POMDP.
        options: of the planner, but for the number of simulations.
        plans_deformation: the distance that it plans for, and that a maximum distance limits, is the deformation; else
            the discrete Fréchet distance.
        follows_phi: there is an action more: as φ does in the same tick.
    """

    model: Callable[..., Pomdp]
    options: PlannerOptions
    plans_deformation: bool = False
    follows_phi: bool = False


PAPER = ObjectiveKind(kamikaze_pomdp, PlannerOptions(exploration=30.0))
FRECHET = ObjectiveKind(frechet_kamikaze_pomdp, PlannerOptions(exploration=0.5, particles=1000))
DEFORMATION = ObjectiveKind(
    deformation_kamikaze_pomdp,
    PlannerOptions(exploration=3.0, particles=1000),
    plans_deformation=True,
    follows_phi=True,
)


def objective_kind(name: str) -> ObjectiveKind:
    """Return the objective of a name.

    Raises:
        UsageError: there is none, or it cannot be loaded.
    """
    found = OBJECTIVES.find(name)
    if not isinstance(found, ObjectiveKind):
        raise UsageError(f"objective {name!r} ({OBJECTIVES.target(name)}) must be an ObjectiveKind, got {found!r:.60}")
    return found
