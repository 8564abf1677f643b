"""The objectives that there are, by name: a module each, imported when it is asked for.

SKD's own, and those of installed packages, stand in `skd_sim.options.adversary.OBJECTIVES`.
"""

from __future__ import annotations

from skd_sim.errors import UsageError
from skd_sim.options.adversary import OBJECTIVES

from skd_adversary.crossing.parts import ObjectiveModel


def objective_named(name: str) -> ObjectiveModel:
    """Return the objective of a name.

    Raises:
        UsageError: there is none, or it cannot be loaded.
    """
    found = OBJECTIVES.find(name)
    if not isinstance(found, ObjectiveModel):
        raise UsageError(f"objective {name!r} ({OBJECTIVES.target(name)}) must be an ObjectiveModel, got {found!r:.60}")
    return found
