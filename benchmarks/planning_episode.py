"""One episode of the planning benchmark in closed loop, and the time that its planner took."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from planner_choice import PLANNERS, options_of
from planning_problems import PROBLEMS, Problem
from recorded_episodes import Episode
from skd_adversary.planning.belief import ParticleBelief
from skd_adversary.planning.general.closed_loop import play
from skd_adversary.planning.options import PlannerOptions
from skd_adversary.planning.pomdp import Pomdp
from skd_sim.arrays import FloatArray

_CALIBRATION_MOVES = 5
CALIBRATION_SEED = 1 << 30
"""Of episodes that count for nothing."""


class _Timed:
    """A planner, and the seconds of processor time that it has taken."""

    def __init__(self, plan: Callable[[ParticleBelief], int], advance: Callable[[int, FloatArray], None]) -> None:
        self._plan = plan
        self._advance = advance
        self.seconds = 0.0

    def plan(self, belief: ParticleBelief) -> int:
        begin = time.process_time()
        action = self._plan(belief)
        self.seconds += time.process_time() - begin
        return action

    def advance(self, action: int, observation: FloatArray) -> None:
        begin = time.process_time()
        self._advance(action, observation)
        self.seconds += time.process_time() - begin


def run_episode(
    name: str,
    seed: int,
    simulations: int,
    *,
    moves: int | None = None,
    planner: str = "ours",
    settings: Mapping[str, Any] | None = None,
    pomdp_py: bool = False,
) -> Episode:
    """Run one episode in closed loop: plan, act, observe, update the belief.

    Args:
        name: of the problem.
        seed: of the episode; problem, world and planner draw from generators of their own.
        simulations: a move.
        moves: at most; the problem's own limit by default.
        planner: one of `PLANNERS`.
        settings: option of the planner → value instead of the problem's.
        pomdp_py: whether pomdp-py plans, with what of these options means something to it.
    """
    problem = PROBLEMS[name]
    model = problem.make(seed)
    options = replace(options_of(name, planner, settings), simulations=simulations)
    world_rng, belief_rng, planner_rng = (
        np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(3)
    )
    belief = ParticleBelief(model, options.particles, belief_rng)
    if pomdp_py:
        timed = _pomdp_py_planner(problem, model, options, seed)
    else:
        chosen = PLANNERS[planner][0](_planning_model(problem, planner, model), options, planner_rng)
        timed = _Timed(chosen.plan, chosen.advance)
    played = play(model, belief, timed, world_rng, moves=problem.moves if moves is None else moves)
    made = len(played.actions)
    return Episode(played.value, made, made * simulations, timed.seconds)


def _planning_model(problem: Problem, planner: str, model: Pomdp) -> Pomdp:
    if planner != "ours" and problem.others_model is not None:
        return problem.others_model()
    return model if problem.planning_model is None else problem.planning_model()


def _pomdp_py_planner(problem: Problem, model: Pomdp, options: PlannerOptions, seed: int) -> _Timed:
    from problems.pomdp_py_models import PomdpPyPlanner, python_model

    assert problem.pomdp_py is not None
    planner = PomdpPyPlanner(
        python_model(problem.pomdp_py, model, problem.bin_width),
        simulations=options.simulations,
        depth=options.depth,
        exploration=options.exploration,
        discount=model.discount,
        seed=seed,
    )
    extra = (0.0,) if problem.pomdp_py == "crossing" else ()
    return _Timed(lambda belief: planner.plan(belief, extra), lambda _action, _observation: None)


def calibrated_simulations(
    name: str, seconds_a_move: float, planner: str = "ours", settings: Mapping[str, Any] | None = None
) -> int:
    """Return the number of simulations that a move of so many seconds (of one core) has time for."""
    simulations = options_of(name, planner, settings).simulations
    run_episode(name, CALIBRATION_SEED, simulations, moves=1, planner=planner, settings=settings)  # compiles
    for _ in range(2):  # a larger tree is slower: the second round starts near the answer
        episode = run_episode(
            name, CALIBRATION_SEED, simulations, moves=_CALIBRATION_MOVES, planner=planner, settings=settings
        )
        simulations = max(1, round(simulations * seconds_a_move * episode.moves / episode.seconds))
    return simulations
