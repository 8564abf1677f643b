"""How fast the tree search is: simulations and model steps a second of one core, beside a bare loop over the model.

The bare loop is compiled too and does nothing but step the model: states drawn from the same belief, actions of the
default policy, a new state where an episode ends or the planner's depth is reached. It is the speed that a planner
without any cost of its own would have. Both count processor time. Tag is measured without the memory that its default
policy goes by: two cells and random rollouts, as in other planners.

    python benchmarks/planner_speed.py [--problems NAME ...] [--simulations N] [--moves N] [--json]
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from planning_problems import PROBLEMS
from problems.tag import tag
from skd_adversary.planning.belief import ParticleBelief
from skd_adversary.planning.planner import Planner
from skd_adversary.planning.pomdp import Pomdp
from skd_sim.arrays import FloatArray
from skd_sim.kernels.compilation import specialise

_DEFAULT = ("crossing", "tag")
_BARE_STEPS = 2_000_000


def _unbound(*_arguments: Any) -> Any:
    raise NotImplementedError("bound to the model's kernel by `specialise`")


_step = _rollout_action = _unbound


def _bare_loop_template(
    parameters: Any, particles: FloatArray, steps: int, depth: int, rng: np.random.Generator
) -> float:
    """Make that many steps of the model; the sum of the rewards keeps the compiler from leaving them out."""
    state = np.empty(particles.shape[1])
    after = np.empty(particles.shape[1])
    total = 0.0
    left = 0
    for _ in range(steps):
        if left == 0:
            chosen = int(rng.random() * particles.shape[0])
            for k in range(state.shape[0]):
                state[k] = particles[chosen, k]
            left = depth
        reward, terminal = _step(parameters, state, _rollout_action(parameters, state, rng), after, rng)
        total += reward
        left = 0 if terminal else left - 1
        state, after = after, state
    return total


def _seconds(call: Callable[[], object]) -> float:
    begin = time.process_time()
    call()
    return time.process_time() - begin


def _bare_steps_per_second(model: Pomdp, belief: ParticleBelief, depth: int, rng: np.random.Generator) -> float:
    bound = {"_step": model.step, "_rollout_action": model.rollout_action}
    loop = specialise(_bare_loop_template, f"bare_{model.name}", bound)
    loop(model.parameters, belief.particles, 100, depth, rng)
    return _BARE_STEPS / min(
        _seconds(lambda: loop(model.parameters, belief.particles, _BARE_STEPS, depth, rng)) for _ in range(3)
    )


def measure(name: str, simulations: int | None, moves: int) -> dict[str, float]:
    """Plan `moves` times from the belief after one action of the default policy, each time with a new tree."""
    problem = PROBLEMS[name]
    model = tag(memory=False) if name == "tag" else problem.make(0)
    options = replace(problem.options, keep_tree=False)
    if simulations is not None:
        options = replace(options, simulations=simulations)
    rng = np.random.default_rng(0)
    belief = ParticleBelief(model, options.particles, rng)
    state, after, observation = np.empty(model.state_dim), np.empty(model.state_dim), np.empty(model.observation_dim)
    model.initial(model.parameters, state, rng)
    action = model.rollout_action(model.parameters, state, rng)
    model.step(model.parameters, state, action, after, rng)
    model.observe(model.parameters, after, action, observation, rng)
    belief.predict(action)
    belief.correct(action, observation)
    planner = Planner(model, options, rng)
    planner.plan(belief)
    before = planner.model_steps
    seconds = sum(_seconds(lambda: planner.plan(belief)) for _ in range(moves))
    bare = _bare_steps_per_second(model, belief, options.depth, rng)
    planned = (planner.model_steps - before) / seconds
    return {
        "simulations_per_move": options.simulations,
        "simulations_per_second": moves * options.simulations / seconds,
        "model_steps_per_second": planned,
        "bare_model_steps_per_second": bare,
        "ratio": planned / bare,
    }


def main() -> None:
    """Measure, and print a table or JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--problems", nargs="+", choices=PROBLEMS, default=list(_DEFAULT), metavar="NAME")
    parser.add_argument("--simulations", type=int, metavar="N", help="a move (default: the problem's own)")
    parser.add_argument("--moves", type=int, default=20, metavar="N", help="decisions to time (default 20)")
    parser.add_argument("--json", action="store_true", help="print JSON: problem → figures")
    arguments = parser.parse_args()
    if arguments.moves < 1 or (arguments.simulations or 1) < 1:
        parser.error("--moves and --simulations must be at least 1")
    results = {name: measure(name, arguments.simulations, arguments.moves) for name in arguments.problems}
    if arguments.json:
        print(json.dumps(results, indent=2))
        return
    print(f"{'':20}{'simulations':>12}{'simulations/s':>15}{'model steps/s':>15}{'bare loop':>14}{'ratio':>8}")
    for name, row in results.items():
        print(
            f"{name:20}{row['simulations_per_move']:12.0f}{row['simulations_per_second']:15,.0f}"
            f"{row['model_steps_per_second']:15,.0f}{row['bare_model_steps_per_second']:14,.0f}{row['ratio']:8.2f}"
        )


if __name__ == "__main__":
    main()
