"""Surrogate safety measures of episodes, one number each and over time.

**Clearance**: how far apart the outlines of the car and the other road user are, at every moment and at the least.
Between two moments the other's centre runs along a straight segment in the car's frame. The distance of two convex
bodies is convex along it, so the least one between two moments is found exactly by bisection of its course.

**Time to collision**: how soon two road users would touch if nothing changed.
J. C. Hayward, "Near-miss determination through use of a scale of danger", Highway Research Record 384, 1972: both keep
their velocities. The contact is that of their outlines, and exact.

**Braking**: how hard the car has to brake.

* Required deceleration (J. Jansson, Collision Avoidance Theory, Linköping 2005, section 5.3.5, of a road user that does
  not accelerate): the constant deceleration after which the gap ahead no longer closes when it is used up, w²/(2·gap),
  with w the speed at which it closes. It is 0 where the two would pass each other if both kept their velocities.
* Brake threat number (M. Brännström, J. Sjöberg and E. Coelingh, "A situation and threat assessment algorithm for a
  rear-end collision avoidance system", IEEE Intelligent Vehicles Symposium 2008): the required deceleration as a share
  of the one that the car has; above 1 braking alone no longer helps.
* Time headway (SAE J2944, section 8.1): how long the front takes to be where the rear of who is ahead is now.

**Post-encroachment time**: how long after one road user has left the place where their paths cross the other arrives.
B. L. Allen, B. T. Shin and P. J. Cooper, "Analysis of traffic conflicts and collisions", Transportation Research Record
667, 1978. The way of the car is the strip that its outline sweeps, that of the other what its outline takes while it
reaches into this strip; both as they went, and nothing is predicted. It is defined on a straight way of the car.

**Impact**: what a contact does to both.

* Closing speed: how fast the two come together at the contact, the amount of their relative velocity.
* Delta-v: how much each one's velocity changes where both go on together, as in a plastic impact without rotation:
  the closing speed by the other's share of the mass (S. M. Shelby, "Delta-V as a measure of traffic conflict severity",
  3rd International Conference on Road Safety and Simulation, 2011). Masses are those of the kinds of road user.
* Risk that a pedestrian dies: Q. Hussain, H. Feng, R. Grzebieta, T. Brijs and J. Olivier, "The relationship between
  impact speed and the probability of pedestrian fatality during a vehicle-pedestrian crash: a systematic review and
  meta-analysis", Accident Analysis and Prevention 129, 2019: odds that grow by 11 % a km/h (95 % interval 10 to 12 %)
  and a risk of one half at 59 km/h. The interval here is that of the growth alone, for the summary states none of the
  level; and people differ: the old die at lower speeds.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
import numpy.typing as npt
from skd_sim.kernels.compilation import kernel
from skd_sim.scenario.road_user import ROAD_USERS, Body
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.contact import first_touch
from skd_sim.world.state import FloatArray, IntArray

from skd_evaluator.metrics.surrogate_scenes import EpisodeMotion, Interaction, Interactions, scenes_of

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
    scenario: Scenario, courses: Iterable[EpisodeMotion], collided: npt.NDArray[np.bool_]
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
    scenario: Scenario, whole: Interactions, grid: Interactions, collided: npt.NDArray[np.bool_]
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
        "fatality_risk": of_contact(lambda one: fatality_risk(one) if on_foot else math.nan),
    }
    return {name: np.where(np.isfinite(found[name]), found[name], math.nan) for name in SURROGATE_MEASURES}


def episode_measures(scenario: Scenario, course: EpisodeMotion, *, collided: bool) -> dict[str, Any]:
    """Return the measures of an episode, as plain data: None for what is not defined, or never came about.

    Args:
        scenario: road, shapes, kind of the adversary, and the deceleration that the car has.
        course: how the episode went.
        collided: whether car and adversary touched at its end.
    """
    whole = scenes_of(scenario, [course])
    grid = whole.every(GRID)
    found = _measures(scenario, whole, grid, np.array([collided]))
    scene = grid.whole
    over = {
        "clearance": clearances(scene),
        "time_to_collision": collision_times(scene),
        "required_deceleration": required_decelerations(scene),
        "brake_threat_number": brake_threat_numbers(scene, scenario.car.deceleration),
        "headway": headways(scene),
    }
    plain = {name: _plain(float(values[0])) for name, values in found.items()}
    risks = [fatality_risk(float(found["closing_speed"][0]), odds) for odds in ODDS_INTERVAL]
    return {
        **plain,
        "fatality_risk_interval": None if plain["fatality_risk"] is None else sorted(risks),
        "over_time": {
            "time": np.round(scene.times, 6).tolist(),
            **{name: [_plain(value) for value in values.tolist()] for name, values in over.items()},
        },
    }


def _plain(value: float) -> float | None:
    return value if math.isfinite(value) else None


_SHRINK = 0.5 * (np.sqrt(5.0) - 1.0)  # golden section
_STEPS = 60  # of it: to 1e-12 of a segment


def clearances(scene: Interaction) -> FloatArray:
    """Return the distance between the outlines at each moment, n, m; 0 where they touch."""
    return _apart(scene, scene.seen, scene.turned_from_car)


def clearance_at(scenario: Scenario, car: Sequence[float], body: Body, place: Sequence[float], heading: float) -> float:
    """Return the distance between the outlines of the car and a road user at one moment, m; 0 where they touch.

    Args:
        scenario: gives the car's footprint.
        car: its pose: x, y, m, and heading, rad.
        body: of the road user.
        place: where the road user is, (x, y), m.
        heading: where its box points, rad.
    """
    states, places, turned = np.array([[*car, 0.0]]), np.array([[*place]]), np.array([heading])
    still = np.zeros((1, 2))
    scene = Interaction(np.zeros(1), states, places, still, turned, scenario.car.footprint, body.shape)
    return float(clearances(scene)[0])


def least_clearances(scenes: Interactions) -> FloatArray:
    """Return the least distance between the outlines in each scene, k, m: between the given moments as well."""
    scene = scenes.whole
    apart = clearances(scene)
    least = scenes.least(apart)
    of = np.repeat(np.arange(len(least)), np.diff(scenes.starts))
    starts = np.flatnonzero(np.arange(len(scene)) < scenes.last)
    track = scene.seen[starts + 1] - scene.seen[starts]
    # A distance changes by no more than the way: most stretches cannot have the least one inside of them. A box keeps
    # its heading along a stretch, and turns at its end.
    end = _apart(scene, scene.seen[starts + 1], scene.turned_from_car[starts])
    nearest = 0.5 * (apart[starts] + end - np.hypot(*track.T))
    may = nearest < least[of[starts]]
    starts, track = starts[may], track[may]
    start, turned = scene.seen[starts], scene.turned_from_car[starts]

    def at(share: FloatArray) -> FloatArray:
        return _apart(scene, start + share[:, None] * track, turned)

    low, high = np.zeros(len(start)), np.ones(len(start))
    for _ in range(_STEPS):
        width = _SHRINK * (high - low)
        left, right = high - width, low + width
        nearer = at(left) < at(right)
        low, high = np.where(nearer, low, left), np.where(nearer, right, high)
    np.minimum.at(least, of[starts], at(0.5 * (low + high)))
    return least


def least_clearance(scene: Interaction) -> float:
    """Return the least distance between the outlines, m, over the whole time: between the given moments as well."""
    return float(least_clearances(Interactions.of(scene))[0])


def _apart(scene: Interaction, seen: FloatArray, turned: FloatArray) -> FloatArray:
    """Return the distance of the outlines with the other's centre at places of the car's frame (n × 2, m)."""
    front, rear, half_width = scene.footprint
    radius, half_length, other_half_width = scene.shape
    if radius > 0.0:
        return np.asarray(np.maximum(0.0, _outside(seen, front, rear, half_width) - radius))
    cos, sin = np.cos(turned), np.sin(turned)
    found = np.full(len(seen), np.inf)
    for along, across in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        # A corner of the other in the car's frame, and one of the car in the other's.
        a, b = along * half_length, across * other_half_width
        corner = seen + np.column_stack([cos * a - sin * b, sin * a + cos * b])
        found = np.minimum(found, _outside(corner, front, rear, half_width))
        x, y = np.where(along > 0, front, -rear) - seen[:, 0], across * half_width - seen[:, 1]
        own = np.column_stack([cos * x + sin * y, cos * y - sin * x])
        found = np.minimum(found, _outside(own, half_length, half_length, other_half_width))
    return np.where(_overlap(scene, seen, cos, sin), 0.0, found)


def _outside(points: FloatArray, front: float, rear: float, half_width: float) -> FloatArray:
    """Return how far points are from a rectangle about the origin, n, m; 0 inside."""
    ahead, left = points.T
    beyond = np.maximum(0.0, np.maximum(ahead - front, -rear - ahead))
    return np.asarray(np.hypot(beyond, np.maximum(0.0, np.abs(left) - half_width)))


def _overlap(scene: Interaction, seen: FloatArray, cos: FloatArray, sin: FloatArray) -> npt.NDArray[np.bool_]:
    """Return whether two rectangles overlap: no edge's direction separates them."""
    front, rear, half_width = scene.footprint
    _, other_length, other_width = scene.shape
    half_length = 0.5 * (front + rear)
    x, y = seen[:, 0] - 0.5 * (front - rear), seen[:, 1]
    c, s = np.abs(cos), np.abs(sin)
    return np.asarray(
        (np.abs(x) <= half_length + c * other_length + s * other_width)
        & (np.abs(y) <= half_width + s * other_length + c * other_width)
        & (np.abs(cos * x + sin * y) <= c * half_length + s * half_width + other_length)
        & (np.abs(cos * y - sin * x) <= s * half_length + c * half_width + other_width)
    )


HORIZON = 20.0
"""s beyond which no touch is foreseen: at 100 km/h more than half a kilometre."""


def collision_times(scene: Interaction) -> FloatArray:
    """Return the time to collision at each moment, n, s; infinite where the two would pass each other."""
    drift = scene.moving - np.column_stack([scene.car[:, 3], np.zeros(len(scene))])
    after = scene.seen + HORIZON * drift
    return np.asarray(HORIZON * _shares(scene.seen, after, scene.turned_from_car, scene.footprint, scene.shape))


@kernel
def _shares(
    before: FloatArray,
    after: FloatArray,
    turned: FloatArray,
    footprint: tuple[float, float, float],
    shape: tuple[float, float, float],
) -> FloatArray:
    """Return the share of each straight segment in the car's frame at which the outlines first touch, else infinity.

    Args:
        before: n × 2, where the other's centre is in the beginning, m.
        after: n × 2, and in the end, m.
        turned: n, where its box points from the car's heading, rad.
        footprint: of the car, as in `Interaction`.
        shape: of the other, as in `Interaction`.
    """
    found = np.empty(before.shape[0])
    for row in range(before.shape[0]):
        begin, end = (before[row, 0], before[row, 1]), (after[row, 0], after[row, 1])
        found[row] = first_touch(begin, end, turned[row], footprint, shape)
    return found


MOST = 9.81
"""m/s² at which a greatest required deceleration ends: tyres have no more, and at a contact it is infinite."""
_TOUCHING = 1e-6  # m: whom the front touches is not beside it by rounding


def required_decelerations(scene: Interaction) -> FloatArray:
    """Return the required deceleration at each moment, n, m/s²; infinite at a contact of the front.

    It is 0 where the other is beside the car or behind its front: braking no longer decides whether they touch.
    """
    on_course = np.isfinite(collision_times(scene)) & (scene.closing > 0.0) & (scene.gap >= -_TOUCHING)
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):  # of speeds and gaps next to 0
        needed = scene.closing**2 / (2.0 * np.maximum(scene.gap, 0.0))
    return np.where(on_course, needed, 0.0)


def greatest_required_deceleration(scene: Interaction) -> float:
    """Return the greatest required deceleration over all moments, m/s², at most `MOST`."""
    return min(MOST, float(required_decelerations(scene).max(initial=0.0)))


def brake_threat_numbers(scene: Interaction, deceleration: float) -> FloatArray:
    """Return the brake threat number at each moment, n, of a car that has a deceleration (m/s², > 0)."""
    return np.asarray(required_decelerations(scene) / deceleration)


def headways(scene: Interaction) -> FloatArray:
    """Return the time headway at each moment, n, s; infinite where none is ahead in the car's strip, or it stands."""
    aside = np.abs(scene.seen[:, 1]) - scene.extent[:, 1]
    ahead = (scene.gap >= -_TOUCHING) & (aside < scene.footprint[2]) & (scene.car[:, 3] > 0.0)
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):  # of speeds and gaps next to 0
        return np.where(ahead, np.maximum(scene.gap, 0.0) / scene.car[:, 3], np.inf)


_STRAIGHT = 1e-6
"""rad by which the car's heading may change: rounding."""


def post_encroachment_times(scenes: Interactions) -> FloatArray:
    """Return the post-encroachment time in each scene, k, s.

    It is 0 where both were there at a time, nan where one of them never was, or where the car turned, so that there is
    no strip with two straight edges.
    """
    scene = scenes.whole
    begins = scenes.starts[np.searchsorted(scenes.starts, np.arange(len(scene)), side="right") - 1]
    headings = scene.car[begins, 2]
    turned = scenes.most(np.abs(scene.car[:, 2] - headings)) > _STRAIGHT
    # Everything along and across the car's first place.
    cos, sin = np.cos(headings), np.sin(headings)
    origin = scene.car[begins, :2]
    (x, y), (car_x, car_y) = (scene.other - origin).T, (scene.car[:, :2] - origin).T
    front, rear, half_width = scene.footprint
    places = np.column_stack([cos * car_x + sin * car_y, cos * x + sin * y, cos * y - sin * x])
    times = _between(scenes.starts, scene.times, places, scene.extent, front, rear, half_width)
    return np.where(turned, math.nan, times)


@kernel
def _between(
    starts: IntArray,
    times: FloatArray,
    places: FloatArray,
    extent: FloatArray,
    front: float,
    rear: float,
    half_width: float,
) -> FloatArray:
    """Return the post-encroachment time in each scene, k, s; nan where one of them was never there.

    Args:
        starts: where each scene begins.
        times: moments, s.
        places: n × 3: how far the car has come, and how far along and across its way the other is, m.
        extent: n × 2: half of what the other takes along and across, m.
        front: of the car's footprint, m.
        rear: of the car's footprint, m.
        half_width: of the car's footprint, m.
    """
    found = np.full(len(starts) - 1, np.nan)
    for scene in range(len(starts) - 1):
        first, end = starts[scene], starts[scene + 1]
        at, along, across = times[first:end], places[first:end, 1], places[first:end, 2]
        driven = places[first:end, 0]
        reaches = half_width + extent[first:end, 1]
        inside = _both(_spans(at, reaches - across), _spans(at, reaches + across))
        if not len(inside):
            continue
        enters, leaves = inside[0, 0], inside[-1, 1]
        low, high, reach = np.inf, -np.inf, 0.0
        for row in range(len(at)):
            reach = max(reach, extent[first + row, 0])
            if enters <= at[row] <= leaves:
                low, high = min(low, along[row]), max(high, along[row])
        for moment in (enters, leaves):
            place = np.interp(moment, at, along)
            low, high = min(low, place), max(high, place)
        covered = _both(_spans(at, driven + front - (low - reach)), _spans(at, high + reach - (driven - rear)))
        for a, b in covered:
            for c, d in inside:
                apart = 0.0 if a < d and c < b else max(c - b, a - d)
                if not found[scene] <= apart:
                    found[scene] = apart
    return found


@kernel
def _spans(times: FloatArray, depth: FloatArray) -> FloatArray:
    """Return the spans of time, m × 2, in which a quantity that is straight between moments is above 0."""
    found = np.empty((len(times), 2))
    count, begin = 0, times[0] if depth[0] > 0.0 else np.nan
    for index in range(1, len(times)):
        before, after = depth[index - 1], depth[index]
        if (before > 0.0) != (after > 0.0):
            crossing = times[index - 1] + (times[index] - times[index - 1]) * before / (before - after)
            if after > 0.0:
                begin = crossing
            else:
                found[count] = begin, crossing
                count += 1
    if depth[-1] > 0.0:
        found[count] = begin, times[-1]
        count += 1
    return found[:count]


@kernel
def _both(some: FloatArray, others: FloatArray) -> FloatArray:
    """Return the spans of time, m × 2, that are in one of some and in one of others."""
    found = np.empty((len(some) * len(others), 2))
    count = 0
    for a, b in some:
        for c, d in others:
            if max(a, c) < min(b, d):
                found[count] = max(a, c), min(b, d)
                count += 1
    return found[:count]


KMH = 3.6
HALF_AT = 59.0
"""km/h at which half of the pedestrians die."""
ODDS, ODDS_INTERVAL = 1.11, (1.10, 1.12)
"""By which the odds grow for each km/h."""
CAR_MASS = 1500.0
"""kg, of the car under test: about the mean of new cars in Europe."""


def closing_speeds(scene: Interaction) -> FloatArray:
    """Return the amount of the relative velocity at each moment, n, m/s; at a contact it is the closing speed."""
    heading, speed = scene.car[:, 2], scene.car[:, 3]
    own = np.column_stack([speed * np.cos(heading), speed * np.sin(heading)])
    return np.asarray(np.hypot(*(own - scene.velocity).T))


def delta_v(closing: float, mass: float, other_mass: float) -> float:
    """Return how much the velocity of one with a mass (kg) changes in a plastic impact with another, m/s."""
    return closing * other_mass / (mass + other_mass)


def greater_delta_v(closing: float, kind: str) -> float:
    """Return how much the velocity changes of whom it changes more, the car or one of a kind, m/s; nan: not known."""
    mass = ROAD_USERS.find(kind).mass if kind in ROAD_USERS else math.nan
    return delta_v(closing, min(mass, CAR_MASS), max(mass, CAR_MASS))


def fatality_risk(closing: float, odds: float = ODDS) -> float:
    """Return the risk that a pedestrian who is hit at a closing speed (m/s) dies.

    Args:
        closing: closing speed, m/s.
        odds: by which the odds grow for each km/h; with the ends of `ODDS_INTERVAL` it is the ends of its interval.
    """
    return 1.0 / (1.0 + math.exp(-math.log(odds) * (KMH * closing - HALF_AT)))
