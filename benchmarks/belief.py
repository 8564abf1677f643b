"""Does the belief find a C that it does not know? Error of the posterior mean against steps, and calibration.

C is drawn from the adversary's own prior for a car of which nothing is known; the adversary stays at the kerb while
the real car (with its acceleration noise, which the belief does not model) comes, brakes and stops or passes.
Calibration: the share of runs in which the true C lies below the posterior's q-quantile should be q. The distance of
those shares from q (Kolmogorov-Smirnov) is up to 1.36/√runs by chance in 95 % of cases.

    python benchmarks/belief.py [--runs N] [--particles N] [--picture FILE] [--json]
"""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats
from skd_adversary.model.car.basic import CarModel, unknown_car
from skd_adversary.model.composer import compose
from skd_adversary.model.crossing import TRIGGER
from skd_adversary.model.objective.paper import OBJECTIVE
from skd_adversary.model.road_user.pedestrian import STAY
from skd_adversary.planning.belief import ParticleBelief
from skd_evaluator import palette
from skd_sim.arrays import FloatArray
from skd_sim.controllers import BasicController
from skd_sim.encounter.scenario import load_scenario
from skd_sim.episode.randomness import Role, generator
from skd_sim.simulation.world import World

_STEPS = 14
_SHOWN = (2, 6, 10, 14)


def _run(car_model: CarModel, particles: int, run: int) -> tuple[FloatArray, FloatArray]:
    """Return, for each step, the error of the posterior mean of C and the true C's quantile in the posterior."""
    scenario = load_scenario("crossing")
    adversary, kappa = scenario.adversary, scenario.car.safe_distance
    draw = generator(0, run, Role.CONTROLLER)
    truth = car_model.multiplier_low + (car_model.multiplier_high - car_model.multiplier_low) * draw.random()
    start = (adversary.start_x, adversary.start_y)
    model = compose(scenario, OBJECTIVE, car_model, start=start, gap=scenario.car.start_gap, path=np.array([start]))
    world = World(scenario, start_rng=generator(0, run, Role.START), car_rng=generator(0, run, Role.CAR))
    controller = BasicController(truth)
    controller.reset(scenario, draw)
    sensor = generator(0, run, Role.SENSOR)
    belief = ParticleBelief(model, particles, generator(0, run, Role.PLANNER))
    errors, ranks = np.empty(_STEPS), np.empty(_STEPS)
    for step in range(_STEPS):
        dx, dy = world.car.x - start[0], world.car.y - start[1]
        seen = dy if car_model.observes_position else math.hypot(dx, dy)
        noise = adversary.position_noise if car_model.observes_position else adversary.distance_noise
        if step:
            belief.predict(STAY)
        belief.correct(STAY, np.array([seen + noise * sensor.standard_normal()]))
        believed = belief.particles[:, TRIGGER] / kappa
        errors[step] = belief.weights @ believed - truth
        ranks[step] = belief.weights[believed < truth].sum()
        world.step(controller.command(world.car, world.adversary), (0.0, 0.0))
    return errors, ranks


def _measure(car_model: CarModel, particles: int, runs: int) -> dict[str, Any]:
    results = [_run(car_model, particles, run) for run in range(runs)]
    errors = np.array([errors for errors, _ in results])
    ranks = np.array([ranks for _, ranks in results])
    return {
        "mean_absolute_error": np.abs(errors).mean(axis=0).tolist(),
        "mean_absolute_error_se": (np.abs(errors).std(axis=0, ddof=1) / math.sqrt(runs)).tolist(),
        "bias": errors.mean(axis=0).tolist(),
        "kolmogorov_smirnov": [float(stats.kstest(ranks[:, step], "uniform").statistic) for step in range(_STEPS)],
        "ranks": {str(step): np.sort(ranks[:, step - 1]).tolist() for step in _SHOWN},
    }


def _save_picture(path: Path, results: dict[str, dict[str, Any]], runs: int) -> None:
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.5, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    for (name, result), colour, marker in zip(results.items(), palette.SERIES[:2], palette.MARKERS[:2], strict=True):
        steps = np.arange(1, _STEPS + 1)
        error = 1.96 * np.array(result["mean_absolute_error_se"])
        left.errorbar(
            steps,
            result["mean_absolute_error"],
            error,
            color=colour,
            marker=marker,
            ms=4,
            capsize=2,
            lw=1.3,
            label=name,
        )
    left.set_ylim(0.0)
    left.set_xlabel("observations")
    left.set_ylabel("mean |posterior mean of C − C|")
    left.set_title("(a) The belief finds C", loc="left", fontsize=10)
    left.grid(alpha=0.3)
    left.legend(frameon=False)
    expected = (np.arange(runs) + 0.5) / runs
    chance = 1.36 / math.sqrt(runs)
    right.fill_between([0, 1], [-chance, 1 - chance], [chance, 1 + chance], color="#dddddd", label="chance, 95 %")
    name, result = next(iter(results.items()))
    series = zip(result["ranks"].items(), palette.SERIES, palette.DASHES, strict=False)
    for (step, ranks), colour, dashes in series:
        right.plot(expected, ranks, lw=1.3, color=colour, dashes=dashes, label=f"after {step} observations")
    right.set_xlabel("share of runs")
    right.set_ylabel("quantile of the true C in the posterior")
    right.set_title(f"(b) Calibration, {name}", loc="left", fontsize=10)
    right.set_xlim(0, 1)
    right.set_ylim(0, 1)
    right.grid(alpha=0.3)
    right.legend(frameon=False)
    figure.savefig(path, dpi=150)


def main() -> None:
    """Measure, and print a table or JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=1000, metavar="N")
    parser.add_argument("--particles", type=int, default=1000, metavar="N")
    parser.add_argument("--picture", type=Path, metavar="FILE")
    parser.add_argument("--json", action="store_true", help="print JSON")
    arguments = parser.parse_args()
    unknown = unknown_car()
    models = {"sees the relative position": replace(unknown, observes_position=True), "sees the distance": unknown}
    results = {name: _measure(model, arguments.particles, arguments.runs) for name, model in models.items()}
    if arguments.picture is not None:
        _save_picture(arguments.picture, results, arguments.runs)
    if arguments.json:
        print(json.dumps(results))
        return
    chance = 1.36 / math.sqrt(arguments.runs)
    print(f"{arguments.runs} runs, {arguments.particles} particles; KS distance up to {chance:.3f} is chance")
    for name, result in results.items():
        print(f"{name}\n  observations   mean |error of C|     bias   KS distance")
        for step in range(_STEPS):
            print(
                f"  {step + 1:12d}   {result['mean_absolute_error'][step]:16.3f}   {result['bias'][step]:+6.3f}"
                f"   {result['kolmogorov_smirnov'][step]:11.3f}"
            )


if __name__ == "__main__":
    main()
