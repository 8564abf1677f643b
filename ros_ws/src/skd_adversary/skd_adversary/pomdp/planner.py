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

`play` runs an episode in closed loop: decide, act, observe, update the belief. docs/decisions.md says why this planner.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.kernels.stream import stream_of

from skd_adversary.pomdp.belief import ParticleBelief
from skd_adversary.pomdp.model import Pomdp
from skd_adversary.pomdp.search import Cells, PlannerOptions, SearchMemory, draw_roots, search_kernel
from skd_adversary.pomdp.tree import (
    CHILDREN,
    KNOWN,
    VALUE,
    VISITS,
    Float32Array,
    clear_node,
    copy_subtree,
    empty_tree,
    exploration_from,
    most_alike_child,
    nearest_child,
    no_returns,
    profile_kernel,
    tables_of,
)


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
        self._returns = no_returns(tree.statistics.shape[1])
        self._search = search_kernel(model, self._by_likelihood)
        self._origin = np.zeros(nodes, np.int32)
        self._tables = tables_of(nodes, options.observation_factor, options.observation_exponent)
        self._scratch = SearchMemory(
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
            returns=self._returns,
        )
        self._kept = 0  # nodes of the tree that `advance` has left
        self.model_steps = 0

    def plan(self, belief: ParticleBelief) -> int:
        """Return the action of highest estimated value at `belief`."""
        draw_roots(belief.weights, self._roots, self._rng)
        if self._kept == 0:  # then an action is taken without a search where no other is legal
            clear_node(self._tree, 0)
        options, model = self._options, self._model
        self.model_steps += self._search(
            model.parameters,
            model.leaves,
            belief.particles,
            self._roots,
            self._tree,
            max(1, self._kept),
            self._tables,
            self._scratch,
            options.ucb_constant,
            model.discount,
            int(options.backup),
            options.cell_distance,
            self._rng,
        )
        self._kept = 0
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


class DecisionMaker(Protocol):
    """Whoever decides: a planner, or a policy in its place."""

    def plan(self, belief: ParticleBelief) -> int:
        """Return an action."""

    def advance(self, action: int, observation: FloatArray) -> None:
        """Be told what was done and what was observed after it."""


@dataclass(frozen=True)
class Played:
    """An episode that was played.

    Attributes:
        value: discounted return of the episode.
        actions: the actions that were taken, in order.
        ended: whether the model ended the episode, and not the limit of moves.
    """

    value: float
    actions: tuple[int, ...]
    ended: bool


def play(
    model: Pomdp, belief: ParticleBelief, planner: DecisionMaker, rng: np.random.Generator, *, moves: int = 1000
) -> Played:
    """Play an episode.

    Args:
        model: the world; the planner may plan with another model of the same states, such as one with leaf values.
        belief: belief at the beginning; it is updated in the episode.
        planner: chooses the actions.
        rng: generator of what happens in the world.
        moves: greatest number of moves.

    Raises:
        ValueError: the belief is about states of another length.
    """
    if belief.particles.shape[1] != model.state_dim:
        raise ValueError(
            f"{model.name} has states of {model.state_dim} numbers, and the belief's have {belief.particles.shape[1]}"
        )
    state, after, seen = np.empty(model.state_dim), np.empty(model.state_dim), np.empty(model.observation_dim)
    model.initial(model.parameters, state, rng)
    value, discount, ended = 0.0, 1.0, False
    actions: list[int] = []
    while not ended and len(actions) < moves:
        action = planner.plan(belief)
        actions.append(action)
        reward, ended = model.step(model.parameters, state, action, after, rng)
        value, discount, state[:] = value + discount * reward, discount * model.discount, after
        if not ended:
            model.observe(model.parameters, state, action, seen, rng)
            belief.predict(action)
            belief.correct(action, seen)
            planner.advance(action, seen)
    return Played(value, tuple(actions), bool(ended))
