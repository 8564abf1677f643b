"""How often the 95 % intervals of a behaviour model's parameters hold those that people were simulated with.

Each repetition simulates 64 people, as many and as long as those of CITR's vci_lat_uni, by the shipped model `walkers`,
and fits a model to them as `skd behaviour fit` does.

    python benchmarks/behaviour_recovery.py [--repetitions 200] [--workers 2] [--json]
"""

from __future__ import annotations

import argparse
import json

import numpy as np
from skd_evaluator.campaign.run.workers import InProcessRunner, available_workers
from skd_evaluator.measure.behaviour.model import NAMES, load_behaviour
from skd_evaluator.measure.behaviour.walking import normals_of
from skd_evaluator.measure.statistics.statistics import wilson_interval
from skd_evaluator.risk.behaviour.fit import FITTED, fit_behaviour, simulated

LENGTHS = [length for length in (19, 22, 21, 19, 25, 31, 33, 35) for _ in range(8)]
"""Places of each of the 64 recorded tracks."""
SPEED, TIME_STEP = 1.22, 0.3


def repeated(number: int) -> tuple[list[float], list[tuple[float, float]]]:
    """Simulate people and fit a model to them; return its parameters and intervals, in the order of `FITTED`."""
    rng = np.random.default_rng(np.random.SeedSequence(64, spawn_key=(number,)))
    chance = rng.standard_normal((len(LENGTHS), normals_of(max(LENGTHS) - 1)))
    ways = simulated(load_behaviour("walkers").values, LENGTHS, SPEED, TIME_STEP, chance)
    fit = fit_behaviour([way[np.isfinite(way[:, 0])] for way in ways], TIME_STEP)
    return [float(fit.values[NAMES.index(name)]) for name in FITTED], [fit.intervals[name] for name in FITTED]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repetitions", type=int, default=200)
    parser.add_argument("--workers", type=int, default=available_workers())
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    truth = load_behaviour("walkers").values
    with InProcessRunner(arguments.workers) as runner:
        found = list(runner.map(repeated, range(arguments.repetitions)))
    rows = []
    for place, name in enumerate(FITTED):
        true = float(truth[NAMES.index(name)])
        values = np.array([one[place] for one, _ in found])
        held = sum(ends[place][0] <= true <= ends[place][1] for _, ends in found)
        rows.append(
            {
                "parameter": name,
                "truth": true,
                "mean": float(values.mean()),
                "deviation": float(values.std(ddof=1)) if len(values) > 1 else None,
                "held": held,
                "held_ci95": wilson_interval(held, len(found)),
            }
        )
    if arguments.json:
        print(json.dumps({"repetitions": len(found), "parameters": rows}, indent=2))
        return
    for row in rows:
        low, high = row["held_ci95"]
        print(
            f"{row['parameter']:16} {row['truth']:7.4f}, found {row['mean']:7.4f} ± {row['deviation'] or 0.0:.4f}; "
            f"intervals hold {row['held']} of {len(found)} [{100 * low:.0f}, {100 * high:.0f}] %"
        )


if __name__ == "__main__":
    main()
