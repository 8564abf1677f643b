"""POMCPOW: tree search over weighted states (Sunberg and Kochenderfer, ICAPS 2018, algorithm 2), for comparison.

A node has an observation of its own and collects every state that a simulation brings to it, weighted by the likelihood
of that observation; a simulation goes on from a state drawn from those. Children are widened progressively, k·N^α of
them; beyond that a simulation picks one at random. A node's value is the mean. What a simulation may expect where it
reaches the look-ahead in a node that there was already is 0, as in POMCPOW.jl: a leaf that sees the state would make it
worth while to wait until then.

That the episode ends is an observation like others, as in POMCPOW.jl, where ended states have one: it makes a child, in
which a state that has not ended has no weight, as an ended one has none elsewhere. So a simulation that is sent there
ends, and one whose step ends the episode may go on in another child, from a state drawn there. Each end makes a child
of its own while there is room: in a single one the first of its rewards would be drawn again and again.
`PomcpowOptions.ends_are_seen` says so; False is for models that observe an ended state like any other, as those of the
published experiments do: then ended states and others share children, by their weights.

A node's states are a list from the newest to the oldest, with their cumulative weights and jump pointers (Myers 1983,
"An applicative random-access stack"): adding takes constant time, drawing logarithmic, and nothing is ever moved.
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
from skd_adversary.planning.pomdp import Pomdp
from skd_adversary.planning.rollouts import tail_kernel
from skd_adversary.planning.search import RootLog
from skd_adversary.planning.search_tree import (
    CHILDREN,
    FIRST_CHILD,
    VALUE,
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

_step = _observe = _likelihood = _tail = _forbid = _widen = _taken = unbound
_ENDS_ARE_SEEN = True


@dataclass(frozen=True)
class PomcpowOptions(PlannerOptions):
    """Options of POMCPOW; `backup`, `keep_tree`, `cells`, `references` and `cell_distance` mean nothing to it.

    Attributes:
        most_visited: whether the action tried most is taken, not the one of highest value.
        ends_are_seen: whether that the episode has ended is something that is seen, for sure; False only for a model
            whose `observe` and `likelihood` (and `legal`, if it has one) stand the states that `step` ends in.
    """

    most_visited: bool = False
    ends_are_seen: bool = True


class _States(NamedTuple):
    """States that nodes have collected: p entries, of n nodes."""

    state: FloatArray  # p × s
    reward: FloatArray  # p: of the step that led to the state
    ended: Int32Array  # p: 1 for a state that the episode ended in
    cumulative: FloatArray  # p: weights of the node's entries up to this one
    older: Int32Array  # p: next older entry of the same node, itself for the oldest
    jump: Int32Array  # p: some older one
    rank: Int32Array  # p: number of older entries
    newest: Int32Array  # n
    generated: Int32Array  # n: how often the node's observation was drawn
    end: Int32Array  # n: 1 where what was seen is that the episode has ended, if that is seen


@kernel(inline=True)
def _collect(
    states: _States, node: int, entry: int, state: FloatArray, reward: float, ended: int, weight: float, first: bool
) -> None:
    for k in range(state.shape[0]):
        states.state[entry, k] = state[k]
    states.reward[entry], states.ended[entry] = reward, ended
    if first:
        states.cumulative[entry], states.rank[entry] = weight, 0
        states.older[entry] = states.jump[entry] = entry
    else:
        older = states.newest[node]
        far = states.jump[older]
        farther = states.jump[far]
        even = states.rank[older] - states.rank[far] == states.rank[far] - states.rank[farther]
        states.cumulative[entry], states.rank[entry] = states.cumulative[older] + weight, states.rank[older] + 1
        states.older[entry] = older
        states.jump[entry] = farther if even else older
    states.newest[node] = entry


@kernel(inline=True)
def _drawn(states: _States, node: int, rng: np.random.Generator) -> int:
    """Return an entry of a node, drawn by weight."""
    entry = states.newest[node]
    mark = rng.random() * states.cumulative[entry]
    while states.rank[entry] > 0 and states.cumulative[states.older[entry]] > mark:
        jump = states.jump[entry]
        entry = jump if states.cumulative[jump] > mark else states.older[entry]
    return int(entry)


@kernel(inline=True)
def _same_child(tree: SearchTree, node: int, action: int, seen: FloatArray) -> int:
    """Return the child with this very observation, or −1."""
    candidate = tree.links[node, action, FIRST_CHILD]
    for _ in range(tree.links[node, action, CHILDREN]):
        same = True
        for k in range(seen.shape[0]):
            if tree.observation[candidate, k] != seen[k]:
                same = False
        if same:
            return int(candidate)
        candidate = tree.sibling[candidate]
    return -1


@kernel(inline=True)
def _any_child(tree: SearchTree, states: _States, node: int, action: int, rng: np.random.Generator) -> int:
    """Return a child, drawn by how often its observation was."""
    total = 0
    candidate = tree.links[node, action, FIRST_CHILD]
    for _ in range(tree.links[node, action, CHILDREN]):
        total += states.generated[candidate]
        candidate = tree.sibling[candidate]
    mark = int(rng.random() * total)
    candidate = tree.links[node, action, FIRST_CHILD]
    for _ in range(tree.links[node, action, CHILDREN] - 1):
        mark -= states.generated[candidate]
        if mark < 0:
            break
        candidate = tree.sibling[candidate]
    return int(candidate)


@kernel(inline=True)
def _chosen(tree: SearchTree, node: int, exploration: float, tables: Tables, rng: np.random.Generator) -> int:
    """Return the action by UCB1, as POMCPOW.jl had it: with ln 1 = 0, a first try that paid is repeated at once."""
    if tree.total[node] == 1:
        for action in range(tree.statistics.shape[1]):
            if tree.statistics[node, action, VISITS] == 1.0 and tree.statistics[node, action, VALUE] > 0.0:
                return action
    return choose(tree, node, exploration, tables, rng)


def _pomcpow_template(
    parameters: Any,
    leaf_parameters: Any,
    particles: FloatArray,
    roots: IndexArray,
    tree: SearchTree,
    states: _States,
    tables: Tables,
    action_widening: Int32Array,
    paths: tuple[Int32Array, Int32Array, FloatArray],
    scratch: tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray],
    log: RootLog,
    exploration: float,
    discount: float,
    rng: np.random.Generator,
) -> None:
    path_node, path_action, path_reward = paths
    state, moved, observation, seen, returns, drawn = scratch
    depth_limit = path_node.shape[0]
    last = tables.widening.shape[0] - 1
    node_count, entries = 1, 0
    clear_node(tree, 0)
    forget_returns(returns)
    for i in range(roots.shape[0]):
        for k in range(state.shape[0]):
            state[k] = particles[roots[i], k]
        constant = exploration_from(exploration, returns)
        if i == 0:
            _forbid(parameters, tree, 0, state)
        node, depth, value = 0, 0, 0.0
        log.cell[i] = -1
        while depth < depth_limit:
            _widen(parameters, tree, node, depth, state, drawn, action_widening, rng)
            action = _chosen(tree, node, constant, tables, rng)
            taken = _taken(tree, node, action, drawn)
            reward, terminal = _step(parameters, state, taken, moved, rng)
            path_node[depth], path_action[depth], path_reward[depth] = node, action, reward
            depth += 1
            ended = 1 if terminal else 0
            end_seen = ended if _ENDS_ARE_SEEN else 0
            children = tree.links[node, action, CHILDREN]
            visits = int(tree.statistics[node, action, VISITS])
            fresh = False
            if children <= tables.widening[min(visits, last)]:
                if end_seen == 1:
                    child = -1
                    for k in range(seen.shape[0]):
                        seen[k] = np.nan  # like no other observation
                else:
                    _observe(parameters, moved, taken, seen, rng)
                    child = _same_child(tree, node, action, seen)
                if child >= 0:
                    states.generated[child] += 1
                    child = _any_child(tree, states, node, action, rng)
                else:
                    fresh = True
                    child = node_count
                    node_count += 1
                    clear_node(tree, child)
                    if end_seen == 0:
                        _forbid(parameters, tree, child, moved)
                    add_child(tree, node, action, child, seen)
                    states.generated[child], states.end[child] = 1, end_seen
            else:
                child = _any_child(tree, states, node, action, rng)
            if states.end[child] == end_seen:
                weight = 1.0
                if end_seen == 0:
                    for k in range(seen.shape[0]):
                        observation[k] = tree.observation[child, k]
                    weight = _likelihood(parameters, moved, taken, observation)
                _collect(states, child, entries, moved, reward, ended, weight, fresh)
                entries += 1
            if depth == 1:
                log.cell[i] = child
            if fresh:
                if not terminal:
                    left = depth_limit - depth
                    value = _tail(parameters, leaf_parameters, moved, state, drawn, left, discount, rng)
                break
            entry = _drawn(states, child, rng)
            path_reward[depth - 1] = states.reward[entry]
            if states.ended[entry] == 1:
                break
            for k in range(state.shape[0]):
                state[k] = states.state[entry, k]
            node = child
        for level in range(depth - 1, -1, -1):
            node, action = path_node[level], path_action[level]
            value = path_reward[level] + discount * value
            tree.total[node] += 1
            note_value(tree, node, action, value)
        log.action[i], log.value[i] = path_action[0], value
        note_return(returns, path_action[0], value)


@functools.cache
def _kernel(
    name: str,
    step: Callable[..., Any],
    observe: Callable[..., Any],
    likelihood: Callable[..., Any],
    rollout_action: Callable[..., Any],
    leaf_value: Callable[..., Any] | None,
    legal: Callable[..., Any] | None,
    draw_action: Callable[..., Any] | None,
    ends_are_seen: bool,
) -> Callable[..., Any]:
    bound = {
        "_step": step,
        "_observe": observe,
        "_likelihood": likelihood,
        "_tail": tail_kernel(name, step, rollout_action, leaf_value, draw_action is not None),
        **action_kernels(name, draw_action, legal),
        "_ENDS_ARE_SEEN": ends_are_seen,
    }
    name += "" if leaf_value is None else "_leaves"
    name += "" if ends_are_seen else "_ends_observed"
    return specialise(_pomcpow_template, name, bound, allocates=False)


class Pomcpow(TreePlanner):
    """POMCPOW; the interface is that of `Planner`."""

    def __init__(self, model: Pomdp, options: PomcpowOptions, rng: np.random.Generator) -> None:
        """Prepare for `model`; all randomness of the search comes from `rng`."""
        nodes, entries = options.simulations + 1, options.simulations * options.depth
        slots = slots_of(model, options, nodes)
        tree = empty_tree(nodes, slots, model.observation_dim, action_dim=model.action_dim)
        super().__init__(model, options, rng, tree)
        self._most_visited = options.most_visited
        self._search = _kernel(
            model.name,
            model.step,
            model.observe,
            model.likelihood,
            model.rollout_action,
            model.leaf_value,
            model.legal,
            model.draw_action,
            options.ends_are_seen,
        )
        self._states = _States(
            state=np.empty((entries, model.state_dim)),
            reward=np.empty(entries),
            ended=np.empty(entries, np.int32),
            cumulative=np.empty(entries),
            older=np.empty(entries, np.int32),
            jump=np.empty(entries, np.int32),
            rank=np.empty(entries, np.int32),
            newest=np.empty(nodes, np.int32),
            generated=np.empty(nodes, np.int32),
            end=np.empty(nodes, np.int32),
        )
        self._tables = tables_of(nodes, options.observation_factor, options.observation_exponent)
        self._action_widening = action_widening(options, nodes)
        self._paths = np.empty(options.depth, np.int32), np.empty(options.depth, np.int32), np.empty(options.depth)
        self._scratch = (
            np.empty(model.state_dim),
            np.empty(model.state_dim),
            np.empty(model.observation_dim),
            np.empty(model.observation_dim),
            self._returns,
            np.empty(model.action_dim),
        )

    def _search_from(self, belief: ParticleBelief) -> None:
        model = self._model
        self._search(
            model.parameters,
            model.leaves,
            belief.particles,
            self._roots,
            self._tree,
            self._states,
            self._tables,
            self._action_widening,
            self._paths,
            self._scratch,
            self._log,
            self._options.ucb_constant,
            model.discount,
            self._rng,
        )

    def _decision(self) -> int:
        return int(np.argmax(self.visits)) if self._most_visited else super()._decision()
