"""Two policies with published returns on SubHunt, which tell whether the port is faithful.

QMDP takes the action of highest expected value as if the state were seen after it; it never pings. Ping-first pings and
then goes on as QMDP. Published (Sunberg and Kochenderfer 2018): 28.0 ± 1.3 and 79.0 ± 1.1.

    python benchmarks/sub_hunt_policies.py [--episodes N] [--particles N]
"""

from __future__ import annotations

import argparse
import math
import time

import numpy as np
from problems.sub_hunt import AWARE, PING, STATES, sub_hunt
from skd_adversary.planning.belief import ParticleBelief
from skd_adversary.planning.general.closed_loop import play
from skd_adversary.planning.general.observed_values import ObservedSolution, solve_observed
from skd_sim.arrays import FloatArray

MOVES = 100


class _Policy:
    """QMDP, or a ping before it."""

    def __init__(self, solution: ObservedSolution, *, ping_first: bool) -> None:
        self._solution = solution
        self._ping_first = ping_first

    def plan(self, belief: ParticleBelief) -> int:
        if self._ping_first and belief.particles[0, AWARE] == 0.0:
            return PING
        solution = self._solution
        return int(np.argmax(belief.weights @ solution.action_values[solution.index(belief.particles)]))

    def advance(self, _action: int, _observation: FloatArray) -> None:
        """Nothing is kept."""


def return_of(solution: ObservedSolution, seed: int, *, ping_first: bool, particles: int) -> float:
    """Return the discounted return of an episode."""
    model = sub_hunt()
    world, rng = (np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(2))
    belief = ParticleBelief(model, particles, rng)
    return play(model, belief, _Policy(solution, ping_first=ping_first), world, moves=MOVES).value


def main() -> None:
    """Play both, and print their returns."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, default=1000, metavar="N")
    parser.add_argument("--particles", type=int, default=10_000, metavar="N", help="of the belief")
    arguments = parser.parse_args()
    begin = time.perf_counter()
    solution = solve_observed(sub_hunt(), STATES, samples=64)
    print(f"solved as if the state were seen: {time.perf_counter() - begin:.0f} s", flush=True)
    for name, ping_first in (("QMDP", False), ("ping first, then QMDP", True)):
        values = np.array(
            [
                return_of(solution, seed, ping_first=ping_first, particles=arguments.particles)
                for seed in range(arguments.episodes)
            ]
        )
        error = values.std(ddof=1) / math.sqrt(len(values))
        print(f"{name}: {values.mean():.2f} ± {error:.2f}, {len(values)} episodes", flush=True)


if __name__ == "__main__":
    main()
