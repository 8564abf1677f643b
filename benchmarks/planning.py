"""How good the planner is on problems with published results, beside those and beside pomdp-py in the same run.

For each problem: mean discounted return ± its standard error over episodes of a seed each, simulations a move, time a
move, simulations a second of one core. The models are in `benchmarks/problems`, each with its source; all are written
against the public interface, `skd_adversary.planning.pomdp`. pomdp-py plans on the same model with the same number of
simulations, the same default policy and the same belief (`benchmarks/problems/pomdp_py_models.py`), in fewer episodes,
for it is slower. The crossing is the kamikaze POMDP of this project, for which nothing is published.

`--planner` lets other planners of this project plan: POMCPOW or PFT-DPW, with published parameters where there are, or
the default policy alone. pomdp-py is compared with ours. `--set` gives options of the planner other values than the
problem does: a number, `true` or `false`, a member's name, or `none` for an exploration that the search finds, as in
`--set cells=NEAREST exploration=none`.

    python benchmarks/planning.py [--problems NAME ...] [--planner ours|pomcpow|pft_dpw|default_policy ...]
                                  [--set OPTION=VALUE ...] [--episodes N]
                                  [--simulations N | --seconds-a-move S] [--pomdp-py-episodes N] [--workers N]
                                  [--seed N] [--record FILE] [--json]
"""

from __future__ import annotations

import argparse
import functools
import importlib.util
import json
import math
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from planner_choice import PLANNERS, options_of, settings_of
from planning_episode import CALIBRATION_SEED, calibrated_simulations, run_episode
from planning_problems import PROBLEMS
from recorded_episodes import Episode, Record
from worker_processes import worker_processes


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
    seeds: Sequence[int],
    pool: Executor,
    record: Record,
    settings: Mapping[str, Any],
    *,
    pomdp_py: bool = False,
) -> dict[str, float]:
    """Measure one planner on one problem. Episodes on record are not run again."""
    options = options_of(name, planner, settings)
    run = {
        "problem": name,
        "simulations": simulations,
        "planner": "pomdp_py" if pomdp_py else planner,
        "options": repr(options if pomdp_py else replace(options, simulations=simulations)),
    }
    one = functools.partial(
        run_episode, name, simulations=simulations, planner=planner, settings=settings, pomdp_py=pomdp_py
    )
    if not pomdp_py:  # compiles, once for all workers
        run_episode(name, CALIBRATION_SEED, min(simulations, 100), moves=2, planner=planner, settings=settings)
    return summary(list(record.episodes(run, seeds, pool, one)))


def _print_row(planner: str, row: Mapping[str, float], remark: str = "") -> None:
    print(
        f"    {row['mean']:7.2f} ± {row['standard_error']:<5.2f} {planner}, {row['episodes']} episodes, "
        f"{row['simulations_per_move']:.0f} simulations and {row['ms_per_move']:.1f} ms a move, "
        f"{row['simulations_per_second']:,.0f} simulations/s and core, {row['moves_per_episode']:.1f} moves{remark}",
        flush=True,
    )


def _print_published(published: Mapping[str, tuple[float, float | None]]) -> None:
    for source, (mean, error) in published.items():
        print(f"    {mean:7.2f}{'' if error is None else f' ± {error:.2f}':8} {source}", flush=True)


def _arguments() -> tuple[argparse.Namespace, dict[str, dict[str, Any]]]:
    """Return the command's arguments, and planner → option → value."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--problems", nargs="+", choices=PROBLEMS, default=list(PROBLEMS), metavar="NAME")
    parser.add_argument(
        "--planner", nargs="+", choices=PLANNERS, default=["ours"], metavar="NAME", help="one or several; default: ours"
    )
    parser.add_argument(
        "--set", nargs="+", action="extend", default=[], metavar="OPTION=VALUE", help="instead of the problem's"
    )
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
    parser.add_argument("--json", action="store_true", help="print JSON: problem → planner → figures")
    arguments = parser.parse_args()
    if arguments.episodes < 2:
        parser.error("--episodes must be at least 2")
    sizes = arguments.workers, arguments.simulations, arguments.seconds_a_move
    if min(size for size in sizes if size is not None) <= 0:
        parser.error("--workers, --simulations and --seconds-a-move must be positive")
    try:
        settings = {planner: settings_of(planner, arguments.set) for planner in arguments.planner}
        for planner in settings:
            for name in arguments.problems:
                options_of(name, planner, settings[planner])
    except ValueError as error:
        parser.error(f"--set: {error}")
    return arguments, settings


def _measure_problem(
    name: str, arguments: argparse.Namespace, settings: Mapping[str, Mapping[str, Any]], pool: Executor
) -> dict[str, Any]:
    """Measure one problem by each planner, and print a row of each at once unless JSON is wanted."""
    problem, record = PROBLEMS[name], Record(arguments.record)
    seeds = range(arguments.seed, arguments.seed + arguments.episodes)
    result: dict[str, Any] = {"published": problem.published}
    others = problem.pomdp_py_episodes if arguments.pomdp_py_episodes is None else arguments.pomdp_py_episodes
    if problem.pomdp_py is None or importlib.util.find_spec("pomdp_py") is None:
        others = 0
    if not arguments.json:
        print(name)
    for planner, chosen in settings.items():
        simulations = arguments.simulations or options_of(name, planner, chosen).simulations
        if arguments.seconds_a_move is not None:
            simulations = calibrated_simulations(name, arguments.seconds_a_move, planner, chosen)
        row = result[planner] = measure(name, planner, simulations, seeds, pool, record, chosen)
        if not arguments.json:
            _print_row(planner, row)
        if planner != "ours" or others <= 0:
            continue
        theirs = measure(name, planner, simulations, seeds[:others], pool, record, chosen, pomdp_py=True)
        result["pomdp_py"] = theirs
        result["speed_ratio"] = row["simulations_per_second"] / theirs["simulations_per_second"]
        if not arguments.json:
            _print_row("pomdp_py", theirs, f", {result['speed_ratio']:.0f} times as slow")
    if not arguments.json:
        _print_published(problem.published)
    return result


def main() -> None:
    """Measure, and print a table or JSON."""
    arguments, settings = _arguments()
    with worker_processes(arguments.workers) as pool:
        results = {name: _measure_problem(name, arguments, settings, pool) for name in arguments.problems}
    if arguments.json:
        print(json.dumps(results, indent=2))


if __name__ == "__main__":
    main()
