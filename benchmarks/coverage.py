"""How often the 95 % intervals of an assessment hold what they speak of, and whether the stopping rule does.

Real campaigns of many φ are the populations:

    for c in 0.75 1 1.15; do
        scripts/skd assess --multiplier $c --seed 2 --safe-count 60 --collision-runs 12000 --out populations/$c
    done
    .venv/bin/python benchmarks/coverage.py populations/{0.75,1,1.15}

A simulated campaign draws φ from a population with replacement, and trials, pairs and runs from those of each φ. What
an interval has to hold is the population's own figure. *By φ* is the default interval of the terminal; *Student's* is
the t interval over φ means; *as independent* the paper's over pairs, the normal one over trials, Wilson's over runs.
The stopping rule is that of `--until-width`, with widths that are reached early and late; *looked at naively* stops by
ordinary 95 % intervals.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from skd_evaluator.assessment.files.results import StoredResult, read_result
from skd_evaluator.assessment.stages.kamikazes import LOOKS
from skd_evaluator.metrics.clustered import DISTANCES, PREFIXES, clustered_mean, clustered_rate, variance_components
from skd_evaluator.metrics.frechet import warped_distance
from skd_evaluator.metrics.sample_size import expected_width, narrow_enough, nominal_confidence
from skd_evaluator.metrics.skd import bound_interval
from skd_evaluator.metrics.statistics import frechet_probability_bound, normal_interval, wilson_interval
from skd_sim.options.car_and_adversary import RANKING_OBJECTIVES, first_of
from skd_sim.world.state import FloatArray
from tally import Tally

PRIORS = {"deviation": DISTANCES, "skd": DISTANCES, "skd_prefix": PREFIXES, "warped": PREFIXES}
RATES = ("deviation_success_rate", "kamikaze_success_rate", "contact_rate")
SIZES = ((5, 100), (10, 100), (20, 100), (10, 50), (20, 25))
BOUND_ETA = 0.5
BATCH, TRIALS = 5, 100
SHARES = (0.75, 0.5, 0.35)
"""Widths to stop at, of the one expected of a single batch."""


def drawn(groups: Sequence[FloatArray], chosen: FloatArray, count: int, rng: np.random.Generator) -> list[FloatArray]:
    """Return values of the groups chosen, `count` of each, drawn with replacement."""
    return [groups[index][rng.integers(len(groups[index]), size=count)] for index in chosen.tolist()]


def warped_distances(result: StoredResult) -> list[FloatArray]:
    """Return the time-warped distance of each pair of the kamikazes that rank the car, by φ, m."""
    episodes, objective = result.episodes, first_of(RANKING_OBJECTIVES, result.figures["objectives"])
    of_it = episodes.hit & (episodes.objective == objective)
    found = []
    for index, phi in enumerate(episodes.safe):
        psis = [
            episodes.until_contact(int(number)) for number in np.flatnonzero(of_it & (episodes.safe_index == index))
        ]
        found.append(np.array([warped_distance(phi[: len(psi)], psi) for psi in psis]))
    return found


def population_mean(groups: Sequence[FloatArray]) -> float:
    """Return what a campaign estimates: every φ counts as much as any other."""
    return float(np.mean([group.mean() for group in groups]))


def population_bound(groups: Sequence[FloatArray]) -> float:
    """Return Theorem 1's bound of the population, every φ counting alike."""
    centre, square = population_mean(groups), population_mean([group**2 for group in groups])
    return frechet_probability_bound(BOUND_ETA, centre, square - centre**2)


def coverage(result: StoredResult, campaigns: int, seed: int) -> Iterator[tuple[Any, Any, Tally]]:
    """Yield, by population and figure, and by size of the campaign and kind of interval, how often it holds."""
    groups: dict[str, Sequence[FloatArray]] = {**result.groups, "warped": warped_distances(result)}
    truths = {name: population_mean(groups[name]) for name in (*PRIORS, *RATES)}
    bound = population_bound(groups["skd"]) if truths["skd"] > BOUND_ETA else None
    for safe, trials in SIZES:
        rng = np.random.default_rng(np.random.SeedSequence((seed, safe, trials)))
        kinds = ("by φ", "Student's", "as independent")
        tallies = {(name, kind): Tally() for name in (*truths, "bound") for kind in kinds}
        for _ in range(campaigns):
            chosen = rng.integers(len(result.safe), size=safe)
            for name, known in PRIORS.items():
                sample = drawn(groups[name], chosen, trials, rng)
                for kind, prior in (("by φ", known), ("Student's", None)):
                    found = clustered_mean(sample, prior=prior)
                    tallies[name, kind].add(truths[name], found.interval if found else None)
                tallies[name, "as independent"].add(truths[name], normal_interval(np.concatenate(sample)))
                if name == "skd" and bound is not None:
                    tallies["bound", "by φ"].add(bound, bound_interval(sample, BOUND_ETA))
            for name in RATES:
                counts = [(int(one.sum()), trials) for one in drawn(groups[name], chosen, trials, rng)]
                rate = clustered_rate(counts)
                tallies[name, "by φ"].add(truths[name], rate.interval if rate else None)
                hits = sum(hit for hit, _ in counts)
                tallies[name, "as independent"].add(truths[name], wilson_interval(hits, safe * trials))
        for (name, kind), tally in tallies.items():
            if tally.count:
                truth = bound if name == "bound" else truths[name]
                yield (result.folder.name, name, truth), ((safe, trials), kind), tally


def stopping(result: StoredResult, campaigns: int, seed: int) -> None:
    """Print, for each width to stop at and each rule, how often the interval at which it stopped holds."""
    groups = result.groups["deviation"]
    truth, parts = population_mean(groups), variance_components(groups)
    single = expected_width(parts.between or 0.0, parts.within or 0.0, BATCH, TRIALS, prior=DISTANCES)
    for share in SHARES:
        wanted = share * single
        for rule, confidence in (("repeated intervals", nominal_confidence(LOOKS)), ("looked at naively", 0.95)):
            rng = np.random.default_rng(np.random.SeedSequence((seed, round(100 * share))))
            tally, used, reached = Tally(), 0, 0
            for _ in range(campaigns):
                sample: list[FloatArray] = []
                for _look in range(LOOKS):
                    chosen = rng.integers(len(groups), size=BATCH)
                    sample += drawn(groups, chosen, TRIALS, rng)
                    found = clustered_mean(sample, confidence, prior=DISTANCES)
                    if narrow_enough(found, wanted):
                        reached += 1
                        break
                tally.add(truth, found.interval if found else None)
                used += len(sample)
            print(
                f"| {result.folder.name} | {wanted:.3f} | {rule} | {tally} | {used / campaigns:.1f} "
                f"| {100 * reached / campaigns:.0f} % |"
            )


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("paths", type=Path, nargs="+", metavar="DIR", help="assessment of many φ")
    parser.add_argument("--campaigns", type=int, default=1000, metavar="N", help="simulated, of each size")
    parser.add_argument("--seed", type=int, default=0, metavar="N")
    arguments = parser.parse_args()
    results = [read_result(path) for path in arguments.paths]
    table: dict[Any, dict[Any, Tally]] = {}
    for result in results:
        for population, kind, tally in coverage(result, arguments.campaigns, arguments.seed):
            table.setdefault(population, {})[kind] = tally
    heads = " | ".join(f"{safe} × {trials}" for safe, trials in SIZES)
    others = [(SIZES[0], kind) for kind in ("Student's", "as independent")]
    last = " | ".join(f"{kind}, {size[0]} × {size[1]}" for size, kind in others)
    print(f"| population | figure | truth | {heads} | {last} |\n" + "|---" * (5 + len(SIZES)) + "|")
    for (name, figure, truth), line in table.items():
        cells = [str(line.get(kind, "–")) for kind in (*((size, "by φ") for size in SIZES), *others)]
        print(f"| {name} | {figure} | {truth:.4f} | {' | '.join(cells)} |")
    print("\n| population | requested width (m) | rule | held (width) | φ, mean | reached |\n" + "|---" * 6 + "|")
    for result in results:
        stopping(result, arguments.campaigns, arguments.seed)


if __name__ == "__main__":
    main()
