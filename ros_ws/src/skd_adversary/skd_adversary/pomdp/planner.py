"""POMCP over cells of observations: online tree search for listed actions and any observations.

A simulation follows one state, drawn from the belief, down the tree: UCB1 chooses actions, observations choose children
(POMCP, Silver and Veness, NIPS 2010). A continuous observation never comes twice, and a tree that makes a child of each
acts as if all were known one step ahead (QMDP; Sunberg and Kochenderfer, ICAPS 2018). So a node stands for a cell of
observations. Those that say nearly the same of the states share one (`Cells.LIKELIHOOD`), however far apart they are as
numbers: noise makes no cells. And children are widened progressively, at most k·N^α of them; beyond that an observation
goes to the child that is most alike.

A node's value is the mean over all that was tried there, as published: where leaves or rollouts see the state, the best
of an action's means is their optimism, and "ask later" always looks better than to ask. A new node's first try is the
default policy's.

Where a model has no leaf values, rollouts learn what states are worth (`learning_rollouts`).

docs/decisions.md says why this planner.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.kernels.stream import stream_of

from skd_adversary.pomdp.belief import ParticleBelief
from skd_adversary.pomdp.learning_rollouts import ROLLOUTS, no_experience, practice_kernel
from skd_adversary.pomdp.observation_cells import most_alike_child, nearest_child, profile_kernel
from skd_adversary.pomdp.options import Cells, PlannerOptions
from skd_adversary.pomdp.pomdp import Pomdp
from skd_adversary.pomdp.search import RootLog, Scratch, draw_roots, search_kernel
from skd_adversary.pomdp.search_tree import (
    CHILDREN,
    FIRST_CHILD,
    KNOWN,
    VALUE,
    VISITS,
    Float32Array,
    SearchTree,
    clear_node,
    copy_subtree,
    empty_tree,
)
from skd_adversary.pomdp.ucb import exploration_from, no_returns, tables_of


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


class Planner:
    """Decides from a particle belief by tree search.

    Attributes:
        model_steps: steps of the model made so far, over all decisions.
    """

    def __init__(self, model: Pomdp, options: PlannerOptions, rng: np.random.Generator) -> None:
        """Prepare for `model`; all randomness of the search comes from `rng`."""
        self._by_likelihood = options.cells == Cells.LIKELIHOOD
        references = options.references if self._by_likelihood else 0
        nodes = 2 * options.simulations + 1  # half of them for what is kept
        tree, self._spare = (
            empty_tree(nodes, model.action_count, model.observation_dim, references, model.state_dim) for _ in range(2)
        )
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
        learns = options.learns and model.leaf_value is None
        self._search = search_kernel(model, self._by_likelihood, learns)
        self._practise = practice_kernel(model.name, model.step, model.rollout_action, model.legal) if learns else None
        self._origin = np.zeros(nodes, np.int32)
        self._tables = tables_of(nodes, options.observation_factor, options.observation_exponent)
        self._scratch = Scratch(
            state=np.empty(model.state_dim),
            moved=np.empty(model.state_dim),
            observation=np.empty(model.observation_dim),
            seen=np.empty(model.observation_dim, np.float32),
            path_node=np.empty(options.depth, np.uint32),
            path_action=np.empty(options.depth, np.uint32),
            path_reward=np.empty(options.depth),
            other_state=np.empty(model.state_dim),
            other_observation=np.empty(model.observation_dim),
            likelihood=np.empty(references),
            profile=np.empty(references, np.float32),
            notes=no_experience(
                options.learned_states if learns else 0, model.state_dim, model.action_count, options.depth
            ),
            returns=self._returns,
        )
        self._kept = 0  # nodes of the tree that `advance` has left
        self.model_steps = 0

    def plan(self, belief: ParticleBelief) -> int:
        """Return the action of highest estimated value at `belief`."""
        draw_roots(belief.weights, self._roots, self._rng)
        self._log.action.fill(-1)
        if self._particles.shape != belief.particles.shape:
            self._particles = np.empty_like(belief.particles)
        self._particles[:] = belief.particles  # the belief goes on; `root` asks what it was
        self._search_from(belief)
        return self._decision()

    def _search_from(self, belief: ParticleBelief) -> None:
        """Search from what `advance` kept, or from nothing.

        Where nothing was kept and but one action is legal, it is that one, without a search.
        """
        if self._kept == 0:
            clear_node(self._tree, 0)
        options, model, scratch = self._options, self._model, self._scratch
        if self._practise is not None and scratch.notes.totals[ROLLOUTS] == 0.0:
            self.model_steps += self._practise(
                model.parameters,
                belief.particles,
                self._roots,
                scratch.state,
                scratch.moved,
                scratch.notes,
                options.depth,
                model.discount,
                self._rng,
            )
        self.model_steps += self._search(
            model.parameters,
            model.leaves,
            belief.particles,
            self._roots,
            self._tree,
            max(1, self._kept),
            self._tables,
            self._scratch,
            self._log,
            options.ucb_constant,
            model.discount,
            int(options.backup),
            options.cell_distance,
            self._rng,
        )
        self._kept = 0

    def _decision(self) -> int:
        best, decision = -math.inf, 0
        for action, (value, visits) in enumerate(self._tree.statistics[0].tolist()):  # for so few, faster than numpy
            if visits > 0.0 and value > best:
                best, decision = value, action
        return decision

    def advance(self, action: int, observation: FloatArray) -> None:
        """Keep of the tree what lies below an action that was taken and the observation made after it."""
        if not self._options.keep_tree:
            return
        child = self._child(action, observation)
        if child < 0:
            return
        self._kept = copy_subtree(self._tree, child, self._spare, self._options.simulations, self._origin)
        self._tree, self._spare = self._spare, self._tree

    def _child(self, action: int, observation: FloatArray) -> int:
        """Return the root's child whose cell an observation belongs to, −1 without a child."""
        tree, scratch, seen = self._tree, self._scratch, observation.astype(np.float32)
        if not self._by_likelihood:
            return int(nearest_child(tree, 0, action, seen)[0])
        if tree.links[0, action, CHILDREN] == 0:
            return -1
        profile_kernel(self._model.name, self._model.likelihood)(
            self._model.parameters,
            tree,
            0,
            action,
            observation,
            scratch.other_state,
            scratch.likelihood,
            scratch.profile,
        )
        known = tree.basis[0, action, KNOWN]
        return int(most_alike_child(tree, 0, action, known, scratch.profile, seen)[0])

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
