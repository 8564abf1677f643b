"""Budget and shape of a search."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from skd_adversary.pomdp.ucb import FOUND


class Backup(IntEnum):
    """How the value of a node enters that of the node above it."""

    BEST = 0  # the best of its actions' means, as in ABT
    MEAN = 1  # the mean over all that was tried there, as in POMCP: exploration counts against it
    MOST_VISITED = 2  # the mean of the action tried most: a lucky first try does not count yet


class Cells(IntEnum):
    """Which observations share a node."""

    LIKELIHOOD = 0  # those that say nearly the same of the states
    NEAREST = 1  # those that are near each other, by Euclid


@dataclass(frozen=True)
class PlannerOptions:
    """Budget and shape of the search.

    Attributes:
        simulations: new simulations per decision: a count, never a time, so that results repeat.
        depth: longest look-ahead, steps.
        exploration: UCB1 constant, in units of reward; None: twice the mean absolute deviation of what an action of the
            root has returned in this decision, of the action for which that is greatest. See `ucb`.
        observation_factor: k of the widening k·N^α; infinity: no limit but what `cells` asks for.
        observation_exponent: α of the widening.
        particles: size of the belief.
        backup: how the value of a node enters that of the node above it.
        keep_tree: whether the subtree of what was done and seen is kept for the next decision.
        cells: says which observations share a node.
        references: next states by whose likelihoods observations are told apart (`Cells.LIKELIHOOD`).
        cell_distance: squared Hellinger distance of an observation's likelihoods from those of every cell that makes it
            a cell of its own (`Cells.LIKELIHOOD`).
        learned_states: how many states, at most, rollouts learn the values of; 0: rollouts are those of the default
            policy alone. What is learned sees the state, so it is done with `Backup.MEAN` only; it means nothing where
            the model has leaf values. See `learning_rollouts`.
    """

    simulations: int = 10_000
    depth: int = 25
    exploration: float | None = None
    observation_factor: float = 4.0
    observation_exponent: float = 0.25
    particles: int = 3000
    backup: Backup = Backup.MEAN
    keep_tree: bool = False
    cells: Cells = Cells.LIKELIHOOD
    references: int = 8
    cell_distance: float = 0.1
    learned_states: int = 1 << 17

    @property
    def learns(self) -> bool:
        """Whether rollouts, where there are any, learn."""
        return self.learned_states > 0 and self.backup == Backup.MEAN

    @property
    def ucb_constant(self) -> float:
        """What the search takes for `exploration`."""
        return FOUND if self.exploration is None else self.exploration

    def __post_init__(self) -> None:
        if self.simulations < 1 or self.depth < 1:
            raise ValueError("a planner needs at least one simulation and a depth of one")
        if self.exploration is not None and not self.exploration >= 0.0:
            raise ValueError(f"exploration must not be negative, got {self.exploration:g}")
        if self.particles < 1:
            raise ValueError(f"a belief needs at least one particle, got particles {self.particles}")
        if self.references < 1:
            raise ValueError(f"cells of observations need at least one reference state, got {self.references}")
        if self.learned_states < 0:
            raise ValueError(f"learned_states must not be negative, got {self.learned_states}")
        for name in ("simulations", "depth", "particles", "references", "learned_states"):
            if getattr(self, name) != int(getattr(self, name)):
                raise ValueError(f"{name} must be a whole number, got {getattr(self, name)!r}")
        if not self.observation_factor > 0.0 or not 0.0 <= self.observation_exponent <= 1.0:
            raise ValueError(
                f"k·N^α needs k > 0 and α in [0, 1], got observation_factor {self.observation_factor!r} and "
                f"observation_exponent {self.observation_exponent!r}"
            )
        for name, kind in (("backup", Backup), ("cells", Cells)):
            if getattr(self, name) not in list(kind):
                raise ValueError(f"{name} must be one of {', '.join(map(str, kind))}, got {getattr(self, name)!r}")
