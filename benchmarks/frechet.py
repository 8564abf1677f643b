"""How long one discrete Fréchet distance takes, here and in the libraries a notebook would otherwise use.

All are timed in one run, in turn, on the same pair of random walks in the plane; a library that is not
installed is reported as such. The batch measures many curves against one and counts per pair.

    python benchmarks/frechet.py [--json]
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Callable

import numpy as np
from skd_evaluator.frechet import discrete_frechet, discrete_frechet_pairs

_SIZES = (40, 1000)
_BATCH = 96  # pairs that share one reference
_ROUNDS = 5
_SECONDS_A_ROUND = 0.25  # per library and size; a slow call is made once a round
_OURS = "skd, one pair"

Timed = tuple[Callable[[], float], int]  # a call, and how many pairs it measures


def _candidates(p: np.ndarray, q: np.ndarray) -> dict[str, Timed | None]:
    """Return what to time; None where the library is missing."""
    many = [q] * _BATCH
    candidates: dict[str, Timed | None] = {
        _OURS: (lambda: discrete_frechet(p, q), 1),
        f"skd, batch of {_BATCH}": (lambda: float(discrete_frechet_pairs(p, many)[-1]), _BATCH),
    }
    try:
        import shapely

        a, b = shapely.LineString(p), shapely.LineString(q)
        candidates["shapely"] = (lambda: float(shapely.frechet_distance(a, b)), 1)
    except ImportError:
        candidates["shapely"] = None
    try:
        from similaritymeasures import frechet_dist

        candidates["similaritymeasures"] = (lambda: float(frechet_dist(p, q)), 1)
    except ImportError:
        candidates["similaritymeasures"] = None
    try:
        from curvesimilarities import dfd

        candidates["curvesimilarities"] = (lambda: float(dfd(p, q)), 1)
    except ImportError:
        candidates["curvesimilarities"] = None
    return candidates


def _measure(size: int) -> dict[str, float | None]:
    """Return µs a pair, the best of all rounds; None where not installed."""
    rng = np.random.default_rng(size)
    p, q = (np.cumsum(rng.normal(size=(size, 2)), axis=0) for _ in range(2))
    candidates = _candidates(p, q)
    present = {name: timed for name, timed in candidates.items() if timed is not None}
    expected = discrete_frechet(p, q)
    repetitions = {}
    best: dict[str, float | None] = dict.fromkeys(candidates)
    for name, (call, _) in present.items():
        value = call()  # compiles, too
        if not math.isclose(value, expected, rel_tol=1e-12):
            raise SystemExit(f"{name} gives {value} for {size} points, not {expected}")
        started = time.perf_counter()
        call()
        repetitions[name] = max(1, int(_SECONDS_A_ROUND / (time.perf_counter() - started)))
    for _ in range(_ROUNDS):
        for name, (call, pairs) in present.items():
            started = time.perf_counter()
            for _ in range(repetitions[name]):
                call()
            micros = 1e6 * (time.perf_counter() - started) / (repetitions[name] * pairs)
            before = best[name]
            best[name] = micros if before is None else min(before, micros)
    return best


def main() -> None:
    """Measure, and print a table or JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true", help="print JSON: size → library → µs a pair")
    arguments = parser.parse_args()
    results = {size: _measure(size) for size in _SIZES}
    if arguments.json:
        print(json.dumps(results, indent=2))
        return
    print("Discrete Fréchet distance, µs a pair, and how many times as long as one pair here")
    print(f"{'':22}" + "".join(f"{f'{size} × {size}':>26}" for size in _SIZES))
    for name in results[_SIZES[0]]:
        row = f"{name:22}"
        for size in _SIZES:
            micros, ours = results[size][name], results[size][_OURS]
            if micros is None or ours is None:
                row += f"{'not installed':>26}"
            else:
                row += f"{micros:14.2f}{f'({micros / ours:.2f}×)':>12}"
        print(row)


if __name__ == "__main__":
    main()
