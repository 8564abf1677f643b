"""How near kamikazes come to the clairvoyant one: closeness = SKD / floor, the paper's experiment with synthetic φ.

Adversaries side by side, on the same φ, cars, noise and sensor: the two objectives, a greedy chaser and random actions.
The floor is what a kamikaze who knew the car's noise beforehand would reach in each episode
(skd_evaluator.floor.clairvoyant).

    python benchmarks/closeness.py [--multipliers C ...] [--episodes N] [--json]
    python benchmarks/closeness.py --simulations 16 64 250 ... --picture closeness.png

The second form plans by the Fréchet objective with each of the budgets, and plots closeness against them.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from skd_adversary.model.road_user.pedestrian import ACTION_COUNT, action_velocity
from skd_adversary.warm_up import warm_up_episodes
from skd_evaluator import palette
from skd_evaluator.campaign.plan.plan import Plan, safe_trajectories
from skd_evaluator.campaign.run.runner import run_episode
from skd_evaluator.campaign.run.workers import InProcessRunner, available_workers
from skd_evaluator.floor.assessment_floor import warm_up_floor
from skd_evaluator.floor.clairvoyant import clairvoyant_floor
from skd_evaluator.measure.distances.frechet import discrete_frechet
from skd_evaluator.measure.statistics.clustered import clustered_mean
from skd_evaluator.measure.statistics.prior import DISTANCES
from skd_evaluator.measure.statistics.statistics import Interval, normal_interval, ratio_interval
from skd_sim.arrays import FloatArray
from skd_sim.choices.objective import DEFAULT_SIMULATIONS, Objective
from skd_sim.controllers import PAPER_MULTIPLIERS
from skd_sim.encounter.scenario import load_scenario
from skd_sim.episode.episode import Episode, Mode, Outcome
from skd_sim.episode.randomness import Role, generator
from skd_sim.state import CarState

CHASER, RANDOM = "greedy chaser", "random actions"
ADVERSARIES = (Objective.FRECHET.value, Objective.PAPER.value, CHASER, RANDOM)


class _Planless:
    """An adversary that needs no plan: it sees the car through the same sensor as the planning one."""

    depletions = 0

    def __init__(self, episode: Episode, *, chases: bool) -> None:
        self._user = episode.scenario.adversary
        self._step = episode.scenario.time_step
        self._x, self._y = episode.start
        self._chases = chases
        self._sensor = generator(episode.seed, episode.episode_id, Role.SENSOR)
        self._choice = generator(episode.seed, episode.episode_id, Role.PLANNER)

    def act(self, car: CarState) -> tuple[float, float]:
        """Go where the car is seen nearest after the step, or anywhere."""
        noise = self._user.position_noise * self._sensor.standard_normal(2)
        seen_x, seen_y = car.x + noise[0], car.y + noise[1]
        moves = [action_velocity(action, self._user.speed) for action in range(ACTION_COUNT)]
        if self._chases:
            ends = [(self._x + self._step * vx, self._y + self._step * vy) for vx, vy in moves]
            chosen = int(np.argmin([math.hypot(x - seen_x, y - seen_y) for x, y in ends]))
        else:
            chosen = int(self._choice.integers(ACTION_COUNT))
        vx, vy = moves[chosen]
        self._x, self._y = self._x + self._step * vx, self._y + self._step * vy
        return vx, vy


@dataclass(frozen=True)
class _Job:
    episode: Episode
    adversary: str


def _distance(job: _Job) -> float:
    """Run an episode; return the distance of ψ from φ (m), nan without a collision."""
    episode = job.episode
    if job.adversary in (CHASER, RANDOM):
        log = run_episode(episode, adversary=_Planless(episode, chases=job.adversary == CHASER))
    else:
        log = run_episode(replace(episode, objective=Objective(job.adversary)))
    if log.outcome != Outcome.COLLISION:
        return math.nan
    assert episode.safe_trajectory is not None
    return discrete_frechet(episode.safe_trajectory.positions, log.trajectory.positions)


def _floor(job: tuple[Episode, float]) -> float:
    """Return the floor (m) of an episode in which some kamikaze came as near as given; nan where nobody can collide."""
    episode, bound = job
    found = clairvoyant_floor(episode, None if math.isnan(bound) else bound)
    return math.nan if found is None else found.distance


@dataclass(frozen=True)
class _Row:
    """One adversary against one car."""

    multiplier: float
    adversary: str
    distances: FloatArray  # one per episode, nan without a collision
    floors: FloatArray
    cluster: npt.NDArray[np.int64]  # index of φ

    def summary(self) -> dict[str, Any]:
        hit = ~np.isnan(self.distances)
        distances, floors = self.distances[hit], self.floors[hit]
        groups = [distances[self.cluster[hit] == index] for index in np.unique(self.cluster)]
        found = bool(hit.any())
        by_phi = clustered_mean(groups, prior=DISTANCES)
        return {
            "multiplier": self.multiplier,
            "adversary": self.adversary,
            "episodes": len(hit),
            "success_rate": float(hit.mean()),
            "skd": float(distances.mean()) if found else None,
            "skd_ci95_pairs": normal_interval(distances),
            "skd_ci95": by_phi.interval if by_phi else None,
            "floor": float(floors.mean()) if found else None,
            "closeness": float(distances.mean() / floors.mean()) if found else None,
            "closeness_ci95": ratio_interval(distances, floors),
        }


def _episodes(plan: Plan, per_phi: int, runner: InProcessRunner) -> list[Episode]:
    safe = safe_trajectories(plan, runner)
    return [
        plan.episode(Mode.KAMIKAZE, index, attempt, phi) for index, phi in enumerate(safe) for attempt in range(per_phi)
    ]


def _rows(plan: Plan, adversaries: tuple[str, ...], per_phi: int, runner: InProcessRunner) -> list[_Row]:
    episodes = _episodes(plan, per_phi, runner)
    runs = {
        name: np.array(list(runner.map(_distance, [_Job(episode, name) for episode in episodes])))
        for name in adversaries
    }
    nearest = np.fmin.reduce(list(runs.values()))
    floors = np.array(list(runner.map(_floor, list(zip(episodes, nearest.tolist(), strict=True)))))
    cluster = np.repeat(np.arange(plan.safe_count), per_phi)
    return [_Row(plan.multiplier, name, distances, floors, cluster) for name, distances in runs.items()]


def _effect_size(one: FloatArray, other: FloatArray) -> float:
    """Return Cohen's d of two samples: difference of the means over the pooled standard deviation."""
    one, other = one[~np.isnan(one)], other[~np.isnan(other)]
    degrees = len(one) + len(other) - 2
    pooled = ((len(one) - 1) * one.var(ddof=1) + (len(other) - 1) * other.var(ddof=1)) / degrees
    return float((other.mean() - one.mean()) / math.sqrt(pooled))


def _interval(values: Interval | None) -> str:
    return "" if values is None else f"[{values[0]:.3f}, {values[1]:.3f}]"


def _print_table(summaries: list[dict[str, Any]]) -> None:
    head = f"{'C':>6}  {'adversary':<15}{'success':>8}{'SKD (m)':>9}  {'95 %, by φ':<16}"
    print(f"{head}{'floor':>7}{'closeness':>11}  95 %")
    for row in summaries:
        print(
            f"{row['multiplier']:6.3f}  {row['adversary']:<15}{row['success_rate']:8.1%}{row['skd'] or math.nan:9.3f}  "
            f"{_interval(row['skd_ci95']):<16}{row['floor'] or math.nan:7.3f}"
            f"{row['closeness'] or math.nan:11.3f}  {_interval(row['closeness_ci95'])}"
        )


def _sweep(arguments: argparse.Namespace, runner: InProcessRunner) -> dict[str, Any]:
    plan = Plan(load_scenario("crossing"), seed=arguments.seed)
    by_car = [
        _rows(replace(plan, multiplier=value), ADVERSARIES, arguments.episodes, runner)
        for value in arguments.multipliers
    ]
    summaries = [row.summary() for rows in by_car for row in rows]
    means, effects = {}, {}
    for index, name in enumerate(ADVERSARIES):
        mine = [row["closeness"] for row in summaries if row["adversary"] == name and row["closeness"] is not None]
        means[name] = float(np.mean(mine)) if mine else None
        if name in tuple(Objective):
            pairs = itertools.pairwise(by_car)
            effects[name] = [_effect_size(one[index].distances, other[index].distances) for one, other in pairs]
    if not arguments.json:
        _print_table(summaries)
        known = ", ".join(f"{name} {value:.3f}" for name, value in means.items() if value is not None)
        print(f"mean closeness over the cars: {known}")
        for name, values in effects.items():
            print(f"effect size (Cohen's d) between neighbouring C, {name}: {', '.join(f'{d:+.2f}' for d in values)}")
    return {"rows": summaries, "mean_closeness": means, "effect_sizes": effects}


def _budgets(arguments: argparse.Namespace, runner: InProcessRunner) -> dict[str, Any]:
    curves: dict[str, list[dict[str, Any]]] = {}
    for value in arguments.multipliers:
        plan = Plan(load_scenario("crossing"), seed=arguments.seed, multiplier=value)
        for count in arguments.simulations:
            budget = replace(plan, simulations=count)
            (row,) = _rows(budget, (Objective.FRECHET.value,), arguments.episodes, runner)
            curves.setdefault(f"{value:g}", []).append({"simulations": count, **row.summary()})
            if not arguments.json:
                last = curves[f"{value:g}"][-1]
                print(
                    f"C = {value:5.3f}  {count:6d} simulations a move: closeness {last['closeness']:.3f} "
                    f"{_interval(last['closeness_ci95'])}, success {last['success_rate']:.1%}",
                    flush=True,
                )
    if arguments.picture is not None:
        _save_picture(arguments.picture, curves)
    return {"curves": curves}


def _save_picture(path: Path, curves: dict[str, list[dict[str, Any]]]) -> None:
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 4.2), layout="constrained")
    axes = figure.subplots()
    for index, (name, points) in enumerate(curves.items()):
        x = np.array([point["simulations"] for point in points]) * 1.03 ** (index - 0.5 * (len(curves) - 1))
        y = np.array([point["closeness"] for point in points])
        ends = np.array([point["closeness_ci95"] for point in points])
        colour, marker = palette.SERIES[index % len(palette.SERIES)], palette.MARKERS[index % len(palette.MARKERS)]
        axes.errorbar(
            x, y, np.abs(ends.T - y), label=f"C = {name}", color=colour, marker=marker, ms=4.0, capsize=2.0, lw=1.3
        )
    axes.axvline(DEFAULT_SIMULATIONS, color="#888888", lw=1.0, ls="--")
    axes.annotate("default ", (DEFAULT_SIMULATIONS, axes.get_ylim()[1]), ha="right", va="top", color="#555555")
    axes.set_xscale("log")
    axes.set_xlabel("simulations per decision")
    axes.set_ylabel("closeness = SKD / floor (1 is perfect)")
    axes.set_title("Fréchet objective: more simulations come nearer, then no more", loc="left", fontsize=10)
    axes.grid(alpha=0.3, which="both")
    axes.legend(frameon=False)
    figure.savefig(path, dpi=150)


def main() -> None:
    """Measure, and print a table or JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--multipliers", type=float, nargs="+", default=list(PAPER_MULTIPLIERS), metavar="C")
    parser.add_argument("--episodes", type=int, default=100, metavar="N", help="per φ and car (default 100)")
    parser.add_argument("--simulations", type=int, nargs="+", metavar="N", help="budgets to compare")
    parser.add_argument("--picture", type=Path, metavar="FILE", help="plot closeness against the budgets")
    parser.add_argument("--seed", type=int, default=0, metavar="N")
    parser.add_argument("--workers", type=int, default=available_workers(), metavar="N")
    parser.add_argument("--json", action="store_true", help="print JSON")
    arguments = parser.parse_args()
    if arguments.episodes < 2:
        parser.error("--episodes must be at least 2")
    with InProcessRunner(arguments.workers) as runner:
        warm_up_floor()
        runner.start([episode for objective in Objective for episode in warm_up_episodes(objective=objective)])
        result = _budgets(arguments, runner) if arguments.simulations else _sweep(arguments, runner)
    if arguments.json:
        print(json.dumps(result, indent=2))


if __name__ == "__main__":
    main()
