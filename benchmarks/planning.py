"""How good the planner is on problems with published results, beside those and beside pomdp-py in the same run.

For each problem: mean discounted return ± its standard error over episodes of a seed each, simulations a move, time a
move, simulations a second of one core. The models are in `benchmarks/problems`, each with its source; all are written
against the public interface, `skd_adversary.planning.pomdp`. pomdp-py plans on the same model with the same number of
simulations, the same default policy and the same belief (`benchmarks/problems/pomdp_py_models.py`), in fewer episodes,
for it is slower. The crossing is the kamikaze POMDP of this project, for which nothing is published.

`--planner` lets another planner of this project plan: POMCPOW or PFT-DPW, with published parameters where there are.

    python benchmarks/planning.py [--problems NAME ...] [--planner ours|pomcpow|pft_dpw] [--episodes N]
                                  [--simulations N | --seconds-a-move S] [--pomdp-py-episodes N] [--workers N]
                                  [--seed N] [--record FILE] [--json]
"""

from __future__ import annotations

import argparse
import functools
import importlib.util
import json
import math
import multiprocessing
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from problems.crossing import crossing
from problems.laser_tag import laser_tag, random_cells
from problems.light_dark import light_dark, light_dark_observed
from problems.rock_sample import rock_sample
from problems.sub_hunt import sub_hunt, sub_hunt_at_random, sub_hunt_with_leaves
from problems.tag import tag
from problems.tiger import tiger
from recorded_episodes import Episode, Record
from skd_adversary.model.parts import SEARCH
from skd_adversary.planning.belief import ParticleBelief
from skd_adversary.planning.options import Backup, Cells, PlannerOptions
from skd_adversary.planning.pft_dpw import PftDpw, PftDpwOptions
from skd_adversary.planning.planner import Planner
from skd_adversary.planning.pomcpow import Pomcpow, PomcpowOptions
from skd_adversary.planning.pomdp import Pomdp
from skd_adversary.planning.tree_planner import TreePlanner

_CALIBRATION_MOVES = 5
_CALIBRATION_SEED = 1 << 30


@dataclass(frozen=True)
class Problem:
    """What is measured.

    Attributes:
        make: seed of the episode → model.
        options: of the planner; `simulations` is the default budget.
        moves: an episode is cut off after so many.
        planning_model: model of the same states that the planner plans on, the default policy's advantages being its
            rewards; the problem's own by default.
        published: figures to compare with: source → (mean return, standard error or None).
        pomdp_py: name in `problems.pomdp_py_models`, or None where pomdp-py is not run.
        others: planner → its options, where they are not those of `options`.
        others_model: model that planners other than ours plan on; ours' by default.
        bin_width: of continuous observations for pomdp-py.
        pomdp_py_episodes: default number of episodes of pomdp-py.
    """

    make: Callable[[int], Pomdp]
    options: PlannerOptions
    moves: int
    published: dict[str, tuple[float, float | None]] = field(default_factory=dict)
    planning_model: Callable[[], Pomdp] | None = None
    pomdp_py: str | None = None
    others: dict[str, PlannerOptions] = field(default_factory=dict)
    others_model: Callable[[], Pomdp] | None = None
    bin_width: float = 1.0
    pomdp_py_episodes: int = 20


# Observations that repeat exactly: each has a child of its own.
_DISCRETE: Final[dict[str, Any]] = {"cells": Cells.NEAREST, "observation_factor": math.inf}
# Leaves have the exact value of a good policy: the mean of the action tried most is neither spoilt by what else was
# tried nor by luck.
_EXACT_LEAVES: Final[dict[str, Any]] = {**_DISCRETE, "backup": Backup.MOST_VISITED}
PROBLEMS: dict[str, Problem] = {
    "tiger": Problem(
        lambda _seed: tiger(),
        # The default policy listens, whatever the state: rollouts have no optimism, and need not learn any.
        PlannerOptions(simulations=5_000, depth=25, exploration=110.0, particles=1_000, learned_states=0, **_DISCRETE),
        moves=150,
        published={"optimum": (19.37, None)},
        pomdp_py="tiger",
    ),
    "rock_sample_7_8": Problem(
        lambda _seed: rock_sample(7, 8),
        PlannerOptions(simulations=5_000, depth=60, exploration=1.0, particles=3_000, **_EXACT_LEAVES),
        planning_model=lambda: rock_sample(7, 8, advantages=True),
        moves=100,
        published={
            "DESPOT C++, 1 s a move": (21.68, 1.19),
            "DESPOT C++, 0.1 s": (20.24, 0.76),
            "DESPOT, published": (20.9, None),
            "ABT (TAPIR), 0.1 s": (19.40, 1.23),
        },
        pomdp_py="rock_sample",
        pomdp_py_episodes=2,
    ),
    "rock_sample_11_11": Problem(
        lambda _seed: rock_sample(11, 11),
        PlannerOptions(simulations=5_000, depth=60, exploration=1.0, particles=3_000, **_EXACT_LEAVES),
        planning_model=lambda: rock_sample(11, 11, advantages=True),
        moves=100,
        published={
            "DESPOT C++, 0.1 s": (20.59, 1.21),
            "DESPOT, published": (21.8, None),
            "ABT (TAPIR), 0.1 s": (17.46, 1.34),
        },
    ),
    "tag": Problem(
        lambda _seed: tag(),
        PlannerOptions(simulations=1_000, depth=90, exploration=1.0, particles=2_000, **_EXACT_LEAVES),
        planning_model=lambda: tag(advantages=True),
        moves=90,
        published={
            "DESPOT C++, 1 s": (-4.47, 1.21),
            "DESPOT C++, 0.1 s": (-7.16, 0.58),
            "ABT (TAPIR), 0.1 s": (-5.60, 1.12),
            "DESPOT, published": (-6.2, None),
            "POMCP, published": (-7.1, None),
        },
        pomdp_py="tag",
        pomdp_py_episodes=10,
    ),
    "laser_tag": Problem(
        lambda seed: laser_tag(random_cells(np.random.default_rng([seed, 0]))),
        PlannerOptions(
            simulations=3_000,
            depth=90,
            exploration=5.0,
            particles=8_000,
            observation_factor=4.0,
            observation_exponent=0.1,
            backup=Backup.MOST_VISITED,
            cells=Cells.NEAREST,
        ),
        moves=90,
        published={
            "DESPOT C++, 0.1 s": (-6.96, 1.25),
            "DESPOT, published": (-8.9, 0.2),
            "POMCPOW, published": (-10.3, 0.2),
        },
    ),
    "light_dark": Problem(
        lambda _seed: light_dark(),
        PlannerOptions(
            simulations=10_000,
            depth=20,
            exploration=100.0,
            particles=3_000,
            observation_factor=4.0,
            observation_exponent=0.2,
            backup=Backup.MOST_VISITED,
            cells=Cells.NEAREST,
        ),
        moves=100,
        published={
            "POMCPOW, published": (56.1, 0.6),
            "PFT-DPW, published": (57.2, 0.5),
            "POMCP, binned observations, published": (61.1, 0.4),
        },
        others_model=light_dark_observed,
        others={
            "pomcpow": PomcpowOptions(
                simulations=20_000,
                depth=20,
                exploration=90.0,
                observation_factor=5.0,
                observation_exponent=1.0 / 15.0,
                particles=10_000,
            ),
            "pft_dpw": PftDpwOptions(
                simulations=5_000,
                depth=20,
                exploration=100.0,
                observation_factor=4.0,
                observation_exponent=0.1,
                particles=10_000,
            ),
        },
        pomdp_py="light_dark",
        bin_width=1.0,
    ),
    "sub_hunt": Problem(
        lambda _seed: sub_hunt(),
        PlannerOptions(simulations=20_000, depth=20, exploration=100.0, particles=10_000),
        planning_model=sub_hunt_with_leaves,
        moves=100,
        published={
            "PFT-DPW, published": (77.4, 1.1),
            "POMCPOW, published": (69.2, 1.3),
            "QMDP, published": (28.0, 1.3),
            "ping first, then QMDP, published": (79.0, 1.1),
        },
        others={
            "pomcpow": PomcpowOptions(
                simulations=20_000,
                depth=20,
                exploration=17.0,
                observation_factor=6.0,
                observation_exponent=0.01,
                particles=10_000,
                most_visited=True,
                ends_are_seen=False,
            ),
            "pft_dpw": PftDpwOptions(
                simulations=5_000,
                depth=20,
                exploration=100.0,
                observation_factor=2.0,
                observation_exponent=0.1,
                particles=10_000,
            ),
        },
    ),
    "sub_hunt_rollouts": Problem(
        lambda _seed: sub_hunt(),
        PlannerOptions(simulations=20_000, depth=20, exploration=100.0, particles=10_000),
        moves=100,
        pomdp_py="sub_hunt",
        bin_width=2.0,
    ),
    "sub_hunt_at_random": Problem(
        lambda _seed: sub_hunt_at_random(),
        PlannerOptions(simulations=20_000, depth=20, exploration=100.0, particles=10_000),
        moves=100,
    ),
    "crossing": Problem(
        lambda _seed: crossing(),
        replace(SEARCH, simulations=1_000, exploration=30.0),
        moves=25,
        pomdp_py="crossing",
        pomdp_py_episodes=5,
    ),
}


PLANNERS: Final[dict[str, tuple[type[TreePlanner], type[PlannerOptions]]]] = {
    "ours": (Planner, PlannerOptions),
    "pomcpow": (Pomcpow, PomcpowOptions),
    "pft_dpw": (PftDpw, PftDpwOptions),
}


def options_of(name: str, planner: str) -> PlannerOptions:
    """Return a planner's options for a problem: its own there, or ours as far as they mean something to it."""
    problem = PROBLEMS[name]
    if planner in problem.others:
        return problem.others[planner]
    return PLANNERS[planner][1](**{f.name: getattr(problem.options, f.name) for f in fields(problem.options)})


def run_episode(
    name: str, seed: int, simulations: int, *, moves: int | None = None, planner: str = "ours", pomdp_py: bool = False
) -> Episode:
    """Run one episode in closed loop: plan, act, observe, update the belief.

    Args:
        name: of the problem.
        seed: of the episode; problem, world and planner draw from generators of their own.
        simulations: a move.
        moves: at most; the problem's own limit by default.
        planner: one of `PLANNERS`.
        pomdp_py: whether pomdp-py plans.
    """
    problem = PROBLEMS[name]
    model = problem.make(seed)
    options = replace(options_of(name, planner), simulations=simulations)
    world_rng, belief_rng, planner_rng = (
        np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(3)
    )
    belief = ParticleBelief(model, options.particles, belief_rng)
    plan, advance = (
        _pomdp_py_planner(problem, model, options, seed)
        if pomdp_py
        else _planner(planner, _planning_model(problem, planner, model), options, planner_rng)
    )
    state, after = np.empty(model.state_dim), np.empty(model.state_dim)
    observation = np.empty(model.observation_dim)
    model.initial(model.parameters, state, world_rng)
    value, discount, seconds, made = 0.0, 1.0, 0.0, 0
    for _ in range(problem.moves if moves is None else moves):
        begin = time.process_time()
        action = plan(belief)
        seconds += time.process_time() - begin
        made += 1
        reward, terminal = model.step(model.parameters, state, action, after, world_rng)
        value += discount * reward
        if terminal:
            break
        discount *= model.discount
        model.observe(model.parameters, after, action, observation, world_rng)
        belief.predict(action)
        belief.correct(action, observation)
        begin = time.process_time()
        advance(action, observation)
        seconds += time.process_time() - begin
        state, after = after, state
    return Episode(value, made, made * simulations, seconds)


def _planning_model(problem: Problem, planner: str, model: Pomdp) -> Pomdp:
    if planner != "ours" and problem.others_model is not None:
        return problem.others_model()
    return model if problem.planning_model is None else problem.planning_model()


def _planner(
    name: str, model: Pomdp, options: PlannerOptions, rng: np.random.Generator
) -> tuple[Callable[[ParticleBelief], int], Callable[..., None]]:
    planner = PLANNERS[name][0](model, options, rng)
    return planner.plan, planner.advance


def _pomdp_py_planner(
    problem: Problem, model: Pomdp, options: PlannerOptions, seed: int
) -> tuple[Callable[[ParticleBelief], int], Callable[..., None]]:
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
    return lambda belief: planner.plan(belief, extra), lambda *_arguments: None


def calibrated_simulations(name: str, seconds_a_move: float, planner: str = "ours") -> int:
    """Return the number of simulations that a move of so many seconds (of one core) has time for."""
    simulations = options_of(name, planner).simulations
    run_episode(name, _CALIBRATION_SEED, simulations, moves=1, planner=planner)  # compiles
    for _ in range(2):  # a larger tree is slower: the second round starts near the answer
        episode = run_episode(name, _CALIBRATION_SEED, simulations, moves=_CALIBRATION_MOVES, planner=planner)
        simulations = max(1, round(simulations * seconds_a_move * episode.moves / episode.seconds))
    return simulations


def summary(episodes: Sequence[Episode]) -> dict[str, float]:
    """Return the figures of a number of episodes."""
    values = np.array([episode.value for episode in episodes])
    moves, simulations = sum(e.moves for e in episodes), sum(e.simulations for e in episodes)
    seconds = sum(e.seconds for e in episodes)
    return {
        "episodes": len(values),
        "mean": float(values.mean()),
        "standard_error": float(values.std(ddof=1) / math.sqrt(len(values))) if len(values) > 1 else math.nan,
        "moves_per_episode": moves / len(values),
        "simulations_per_move": simulations / moves,
        "ms_per_move": 1000.0 * seconds / moves,
        "simulations_per_second": simulations / seconds,
    }


def measure(
    name: str,
    planner: str,
    simulations: int,
    count: int,
    pomdp_py_count: int,
    seed: int,
    workers: int,
    record: Record | None = None,
) -> dict[str, Any]:
    """Measure one problem; pomdp-py's episodes have the seeds of ours. Episodes on record are not run again."""
    problem = PROBLEMS[name]
    record = Record(None) if record is None else record
    seeds = range(seed, seed + count)
    result: dict[str, Any] = {"published": problem.published}
    what = {"problem": name, "simulations": simulations}
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        run = what | {"planner": planner, "options": repr(replace(options_of(name, planner), simulations=simulations))}
        run_one = functools.partial(run_episode, name, simulations=simulations, planner=planner)
        # compiles before the workers start
        run_episode(name, _CALIBRATION_SEED, min(simulations, 100), moves=2, planner=planner)
        result["skd"] = summary(list(record.episodes(run, seeds, pool, run_one)))
        if problem.pomdp_py is not None and pomdp_py_count > 0 and importlib.util.find_spec("pomdp_py") is not None:
            run = what | {"planner": "pomdp_py", "options": repr(options_of(name, "ours"))}
            run_one = functools.partial(run_episode, name, simulations=simulations, pomdp_py=True)
            result["pomdp_py"] = summary(list(record.episodes(run, seeds[:pomdp_py_count], pool, run_one)))
            result["speed_ratio"] = (
                result["skd"]["simulations_per_second"] / result["pomdp_py"]["simulations_per_second"]
            )
    return result


def _print(name: str, result: dict[str, Any]) -> None:
    row = result["skd"]
    print(
        f"{name}: {row['mean']:.2f} ± {row['standard_error']:.2f}   {row['episodes']} episodes, "
        f"{row['simulations_per_move']:.0f} simulations and {row['ms_per_move']:.1f} ms a move, "
        f"{row['simulations_per_second']:,.0f} simulations/s and core, {row['moves_per_episode']:.1f} moves"
    )
    for source, (mean, error) in result["published"].items():
        print(f"    {mean:7.2f}{'' if error is None else f' ± {error:.2f}':9} {source}")
    if "pomdp_py" in result:
        other = result["pomdp_py"]
        print(
            f"    {other['mean']:7.2f} ± {other['standard_error']:.2f}   pomdp-py, {other['episodes']} episodes, "
            f"{other['ms_per_move']:.0f} ms a move, {other['simulations_per_second']:,.0f} simulations/s: "
            f"{result['speed_ratio']:.0f} times as slow"
        )
    sys.stdout.flush()


def main() -> None:
    """Measure, and print a table or JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--problems", nargs="+", choices=PROBLEMS, default=list(PROBLEMS), metavar="NAME")
    parser.add_argument("--planner", choices=PLANNERS, default="ours", help="default: ours")
    parser.add_argument("--episodes", type=int, default=100, metavar="N", help="per problem (default 100)")
    budget = parser.add_mutually_exclusive_group()
    budget.add_argument("--simulations", type=int, metavar="N", help="a move (default: the problem's own)")
    budget.add_argument("--seconds-a-move", type=float, metavar="S", help="converted to a number once per problem")
    parser.add_argument(
        "--pomdp-py-episodes", type=int, metavar="N", help="of pomdp-py, 0: none (default: the problem's own)"
    )
    parser.add_argument("--workers", type=int, default=1, metavar="N", help="processes (default 1)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the first episode (default 0)")
    parser.add_argument("--record", type=Path, metavar="FILE", help="add episodes to it; those in it are not run again")
    parser.add_argument("--json", action="store_true", help="print JSON: problem → figures")
    arguments = parser.parse_args()
    if arguments.episodes < 2:
        parser.error("--episodes must be at least 2")
    if min(arguments.workers, arguments.simulations or 1, arguments.seconds_a_move or 1.0) <= 0:
        parser.error("--workers, --simulations and --seconds-a-move must be positive")
    record, results = Record(arguments.record), {}
    for name in arguments.problems:
        problem = PROBLEMS[name]
        planner = arguments.planner
        simulations = arguments.simulations or options_of(name, planner).simulations
        if arguments.seconds_a_move is not None:
            simulations = calibrated_simulations(name, arguments.seconds_a_move, planner)
        others = problem.pomdp_py_episodes if arguments.pomdp_py_episodes is None else arguments.pomdp_py_episodes
        results[name] = measure(
            name, planner, simulations, arguments.episodes, others, arguments.seed, arguments.workers, record
        )
        if not arguments.json:
            _print(name, results[name])
    if arguments.json:
        print(json.dumps(results, indent=2))


if __name__ == "__main__":
    main()
