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

import numpy as np
from skd_sim.arrays import FloatArray

from skd_adversary.planning.belief import ParticleBelief
from skd_adversary.planning.learning_rollouts import ROLLOUTS, no_experience, practice_kernel
from skd_adversary.planning.observation_cells import most_alike_child, nearest_child, profile_kernel
from skd_adversary.planning.options import Cells, PlannerOptions
from skd_adversary.planning.pomdp import Pomdp
from skd_adversary.planning.search import Scratch, search_kernel
from skd_adversary.planning.search_tree import (
    CHILDREN,
    KNOWN,
    clear_node,
    copy_subtree,
    empty_tree,
)
from skd_adversary.planning.tree_planner import TreePlanner
from skd_adversary.planning.ucb import tables_of


class Planner(TreePlanner):
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
        super().__init__(model, options, rng, tree)
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
