"""Whether `skd fit` is right: the basic car at the paper's nine C, many independent probes of each.

Per C: relative error of the trigger distance and of the noise levels, how often the 95 % intervals hold the true
values, how often the right family is chosen, and the Kolmogorov-Smirnov test of the probability integral transform on
held-out ticks (calibrated: 5 % of the p-values below 0.05).

    python benchmarks/car_fit.py [--repetitions 100] [--episodes 500] [--workers 2] [--multipliers C ...] [--json]
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import time
from typing import Any

import numpy as np
from skd_adversary.car_fit import Recording, fit_car, observe
from skd_evaluator.probe import probe_episodes
from skd_evaluator.runner import run_episode
from skd_sim.controllers import PAPER_MULTIPLIERS
from skd_sim.scenario import load_scenario

NAMES = ("trigger", "deceleration", "deceleration_noise", "speed_noise")


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
    data = observe([Recording(log.pedestrian, log.car, scenario.time_step, car.front, car.rear) for log in logs])
    fitted = fit_car(data)
    found: dict[str, Any] = {"multiplier": multiplier, "seed": seed, "family": fitted.chosen}
    found["p_value"] = fitted.calibration.p_value if fitted.calibration else None
    for name, true in truth.items():
        parameter = fitted.parameters[name]
        if parameter.estimate is None or parameter.interval is None:
            found[name] = None
            continue
        low, high = parameter.interval
        found[name] = {"error": parameter.estimate / true - 1.0, "covered": low <= true <= high}
    return found


def summary(results: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the figures of one C."""
    line: dict[str, Any] = {
        "multiplier": results[0]["multiplier"],
        "repetitions": len(results),
        "right_family": float(np.mean([result["family"] == "distance" for result in results])),
        "p_below_0.05": float(np.mean([result["p_value"] < 0.05 for result in results])),
        "p_below_0.5": float(np.mean([result["p_value"] < 0.5 for result in results])),
    }
    for name in NAMES:
        known = [result[name] for result in results if result[name] is not None]
        errors = np.abs([one["error"] for one in known])
        line[name] = {
            "not_identifiable": len(results) - len(known),
            "median_error": float(np.median(errors)),
            "largest_error": float(errors.max()),
            "coverage": float(np.mean([one["covered"] for one in known])),
        }
    return line


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repetitions", type=int, default=100)
    parser.add_argument("--episodes", type=int, default=500, help="of a probe")
    parser.add_argument("--multipliers", type=float, nargs="+", default=list(PAPER_MULTIPLIERS))
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    begin = time.perf_counter()
    lines = []
    with multiprocessing.get_context("spawn").Pool(arguments.workers) as pool:
        for multiplier in arguments.multipliers:
            tasks = [(multiplier, seed, arguments.episodes) for seed in range(arguments.repetitions)]
            lines.append(summary(pool.map(repetition, tasks, chunksize=2)))
            if not arguments.json:
                _print(lines[-1])
    if arguments.json:
        print(json.dumps({"lines": lines, "seconds": time.perf_counter() - begin}, indent=2))
    else:
        print(f"{time.perf_counter() - begin:.0f} s")


def _print(line: dict[str, Any]) -> None:
    print(
        f"C = {line['multiplier']:<6g} {line['repetitions']} probes; right family {100 * line['right_family']:.0f} %; "
        f"p < 0.05: {100 * line['p_below_0.05']:.0f} %, p < 0.5: {100 * line['p_below_0.5']:.0f} %"
    )
    for name in NAMES:
        one = line[name]
        print(
            f"  {name:<20} median |error| {100 * one['median_error']:6.3f} %, "
            f"largest {100 * one['largest_error']:6.3f} %, "
            f"coverage {100 * one['coverage']:.0f} %, not identifiable {one['not_identifiable']}",
            flush=True,
        )


if __name__ == "__main__":
    main()
