"""What the page draws episodes on: road, car, adversary and others of a scenario, and φ."""

from __future__ import annotations

from typing import Any

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.scenario.road import right_and_along, road_pose
from skd_sim.scenario.scenario import Scenario

from skd_evaluator.report.html.subjects import Subject

_STRAIGHT, _CURVED = 60.0, 80.0  # m of the lane to each side of the crossing
_DIGITS = 2
"""Of what is drawn in m: as many as ways have, so that who is on φ is drawn on it."""


def scene(subject: Subject) -> dict[str, Any]:
    """Return road (edges of its lanes and arrows on them, m), car, adversary, others and φ of a subject."""
    scenario = subject.scenario
    length = _STRAIGHT if scenario.road.straight else _CURVED
    radius, half_length, half_width = scenario.adversary.shape
    names = [str(row["name"]) for row in subject.figures["per_safe_trajectory"]]
    return {
        "lanes": [[_rounded(edge) for edge in edges] for edges in scenario.road.surfaces(-length, length)],
        "arrows": [_rounded(arrow) for arrow in scenario.road.arrows(-length, length)],
        "obstacles": [_rounded(one.corners) for one in scenario.obstacles],
        "others": [_other(scenario, index) for index in range(len(scenario.others))],
        "car": {"front": scenario.car.front, "rear": scenario.car.rear, "half": scenario.car.half_width},
        "user": {"radius": radius, "halfLength": half_length, "halfWidth": half_width},
        "timeStep": subject.episodes.time_step,
        "safe": [
            {"name": name, "points": _rounded(phi)} for name, phi in zip(names, subject.episodes.safe, strict=True)
        ],
    }


def _other(scenario: Scenario, index: int) -> dict[str, Any]:
    """Return shape, places (m) and headings (rad) at ticks of one of the others; one place of one that stands."""
    other = scenario.others[index]
    radius, half_length, half_width = other.shape
    states = [scenario.others_at(tick)[index] for tick in range(1 if other.stands else scenario.ticks + 1)]
    return {
        "radius": radius,
        "halfLength": half_length,
        "halfWidth": half_width,
        "points": _rounded(np.array([state[:2] for state in states])),
        "headings": [round(state.heading, 3) for state in states],
    }


def margin_ways(subject: Subject, most: int) -> list[list[dict[str, Any]]]:
    """Return per φ the ways of the margin, the least first, at most so many: points at ticks, m, and their figures."""
    if not subject.episodes.margin_ways:
        return [[] for _ in subject.episodes.safe]
    return [
        [
            {
                "points": _rounded(way.trajectory.positions),
                "deviation": round(way.distance, 3),
                "impactSpeed": round(way.impact_speed, 2),
                "trial": trial,
            }
            for trial, way in sorted(
                ((k, one) for k, one in enumerate(ways) if one is not None),
                key=lambda pair: (pair[1].distance, pair[0]),
            )[:most]
        ]
        for ways in subject.episodes.margin_ways
    ]


def headings(scenario: Scenario, car: FloatArray) -> FloatArray:
    """Return where the car points (rad) at positions of it (n × 2 or more, m): as the lane does there."""
    line = scenario.road.line
    along = right_and_along(line, np.ascontiguousarray(car[:, :2]))[:, 1]
    return np.array([road_pose(line, float(s))[2] for s in along])


def _rounded(points: FloatArray) -> list[list[float]]:
    return [[round(float(x), _DIGITS), round(float(y), _DIGITS)] for x, y in points]
