"""How good a hazard network is on labelled scenes: precision, recall, calibration."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from skd_sim.hazard.network import HazardNetwork
from skd_sim.hazard_training.scenes import Scenes

FloatArray = NDArray[np.float64]

BINS = 10


def scene_probabilities(network: HazardNetwork, scenes: Scenes) -> FloatArray:
    """Return the probability of a hazard at each moment, the greatest over the objects seen; 0 where none is."""
    greatest = np.zeros(len(scenes.course))
    np.maximum.at(greatest, scenes.moment, network.probability(scenes.features))
    return greatest


def _share(part: NDArray[np.bool_], whole: NDArray[np.bool_]) -> float | None:
    """Return which share of `whole` is in `part` too; none where there is nothing to share."""
    return float((part & whole).sum() / whole.sum()) if whole.any() else None


def detection(probabilities: FloatArray, scenes: Scenes, threshold: float) -> dict[str, float | int | None]:
    """Return precision and recall of "probability > threshold".

    Recall is over the visible adversaries: of those on a collision course within braking range, and of all that the
    label calls a hazard (the margin included). Precision is over all alarms, those for parked cars among them.
    """
    alarm = probabilities > threshold
    course, hazard = scenes.course & scenes.visible, scenes.hazard & scenes.visible
    return {
        "threshold": threshold,
        "alarms": int(alarm.sum()),
        "on_course": int(course.sum()),
        "on_course_detected": int((alarm & course).sum()),
        "recall": _share(alarm, course),
        "precision": _share(scenes.course, alarm),
        "recall_with_margin": _share(alarm, hazard),
        "precision_with_margin": _share(scenes.hazard, alarm),
    }


def calibration(probabilities: FloatArray, scenes: Scenes) -> dict[str, Any]:
    """Return Brier score, expected calibration error and the reliability table, over the visible adversaries.

    Each row of the table: lower and upper end of the bin, moments in it, mean probability, share of hazards.
    """
    chosen = scenes.visible
    p, y = probabilities[chosen], scenes.hazard[chosen].astype(float)
    index = np.minimum((p * BINS).astype(int), BINS - 1)
    table, error = [], 0.0
    for number in range(BINS):
        inside = index == number
        count = int(inside.sum())
        mean, share = (float(p[inside].mean()), float(y[inside].mean())) if count else (None, None)
        table.append([number / BINS, (number + 1) / BINS, count, mean, share])
        error += count / len(p) * abs(mean - share) if mean is not None and share is not None else 0.0
    return {"brier": float(np.mean((p - y) ** 2)), "expected_calibration_error": error, "reliability": table}
