"""What the margin's search says of cars, and what many times the effort still finds.

    python benchmarks/margin_search.py [--cars NAME ...] [--settings NAME ...] [--seeds N ...] [--out FILE]

A row for each car, setting and seed: the margin that the search says with the effort of an assessment, whether it has
converged, its candidates a trial, its interval's part for the search (the estimated excess, and its standard error),
and its processor time. Some of the trials, drawn at random, are then searched anew with so many times the candidates
that a trial had. "too high" is the mean of these trials over the mean of the least that is known then: 1
where nothing less was found. Basic cars, whose margins are exact, are left out. The last lines count.

Rows are kept in a file: what is there is not computed again, so the table can be made in parts.
"""

from __future__ import annotations

import argparse
import itertools
import json
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from cars.catalogue import CARS, Car
from cars.memory import MEMORY_CARS
from skd_evaluator.assessment.plan import Plan, runs_along
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages.kamikazes import with_steering
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories
from skd_evaluator.margin.search.rounds import one_by_one
from skd_evaluator.margin.search.search import DEEPER, IN_PROCESS, search_margins
from skd_evaluator.metrics.difference import difference
from skd_evaluator.metrics.margins import Margins
from skd_sim.errors import AssessmentError, UsageError
from skd_sim.world.episode import EpisodeSpec

COLUMNS = "car", "setting", "seed", "margin (m)", "converged", "budget", "excess (m)", "too high", "CPU (s)"
MOST = 65_535
SETTINGS = {
    "crossing": ("crossing", "synthetic", MOST),
    "walkers": ("crossing", "walkers", MOST),
    "cpna": ("cpna", "regulatory", 7),
    "cut_in": ("cut_in", "synthetic", MOST),
    "recorded": ("citr_crossing", "", MOST),
}
"""Scenario, φ, and how many there are at most; recorded ones are those of --recorded."""
SIGNIFICANT = 0.05
Row = dict[str, Any]


def episodes_of(car: Car, seed: int, safe: str, safe_count: int, trials: int) -> list[EpisodeSpec]:
    """Return so many trials of a car, equally many on each nominal trajectory."""
    each = max(1, trials // safe_count)
    plan = Plan(
        car.scenario,
        controller=car.controller,
        multiplier=car.multiplier,
        safe=safe,
        safe_count=safe_count,
        kamikaze_count=each,
        seed=seed,
    )
    with InProcessRunner() as runner:
        phi = safe_trajectories(plan, runner)
        return with_steering(plan, runner.run(runs_along(plan, phi))).trials(phi, each)


def row(episodes: Sequence[EpisodeSpec], safe_count: int, deep_trials: int, times: int) -> Row:
    """Return what is found of a car."""
    eta_max, each = episodes[0].scenario.eta_max, len(episodes) // safe_count
    begin = time.process_time()
    found = search_margins(episodes, {}, one_by_one)
    seconds = time.process_time() - begin
    hits = tuple(tuple(found.hits[at : at + each]) for at in range(0, len(episodes), each))
    said, excess = Margins(hits, eta_max, found.search), found.search.excess
    chosen = np.sort(np.random.default_rng(episodes[0].seed).permutation(len(episodes))[:deep_trials])
    limit = max(1, times * found.search.budget // DEEPER)  # so few trials are searched DEEPER times as deep
    effort = IN_PROCESS._replace(first=DEEPER * limit, limit=limit)
    more = search_margins([episodes[number] for number in chosen.tolist()], {}, one_by_one, effort)
    before = said.values[chosen]
    least = np.minimum(before, Margins((tuple(more.hits),), eta_max).values).mean()
    ratio = float(before.mean() / least) if least > 0.0 else 1.0
    low, high = said.ci95 or (0.0, eta_max)
    return {
        "margin": said.mean,
        "converged": found.search.converged,
        "budget": found.search.budget,
        "excess": None if excess is None else [excess.mean, excess.error],
        "too_high": ratio,
        "held": low <= said.mean / ratio <= high,
        "seconds": seconds,
        "phi": [group.tolist() for group in said.per_phi],
    }


def shown(one: Row) -> str:
    """Return a line of the table."""
    excess = "–" if one["excess"] is None else "{:.3f} ± {:.3f}".format(*one["excess"])
    converged = "yes" if one["converged"] else "no"
    return (
        f"| {one['car']} | {one['setting']} | {one['seed']} | {one['margin']:.3f} | {converged} | {one['budget']} | "
        f"{excess} | {one['too_high']:.3f} | {one['seconds']:.0f} |"
    )


def summary(rows: Sequence[Row]) -> list[str]:
    """Return lines that count."""
    lines = []
    for converged in (True, False):
        ratios = np.array([one["too_high"] for one in rows if one["converged"] == converged])
        if ratios.size:
            said = "converged" if converged else "not converged, so at most"
            lines.append(
                f"{said}: {ratios.size} rows, at most {100.0 * (ratios.max() - 1.0):.1f} % too high, "
                f"no more than 1 % in {(ratios <= 1.01).sum()}, no more than 3 % in {(ratios <= 1.03).sum()}"
            )
    lines.append(f"intervals hold what deeper search finds in {sum(one['held'] for one in rows)} of {len(rows)} rows")
    pairs = []
    for one, other in itertools.combinations([one for one in rows if one["converged"]], 2):
        if (one["car"], one["setting"]) == (other["car"], other["setting"]) and one["seed"] != other["seed"]:
            groups = [[np.array(group) for group in each["phi"]] for each in (one, other)]
            found = difference(*groups, paired=False)
            pairs += [found.p_value] if found is not None and found.p_value is not None else []
    if pairs:
        wrong = sum(p < SIGNIFICANT for p in pairs)
        lines.append(f"pairs of seeds of one car that differ significantly: {wrong} of {len(pairs)}")
    median, most = np.quantile([one["seconds"] for one in rows], (0.5, 0.9))
    lines.append(f"processor time: median {median:.0f} s, nine tenths {most:.0f} s")
    return lines


def main() -> None:
    """Print the table, row by row, as Markdown."""
    cars = {car.label: car for car in (*MEMORY_CARS, *CARS) if not car.is_basic}
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cars", nargs="+", default=list(cars), metavar="NAME", help="of the catalogue, or controller")
    parser.add_argument(
        "--settings", nargs="+", metavar="NAME", help="of these, or a scenario; default: that of the car"
    )
    parser.add_argument("--seeds", nargs="+", type=int, default=[0], metavar="N")
    parser.add_argument("--recorded", default="", metavar="DIR", help="CITR data of the setting recorded")
    parser.add_argument("--safe-count", type=int, default=20, metavar="N")
    parser.add_argument("--trials", type=int, default=500, metavar="N", help="in all (default 500)")
    parser.add_argument("--deep-trials", type=int, default=20, metavar="N", help="searched deeper, at most 20")
    parser.add_argument("--times", type=int, default=100, metavar="N", help="the candidates (default 100)")
    parser.add_argument("--out", type=Path, metavar="FILE", help="where rows are kept")
    arguments = parser.parse_args()
    kept = [json.loads(line) for line in arguments.out.open()] if arguments.out and arguments.out.exists() else []
    known = {one["key"]: one for one in kept}
    size = f"{arguments.trials} on {arguments.safe_count}, {arguments.deep_trials} × {arguments.times}"
    print("| " + " | ".join(COLUMNS) + " |", "|---" * len(COLUMNS) + "|", sep="\n", flush=True)
    rows: list[Row] = []
    failed = []
    for seed, label, name in itertools.product(arguments.seeds, arguments.cars, arguments.settings or [""]):
        car = cars.get(label, Car(label, label, label))
        setting = name or car.scenario_name
        scenario, safe, most = SETTINGS.get(setting, (setting, "synthetic", MOST))
        count = min(arguments.safe_count, most)
        key = f"{label}, {setting}, {seed}, {size}"
        try:
            if key not in known:
                other = replace(car, scenario_name=scenario)
                episodes = episodes_of(other, seed, safe or arguments.recorded, count, arguments.trials)
                one = row(episodes, count, arguments.deep_trials, arguments.times)
                known[key] = {"key": key, "car": label, "setting": setting, "seed": seed, **one}
                if arguments.out:
                    with arguments.out.open("a") as file:
                        file.write(json.dumps(known[key]) + "\n")
        except (AssessmentError, UsageError) as error:
            failed.append(f"{key}: {error}")
            continue
        rows.append(known[key])
        print(shown(known[key]), flush=True)
    print("", *(summary(rows) if rows else ()), *failed, sep="\n")


if __name__ == "__main__":
    main()
