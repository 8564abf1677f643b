"""How good the planner is on problems with published results: mean discounted return, and time a move.

Each problem is played in closed loop, an episode a seed: plan, act, observe, update the belief. The models are in
`benchmarks/problems`, each with its source, written against the public interface, `skd_adversary.pomdp.model`.

    python benchmarks/planning.py [--problems NAME ...] [--episodes N] [--simulations N] [--workers N] [--seed N]
"""

from __future__ import annotations

import argparse
import functools
import math
import multiprocessing
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any, Final, NamedTuple

import numpy as np
from problems.rock_sample import rock_sample
from problems.sub_hunt import sub_hunt, sub_hunt_with_leaves
from problems.tiger import tiger
from skd_adversary.pomdp.belief import ParticleBelief
from skd_adversary.pomdp.model import Pomdp
from skd_adversary.pomdp.planner import Backup, Cells, Planner, PlannerOptions, play
from skd_sim.world.state import FloatArray


@dataclass(frozen=True)
class Problem:
    """What is measured.

    Attributes:
        make: the model.
        options: of the planner; `simulations` is the default budget.
        moves: an episode is cut off after so many.
        planning_model: model of the same states that the planner plans on; the problem's own by default.
        published: figures to compare with: source → (mean return, standard error or None).
    """

    make: Callable[[], Pomdp]
    options: PlannerOptions
    moves: int
    planning_model: Callable[[], Pomdp] | None = None
    published: dict[str, tuple[float, float | None]] = field(default_factory=dict)


# Observations that repeat exactly: each has a child of its own.
_DISCRETE: Final[dict[str, Any]] = {"cells": Cells.NEAREST, "observation_factor": math.inf}
_TIGER: Final = PlannerOptions(simulations=5_000, depth=25, exploration=110.0, particles=1_000, **_DISCRETE)
# Leaves have the exact value of a good policy: the mean of the action tried most is not spoilt by the others.
_ROCK_SAMPLE: Final = PlannerOptions(
    simulations=5_000, depth=60, exploration=1.0, particles=3_000, backup=Backup.MOST_VISITED, **_DISCRETE
)
_SUB_HUNT: Final = PlannerOptions(simulations=20_000, depth=20, exploration=100.0, particles=10_000)


def _rocks(size: int, count: int, published: dict[str, tuple[float, float | None]]) -> Problem:
    make = functools.partial(rock_sample, size, count)
    return Problem(make, _ROCK_SAMPLE, 100, functools.partial(make, advantages=True), published)


PROBLEMS: Final[dict[str, Problem]] = {
    "tiger": Problem(tiger, _TIGER, 150, published={"optimum": (19.37, None)}),
    "rock_sample_7_8": _rocks(7, 8, {
        "SARSOP": (21.47, 0.04), "DESPOT C++, 1 s a move": (21.68, 1.19), "DESPOT, published": (20.9, None),
        "ABT (TAPIR), 0.1 s": (19.40, 1.23),
    }),
    "rock_sample_11_11": _rocks(11, 11, {
        "SARSOP": (21.56, 0.11), "DESPOT C++, 0.1 s": (20.59, 1.21), "DESPOT, published": (21.8, None),
        "ABT (TAPIR), 0.1 s": (17.46, 1.34),
    }),
    "sub_hunt": Problem(sub_hunt, _SUB_HUNT, 100, sub_hunt_with_leaves, {
        "PFT-DPW, published": (77.4, 1.1), "POMCPOW, published": (69.2, 1.3), "QMDP, published": (28.0, 1.3),
        "ping first, then QMDP, published": (79.0, 1.1),
    }),
}  # fmt: skip


class Played(NamedTuple):
    """What one episode gave: discounted return, moves, and seconds of processor time that planning took."""

    value: float
    moves: int
    seconds: float


class _Timed:
    """A planner, and the seconds of processor time that it has taken."""

    def __init__(self, planner: Planner) -> None:
        self._planner = planner
        self.seconds = 0.0

    def plan(self, belief: ParticleBelief) -> int:
        begin = time.process_time()
        action = self._planner.plan(belief)
        self.seconds += time.process_time() - begin
        return action

    def advance(self, action: int, observation: FloatArray) -> None:
        begin = time.process_time()
        self._planner.advance(action, observation)
        self.seconds += time.process_time() - begin


def run_episode(name: str, simulations: int, seed: int, moves: int | None = None) -> Played:
    """Run one episode.

    Args:
        name: of the problem.
        simulations: a move.
        seed: of the episode; world, belief and planner draw from generators of their own.
        moves: at most; the problem's own limit by default.
    """
    problem = PROBLEMS[name]
    model = problem.make()
    options = replace(problem.options, simulations=simulations)
    world, believing, planning = (np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(3))
    planner = _Timed(Planner((problem.planning_model or problem.make)(), options, planning))
    belief = ParticleBelief(model, options.particles, believing)
    played = play(model, belief, planner, world, moves=moves or problem.moves)
    return Played(played.value, len(played.actions), planner.seconds)


def main() -> None:
    """Measure, and print a row for each problem with those that it is compared with."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--problems", nargs="+", choices=PROBLEMS, default=list(PROBLEMS), metavar="NAME")
    parser.add_argument("--episodes", type=int, default=100, metavar="N", help="per problem (default 100)")
    parser.add_argument("--simulations", type=int, metavar="N", help="a move (default: the problem's own)")
    parser.add_argument("--workers", type=int, default=1, metavar="N", help="processes (default 1)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the first episode (default 0)")
    arguments = parser.parse_args()
    with ProcessPoolExecutor(arguments.workers, multiprocessing.get_context("spawn")) as pool:
        for name in arguments.problems:
            simulations = arguments.simulations or PROBLEMS[name].options.simulations
            run_episode(name, min(simulations, 100), 1 << 30, moves=2)  # compiles, once for all workers
            seeds = range(arguments.seed, arguments.seed + arguments.episodes)
            episodes = list(pool.map(functools.partial(run_episode, name, simulations), seeds))
            values = np.array([one.value for one in episodes])
            moves = sum(one.moves for one in episodes)
            print(
                f"{name}\n    {values.mean():7.2f} ± {values.std(ddof=1) / math.sqrt(len(values)):<5.2f} SKD, "
                f"{len(values)} episodes, {simulations} simulations and "
                f"{1000.0 * sum(one.seconds for one in episodes) / moves:.1f} ms a move",
                flush=True,
            )
            for source, (mean, error) in PROBLEMS[name].published.items():
                print(f"    {mean:7.2f}{'' if error is None else f' ± {error:.2f}':8} {source}", flush=True)


if __name__ == "__main__":
    main()
