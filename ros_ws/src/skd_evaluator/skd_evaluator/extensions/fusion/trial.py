"""One trial, played by the physical car or simulated: on which φ, with which timing, and its figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from skd_sim.arrays import FloatArray
from skd_sim.scenario.road import right_and_along
from skd_sim.scenario.scenario import Scenario

from skd_evaluator.metrics.surrogate.braking import greatest_required_deceleration
from skd_evaluator.metrics.surrogate.clearance import least_clearance
from skd_evaluator.metrics.surrogate.episode import GRID
from skd_evaluator.metrics.surrogate.scene import Scene
from skd_evaluator.metrics.surrogate.scenes import Scenes


@dataclass(frozen=True)
class PhysicalTrial:
    """One trial.

    Attributes:
        phi: name of the φ that the adversary was to walk.
        values: by key of `figures.FIGURES`.
        gap: timing: how far the car's front was before the crossing line when φ began, m; None where it is not known.
        where: file and line, for messages.
        seen_hit: whether the car hits by its recording, whatever the table says; None without a recording.
        track: where car and road user were from the beginning of φ to its end, or to the contact, by the recording,
            n × 4, m; None without one.
    """

    phi: str
    values: Mapping[str, float] = field(default_factory=dict)
    gap: float | None = None
    where: str = ""
    seen_hit: bool | None = None
    track: FloatArray | None = field(default=None, repr=False, compare=False)


def figures_of(scene: Scene, *, hit: bool) -> dict[str, float]:
    """Return the figures of a trial by what happened in it."""
    return {
        "clearance": least_clearance(scene),
        "required_deceleration": greatest_required_deceleration(Scenes.of(scene).every(GRID).whole),
        "hit": float(hit),
    }


def gap_to_crossing(scenario: Scenario, car: FloatArray) -> float:
    """Return how far the front of a car (reference point (x, y), m) is before the crossing line, m."""
    along = right_and_along(scenario.road.line, car[None, :2].copy())[0, 1]
    return float(-along - scenario.car.front)
