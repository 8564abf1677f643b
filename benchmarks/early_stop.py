"""What a search would save that stops before its last simulation: by an oracle, and by a statistical rule.

Decisions of kamikazes are made with all their simulations. From what each returned at the root it follows after how
many of them the choice was made that never changed again (oracle), and where a rule would have stopped: from the 200th
simulation on, at each fiftieth, if the best action's mean return is above that of every other by z standard errors of
the difference, and each was tried twice. `other` is the share of decisions that the rule makes differently. What the
kept tree loses for the next decision is not in these figures.

    python benchmarks/early_stop.py [--episodes N] [--json]
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
from skd_adversary.planning.belief import ParticleBelief
from skd_adversary.planning.planner import Planner
from skd_adversary.planning.search_tree import VALUE, VISITS, Float32Array, Int32Array
from skd_evaluator.campaign.plan.plan import Plan, safe_trajectories
from skd_evaluator.campaign.run.runner import run_episode
from skd_evaluator.campaign.run.workers import InProcessRunner
from skd_sim.arrays import FloatArray
from skd_sim.choices.objective import Objective
from skd_sim.encounter.scenario import load_scenario
from skd_sim.episode.episode import Mode
from skd_sim.kernels.compilation import kernel

_MULTIPLIERS = (0.5, 1.0, 1.15)
_ERRORS = (2.0, 3.0, 4.0)
_LEAST, _EVERY = 200, 50
_SAFE_COUNT = 5


@kernel
def _followed(
    means: Float32Array, visits: Float32Array, actions: Int32Array, returns: FloatArray, errors: float
) -> tuple[int, int, int, int]:
    """Go through a decision's simulations; `means` and `visits` of the root before them are overwritten.

    Returns:
        Simulations after which the choice never changes, after which the rule stops, its choice, that of all of them.
    """
    number = means.shape[0]
    tried, mean, squares = np.zeros(number), np.zeros(number), np.zeros(number)
    chosen, settled, stopped, by_rule = -1, 0, 0, -1
    for i in range(actions.shape[0]):
        action = actions[i]
        visits[action] += np.float32(1.0)
        before = means[action] if visits[action] > 1.0 else np.float32(0.0)
        means[action] = before + (np.float32(returns[i]) - before) / visits[action]
        tried[action] += 1.0
        apart = returns[i] - mean[action]
        mean[action] += apart / tried[action]
        squares[action] += apart * (returns[i] - mean[action])
        best = -1
        for other in range(number):
            if visits[other] > 0.0 and (best < 0 or means[other] > means[best]):
                best = other
        if best != chosen:
            chosen, settled = best, i + 1
        if stopped > 0 or i + 1 < _LEAST or (i + 1) % _EVERY != 0:
            continue
        sure = tried[best] > 1.0
        for other in range(number):
            if other == best or visits[other] < 0.0:
                continue
            if tried[best] < 2.0 or tried[other] < 2.0:
                sure = False
                continue
            variance = squares[best] / (tried[best] - 1.0) / tried[best]
            variance += squares[other] / (tried[other] - 1.0) / tried[other]
            if means[best] - means[other] <= errors * np.sqrt(variance):
                sure = False
        if sure:
            stopped, by_rule = i + 1, best
    return settled, stopped if stopped > 0 else actions.shape[0], by_rule if stopped > 0 else chosen, chosen


@contextmanager
def _watched_planner() -> Iterator[list[list[tuple[int, int, int, int]]]]:
    """Have every search followed; those in which but one action makes sense are none."""
    found: list[list[tuple[int, int, int, int]]] = []
    search = Planner._search_from

    def watched(self: Planner, belief: ParticleBelief) -> None:
        root = self._tree.statistics[0].copy() if self._kept else np.zeros_like(self._tree.statistics[0])
        search(self, belief)
        if self._log.action[0] < 0:
            return
        visits = np.where(self._tree.statistics[0, :, VISITS] < 0.0, np.float32(-1.0), root[:, VISITS])
        means = np.where(visits > 0.0, root[:, VALUE], np.float32(0.0))
        log = self._log
        found.append([_followed(means.copy(), visits.copy(), log.action, log.value, errors) for errors in _ERRORS])

    Planner._search_from = watched  # type: ignore[method-assign]
    try:
        yield found
    finally:
        Planner._search_from = search  # type: ignore[method-assign]


def measure(plan: Plan, episodes: int) -> dict[str, Any]:
    """Return shares of simulations for one car and objective."""
    safe = safe_trajectories(plan, InProcessRunner(1))
    with _watched_planner() as found:
        for run in range(episodes):
            run_episode(plan.episode(Mode.KAMIKAZE, run % len(safe), run // len(safe), safe[run % len(safe)]))
    table = np.array(found)  # decisions × errors × 4
    whole = float(plan.simulations)
    return {
        "objective": str(plan.objective),
        "multiplier": plan.multiplier,
        "decisions": len(table),
        "oracle": float(table[:, 0, 0].mean() / whole),
        "rule": (table[:, :, 1].mean(axis=0) / whole).tolist(),
        "other": (table[:, :, 2] != table[:, :, 3]).mean(axis=0).tolist(),
    }


def main() -> None:
    """Measure, and print a table or JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, default=50, metavar="N", help="per car and objective (default 50)")
    parser.add_argument("--json", action="store_true", help="print JSON")
    arguments = parser.parse_args()
    if arguments.episodes < 1:
        parser.error("--episodes must be at least 1")
    plan = Plan(load_scenario("crossing"), safe_count=_SAFE_COUNT, seed=3)
    rows = [
        measure(replace(plan, objective=objective, multiplier=multiplier), arguments.episodes)
        for objective in Objective
        for multiplier in _MULTIPLIERS
    ]
    if arguments.json:
        print(json.dumps(rows, indent=2))
        return
    rules = "".join(f"{f'z = {errors:g}':>10}{'other':>8}" for errors in _ERRORS)
    print(f"{'objective':>12}{'C':>6}{'decisions':>11}{'oracle':>9}{rules}")
    for row in rows:
        rules = "".join(
            f"{100 * used:8.1f} %{100 * differ:6.1f} %" for used, differ in zip(row["rule"], row["other"], strict=True)
        )
        print(f"{row['objective']:>12}{row['multiplier']:6g}{row['decisions']:11}{100 * row['oracle']:7.1f} %{rules}")


if __name__ == "__main__":
    main()
