"""POMCPOW: online tree search for discrete actions and continuous observations.

Sunberg and Kochenderfer (ICAPS 2018), Algorithm 2. Observations are widened progressively: a child for a new
observation is made only while their number is at most k·N^α; otherwise an old one is taken, and the simulated state
joins that child's particles with the weight Z(o | s′). The next state is drawn from those weighted particles, so a
node deep in the tree holds a belief, not a single state; a tree that did neither would act as if all were known one
step ahead (QMDP).

Two things differ from the published algorithm. A node's value is backed up as the best of its actions' means, as in
ABT, rather than as the mean over all that was tried there; and a new node tries the action of the default policy first.

docs/decisions.md says why this planner rather than ABT, PFT-DPW or DESPOT.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from skd_sim.compilation import specialise

from skd_adversary.belief import ParticleBelief
from skd_adversary.pomdp import FloatArray, Pomdp

IntArray = npt.NDArray[np.int64]


def _unbound(*_arguments: Any) -> Any:
    raise NotImplementedError("bound to the model's kernel by `specialise`")


_step = _observe = _likelihood = _rollout_action = _unbound


@dataclass(frozen=True)
class PlannerOptions:
    """Budget and shape of the search.

    Attributes:
        simulations: simulations per decision: a count, never a time, so that results repeat.
        depth: longest look-ahead, steps.
        exploration: UCB1 constant, in units of reward.
        observation_factor: k of the widening k·N^α.
        observation_exponent: α of the widening.
        particles: size of the belief.
    """

    simulations: int = 1000
    depth: int = 25
    exploration: float = 1.0
    observation_factor: float = 4.0
    observation_exponent: float = 0.25
    particles: int = 300


class _Tree:
    """Flat arrays of the search tree, reused between decisions.

    A node is a history; slot (node, action) holds N and Q of the action, and the list of its observation children.
    """

    def __init__(self, model: Pomdp, options: PlannerOptions) -> None:
        nodes, actions = options.simulations + 1, model.action_count
        links = options.simulations * options.depth + 1
        self.visits = np.zeros((nodes, actions), np.int64)
        self.values = np.zeros((nodes, actions))
        self.children = np.zeros((nodes, actions), np.int64)  # number of observation children
        self.first_child = np.zeros((nodes, actions), np.int64)
        self.sibling = np.zeros(nodes, np.int64)
        self.occurrences = np.zeros(nodes, np.int64)  # M(hao)
        self.observation = np.zeros((nodes, model.observation_dim))
        self.first_link = np.zeros(nodes, np.int64)  # particles of the node: a linked list in the pool
        self.weight_sum = np.zeros(nodes)
        self.link = np.zeros(links, np.int64)
        self.link_weight = np.zeros(links)
        self.link_reward = np.zeros(links)
        self.link_state = np.zeros((links, model.state_dim))
        self.arrays = (
            self.visits, self.values, self.children, self.first_child, self.sibling, self.occurrences,
            self.observation, self.first_link, self.weight_sum, self.link, self.link_weight,
            self.link_reward, self.link_state,
        )  # fmt: skip


def _search_template(
    parameters: Any,
    particles: FloatArray,
    weights: FloatArray,
    tree: Any,
    simulations: int,
    depth_limit: int,
    exploration: float,
    factor: float,
    exponent: float,
    discount: float,
    rng: np.random.Generator,
) -> None:
    """Grow the tree from the belief; the root is node 0 and its statistics are the result."""
    (
        visits, values, children, first_child, sibling, occurrences, observations,
        first_link, weight_sum, link, link_weight, link_reward, link_state,
    ) = tree  # fmt: skip
    action_count = visits.shape[1]
    cumulative = np.cumsum(weights)
    state = np.empty(particles.shape[1])
    moved = np.empty(particles.shape[1])
    observation = np.empty(observations.shape[1])
    path_node = np.empty(depth_limit, np.int64)
    path_action = np.empty(depth_limit, np.int64)
    path_reward = np.empty(depth_limit)
    visits[0] = 0
    values[0] = 0.0
    children[0] = 0
    node_count = 1
    link_count = 1  # 0 ends a list

    for _ in range(simulations):
        index = np.searchsorted(cumulative, rng.random() * cumulative[-1], side="right")
        state[:] = particles[min(index, particles.shape[0] - 1)]
        node = 0
        depth = 0
        tail = 0.0
        while depth < depth_limit:
            # --- action: UCB1, untried ones first; at a new node the default policy's, else from a random one on
            total = 0
            for a in range(action_count):
                total += visits[node, a]
            log_total = math.log(total) if total > 0 else 0.0
            offset = int(rng.random() * action_count) if total > 0 else _rollout_action(parameters, state, rng)
            action = -1
            best = -math.inf
            for i in range(action_count):
                a = (i + offset) % action_count
                if visits[node, a] == 0:
                    action = a
                    break
                score = values[node, a] + exploration * math.sqrt(log_total / visits[node, a])
                if score > best:
                    best = score
                    action = a
            # --- step
            reward, terminal = _step(parameters, state, action, moved, rng)
            path_node[depth] = node
            path_action[depth] = action
            path_reward[depth] = reward
            depth += 1
            if terminal:
                break
            _observe(parameters, moved, action, observation, rng)
            # --- observation: a new child, or an old one by its number of occurrences. One that was seen before is
            # only counted: were the state put into the very child whose observation it caused, and weighted by Z there,
            # the observation would count twice (with discrete observations the belief was too sure).
            child = 0
            known = children[node, action]
            if known <= factor * visits[node, action] ** exponent:
                candidate = first_child[node, action] if known > 0 else 0
                while candidate != 0:
                    same = True
                    for k in range(observation.shape[0]):
                        if observations[candidate, k] != observation[k]:
                            same = False
                            break
                    if same:
                        child = candidate
                        break
                    candidate = sibling[candidate]
                fresh = child == 0
                if not fresh:
                    occurrences[child] += 1
            else:
                fresh = False
            if not fresh:
                occurred = 0
                candidate = first_child[node, action]
                while candidate != 0:
                    occurred += occurrences[candidate]
                    candidate = sibling[candidate]
                pick = rng.random() * occurred
                candidate = first_child[node, action]
                while candidate != 0:
                    child = candidate
                    pick -= occurrences[candidate]
                    if pick < 0.0:
                        break
                    candidate = sibling[candidate]
            if fresh:
                child = node_count
                node_count += 1
                visits[child] = 0
                values[child] = 0.0
                children[child] = 0
                observations[child] = observation
                occurrences[child] = 1
                first_link[child] = 0
                weight_sum[child] = 0.0
                sibling[child] = first_child[node, action] if known > 0 else 0
                first_child[node, action] = child
                children[node, action] = known + 1
            # --- the state joins the child's weighted particles
            weight = _likelihood(parameters, moved, action, observations[child])
            link[link_count] = first_link[child]
            link_weight[link_count] = weight
            link_reward[link_count] = reward
            link_state[link_count] = moved
            first_link[child] = link_count
            link_count += 1
            weight_sum[child] += weight
            if fresh:
                discounting = 1.0
                step_count = depth
                state[:] = moved
                while step_count < depth_limit:
                    rollout = _rollout_action(parameters, state, rng)
                    reward, terminal = _step(parameters, state, rollout, moved, rng)
                    tail += discounting * reward
                    if terminal:
                        break
                    discounting *= discount
                    state[:] = moved
                    step_count += 1
                break
            chosen = first_link[child]
            pick = rng.random() * weight_sum[child]
            candidate = chosen
            while candidate != 0:
                chosen = candidate
                pick -= link_weight[candidate]
                if pick < 0.0:
                    break
                candidate = link[candidate]
            state[:] = link_state[chosen]
            path_reward[depth - 1] = link_reward[chosen]
            node = child
        # --- backup: a node is worth its best action; the mean would count what exploration tries against it
        value = tail
        for level in range(depth - 1, -1, -1):
            value = path_reward[level] + discount * value
            node, action = path_node[level], path_action[level]
            visits[node, action] += 1
            values[node, action] += (value - values[node, action]) / visits[node, action]
            value = -math.inf
            for a in range(action_count):
                if visits[node, a] > 0 and values[node, a] > value:
                    value = values[node, a]


@functools.cache
def _search_kernel(
    name: str,
    step: Callable[..., Any],
    observe: Callable[..., Any],
    likelihood: Callable[..., Any],
    rollout_action: Callable[..., Any],
) -> Callable[..., None]:
    bound = {
        "_step": step,
        "_observe": observe,
        "_likelihood": likelihood,
        "_rollout_action": rollout_action,
    }
    return specialise(_search_template, name, bound)


class Planner:
    """Decides by POMCPOW from a particle belief."""

    def __init__(self, model: Pomdp, options: PlannerOptions, rng: np.random.Generator) -> None:
        """Prepare for `model`; all randomness of the search comes from `rng`."""
        if options.simulations < 1 or options.depth < 1:
            raise ValueError("a planner needs at least one simulation and a depth of one")
        self._model = model
        self._options = options
        self._rng = rng
        self._tree = _Tree(model, options)
        self._search = _search_kernel(model.name, model.step, model.observe, model.likelihood, model.rollout_action)

    def plan(self, belief: ParticleBelief) -> int:
        """Return the action of highest estimated value at `belief`."""
        options = self._options
        self._search(
            self._model.parameters,
            belief.particles,
            belief.weights,
            self._tree.arrays,
            options.simulations,
            options.depth,
            options.exploration,
            options.observation_factor,
            options.observation_exponent,
            self._model.discount,
            self._rng,
        )
        return int(np.argmax(np.where(self.visits > 0, self.values, -np.inf)))

    @property
    def values(self) -> FloatArray:
        """Estimated value of each action at the last belief planned from."""
        values: FloatArray = self._tree.values[0]
        return values

    @property
    def visits(self) -> IntArray:
        """Number of simulations through each action at the last belief planned from."""
        visits: IntArray = self._tree.visits[0]
        return visits
