"""How often the intervals of `skd fuse` hold the physical car's mean, and how much narrower than by trials alone.

    nice .venv/bin/python benchmarks/fusion_trials.py --out fusion_trials.npz
    nice .venv/bin/python benchmarks/fusion.py --trials fusion_trials.npz

Every repetition draws simulated φ, physical trials on the first of them, and asks for the figure that stands: with the
simulator where the test says that it predicts, else by the physical trials alone. What an interval has to hold is the
population's own mean. The pairs are normal; skewed (gamma, of skewness 1 and 2, and log-normal, both sides, residuals
as well); cut off at 0, as clearances are; clustered by φ, with 3 trials on each, or unequally, with 1 to 6 trials; both
skewed (gamma, skewness 2) and unequally clustered; and those of `fusion_trials.py`, φ drawn with replacement.
*Looks* stop at the first of 4 looks, each after as many further trials, at which the interval
is as narrow as it is on average at the third, or at the last.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from fusion_trials import FIGURES as PLAYED
from skd_evaluator.extensions.fusion.fusion import FusedFigure, fused_figure
from skd_evaluator.extensions.fusion.trials import FIGURES, Pairs, TrialFigure
from skd_evaluator.metrics.sample_size import nominal_confidence
from skd_sim.errors import UsageError
from skd_sim.world.state import FloatArray

Draw = Callable[[np.random.Generator, int, int], tuple[FloatArray, list[FloatArray]]]
"""Given a generator, N and n: simulated figures of N φ, and physical figures of the first n, per φ."""
CORRELATIONS = (0.0, 0.3, 0.5, 0.8, 0.9)
TRIALS = (10, 20, 40)
SIMULATED = 2000
LOOKS = 4
KINDS = (
    "normal", "gamma 1", "gamma 2", "log-normal", "cut off", "clustered", "clustered unequally", "clustered gamma 2"
)  # fmt: skip
_PLAIN = TrialFigure("clearance", "figure", "m", math.inf)


def shaped(kind: str, rho: float) -> tuple[Draw, float]:
    """Return how pairs of a kind are drawn, and the mean that they have."""

    def of(rng: np.random.Generator, count: int) -> tuple[FloatArray, FloatArray]:
        if "gamma" in kind:
            shape = 4.0 / float(kind.split()[-1]) ** 2
            one, other = (rng.gamma(shape, size=count) / math.sqrt(shape) - math.sqrt(shape) for _ in range(2))
            return one, rho * one + math.sqrt(1.0 - rho**2) * other
        one, other = rng.standard_normal((2, count))
        pair = one, rho * one + math.sqrt(1.0 - rho**2) * other
        if kind == "log-normal":
            return np.exp(0.5 * pair[0]), np.exp(0.5 * pair[1])
        if kind == "cut off":
            return np.maximum(0.0, pair[0] + 0.5), np.maximum(0.0, pair[1] + 0.5)
        return pair

    def draw(rng: np.random.Generator, simulated: int, trials: int) -> tuple[FloatArray, list[FloatArray]]:
        x, y = of(rng, simulated)
        if kind.startswith("clustered"):  # half of what the simulator does not know is of the φ, half of its trials
            half, left = math.sqrt(0.5), y - rho * x
            counts = np.full(trials, 3) if kind == "clustered" else rng.integers(1, 7, trials)
            scale = math.sqrt(0.5 * (1.0 - rho**2) / float(np.mean(1.0 / counts)))
            return x, [
                rho * x[number] + half * left[number] + scale * rng.standard_normal(count)
                for number, count in enumerate(counts.tolist())
            ]
        return x, [y[number : number + 1] for number in range(trials)]

    density = math.exp(-0.125) / math.sqrt(2.0 * math.pi)
    means = {"log-normal": math.exp(0.125), "cut off": 0.25 * (1.0 + math.erf(0.5 / math.sqrt(2.0))) + density}
    return draw, means.get(kind, 0.0)


def played(figures: FloatArray) -> tuple[Draw, float]:
    """Return how φ of the multi-body car are drawn, with replacement, and the mean of its physical trials."""
    simulated, physical = figures[0].mean(axis=1), figures[1]

    def draw(rng: np.random.Generator, count: int, trials: int) -> tuple[FloatArray, list[FloatArray]]:
        chosen = rng.integers(len(simulated), size=count)
        runs = rng.integers(physical.shape[1], size=trials)
        return simulated[chosen], [physical[chosen[number], run : run + 1] for number, run in enumerate(runs.tolist())]

    return draw, float(physical.mean())


def asked(x: FloatArray, groups: list[FloatArray], figure: TrialFigure, confidence: float = 0.95) -> FusedFigure | None:
    """Return the figure; None where nothing is said."""
    count, every = len(groups), np.concatenate(groups)
    if not figure.is_rate and np.ptp(every) == 0.0:
        return None
    predicted = np.repeat(x[:count], [len(one) for one in groups])
    means = np.array([one.mean() for one in groups])
    names = tuple(map(str, range(count)))
    pairs = Pairs(names, tuple(groups), means, x[:count], x, every, predicted, True, x)
    try:
        return fused_figure(figure, pairs, confidence)
    except UsageError:
        return None


def coverage(draw: Draw, truth: float, figure: TrialFigure, repetitions: int, seed: int) -> Iterator[dict[str, Any]]:
    """Yield for each number of trials how often intervals hold, and their widths."""
    for trials in TRIALS:
        rng = np.random.default_rng((seed, trials))
        found = [asked(*draw(rng, SIMULATED, trials), figure) for _ in range(repetitions)]
        said = [one for one in found if one is not None]
        if not said:
            yield {"trials": trials, "said": 0.0}
            continue
        alone, stands = np.mean([one.alone.width for one in said]), np.mean([one.stands.width for one in said])
        both = [one.with_simulator.width for one in said if one.with_simulator is not None]
        yield {
            "trials": trials,
            "said": len(said) / repetitions,
            "correlation": float(np.mean([one.line.correlation or 0.0 for one in said])),
            "alone_held": share(truth, said, lambda one: one.alone.interval),
            "held": share(truth, said, lambda one: one.stands.interval),
            "predicts": float(np.mean([one.predicts for one in said])),
            "narrower": float(alone / stands),
            "narrower_always": float(alone / np.mean(both)) if len(both) == len(said) else None,
            "saved": float(np.median([one.saved for one in said])),
        }


def share(truth: float, found: list[FusedFigure], interval: Callable[[FusedFigure], tuple[float, float]]) -> float:
    """Return how often an interval holds the truth."""
    return float(np.mean([low <= truth <= high for low, high in map(interval, found)]))


def stopping(rho: float, repetitions: int, seed: int) -> Iterator[tuple[str, float, float]]:
    """Yield, by both ways to look, how often the interval holds at which one stopped, and after how many trials."""
    draw, truth = shaped("normal", rho)
    rng = np.random.default_rng((seed, 1))
    tried = [asked(*draw(rng, SIMULATED, 24), _PLAIN) for _ in range(200)]
    typical = np.mean([one.stands.width for one in tried if one is not None])
    for rule, confidence in (("--looks", nominal_confidence(LOOKS)), ("looked at naively", 0.95)):
        rng, held, used = np.random.default_rng((seed, 2)), 0, 0
        for _ in range(repetitions):
            x, groups = draw(rng, SIMULATED, 8 * LOOKS)
            for look in range(1, LOOKS + 1):
                one = asked(x, groups[: 8 * look], _PLAIN, confidence)
                if one is None:
                    continue
                if one.stands.width <= typical or look == LOOKS:
                    held += one.stands.interval[0] <= truth <= one.stands.interval[1]
                    used += 8 * look
                    break
        yield rule, held / repetitions, used / repetitions


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=Path, metavar="FILE", help="of fusion_trials.py")
    parser.add_argument("--kinds", nargs="*", default=KINDS, choices=KINDS, metavar="KIND", help="of drawn pairs")
    parser.add_argument("--repetitions", type=int, default=1000, metavar="N")
    parser.add_argument("--seed", type=int, default=0, metavar="N")
    arguments = parser.parse_args()
    print("| pairs | ρ | n | held % (alone) | narrower | always | predicts % | saved | said % |\n" + "|---" * 9 + "|")
    for kind in arguments.kinds:
        for rho in CORRELATIONS:
            draw, truth = shaped(kind, rho)
            for row in coverage(draw, truth, _PLAIN, arguments.repetitions, arguments.seed):
                show({"pairs": kind, "rho": rho, **row})
    if arguments.trials:
        with np.load(arguments.trials) as populations:
            for name in populations.files:
                for place, key in enumerate(PLAYED):
                    draw, truth = played(populations[name][..., place])
                    figure = FIGURES[key] if FIGURES[key].is_rate else replace(_PLAIN, wrong=FIGURES[key].wrong)
                    for row in coverage(draw, truth, figure, arguments.repetitions, arguments.seed):
                        show({"pairs": f"{name}: {key}", **row})
    print("\n| rule | ρ | held % | trials, mean |\n|---|---|---|---|")
    for rho in (0.0, 0.8):
        for rule, held, trials in stopping(rho, arguments.repetitions, arguments.seed):
            print(f"| {rule} | {rho} | {100 * held:.1f} | {trials:.1f} |")


def show(row: dict[str, Any]) -> None:
    """Print a line of the first table."""
    if not row["said"]:
        print(f"| {row['pairs']} | | {row['trials']} | nothing is said | | | | | 0 |", flush=True)
        return
    always = "–" if row["narrower_always"] is None else f"{row['narrower_always']:.2f}"
    print(
        f"| {row['pairs']} | {row.get('rho', row['correlation']):.2f} | {row['trials']} | {100 * row['held']:.1f} "
        f"({100 * row['alone_held']:.1f}) | {row['narrower']:.2f} | {always} | {100 * row['predicts']:.0f} | "
        f"{row['saved']:.0f} | {100 * row['said']:.0f} |",
        flush=True,
    )


if __name__ == "__main__":
    main()
