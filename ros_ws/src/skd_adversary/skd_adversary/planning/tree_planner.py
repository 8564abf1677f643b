"""What all planners have in common: options, a tree, and what can be asked about the last decision."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.kernels.stream import stream_of

from skd_adversary.planning.belief import ParticleBelief
from skd_adversary.planning.options import PlannerOptions
from skd_adversary.planning.pomdp import Pomdp
from skd_adversary.planning.search import RootLog, draw_roots
from skd_adversary.planning.search_tree import CHILDREN, FIRST_CHILD, VALUE, VISITS, Float32Array, SearchTree
from skd_adversary.planning.ucb import exploration_from, no_returns


@dataclass(frozen=True)
class RootCell:
    """A child of the root: observations that lead to the same node.

    Attributes:
        observation: the observation that made the cell, d numbers.
        visits: simulations of the last decision that went on there.
        states: different states of the belief that these began in. Where most cells hold most of the belief's states,
            the observation says little, or the cells do not tell apart what it says.
    """

    observation: FloatArray
    visits: int
    states: int


@dataclass(frozen=True)
class RootAction:
    """What the last decision found out about an action.

    Attributes:
        action: the action.
        visits: simulations through it, those of a kept tree included.
        value: estimated return; nan where it was not tried.
        standard_error: standard error of the mean return of the last decision's simulations, as if they were
            independent; nan with fewer than two. They are not independent, for all learn from the same tree: the true
            error is larger.
        cells: most visited first.
    """

    action: int
    visits: int
    value: float
    standard_error: float
    cells: tuple[RootCell, ...]


class TreePlanner(ABC):
    """Decides from a particle belief by tree search."""

    def __init__(self, model: Pomdp, options: PlannerOptions, rng: np.random.Generator, tree: SearchTree) -> None:
        """Prepare for `model`; all randomness of the search comes from `rng`."""
        self._model = model
        self._options = options
        self._rng = stream_of(rng)
        self._tree = tree
        self._roots = np.zeros(options.simulations, np.uint32)
        self._log = RootLog(
            np.full(options.simulations, -1, np.int32),
            np.zeros(options.simulations),
            np.full(options.simulations, -1, np.int32),
        )
        self._returns = no_returns(tree.statistics.shape[1])
        self._particles = np.empty((0, model.state_dim))

    def plan(self, belief: ParticleBelief) -> int:
        """Return the action of highest estimated value at `belief`."""
        draw_roots(belief.weights, self._roots, self._rng)
        self._log.action.fill(-1)
        if self._particles.shape != belief.particles.shape:
            self._particles = np.empty_like(belief.particles)
        self._particles[:] = belief.particles  # the belief goes on; `root` asks what it was
        self._search_from(belief)
        return self._decision()

    @abstractmethod
    def _search_from(self, belief: ParticleBelief) -> None:
        """Grow the tree, one simulation for each of the roots."""

    def _decision(self) -> int:
        best, decision = -math.inf, 0
        for action, (value, visits) in enumerate(self._tree.statistics[0].tolist()):  # for so few, faster than numpy
            if visits > 0.0 and value > best:
                best, decision = value, action
        return decision

    def advance(self, action: int, observation: FloatArray) -> None:  # noqa: B027 - nothing, unless a tree is kept
        """Say what was done and what was observed after it."""

    @property
    def values(self) -> Float32Array:
        """Estimated value of each action at the last belief planned from."""
        values: Float32Array = np.where(self.visits > 0.0, self._tree.statistics[0, :, VALUE], np.float32(0.0))
        return values

    @property
    def visits(self) -> Float32Array:
        """Number of simulations through each action at the last belief planned from."""
        visits: Float32Array = np.maximum(self._tree.statistics[0, :, VISITS], 0.0)
        return visits

    @property
    def exploration(self) -> float:
        """UCB1's constant at the end of the last decision, in units of reward."""
        return float(exploration_from(self._options.ucb_constant, self._returns))

    @property
    def tree(self) -> SearchTree:
        """The tree of the last decision, until `advance`; the planner's own arrays, to be read only."""
        return self._tree

    def root(self) -> tuple[RootAction, ...]:
        """Return what the last decision found out about each action; to be asked before `advance`."""
        _, numbers = np.unique(self._particles, axis=0, return_inverse=True)
        state_of = numbers.ravel()[self._roots]
        return tuple(self._root_action(action, state_of) for action in range(self._model.action_count))

    def _root_action(self, action: int, state_of: np.ndarray) -> RootAction:
        visits = int(self.visits[action])
        returns = self._log.value[self._log.action == action]
        cells = []
        child = int(self._tree.links[0, action, FIRST_CHILD])
        for _ in range(self._tree.links[0, action, CHILDREN]):
            here = (self._log.cell == child) & (self._log.action == action)
            observation = self._tree.observation[child].copy()
            cells.append(RootCell(observation, int(here.sum()), len(np.unique(state_of[here]))))
            child = int(self._tree.sibling[child])
        return RootAction(
            action,
            visits,
            float(self.values[action]) if visits else np.nan,
            float(returns.std(ddof=1) / np.sqrt(len(returns))) if len(returns) > 1 else np.nan,
            tuple(sorted(cells, key=lambda cell: -cell.visits)),
        )
