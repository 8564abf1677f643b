"""All surrogate safety measures of episodes: one number each, and over time."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
import numpy.typing as npt
from skd_sim.arrays import FloatArray
from skd_sim.scenario.scenario import Scenario

from skd_evaluator.metrics.surrogate.braking import MOST, brake_threat_numbers, headways, required_decelerations
from skd_evaluator.metrics.surrogate.clearance import clearances, least_clearances
from skd_evaluator.metrics.surrogate.collision_time import collision_times, path_collision_times
from skd_evaluator.metrics.surrogate.encroachment import post_encroachment_times
from skd_evaluator.metrics.surrogate.impact import closing_speeds, fatality_risk, greater_delta_v
from skd_evaluator.metrics.surrogate.scenes import Course, Scenes, scenes_of

GRID = 0.05
"""s between the moments of measures over time, and of their extremes."""
ON_FOOT = ("pedestrian", "runner", "child")
"""Kinds of whom the risk of a fatality is known."""


@dataclass(frozen=True)
class SurrogateMeasure:
    """A surrogate safety measure of an episode.

    Attributes:
        label: what it is called where people read it.
        unit: of its values; empty: none.
        worst: which of several values is the worst, `min` or `max`.
    """

    label: str
    unit: str
    worst: str


SURROGATE_MEASURES = {
    "clearance": SurrogateMeasure("least clearance", "m", "min"),
    "time_to_collision": SurrogateMeasure("least time to collision", "s", "min"),
    "post_encroachment_time": SurrogateMeasure("post-encroachment time", "s", "min"),
    "required_deceleration": SurrogateMeasure("greatest required deceleration", "m/s²", "max"),
    "brake_threat_number": SurrogateMeasure("greatest brake threat number", "", "max"),
    "headway": SurrogateMeasure("least time headway", "s", "min"),
    "closing_speed": SurrogateMeasure("closing speed", "m/s", "max"),
    "delta_v": SurrogateMeasure("ΔV of whom it changes more", "m/s", "max"),
    "fatality_risk": SurrogateMeasure("risk of a fatality", "", "max"),
}
"""By their names in results."""

_AT_ONCE = 1000  # episodes: each takes ten kilobytes while it is measured


def surrogate_measures(
    scenario: Scenario, courses: Iterable[Course], collided: npt.NDArray[np.bool_]
) -> dict[str, FloatArray]:
    """Return every surrogate safety measure of episodes, by name, k each; nan: not defined, or it never came about.

    Args:
        scenario: road, shapes, kind of the adversary, and the deceleration that the car has.
        courses: how the episodes went, k; as many as are looked at together are in memory at once.
        collided: whether car and adversary touched at the end of each.
    """
    waiting, parts, done = iter(courses), [dict.fromkeys(SURROGATE_MEASURES, np.empty(0))], 0
    while some := list(islice(waiting, _AT_ONCE)):
        whole = scenes_of(scenario, some)
        parts.append(_measures(scenario, whole, whole.every(GRID), collided[done : done + len(some)]))
        done += len(some)
    return {name: np.concatenate([one[name] for one in parts]) for name in SURROGATE_MEASURES}


def _measures(
    scenario: Scenario, whole: Scenes, grid: Scenes, collided: npt.NDArray[np.bool_]
) -> dict[str, FloatArray]:
    """Return the measures of scenes, given as they are and on the grid."""
    braking = np.minimum(MOST, grid.most(required_decelerations(grid.whole)))
    closing = np.where(collided, whole.at_end(closing_speeds(whole.whole)), math.nan)
    kind = scenario.adversary.kind
    on_foot = kind in ON_FOOT

    def of_contact(value: Any) -> FloatArray:
        return np.array([value(one) if math.isfinite(one) else math.nan for one in closing.tolist()], np.float64)

    # At a contact rounding would decide whether it is one.
    found = {
        "clearance": np.where(collided, 0.0, least_clearances(whole)),
        "time_to_collision": np.where(collided, 0.0, grid.least(collision_times(grid.whole))),
        "post_encroachment_time": np.where(collided, 0.0, post_encroachment_times(whole)),
        "required_deceleration": braking,
        "brake_threat_number": braking / scenario.car.deceleration,
        "headway": grid.least(headways(grid.whole)),
        "closing_speed": closing,
        "delta_v": of_contact(lambda one: greater_delta_v(one, kind)),
        "fatality_risk": of_contact(lambda one: fatality_risk(one).value if on_foot else math.nan),
    }
    return {name: np.where(np.isfinite(found[name]), found[name], math.nan) for name in SURROGATE_MEASURES}


def episode_measures(scenario: Scenario, course: Course, phi: FloatArray, *, collided: bool) -> dict[str, Any]:
    """Return the measures of an episode, as plain data: None for what is not defined, or never came about.

    Args:
        scenario: road, shapes, kind of the adversary, and the deceleration that the car has.
        course: how the episode went.
        phi: φ at ticks, m, along which the adversary is predicted to go on.
        collided: whether car and adversary touched at its end.
    """
    whole = scenes_of(scenario, [course])
    grid = whole.every(GRID)
    found = _measures(scenario, whole, grid, np.array([collided]))
    scene = grid.whole
    over = {
        "clearance": clearances(scene),
        "time_to_collision": collision_times(scene),
        "path_time_to_collision": path_collision_times(scene, scenario, phi),
        "required_deceleration": required_decelerations(scene),
        "brake_threat_number": brake_threat_numbers(scene, scenario.car.deceleration),
        "headway": headways(scene),
    }
    plain = {name: _plain(float(values[0])) for name, values in found.items()}
    risk = None if plain["fatality_risk"] is None else fatality_risk(float(found["closing_speed"][0]))
    return {
        **plain,
        "path_time_to_collision": _plain(float(over["path_time_to_collision"].min())),
        "fatality_risk_interval": risk and list(risk.interval),
        "over_time": {
            "time": np.round(scene.times, 6).tolist(),
            **{name: [_plain(value) for value in values.tolist()] for name, values in over.items()},
        },
    }


def _plain(value: float) -> float | None:
    return value if math.isfinite(value) else None
