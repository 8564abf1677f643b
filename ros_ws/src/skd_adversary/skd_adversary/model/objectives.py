"""The objectives that there are, by name. Each is a module of its own, imported when it is asked for."""

from __future__ import annotations

import importlib
from typing import Final

from skd_sim.objective import Objective

from skd_adversary.model.parts import ObjectiveModel

SAFE: Final = "safe"

MODULES: Final = {
    SAFE: "skd_adversary.model.objective.safe",
    Objective.PAPER: "skd_adversary.model.objective.paper",
    Objective.FRECHET: "skd_adversary.model.objective.frechet",
    Objective.DEFORMATION: "skd_adversary.model.objective.deformation",
}
"""Name → module whose `OBJECTIVE` it is."""


def objective_named(name: str) -> ObjectiveModel:
    """Return the objective of a name."""
    found: ObjectiveModel = importlib.import_module(MODULES[name]).OBJECTIVE
    return found
