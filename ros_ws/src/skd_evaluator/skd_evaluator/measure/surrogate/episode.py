"""All surrogate safety measures of one episode: over time, and one number each."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.encounter.scenario import Scenario

from skd_evaluator.measure.surrogate.braking import brake_threat_numbers, headways, required_decelerations
from skd_evaluator.measure.surrogate.clearance import clearances, least_clearance
from skd_evaluator.measure.surrogate.collision_time import collision_times, path_collision_times
from skd_evaluator.measure.surrogate.encroachment import post_encroachment_time
from skd_evaluator.measure.surrogate.impact import closing_speed, fatality_risk
from skd_evaluator.measure.surrogate.scene import Scene, scene_of

GRID = 0.05
"""s between the moments of measures over time."""
ON_FOOT = ("pedestrian", "child")
"""Kinds of whom the risk of a fatality is known."""


def episode_measures(
    scenario: Scenario, times: FloatArray, adversary: FloatArray, car: FloatArray, phi: FloatArray, *, collided: bool
) -> dict[str, Any]:
    """Return the measures of an episode, as plain data: None for what is not defined, or never came about.

    Args:
        scenario: road, shapes, and the deceleration that the car has.
        times: ticks, and at the end the contact, if there is one, s.
        adversary: n × 2 positions then, m.
        car: n × 3: reference point (x, y), m, and speed, m/s.
        phi: φ at ticks, m, along which the adversary is predicted to go on.
        collided: whether it ended in a contact.
    """
    whole = scene_of(scenario, times, adversary, car)
    scene = whole.every(GRID)
    over = {
        "clearance": clearances(scene),
        "collision_time": collision_times(scene),
        "path_collision_time": path_collision_times(scene, scenario, phi),
        "required_deceleration": required_decelerations(scene),
        "brake_threat_number": brake_threat_numbers(scene, scenario.car.deceleration),
        "headway": headways(scene),
    }
    largest = ("required_deceleration", "brake_threat_number")
    extremes = {name: float(values.max() if name in largest else values.min()) for name, values in over.items()}
    extremes["clearance"] = 0.0 if collided else least_clearance(whole)
    closing = closing_speed(whole) if collided else math.nan
    on_foot = collided and scenario.adversary.kind in ON_FOOT
    risk = fatality_risk(closing) if on_foot else None
    return {
        **{name: _plain(value) for name, value in extremes.items()},
        "post_encroachment_time": _plain(_encroachment(whole)),
        "closing_speed": _plain(closing),
        "fatality_risk": risk and risk.value,
        "fatality_risk_interval": risk and list(risk.interval),
        "over_time": {
            "time": np.round(scene.times, 6).tolist(),
            **{name: [_plain(value) for value in values.tolist()] for name, values in over.items()},
        },
    }


def _encroachment(scene: Scene) -> float:
    try:
        return post_encroachment_time(scene)
    except ValueError:  # on a curve
        return math.nan


def _plain(value: float) -> float | None:
    return value if math.isfinite(value) else None
