"""What the planner's choices on Tiger are worth: the exact return of choosing as it does, which needs no episodes.

What is known of the tiger is how much oftener it was heard on one side than on the other. At each such count the
planner decides a number of times; the return of a policy that draws from these decisions is computed. The optimum is
19.37. `--set` gives options other values, as for `benchmarks/planning.py`.

    python benchmarks/tiger_choices.py [--simulations N ...] [--set OPTION=VALUE ...] [--runs N]
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from planner_choice import options_of, settings_of
from problems.tiger import DISCOUNT, OPTIMUM, TigerParameters, tiger
from skd_adversary.planning.belief import ParticleBelief
from skd_adversary.planning.options import PlannerOptions
from skd_adversary.planning.planner import Planner
from skd_sim.arrays import FloatArray

COUNTS = 5  # from there on the choice is that of the last one
_ACCURACY = TigerParameters().accuracy
_MOST, _STEPS = 40, 600  # beyond which nothing matters: 0.95^600 is 4e-14


def belief_after(count: int) -> float:
    """Return how probable the tiger is on the side where it was heard `count` times oftener than on the other."""
    return 1.0 / (1.0 + ((1.0 - _ACCURACY) / _ACCURACY) ** count)


def shares_of_actions(options: PlannerOptions, probability: float, runs: int) -> FloatArray:
    """Return how often each action is chosen where the tiger is behind the right door with this probability."""
    model, actions = tiger(), []
    for seed in range(runs):
        rng = np.random.default_rng([17, seed])
        belief = ParticleBelief(model, options.particles, rng)
        belief.particles[:, 0] = np.arange(options.particles) >= options.particles // 2
        belief.weights[:] = np.where(belief.particles[:, 0] == 1.0, probability, 1.0 - probability)
        belief.weights /= belief.weights.sum()
        actions.append(Planner(model, options, rng).plan(belief))
    return np.bincount(actions, minlength=model.action_count) / runs


def return_of_choices(shares: Sequence[FloatArray]) -> float:
    """Return what it is worth, from the even belief, to choose with these shares.

    Args:
        shares: for each count from 0, of (listen, the door away from the tiger, as far as one knows, the other door);
            the last ones are those of all higher counts.
    """
    value = np.zeros(_MOST + 1)
    for _ in range(_STEPS):
        after = value.copy()
        for count in range(_MOST):
            listen, away, towards = shares[min(count, len(shares) - 1)]
            right = belief_after(count)
            nearer = _ACCURACY * right + (1.0 - _ACCURACY) * (1.0 - right)
            after[count] = (
                listen * (-1.0 + DISCOUNT * (nearer * value[count + 1] + (1.0 - nearer) * value[abs(count - 1)]))
                + away * (10.0 * right - 100.0 * (1.0 - right) + DISCOUNT * value[0])
                + towards * (10.0 * (1.0 - right) - 100.0 * right + DISCOUNT * value[0])
            )
        after[_MOST] = after[_MOST - 1]
        value = after
    return float(value[0])


def main() -> None:
    """Decide, and print what that is worth."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--simulations", type=int, nargs="+", default=[4000], metavar="N", help="a move (default 4000)")
    parser.add_argument(
        "--set", nargs="+", action="extend", default=[], metavar="OPTION=VALUE", help="instead of the benchmark's"
    )
    parser.add_argument("--runs", type=int, default=200, metavar="N", help="decisions at each count (default 200)")
    arguments = parser.parse_args()
    if min(*arguments.simulations, arguments.runs) < 1:
        parser.error("--simulations and --runs must be positive")
    try:
        options = options_of("tiger", "ours", settings_of("ours", arguments.set))
    except ValueError as error:
        parser.error(f"--set: {error}")
    for simulations in arguments.simulations:
        choices = replace(options, simulations=simulations)
        shares = [shares_of_actions(choices, belief_after(count), arguments.runs) for count in range(COUNTS)]
        print(f"{simulations} simulations a move: {return_of_choices(shares):.2f}; the optimum is {OPTIMUM:.2f}")


if __name__ == "__main__":
    main()
