"""Whether `skd fit` is right: the basic car at the paper's nine C, many independent probes of each.

Per C: relative error of the trigger distance and of the noise levels, how often the 95 % intervals hold the true
values, how often the right family is chosen, and the Kolmogorov-Smirnov test of the probability integral transform on
held-out ticks (calibrated: 5 % of the p-values below 0.05).

With --skd instead: the Safe-Kamikaze Distance of kamikazes that plan with a fitted model, against those that know C,
on the same safe trajectories and the same draws of the car.

    python benchmarks/car_fit.py [--repetitions 100] [--episodes 1000] [--workers 2] [--multipliers C ...]
    python benchmarks/car_fit.py --skd [--kamikaze-count 100] [--objective frechet] [...]
"""

from __future__ import annotations

import argparse
import multiprocessing
import time
from dataclasses import replace
from typing import Any

import numpy as np
from scipy import stats
from skd_adversary.car_models.car_model_file import car_model_text
from skd_adversary.car_models.fit import fit_with_law
from skd_adversary.car_models.observations import observe
from skd_evaluator.assessment.plan import Plan, probe_episodes
from skd_evaluator.assessment.run.episodes import run_episode
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages.car_model import recording_of
from skd_evaluator.assessment.stages.kamikazes import kamikaze_sets
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories
from skd_evaluator.metrics.skd import compute_skd
from skd_sim.controllers.basic import PAPER_MULTIPLIERS
from skd_sim.options.car_and_adversary import Objective
from skd_sim.scenario.scenario import load_scenario

NAMES = ("trigger", "deceleration", "deceleration_noise", "speed_noise")
WITHIN = {"trigger": 0.03, "deceleration": 0.03, "deceleration_noise": 0.1, "speed_noise": 0.1}
"""Relative error that is asked for."""
SEEDS_APART = 10_000


def repetition(task: tuple[float, int, int]) -> dict[str, Any]:
    """Probe the basic car once, fit it, and compare with the truth."""
    multiplier, seed, episodes = task
    scenario = load_scenario("crossing")
    car = scenario.car
    truth = {
        "trigger": multiplier * car.safe_distance,
        "deceleration": car.deceleration,
        "deceleration_noise": car.acceleration_noise,
        "speed_noise": car.speed_noise,
    }
    logs = [run_episode(spec) for spec in probe_episodes(scenario, episodes, seed=seed, multiplier=multiplier)]
    fitted = fit_with_law(observe([recording_of(log) for log in logs]))[0]
    found: dict[str, Any] = {"multiplier": multiplier, "seed": seed, "family": fitted.chosen}
    found["p_value"] = fitted.calibration.p_value if fitted.calibration else None
    for name, true in truth.items():
        parameter = fitted.parameters[name]
        if parameter.estimate is None or parameter.interval is None:
            found[name] = None
            continue
        low, high = parameter.interval
        found[name] = {"error": parameter.estimate / true - 1.0, "below": true < low, "above": true > high}
    return found


def kamikazes(multiplier: float, arguments: argparse.Namespace, runner: InProcessRunner) -> str:
    """Compare the SKD of kamikazes that plan with a fitted model with that of those that know C."""
    scenario = load_scenario("crossing")
    logs = list(runner.run(probe_episodes(scenario, arguments.episodes, seed=1, multiplier=multiplier)))
    fitted = fit_with_law(observe([recording_of(log) for log in logs]))[0]
    plan = Plan(scenario, multiplier=multiplier, safe_count=5, kamikaze_count=arguments.kamikaze_count)
    plan = replace(plan, objective=Objective(arguments.objective))
    safe = safe_trajectories(plan, runner)
    means = []
    line = f"C = {multiplier:g}, {arguments.objective}, {fitted.chosen}:"
    for name, text in (("true", ""), ("fitted", car_model_text(fitted))):
        sets = kamikaze_sets(replace(plan, car_model=text), safe, runner)
        found = compute_skd([(one.safe_trajectory, [log.trajectory for log in one.logs]) for one in sets]).distances
        means.append(found.mean)
        line += f" SKD, {name} {found.mean:.3f} {found.plain_interval} m of {found.values.size} pairs;"
    return f"{line} ratio {means[1] / means[0]:.3f}"


def summary(results: list[dict[str, Any]]) -> dict[str, tuple[int, int]]:
    """Print the figures of one C, and return for each parameter how many intervals there are and how many hold."""
    right, low, half = (
        100.0 * float(np.mean(found))
        for found in (
            [result["family"] == "distance" for result in results],
            [result["p_value"] < 0.05 for result in results],
            [result["p_value"] < 0.5 for result in results],
        )
    )
    print(
        f"C = {results[0]['multiplier']:<6g} {len(results)} probes; right family {right:.0f} %; "
        f"p < 0.05: {low:.0f} %, p < 0.5: {half:.0f} %"
    )
    held = {}
    for name in NAMES:
        known = [result[name] for result in results if result[name] is not None]
        errors = 100.0 * np.abs([one["error"] for one in known])
        below, above = (sum(one[side] for one in known) for side in ("below", "above"))
        held[name] = len(known), len(known) - below - above
        print(
            f"  {name:<20} median |error| {np.median(errors):6.3f} %, largest {errors.max():6.3f} %, "
            f"within {100 * WITHIN[name]:g} %: {100 * np.mean(errors <= 100 * WITHIN[name]):.0f} %, "
            f"coverage {100 * held[name][1] / len(known):.0f} % (truth below {below}, above {above}), "
            f"not identifiable {len(results) - len(known)}",
            flush=True,
        )
    return held


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repetitions", type=int, default=100)
    parser.add_argument("--episodes", type=int, default=1000, help="of a probe")
    parser.add_argument("--skd", action="store_true", help="compare kamikazes instead")
    parser.add_argument("--objective", choices=tuple(Objective), default="paper", help="of the kamikazes")
    parser.add_argument("--kamikaze-count", type=int, default=100, help="per safe trajectory, of five")
    parser.add_argument("--multipliers", type=float, nargs="+", default=list(PAPER_MULTIPLIERS))
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args()
    begin = time.perf_counter()
    if arguments.skd:
        with InProcessRunner(arguments.workers) as runner:
            for multiplier in arguments.multipliers:
                print(kamikazes(multiplier, arguments, runner), flush=True)
        return
    lines = []
    with multiprocessing.get_context("spawn").Pool(arguments.workers) as pool:
        for multiplier in arguments.multipliers:
            # Seeds of its own for each C: cars of the same seed draw the same noise, whatever their C.
            first = round(1000 * multiplier) * SEEDS_APART
            seeds = range(first, first + arguments.repetitions)
            lines.append(summary(pool.map(repetition, [(multiplier, seed, arguments.episodes) for seed in seeds], 2)))
    for name in NAMES:
        count, held = (sum(line[name][part] for line in lines) for part in (0, 1))
        low, high = (int(end) for end in stats.binom.interval(0.95, count, 0.95))
        print(
            f"all C: {name}: {held} of {count} intervals hold the truth "
            f"(of intervals that hold with 95 %, {low} to {high} do in 95 % of the cases)"
        )
    print(f"{time.perf_counter() - begin:.0f} s")


if __name__ == "__main__":
    main()
