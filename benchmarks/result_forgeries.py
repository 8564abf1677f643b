"""Ways to forge a result so that its files agree with each other; see `result_mutations.py`.

An array of episodes.npz is changed, and all figures are computed anew of it; or something that nothing is computed of.
"""

from __future__ import annotations

import itertools
import json
import math
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from result_selections import SELECTIONS, Arrays, keep_episodes
from skd_evaluator.campaign.store.rebuilt import rebuilt, recompute
from skd_evaluator.campaign.store.result_file import read_figures
from skd_evaluator.campaign.store.stored_episodes import read_episodes
from skd_evaluator.measure.distances.deformation import deformation


def _rows(arrays: Arrays, mode: int | None = None) -> np.ndarray:
    return np.flatnonzero(arrays["mode"] != 0 if mode is None else arrays["mode"] == mode)


def _margin_beyond(arrays: Arrays, draw: random.Random) -> None:
    row = draw.choice(range(len(arrays["margin"])))
    arrays["margin"][row] = math.inf


def _margin_way(arrays: Arrays, draw: random.Random) -> None:
    rows = np.flatnonzero(np.isfinite(arrays["margin"])).tolist()
    if not rows:
        return
    row, spans = draw.choice(rows), arrays["offsets"]
    low, high = arrays["margin_offsets"][row : row + 2]
    arrays["margin_positions"][low + 1 : high] += [0.0, draw.choice([1e-4, 0.01, 0.1, -0.1])]
    phi = [arrays["positions"][a:b] for a, b in itertools.pairwise(spans)][arrays["margin_safe_index"][row]]
    arrays["margin"][row] = deformation(phi, arrays["margin_positions"][low:high], arrays["margin_duration"][row])


def _margin_attempts(arrays: Arrays, _draw: random.Random) -> None:
    kept = arrays["margin_attempt"] < arrays["margin_attempt"].max()
    lengths = np.diff(arrays["margin_offsets"])
    arrays["margin_positions"] = arrays["margin_positions"][np.repeat(kept, lengths)]
    arrays["margin_offsets"] = np.cumsum([0, *lengths[kept]])
    for name in ("", "_gap", "_safe_index", "_attempt", "_duration", "_impact_speed"):
        arrays[f"margin{name}"] = arrays[f"margin{name}"][kept]


def _margin_speed(arrays: Arrays, draw: random.Random) -> None:
    arrays["margin_impact_speed"] *= draw.choice([0.5, 0.99])


def _crossings(arrays: Arrays, draw: random.Random) -> None:
    """Call hits in crossings of the risk touches by the flank, or nothing."""
    if "risk_touch" not in arrays:  # nobody knows how a cyclist's ways vary
        return
    touches = arrays["risk_touch"]
    hits = np.flatnonzero(touches == 1)
    touches[draw.sample(hits.tolist(), min(len(hits), draw.choice([1, 3])))] = draw.choice([0, 2])


def _clipped(arrays: Arrays, _draw: random.Random) -> None:
    arrays["clipped"][_rows(arrays)] = 3


def _runs_fewer(arrays: Arrays, draw: random.Random) -> None:
    """Leave out the last episode along a φ, or all of them that collided."""
    drop = _rows(arrays, 2)[-1:]
    if draw.random() < 0.5:
        drop = np.array([row for row in _rows(arrays, 2) if arrays["outcome"][row] == 1], np.int64)
    keep_episodes(arrays, np.setdiff1d(np.arange(len(arrays["mode"])), drop))


ARRAYS: dict[str, Callable[[Arrays, random.Random], None]] = {
    "margin beyond": _margin_beyond,
    "margin's way": _margin_way,
    "margin's attempts": _margin_attempts,
    "margin's speeds": _margin_speed,
    "crossings": _crossings,
    "clipped": _clipped,
    "runs left out": _runs_fewer,
}


def mutate_consistently(folder: Path, draw: random.Random) -> str:
    """Change an array, and write all figures anew that follow from it."""
    kind = draw.choice(sorted(ARRAYS))
    arrays = _arrays(folder)
    ARRAYS[kind](arrays, draw)
    return _written(folder, arrays, f"consistent {kind}")


def mutate_selection(folder: Path, draw: random.Random) -> str:
    """Choose what the result is of, and write all figures anew that follow from it."""
    kind = draw.choice(sorted(SELECTIONS))
    arrays, said = _arrays(folder), json.loads((folder / "assessment.json").read_text())
    SELECTIONS[kind](arrays, said, draw)
    (folder / "assessment.json").write_text(json.dumps(said))
    return _written(folder, arrays, f"selection {kind}")


def _arrays(folder: Path) -> Arrays:
    with np.load(folder / "episodes.npz") as file:
        return {name: file[name].copy() for name in file.files}


def _written(folder: Path, arrays: Arrays, what: str) -> str:
    """Write arrays, and all figures that follow from them; return what was done."""
    np.savez(folder / "episodes.npz", **arrays)
    try:
        figures, _ = read_figures(folder)
        stored = read_episodes(folder)
        rating = rebuilt(figures, stored)
        wrong = {one.name.partition(".")[0] for one in recompute(figures, stored).contradict}
    except Exception as error:  # what the reader refuses need not be written any further
        return f"{what}: {type(error).__name__}"
    given = json.loads(json.dumps(rating.as_dict()))
    said = json.loads((folder / "assessment.json").read_text())
    said |= {name: given[name] for name in wrong if name in given}
    (folder / "assessment.json").write_text(json.dumps(said))
    with (folder / "surrogate_measures.csv").open("w", encoding="utf-8", newline="") as table:
        rating.surrogates.write_csv(table)
    return f"{what}: figures anew"


def _equivalent(figures: dict[str, Any], _draw: random.Random) -> None:
    figures["equivalent_multiplier"] = 2.0
    figures["equivalent_multiplier_text"] = "2.000"


def _parameter(figures: dict[str, Any], draw: random.Random) -> None:
    if figures.get("risk"):
        parameters = figures["risk"]["behaviour"]["parameters"]
        parameters[draw.choice(sorted(parameters))]["value"] *= draw.choice([0.5, 1.01])


SAYINGS: dict[str, Callable[[dict[str, Any], random.Random], object]] = {
    "a warning": lambda figures, _: figures["warnings"].append("do not believe these figures: nothing"),
    "the warnings": lambda figures, _: figures["warnings"].clear(),
    "what was left out": lambda figures, _: figures["left_out"].clear(),
    "provenance": lambda figures, _: figures["provenance"].update(command="skd assess --seed 1"),
    "the car": lambda figures, _: figures.update(controller="carla", multiplier=None),
    "converged": lambda figures, _: figures.update(margin_converged=not figures["margin_converged"]),
    "budget": lambda figures, _: figures.update(margin_budget=10**6),
    "C": _equivalent,
    "behaviour": _parameter,
    "static tests": lambda figures, _: figures.update(static_tests=[]),
    "seconds": lambda figures, _: figures.update(seconds=0.5),
}


def mutate_sayings(folder: Path, draw: random.Random) -> str:
    """Change what nothing is computed of."""
    kind = draw.choice(sorted(SAYINGS))
    path = folder / "assessment.json"
    figures = json.loads(path.read_text())
    SAYINGS[kind](figures, draw)
    path.write_text(json.dumps(figures))
    return f"said {kind}: changed"
