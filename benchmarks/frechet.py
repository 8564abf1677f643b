"""How long one discrete Fréchet distance takes, here and in the libraries a notebook would otherwise use.

All are timed in one run, in turn, on one core, in processor time, and the median of the turns counts. shapely's time
depends on the curves, so there are several kinds, from those that it is fastest on to random walks. Each batch is
many curves of one length against one reference; slow libraries get the first pairs of it. Every value must agree to
1e-12 with ours, or there is no result. A library that is not installed is reported as such.

    python benchmarks/frechet.py
"""

from __future__ import annotations

import argparse
import importlib
import math
import os
import statistics
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from skd_evaluator.metrics.frechet import discrete_frechet, discrete_frechet_pairs

_SIZES = (40, 1000)
_BATCH = {40: 192, 1000: 16}  # pairs that share one reference
_ROUNDS = 5
_SECONDS_A_TURN = 0.1  # per library, kind and size; a slow call is made once a turn
_BATCHED, _ONE = "skd, batch", "skd, one pair"
_LIBRARIES = {
    "shapely": "frechet_distance", "similaritymeasures": "frechet_dist", "curvesimilarities": "dfd",
    "traj_dist.distance": "discret_frechet",
}  # fmt: skip
_TOLERANCE = 1e-12

Timed = tuple[Callable[[], Any], int]  # a call, and how many pairs it measures


def _parallel(rng: np.random.Generator, size: int, count: int) -> np.ndarray:
    """Straight crossings beside one another, nothing else: the first links are as long as the longest."""
    along = np.linspace(0.0, 12.0, size)
    offsets = rng.uniform(-2.0, 2.0, size=(count, 1))
    return np.stack([np.broadcast_to(along, (count, size)), np.broadcast_to(offsets, (count, size))], axis=2)


def _noisy(rng: np.random.Generator, size: int, count: int) -> np.ndarray:
    """Straight crossings beside one another, with noise of a sixth of the spacing."""
    curves = _parallel(rng, size, count)
    return curves + rng.normal(size=curves.shape) * (12.0 / (size - 1) / 6.0)


def _swaying(rng: np.random.Generator, size: int, count: int) -> np.ndarray:
    """Crossings that sway smoothly to the side."""
    along = np.linspace(0.0, 1.0, size)
    sway, phase = rng.normal(size=(count, 1)) * 0.5, rng.uniform(0.0, 2.0 * math.pi, size=(count, 1))
    return np.stack([np.broadcast_to(12.0 * along, (count, size)), sway * np.sin(3.0 * along + phase)], axis=2)


def _walks(rng: np.random.Generator, size: int, count: int) -> np.ndarray:
    """Random walks."""
    return np.cumsum(rng.normal(size=(count, size, 2)), axis=1)


_KINDS = {"parallel lines": _parallel, "noisy lines": _noisy, "swaying lines": _swaying, "random walks": _walks}


def _curves(kind: str, size: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a reference, size × 2, and others, count × size × 2."""
    curves = _KINDS[kind](np.random.default_rng(size), size, count + 1)
    return curves[0].copy(), curves[1:].copy()


def _candidates(kind: str, p: np.ndarray, others: np.ndarray) -> dict[str, Timed | None]:
    """Return what to time; None where the library is missing."""
    candidates: dict[str, Timed | None] = {
        _BATCHED: (lambda: discrete_frechet_pairs(p, others), len(others)),
        _ONE: (lambda: [discrete_frechet(p, q) for q in others], len(others)),
    }
    # All geometry of shapely is made beforehand, and one call measures all pairs: its fastest use. Long random walks
    # take it a second each, so that two of them must do. The time of the others does not depend on the curves.
    some = others[:2] if kind == "random walks" and len(p) > 100 else others
    few = others[: 8 if len(p) < 100 else 1]
    for module, name in _LIBRARIES.items():
        try:
            call = getattr(importlib.import_module(module), name)
        except ImportError:
            candidates[module] = None
            continue
        if module == "shapely":
            lines = [np.array([_line(curve) for curve in curves]) for curves in ([p] * len(some), some)]
            candidates[module] = (partial(call, *lines), len(some))
        else:
            candidates[module] = (lambda call=call: [call(p, q) for q in few], len(few))
    return candidates


def _line(curve: np.ndarray) -> Any:
    return importlib.import_module("shapely").LineString(curve)


def _medians(timed: dict[str, Timed]) -> dict[str, float]:
    """Return µs a pair: the median over rounds in which each has its turn."""
    repetitions = {}
    for name, (call, _) in timed.items():
        call()  # compiles, too
        started = time.thread_time()
        call()
        repetitions[name] = max(1, int(_SECONDS_A_TURN / (time.thread_time() - started)))
    turns: dict[str, list[float]] = {name: [] for name in timed}
    for _ in range(_ROUNDS):
        for name, (call, pairs) in timed.items():
            started = time.thread_time()
            for _ in range(repetitions[name]):
                call()
            turns[name].append(1e6 * (time.thread_time() - started) / (repetitions[name] * pairs))
    return {name: statistics.median(values) for name, values in turns.items()}


def _compare(kind: str, size: int) -> dict[str, float | None]:
    """Return µs a pair; None where not installed."""
    p, others = _curves(kind, size, _BATCH[size])
    candidates = _candidates(kind, p, others)
    present = {name: timed for name, timed in candidates.items() if timed is not None}
    expected = discrete_frechet_pairs(p, others)
    for name, (call, pairs) in present.items():
        if not np.allclose(call(), expected[:pairs], rtol=_TOLERANCE, atol=0.0):
            raise SystemExit(f"{name} differs by more than {_TOLERANCE} for {kind} of {size} points")
    medians = _medians(present)
    return {name: medians.get(name) for name in candidates}


def _fastest_library(row: dict[str, float | None]) -> tuple[str, float] | None:
    others = {name: micros for name, micros in row.items() if micros is not None and not name.startswith("skd")}
    name = min(others, key=others.__getitem__, default=None)
    return None if name is None else (name, others[name])


def _print_comparison(size: int, rows: dict[str, dict[str, float | None]]) -> None:
    print(f"\nDiscrete Fréchet distance, {size} × {size} points, µs of processor time a pair, one core")
    print(f"{'':22}" + "".join(f"{kind:>17}" for kind in rows))
    for name in next(iter(rows.values())):
        values = [row[name] for row in rows.values()]
        print(f"{name:22}" + "".join(f"{'not installed' if v is None else f'{v:.2f}':>17}" for v in values))
    for ours in (_BATCHED, _ONE):
        line = f"{'× ' + ours:22}"
        for row in rows.values():
            fastest, micros = _fastest_library(row), row[ours]
            line += f"{'' if fastest is None or not micros else f'{fastest[1] / micros:.1f}':>17}"
        print(line)
    print(
        "×: how many times as long the fastest library takes: "
        + ", ".join(f"{fastest[0]} ({kind})" for kind, row in rows.items() if (fastest := _fastest_library(row)))
    )


def main() -> None:
    """Measure, and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.parse_args()
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    for size in _SIZES:
        _print_comparison(size, {kind: _compare(kind, size) for kind in _KINDS})


if __name__ == "__main__":
    main()
