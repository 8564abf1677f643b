"""Whether a behaviour model holds for people whom it has not seen: it is fitted without some and compared on these."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from skd_sim.arrays import FloatArray

from skd_evaluator.metrics.behaviour.walking import normals_of
from skd_evaluator.risk.behaviour.fit import LEAST_TRACKS, fit_behaviour, simulated
from skd_evaluator.risk.behaviour.residuals import HORIZONS, QUANTILES, padded, quantile_table
from skd_evaluator.risk.behaviour.tracks import TIME_STEP, Tracked

FOLDS: Final = 4
WITHIN: Final = 0.2
"""Of the recorded quantiles, within which a model counts as holding."""
_COPIES = 32  # simulated persons for each one held out
_SEED = 712


@dataclass(frozen=True, eq=False)
class Validation:
    """Quantiles of the residual of constant velocity of people held out, as recorded and as predicted for them.

    Attributes:
        recorded: horizons × quantiles, m.
        predicted: the same by models that were fitted without them, m.
        by: what was held out together: `recording` or `person`.
        folds: number of parts that were held out, one after the other.
        example: some simulated tracks, by the last model.
    """

    recorded: FloatArray
    predicted: FloatArray
    by: str
    folds: int
    example: FloatArray

    @property
    def worst(self) -> float:
        """Greatest relative difference of a quantile."""
        return float(np.max(np.abs(self.predicted / self.recorded - 1.0)))

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain data."""
        rows = [
            {"horizon": horizon, "quantile": quantile, "recorded": float(mine), "predicted": float(theirs)}
            for horizon, ours, others in zip(HORIZONS, self.recorded, self.predicted, strict=True)
            for quantile, mine, theirs in zip(QUANTILES, ours, others, strict=True)
        ]
        return {"held_out_by": self.by, "folds": self.folds, "worst": self.worst, "residuals": rows}


def folds_of(tracks: Sequence[Tracked]) -> tuple[str, list[int]]:
    """Return by what tracks are held out, and for each of them in which fold; recordings take turns."""
    recordings = sorted({one.recording for one in tracks})
    if len(recordings) < 2:
        return "person", [number % min(FOLDS, len(tracks)) for number in range(len(tracks))]
    fold = {name: number % min(FOLDS, len(recordings)) for number, name in enumerate(recordings)}
    return "recording", [fold[one.recording] for one in tracks]


def validate(tracks: Sequence[Tracked], progress: Callable[[int, int], None] = lambda _done, _of: None) -> Validation:
    """Fit a model without each part of the tracks in turn, and compare its prediction with that part.

    Raises:
        ValueError: too few tracks are left without one part.
    """
    by, folds = folds_of(tracks)
    count = max(folds) + 1
    predicted: list[FloatArray] = []
    example = np.empty((0, 0, 2))
    for number in range(count):
        kept = [one.positions for one, fold in zip(tracks, folds, strict=True) if fold != number]
        if len(kept) < LEAST_TRACKS:
            raise ValueError(f"{len(kept)} tracks are left when a {by} is held out; {LEAST_TRACKS} are needed")
        lengths = [len(one.positions) for one, fold in zip(tracks, folds, strict=True) if fold == number]
        fit = fit_behaviour(kept, TIME_STEP, intervals=False)
        rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(_SEED, spawn_key=(number,))))
        normals = rng.standard_normal((_COPIES * len(lengths), normals_of(max(lengths) - 1)))
        example = simulated(fit.values, lengths * _COPIES, fit.speed, TIME_STEP, normals)
        predicted += [way[np.isfinite(way[:, 0])] for way in example]
        progress(number + 1, count)
    recorded = quantile_table(padded([one.positions for one in tracks]), TIME_STEP)
    return Validation(recorded, quantile_table(padded(predicted), TIME_STEP), by, count, example)
