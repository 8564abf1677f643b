"""PFT-DPW: tree search over particle beliefs (Sunberg and Kochenderfer, ICAPS 2018, algorithm 3), for comparison.

A node is a belief of m particles. Where an action is to be widened, k·N^α beliefs at most, one particle draws what is
observed, all are moved and weighted by it, and resampled; beyond that a simulation picks one of the beliefs at random.
What the step is worth is the mean over the particles, and those whose episode it ends are worth no more: the value of
the belief counts with the share of the others. A node's value is the mean.

As in the published experiments, a new belief's value is a rollout over beliefs that acts by QMDP, where the model says
what its actions are worth to somebody who sees the state (`Pomdp.action_value`): such a policy sees no more than it
would. Else it is the mean of the particles' leaf values, or the default policy's return from one of them.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.kernels.compilation import kernel, specialise, unbound

from skd_adversary.planning.belief import ParticleBelief
from skd_adversary.planning.drawn_actions import action_kernels, action_widening, slots_of
from skd_adversary.planning.options import PlannerOptions
from skd_adversary.planning.pomdp import Action, Pomdp
from skd_adversary.planning.rollouts import tail_kernel
from skd_adversary.planning.search import RootLog
from skd_adversary.planning.search_tree import (
    CHILDREN,
    FIRST_CHILD,
    VISITS,
    IndexArray,
    Int32Array,
    SearchTree,
    add_child,
    clear_node,
    empty_tree,
    note_value,
)
from skd_adversary.planning.tree_planner import TreePlanner
from skd_adversary.planning.ucb import Tables, choose, exploration_from, forget_returns, note_return, tables_of

_step = _observe = _likelihood = _move = _tail = _state_tail = _action_value = _forbid = _widen = _taken = unbound
_HAS_LEAF_VALUE = _HAS_ACTION_VALUE = False


@dataclass(frozen=True)
class PftDpwOptions(PlannerOptions):
    """Options of PFT-DPW; `backup`, `keep_tree`, `cells`, `references` and `cell_distance` mean nothing to it.

    Attributes:
        node_particles: m, size of a node's belief.
    """

    node_particles: int = 20

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.node_particles < 1:
            raise ValueError(f"a belief needs at least one particle, got node_particles {self.node_particles}")


class _Beliefs(NamedTuple):
    """Beliefs of n nodes and, in the last row, of a rollout; m particles each."""

    particles: FloatArray  # n × m × s
    reward: FloatArray  # n: mean of the step that led here
    going_on: FloatArray  # n: share of the particles whose episode goes on; 0: this node has no particles


class _Scratch(NamedTuple):
    after: FloatArray  # m × s
    weights: FloatArray  # m
    state: FloatArray  # s
    moved: FloatArray  # s
    observation: FloatArray  # d
    path_node: Int32Array  # h
    path_action: Int32Array  # h
    path_child: Int32Array  # h
    returns: FloatArray  # actions × 3: what is kept of the decision's returns
    drawn: FloatArray  # e: an action that was drawn


@kernel(inline=True)
def _resample(scratch: _Scratch, beliefs: _Beliefs, node: int, total: float, rng: np.random.Generator) -> None:
    """Draw a node's particles from those that were moved, systematically by weight."""
    count = scratch.weights.shape[0]
    offset = rng.random()
    cumulative = scratch.weights[0] / total
    source = 0
    for i in range(count):
        while cumulative < (i + offset) / count and source < count - 1:
            source += 1
            cumulative += scratch.weights[source] / total
        for k in range(scratch.state.shape[0]):
            beliefs.particles[node, i, k] = scratch.after[source, k]


def _move_template(
    parameters: Any,
    particles: FloatArray,
    weights: FloatArray,
    beliefs: _Beliefs,
    scratch: _Scratch,
    node: int,
    action: Action,
    child: int,
    first: int,
    rng: np.random.Generator,
) -> None:
    """Make `child` the belief after an action in `node` and something observed then, which is left in `scratch`.

    At the root the particles are drawn anew from the belief, beginning with number `first`.
    """
    count, width = scratch.weights.shape[0], scratch.state.shape[0]
    reward, going_on, drawer = 0.0, 0, -1
    offset = rng.random()
    cumulative, source = weights[0], 0
    for i in range(count):
        if node == 0 and i == 0:
            source_now = first
        elif node == 0:
            while cumulative < (i - 1 + offset) / (count - 1) and source < weights.shape[0] - 1:
                source += 1
                cumulative += weights[source]
            source_now = source
        else:
            source_now = i
        for k in range(width):
            scratch.state[k] = particles[source_now, k] if node == 0 else beliefs.particles[node, i, k]
        gain, terminal = _step(parameters, scratch.state, action, scratch.moved, rng)
        reward += gain
        scratch.weights[i] = 0.0 if terminal else 1.0
        for k in range(width):
            scratch.after[i, k] = scratch.moved[k]
        if not terminal:
            going_on += 1
            if drawer < 0 or (node > 0 and int(rng.random() * going_on) == 0):
                drawer = i  # the first at the root, which was drawn by weight; any with equal chance elsewhere
    beliefs.reward[child] = reward / count
    beliefs.going_on[child] = going_on / count
    if drawer < 0:
        for k in range(scratch.observation.shape[0]):
            scratch.observation[k] = 0.0
        return
    for k in range(width):
        scratch.state[k] = scratch.after[drawer, k]
    _observe(parameters, scratch.state, action, scratch.observation, rng)
    total = 0.0
    for i in range(count):
        if scratch.weights[i] > 0.0:
            for k in range(width):
                scratch.moved[k] = scratch.after[i, k]
            scratch.weights[i] = _likelihood(parameters, scratch.moved, action, scratch.observation)
            total += scratch.weights[i]
    if not total > 0.0:  # even the drawer's own is too small a number
        scratch.weights[drawer] = total = 1.0
    _resample(scratch, beliefs, child, total, rng)


def _tail_template(
    parameters: Any,
    leaf_parameters: Any,
    particles: FloatArray,
    weights: FloatArray,
    beliefs: _Beliefs,
    scratch: _Scratch,
    node: int,
    spare: int,
    action_count: int,
    steps: int,
    discount: float,
    rng: np.random.Generator,
) -> float:
    """Return what is to be expected from a node's belief on; row `spare` is overwritten."""
    count, width = scratch.weights.shape[0], scratch.state.shape[0]
    value = 0.0
    if _HAS_ACTION_VALUE:
        scale = 1.0
        for _ in range(steps):
            best, action = -np.inf, 0
            for a in range(action_count):
                score = 0.0
                for i in range(count):
                    for k in range(width):
                        scratch.state[k] = beliefs.particles[node, i, k]
                    score += _action_value(leaf_parameters, scratch.state, a)
                if score > best:
                    best, action = score, a
            _move(parameters, particles, weights, beliefs, scratch, node, action, spare, 0, rng)
            node = spare
            value += scale * beliefs.reward[node]
            scale *= discount * beliefs.going_on[node]
            if scale == 0.0:
                break
        return value
    tails = count if _HAS_LEAF_VALUE else 1  # a rollout costs as much as many leaf values
    for i in range(tails):
        for k in range(width):
            scratch.state[k] = beliefs.particles[node, i, k]
        value += _state_tail(
            parameters, leaf_parameters, scratch.state, scratch.moved, scratch.drawn, steps, discount, rng
        )
    return value / tails


def _pft_dpw_template(
    parameters: Any,
    leaf_parameters: Any,
    particles: FloatArray,
    weights: FloatArray,
    roots: IndexArray,
    tree: SearchTree,
    beliefs: _Beliefs,
    tables: Tables,
    action_widening: Int32Array,
    scratch: _Scratch,
    log: RootLog,
    exploration: float,
    discount: float,
    rng: np.random.Generator,
) -> None:
    path_node, path_action, path_child = scratch.path_node, scratch.path_action, scratch.path_child
    depth_limit = path_node.shape[0]
    last = tables.widening.shape[0] - 1
    width, spare = scratch.state.shape[0], tree.total.shape[0]
    node_count = 1
    clear_node(tree, 0)
    for k in range(width):
        scratch.state[k] = particles[roots[0], k]
    _forbid(parameters, tree, 0, scratch.state)
    forget_returns(scratch.returns)
    for i in range(roots.shape[0]):
        constant = exploration_from(exploration, scratch.returns)
        node, depth, value = 0, 0, 0.0
        while depth < depth_limit:
            if scratch.drawn.shape[0] > 0:  # of which another action may be drawn
                for k in range(width):
                    scratch.state[k] = particles[roots[i], k] if node == 0 else beliefs.particles[node, 0, k]
            _widen(parameters, tree, node, depth, scratch.state, scratch.drawn, action_widening, rng)
            action = choose(tree, node, constant, tables, rng)
            children = tree.links[node, action, CHILDREN]
            fresh = children <= tables.widening[min(int(tree.statistics[node, action, VISITS]), last)]
            if fresh:
                child = node_count
                node_count += 1
                clear_node(tree, child)
                taken = _taken(tree, node, action, scratch.drawn)
                _move(parameters, particles, weights, beliefs, scratch, node, taken, child, roots[i], rng)
                if beliefs.going_on[child] > 0.0:
                    _forbid(parameters, tree, child, scratch.state)
                add_child(tree, node, action, child, scratch.observation)
            else:
                child = tree.links[node, action, FIRST_CHILD]
                for _ in range(int(rng.random() * children)):
                    child = tree.sibling[child]
            path_node[depth], path_action[depth], path_child[depth] = node, action, child
            depth += 1
            if beliefs.going_on[child] == 0.0:
                break
            if fresh or depth == depth_limit:
                value = _tail(
                    parameters,
                    leaf_parameters,
                    particles,
                    weights,
                    beliefs,
                    scratch,
                    child,
                    spare,
                    tree.statistics.shape[1],
                    depth_limit - depth,
                    discount,
                    rng,
                )
                break
            node = child
        for level in range(depth - 1, -1, -1):
            node, action, child = path_node[level], path_action[level], path_child[level]
            value = beliefs.reward[child] + discount * beliefs.going_on[child] * value
            tree.total[node] += 1
            note_value(tree, node, action, value)
        log.action[i], log.value[i], log.cell[i] = path_action[0], value, path_child[0]
        note_return(scratch.returns, path_action[0], value)


@functools.cache
def _kernel(
    name: str,
    step: Callable[..., Any],
    observe: Callable[..., Any],
    likelihood: Callable[..., Any],
    rollout_action: Callable[..., Any],
    leaf_value: Callable[..., Any] | None,
    action_value: Callable[..., Any] | None,
    legal: Callable[..., Any] | None,
    draw_action: Callable[..., Any] | None,
) -> Callable[..., Any]:
    own = {"_step": step, "_observe": observe, "_likelihood": likelihood}
    move = specialise(_move_template, name, own, allocates=False)
    tail: dict[str, Any] = {"_move": move}
    kind = name
    if action_value is not None:
        kind += "_action_values"
        tail |= {"_HAS_ACTION_VALUE": True, "_action_value": action_value}
    else:
        kind += "" if leaf_value is None else "_leaves"
        tail |= {
            "_HAS_LEAF_VALUE": leaf_value is not None,
            "_state_tail": tail_kernel(name, step, rollout_action, leaf_value, draw_action is not None),
        }
    bound = {
        "_move": move,
        "_tail": specialise(_tail_template, kind, tail, allocates=False),
        **action_kernels(name, draw_action, legal),
    }
    return specialise(_pft_dpw_template, kind, bound, allocates=False)


class PftDpw(TreePlanner):
    """PFT-DPW; the interface is that of `Planner`."""

    def __init__(self, model: Pomdp, options: PftDpwOptions, rng: np.random.Generator) -> None:
        """Prepare for `model`; all randomness of the search comes from `rng`."""
        nodes, count = options.simulations + 1, options.node_particles
        slots = slots_of(model, options, nodes)
        tree = empty_tree(nodes, slots, model.observation_dim, action_dim=model.action_dim)
        super().__init__(model, options, rng, tree)
        self._search = _kernel(
            model.name,
            model.step,
            model.observe,
            model.likelihood,
            model.rollout_action,
            model.leaf_value,
            model.action_value,
            model.legal,
            model.draw_action,
        )
        self._beliefs = _Beliefs(
            particles=np.empty((nodes + 1, count, model.state_dim)),
            reward=np.empty(nodes + 1),
            going_on=np.empty(nodes + 1),
        )
        self._tables = tables_of(nodes, options.observation_factor, options.observation_exponent)
        self._action_widening = action_widening(options, nodes)
        self._scratch = _Scratch(
            after=np.empty((count, model.state_dim)),
            weights=np.empty(count),
            state=np.empty(model.state_dim),
            moved=np.empty(model.state_dim),
            observation=np.empty(model.observation_dim),
            path_node=np.empty(options.depth, np.int32),
            path_action=np.empty(options.depth, np.int32),
            path_child=np.empty(options.depth, np.int32),
            returns=self._returns,
            drawn=np.empty(model.action_dim),
        )

    def _search_from(self, belief: ParticleBelief) -> None:
        model = self._model
        self._search(
            model.parameters,
            model.leaves,
            belief.particles,
            belief.weights,
            self._roots,
            self._tree,
            self._beliefs,
            self._tables,
            self._action_widening,
            self._scratch,
            self._log,
            self._options.ucb_constant,
            model.discount,
            self._rng,
        )
