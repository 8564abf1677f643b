"""Where the car is within a tick when it touches a road user: between its states at both ends of that tick.

A log has the car's states at ticks, and of a contact the time and the car's speed then. Adversary and others move
uniformly within a tick, and so does a car that keeps to one command in it and has no tyres. One that decides in
between, or whose brake comes on in between, does not: halfway through a tick in which it brakes hard it has more than
half of its way behind it. Where it was follows from its speed. After a contact nothing is decided until the tick ends
(`skd_sim.world.world`), so from there on its speed goes straight to the one at the end of the tick, and what it
drives in that time is missing from the tick's way. Of a car with tyres neither part goes straight: by what the way is
longer or shorter than both together, each of them is. A simulator that ends its tick with the contact leaves the way
up to there alone. Held against what the world itself did, places are right to 4 mm of cars without tyres, and to 7 mm
of cars with them (tests/evaluator/test_risk_comparison.py); in 28,000 crossings with ticks of up to 0.5 s and cars that
command something else in every period, to 7 cm.

Required deceleration at entry: how hard a car would have had to brake when who is hit came into its way.

The deceleration rate to avoid the crash (Cooper and Ferguson, "Traffic studies at T-junctions. 2. A conflict simulation
record", Traffic Engineering and Control 17, 1976): Δv²/(2 d), with the speed Δv at which car and adversary come
together along the road and the gap d between the car's front and the adversary's nearest point along it. It is taken at
the first tick at which the adversary can reach into the strip that the car sweeps. Above some 8 m/s² on a dry road no
brake could have helped, so that such a collision says more of the adversary than of the car.

The greatest required deceleration of a whole episode is another figure (`measure.surrogate.braking`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from skd_sim.options.car_and_adversary import DYNAMICS
from skd_sim.scenario.road import right_and_along, road_pose, road_position
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.contact import to_car_frame
from skd_sim.world.episode import EpisodeLog, Outcome, until_contact
from skd_sim.world.state import FloatArray, Trajectory, travelled

from skd_evaluator.metrics.measures import Measure, Pair

Pose = tuple[float, float, float]
"""x, y, m, and heading, rad."""


_ALIKE = 1e-6  # rad between two computations of a heading
_SAME = 1e-6  # m between two computations of a way
_OFF = 0.05  # m, at the most, by which a place is mended
_AT_A_CORNER = 0.9  # of the radius: by how much the front is missed to the side at most
_BENT = 0.1  # m by which the way up to a contact may differ from that of a speed that goes straight


def car_at_contact(log: EpisodeLog) -> tuple[Pose, float]:
    """Return the car's pose at the contact in the last tick, and the share of that tick that has passed."""
    scenario = log.episode.scenario
    share = log.impact_time / scenario.time_step - (len(log.car) - 2)
    return pose_at_contact(scenario, log.car[-2:], share, log.impact_speed), share


def outline_of(scenario: Scenario, pose: Sequence[float]) -> FloatArray:
    """Return the corners of the car (4 × 2, m) at a pose: x, y of its reference point (m), heading (rad)."""
    car, (x, y, heading) = scenario.car, pose
    cos, sin = math.cos(heading), math.sin(heading)
    ahead, left = np.array([cos, sin]), np.array([-sin, cos])
    corners = [(car.front, 1), (-car.rear, 1), (-car.rear, -1), (car.front, -1)]
    return np.array([np.array([x, y]) + a * ahead + b * car.half_width * left for a, b in corners])


def last_pose(log: EpisodeLog) -> Pose:
    """Return the car's pose at the end: at the first contact, if there is one."""
    if log.outcome == Outcome.COLLISION:
        return car_at_contact(log)[0]
    x, y, heading, _ = log.car[-1].tolist()
    return x, y, heading


def last_car_position(log: EpisodeLog) -> float:
    """Return the path coordinate of the car's reference point at the end, m: at the first contact, if there is one."""
    return float(road_position(log.episode.scenario.road.line, *last_pose(log)[:2])[0])


def car_until_contact(
    scenario: Scenario, car: FloatArray, ticks: float, impact: float, adversary: FloatArray
) -> FloatArray:
    """Return the car's states at ticks with the last one moved back to the contact in the last tick.

    Where the car's front touches a disc the two are as far from one another as its radius, to the last digit.

    Args:
        scenario: fixed description of the test.
        car: n × 4 with n ≥ 2: reference point (x, y), m, heading, rad, and speed, m/s, at ticks.
        ticks: when the contact was, in ticks.
        impact: speed of the car then, m/s.
        adversary: where the adversary was then, (x, y), m.
    """
    moved = until_contact(car, ticks)
    if goes_straight(scenario, car[-2:]):
        return moved
    pose = pose_at_contact(scenario, car[-2:], ticks - (len(car) - 2), impact)
    off = _off_the_front(scenario, pose, adversary)
    moved[-1, 2] = math.remainder(pose[2], math.tau)
    moved[-1, :2] = pose[0] + off * math.cos(pose[2]), pose[1] + off * math.sin(pose[2])
    if not moves_uniformly(scenario, car[-2:]):
        moved[-1, 3] = impact
    return moved


def _off_the_front(scenario: Scenario, pose: Pose, adversary: FloatArray) -> float:
    """Return how far the car has to be moved ahead to touch a disc with its front, m; 0 where it does not touch so."""
    ahead, left = to_car_frame(float(adversary[0]), float(adversary[1]), *pose)
    radius, aside = scenario.adversary.shape[0], max(0.0, abs(left) - scenario.car.half_width)
    if aside >= _AT_A_CORNER * radius:  # it is the side that touches, or nearly so
        return 0.0
    off = ahead - scenario.car.front - math.sqrt(radius * radius - aside * aside)
    return off if abs(off) <= _OFF else 0.0


def goes_straight(scenario: Scenario, ends: FloatArray) -> bool:
    """Return whether the car moves uniformly and straight on in a tick; see `pose_at_contact`."""
    return scenario.road.straight and ends[0, 2] == ends[1, 2] and moves_uniformly(scenario, ends)


def moves_uniformly(scenario: Scenario, ends: FloatArray) -> bool:
    """Return whether the car moves uniformly along its path in a tick; see `pose_at_contact`.

    That is a car without tyres that decides once a tick, in a world whose tick does not end with a contact.
    """
    if scenario.control_periods > 1 or not DYNAMICS[scenario.car.dynamics].known:
        return False
    return abs(_way(scenario, ends) - travelled(float(ends[0, 3]), float(ends[1, 3]), scenario.time_step)) < _SAME


def pose_at_contact(scenario: Scenario, ends: FloatArray, share: float, impact: float) -> Pose:
    """Return the car's pose at the contact: along its lane in a curve, else along an arc between its headings.

    Args:
        scenario: fixed description of the test.
        ends: the car at both ends of the tick, as `car_until_contact` has it, 2 × 4.
        share: of the tick that has passed at the contact.
        impact: speed of the car then, m/s.
    """
    line = scenario.road.line
    driven = _share_driven(scenario, ends, share, impact)
    if scenario.road.straight or leaves_line(scenario, ends):
        x, y = (ends[0, :2] + driven * (ends[1, :2] - ends[0, :2])).tolist()
        (dx, dy), turned = (ends[1, :2] - ends[0, :2]).tolist(), _turned(ends)
        bulge = 0.5 * turned * driven * (1.0 - driven)
        return x + bulge * dy, y - bulge * dx, float(ends[0, 2]) + driven * turned
    (before, aside), (after, aside_after) = (road_position(line, *one[:2].tolist()) for one in ends)
    x, y, heading = road_pose(line, before + driven * (after - before))
    left = aside + driven * (aside_after - aside)
    return x - left * math.sin(heading), y + left * math.cos(heading), float(heading)


def _way(scenario: Scenario, ends: FloatArray) -> float:
    """Return how far along its lane, or along its own arc, the car comes in a tick, m."""
    if leaves_line(scenario, ends):
        return math.dist(*ends[:, :2].tolist()) * (1.0 + _turned(ends) ** 2 / 24.0)
    before, after = (float(road_position(scenario.road.line, *one[:2].tolist())[0]) for one in ends)
    return after - before


def leaves_line(scenario: Scenario, ends: FloatArray) -> bool:
    """Return whether the car points elsewhere than the line along which its lane leads, at one end of a tick."""
    line = scenario.road.line
    return any(
        abs(math.remainder(float(one[2]) - road_pose(line, road_position(line, *one[:2].tolist())[0])[2], math.tau))
        > _ALIKE
        for one in ends
    )


def _turned(ends: FloatArray) -> float:
    """Return by how much the car turns in a tick, rad."""
    return math.remainder(float(ends[1, 2] - ends[0, 2]), math.tau)


def _share_driven(scenario: Scenario, ends: FloatArray, share: float, impact: float) -> float:
    """Return the share of a tick's way that the car has driven at a contact; see `pose_at_contact`."""
    if moves_uniformly(scenario, ends):
        return share
    track, first, last = _way(scenario, ends), float(ends[0, 3]), float(ends[1, 3])
    if not (track > 0.0 and 0.0 < share < 1.0):
        return min(1.0, max(0.0, share))
    passed, left = share * scenario.time_step, (1.0 - share) * scenario.time_step
    until, beyond = travelled(first, impact, passed), travelled(impact, last, left)
    if track < until + 0.5 * beyond - _BENT:  # the tick ends with the contact
        driven = until
    elif last <= 0.0:  # it stands before the tick ends, and since when is not known
        driven = track - min(beyond, max(0.0, track - until))
    elif DYNAMICS[scenario.car.dynamics].known:
        driven = track - _driven_after(impact, last, share, scenario)
    else:
        late = passed**3 / (passed**3 + left**3)  # what a bent speed comes to grows with the cube of the time
        driven = until + late * (track - until - beyond)
    return min(1.0, max(0.0, driven / track))


def _driven_after(impact: float, last: float, share: float, scenario: Scenario) -> float:
    """Return how far a car drives from a contact to the end of the tick, m: uniformly in each control period.

    Its speed at a contact is that between both ends of the period, so it is by it how the command changes the speed.
    """
    periods = scenario.control_periods
    duration = scenario.time_step / periods
    within = share * periods - math.floor(share * periods)
    change = (last - impact) / ((1.0 - share) * periods)  # m/s a period
    before, after = impact - within * change, impact + (1.0 - within) * change
    whole = round((1.0 - share) * periods - (1.0 - within))
    return duration * ((1.0 - within) * 0.5 * (before + after) + whole * 0.5 * (after + last))


def deceleration_at_entry(log: EpisodeLog) -> float:
    """Return the deceleration (m/s²) that would have kept the car off, braking from when the adversary was in its way.

    Returns:
        0 where the two did not come together along the road then; nan where the adversary was in the way at no tick
        before the contact, or beside the car already.
    """
    scenario, step = log.episode.scenario, log.episode.scenario.time_step
    line = scenario.road.line
    before = int(np.ceil(log.impact_time / step))  # ticks from here on are not before the contact
    across, along = right_and_along(line, np.ascontiguousarray(log.adversary)).T
    (in_the_way,) = np.nonzero(np.abs(across[:before]) <= scenario.end.path_edge)
    if not len(in_the_way):
        return float("nan")
    tick = int(in_the_way[0])
    outline = scenario.adversary.outline(log.adversary[: tick + 1])
    front = right_and_along(line, np.ascontiguousarray(log.car[tick : tick + 1, :2]))[0, 1] + scenario.car.front
    gap = float(right_and_along(line, outline)[:, 1].min() - front)
    if gap <= 0.0:
        return float("nan")
    last = max(tick, 1)
    closing = float(log.car[tick, 3] - (along[last] - along[last - 1]) / step)
    return max(0.0, closing) ** 2 / (2.0 * gap)


def _of_pairs(_phi: Trajectory, pairs: Sequence[Pair]) -> list[float]:
    return [deceleration_at_entry(one.log) for one in pairs]


DECELERATION_AT_ENTRY = Measure("required deceleration at entry", "m/s²", _of_pairs)
