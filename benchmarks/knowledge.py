"""What planned kamikazes come to, by what they know of the car, beside the margin, which does not depend on that.

Each car is assessed as a user would, with each knowledge: `nothing`, `learned`, `itself` and `itself` told the car's
true state; the basic car with `known`, too. Per assessment: margin, planned deformation over all attempts (one without
a hit by the moving car counts as η_max), closeness = planned / margin with its interval, the share of attempts that
hit, and seconds. Of a learned car also the Kolmogorov-Smirnov distance of held-out ticks, over all and near the car.
At the end, per car, by how much the greatest margin exceeds the least.

    python benchmarks/knowledge.py [--cars LABEL ...] [--safe DIR] [--seed N] [--workers N] [--json FILE]

Cars are labels of `cars/catalogue.py`; by default one of each of eight families.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from cars.catalogue import CARS, Car, available

EIGHT = (
    "time to collision",
    "latched and delayed",
    "slows near anybody",
    "Intelligent Driver Model",
    "required deceleration",
    "encroachment",
    "CAL",
    "basic, C = 1",
)
KINDS = {
    "nothing": ("--knowledge", "nothing"),
    "learned": ("--knowledge", "learned"),
    "itself": ("--knowledge", "itself"),
    "itself, told": ("--knowledge", "itself", "--told"),
    "known": ("--knowledge", "known"),
}
RECORDED = "citr_crossing"
"""Scenario whose car is the one that recorded pedestrians met."""


def assessed(car: Car, kind: str, arguments: argparse.Namespace) -> dict[str, Any]:
    """Assess a car with a knowledge; return assessment.json, or why there is none."""
    scenario = car.scenario_name if arguments.safe is None else RECORDED
    words = ["--controller", car.controller, "--multiplier", str(car.multiplier), "--scenario", scenario]
    words += ["--safe-count", str(arguments.safe_count), "--kamikaze-count", str(arguments.kamikaze_count)]
    words += ["--collision-runs", "20", "--seed", str(arguments.seed), "--workers", str(arguments.workers)]
    if arguments.safe is not None:
        words += ["--safe", str(arguments.safe)]
    here = Path(__file__).resolve().parent
    searched = [str(here), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(searched)}
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "skd_evaluator", "assess", *words, *KINDS[kind], "--out", folder + "/out"]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            return {"error": done.stderr.strip().splitlines()[-1]}
        found: dict[str, Any] = json.loads(Path(folder, "out", "assessment.json").read_text())
    return found


def row(found: dict[str, Any]) -> dict[str, Any]:
    """Return the figures of an assessment that are of interest here."""
    if "error" in found:
        return found
    shown = {
        "margin": found["margin"],
        "converged": found["margin_converged"],
        "planned": found["deformation"],
        "closeness": found["closeness"],
        "closeness_ci95": found["closeness_ci95"],
        "success_rate": found["deformation_success_rate"],
        "seconds": found["seconds"],
    }
    predictions = (found["car_model"] or {}).get("predictions") or ()
    return {**shown, "predictions": [dict(one) for one in predictions]}


def say(kind: str, one: dict[str, Any]) -> None:
    """Print one row of the table."""
    if "error" in one:
        print(f"  {kind:13} {one['error']}", flush=True)
        return
    low, high = one["closeness_ci95"] or (math.nan, math.nan)
    told = "; ".join(
        f"{each['model']}: {each['statistic']:.3f} over all, {each['near_statistic']:.3f} near"
        for each in one["predictions"]
    )
    print(
        f"  {kind:13} margin {one['margin']:.3f}{'' if one['converged'] else ' (not converged)'}, planned "
        f"{one['planned']:.3f}, closeness {one['closeness'] or math.nan:.2f} [{low:.2f}, {high:.2f}], hits "
        f"{one['success_rate']:.0%}, {one['seconds']:.0f} s{'; ' + told if told else ''}",
        flush=True,
    )


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cars", nargs="+", default=list(EIGHT), choices=[car.label for car in CARS], metavar="LABEL")
    parser.add_argument("--kinds", nargs="+", default=[kind for kind in KINDS if kind != "known"], choices=list(KINDS))
    parser.add_argument("--safe", type=Path, metavar="DIR", help="recorded safe trajectories")
    parser.add_argument("--safe-count", type=int, default=10, metavar="N")
    parser.add_argument("--kamikaze-count", type=int, default=5, metavar="N")
    parser.add_argument("--seed", type=int, default=0, metavar="N")
    parser.add_argument("--workers", type=int, default=2, metavar="N")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there as well")
    arguments = parser.parse_args()
    arguments.safe = arguments.safe and arguments.safe.resolve()
    everything: dict[str, dict[str, Any]] = {}
    for car in available([car for car in CARS if car.label in arguments.cars])[0]:
        print(car.label, flush=True)
        kinds = [*arguments.kinds, *(["known"] if car.is_basic else [])]
        rows = everything[car.label] = {}
        for kind in kinds:
            rows[kind] = row(assessed(car, kind, arguments))
            say(kind, rows[kind])
        margins = [one["margin"] for one in rows.values() if "error" not in one]
        if len(margins) > 1 and min(margins) > 0.0:
            print(f"  margins differ by {max(margins) / min(margins) - 1.0:.1%} at most", flush=True)
        if arguments.json:
            arguments.json.write_text(json.dumps(everything, indent=2) + "\n")


if __name__ == "__main__":
    main()
