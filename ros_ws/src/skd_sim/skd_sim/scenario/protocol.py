"""The trajectory of a regulator's target: from the section `protocol` of a scenario, one per impact place.

The car comes unbraked at its start speed, from the middle of the range of places in which it starts. The target's
centre moves along a straight line, or changes over to one. When the car's front reaches the target's nearest surface,
the target is at its impact place.

A target changes lanes on an arc, straight on, and on an arc back, at one speed. Euro NCAP's CCFhol has arcs with radii
of 125 m (50 km/h, 44 m) and 250 m (70 km/h, 60 m) with 10 m between them (Vector's OSC-NCAP-scenarios, catalogue of
trajectories, GVT_CCFhol_50 and GVT_CCFhol_70). Here a fifth of the path is straight, whatever the speed.
"""

from __future__ import annotations

import math

import numpy as np

from skd_sim.errors import UsageError
from skd_sim.scenario.road import road_pose
from skd_sim.scenario.scenario import Protocol, Scenario
from skd_sim.world.state import FloatArray, Trajectory

_ALONG = math.sin(math.radians(45.0))  # of who moves so or more along the lane, the place is across, not in time
_LOOK, _HALVINGS = 0.02, 60  # s between two looks at where the car's front is, and how often that is halved
_STRAIGHT = 0.2  # share of a lane change that is straight


def regulatory_trajectories(scenario: Scenario) -> list[Trajectory]:
    """Return the target's path for each impact place of the scenario's protocol, in its order.

    A path ends where the adversary has arrived, or at the horizon. It is exact at each tick; between two ticks its
    speed is uniform, whatever it accelerates.

    Raises:
        UsageError: the scenario has no protocol, its road has curves where the car meets the target, or its target
            cannot be met.
    """
    protocol = scenario.protocol
    if protocol is None:
        raise UsageError(
            f"scenario {scenario.name} has no section protocol, so there are no regulatory safe trajectories; give "
            "synthetic, own, or the path of recorded ones"
        )
    return [_trajectory(scenario, protocol, place) for place in protocol.impact_places]


def meeting_time(scenario: Scenario) -> float:
    """Return how long the unbraked car takes to the crossing line from the middle of its start range, s."""
    car = scenario.car
    if car.start_speed <= 0.0:
        raise UsageError(f"scenario {scenario.name}: regulatory safe trajectories are for a car that drives; it stands")
    return (car.start_gap + 0.5 * car.start_gap_range) / car.start_speed


def time_of_meeting(scenario: Scenario) -> float:
    """Return when the front of the unbraked car reaches the path of its protocol's target, s since the start.

    Where the target goes along the lane, or there is no protocol, that is at the crossing line.
    """
    heading = target_heading(scenario)
    if scenario.protocol is None or abs(math.sin(heading)) >= _ALONG:
        return meeting_time(scenario)
    start = np.array([scenario.adversary.start_x, scenario.adversary.start_y])
    return _front_reaches(scenario, start, _direction(heading))[0]


def target_heading(scenario: Scenario) -> float:
    """Return the direction in which the target moves, rad: the adversary's start heading, or across the lane."""
    heading = scenario.adversary.start_heading
    if heading is not None:
        return heading
    return 0.0 if scenario.end.crossing > 0.0 else math.pi


def impact_offset(scenario: Scenario, place: float) -> float:
    """Return where an impact place (%) is, m to the right of the car's axis."""
    heading = target_heading(scenario)
    from_left = abs(math.sin(heading)) < _ALONG and math.cos(heading) > 0.0
    return (1.0 if from_left else -1.0) * (place / 100.0 - 0.5) * scenario.car.width


def _trajectory(scenario: Scenario, protocol: Protocol, place: float) -> Trajectory:
    heading, offset = target_heading(scenario), impact_offset(scenario, place)
    direction = _direction(heading)
    along = abs(direction[1]) >= _ALONG
    start = np.array([offset if along else scenario.adversary.start_x, scenario.adversary.start_y])
    times = scenario.time_step * np.arange(scenario.ticks + 1, dtype=np.float64)
    if protocol.aside:
        if not along:
            raise UsageError(f"scenario {scenario.name}: protocol.aside is for a target that moves along the lane")
        return _ended(scenario, _changing_lanes(scenario, protocol, offset, float(direction[1]), times), place)
    if along:
        start[1] = _first_place_along(scenario, protocol, float(direction[1]))
        covered = _covered(protocol, times)
    else:
        meeting, front = _front_reaches(scenario, start, direction)
        path = float(direction @ (front - start)) + offset * math.copysign(1.0, direction[0])
        covered = _crossing(scenario, protocol, place, path, meeting, times)
    return _ended(scenario, start + covered[:, None] * direction, place)


def _direction(heading: float) -> FloatArray:
    """Return the direction (x, y) of a heading (rad), whatever π's last digit is."""
    return np.array([round(math.cos(heading), 12), round(math.sin(heading), 12)])


def _ended(scenario: Scenario, positions: FloatArray, place: float) -> Trajectory:
    """Return the path up to where the adversary has arrived, or to the horizon."""
    last = next(
        (tick for tick, (x, y) in enumerate(positions.tolist()) if scenario.end.arrived(x, y)), len(positions) - 1
    )
    return Trajectory(positions[: max(1, last) + 1], scenario.time_step, f"regulatory/{place:g}")


def _depth(scenario: Scenario, *, along: bool) -> float:
    """Return how far the target reaches from its centre along the lane, m."""
    radius, half_length, half_width = scenario.adversary.shape
    return radius or (half_length if along else half_width)


def _first_place_along(scenario: Scenario, protocol: Protocol, north: float) -> float:
    """Return where the centre of a target that moves along the lane is at the start, m along the lane."""
    depth, car = _depth(scenario, along=True), scenario.car
    if protocol.headway is not None:
        return -car.start_gap - 0.5 * car.start_gap_range + protocol.headway * car.start_speed + depth
    if protocol.brake_after is not None:
        raise UsageError(f"scenario {scenario.name}: protocol.brake_after goes with protocol.headway: give it, too")
    return depth - north * protocol.speed * meeting_time(scenario)


def _changing_lanes(
    scenario: Scenario, protocol: Protocol, offset: float, north: float, times: FloatArray
) -> FloatArray:
    """Return places (x, y), m, at some times (s) of a target that comes over to the line of its impact place.

    Args:
        scenario: fixed description of the test.
        protocol: its section.
        offset: where the impact place is, m to the right of the car's axis.
        north: 1 of a target that drives the direction of the car, -1 of one that comes towards it.
        times: s since the start.
    """
    assert protocol.change_time is not None
    assert protocol.change_ends is not None
    meeting, length = meeting_time(scenario), protocol.speed * protocol.change_time
    begins = meeting - protocol.change_ends - protocol.change_time
    along, across = changed_over(protocol.speed * (np.append(times, meeting) - begins), length, abs(protocol.aside))
    y = _depth(scenario, along=True) - north * (along[-1] - along[:-1])
    x = offset + protocol.aside - math.copysign(1.0, protocol.aside) * across[:-1]
    return np.column_stack([x, y])


def _covered(protocol: Protocol, times: FloatArray) -> FloatArray:
    """Return how far one that comes at its speed, and may brake, has got at some times (s), m."""
    if protocol.brake_after is None:
        return protocol.speed * times
    stopping = protocol.speed / protocol.deceleration
    braked = np.clip(times - protocol.brake_after, 0.0, stopping)
    steady = np.minimum(times, protocol.brake_after)
    return np.asarray(protocol.speed * (steady + braked) - 0.5 * protocol.deceleration * braked**2)


def _front_reaches(scenario: Scenario, start: FloatArray, direction: FloatArray) -> tuple[float, FloatArray]:
    """Return when (s) the middle of the unbraked car's front reaches a target that crosses, and where (x, y) (m) it is.

    Args:
        scenario: fixed description of the test.
        start: a point of the path of the target's centre (x, y), m.
        direction: in which it goes, of length 1.

    Raises:
        UsageError: it never does within the horizon.
    """
    car, depth = scenario.car, _depth(scenario, along=False)
    begin = -meeting_time(scenario) * car.start_speed - car.front

    def front(time: float) -> FloatArray:
        x, y, heading = road_pose(scenario.road.line, begin + car.start_speed * time)
        return np.array([x + car.front * math.cos(heading), y + car.front * math.sin(heading)])

    def beside(time: float) -> float:
        ahead = front(time) - start
        return float(direction[0] * ahead[1] - direction[1] * ahead[0])

    side = math.copysign(1.0, beside(0.0))
    before, after = 0.0, 0.0
    while side * beside(after) > depth:
        before, after = after, after + _LOOK
        if after > scenario.horizon:
            raise UsageError(
                f"scenario {scenario.name}: the unbraked car does not get to the path of its protocol's target within "
                f"the horizon of {scenario.horizon:g} s; make horizon longer, or car.start_gap shorter"
            )
    for _ in range(_HALVINGS):
        middle = 0.5 * (before + after)
        before, after = (middle, after) if side * beside(middle) > depth else (before, middle)
    return after, front(after)


def _crossing(
    scenario: Scenario, protocol: Protocol, place: float, path: float, meeting: float, times: FloatArray
) -> FloatArray:
    """Return how far the target has got across the lane at some times (s), m: at its place when the car's front is.

    Args:
        scenario: fixed description of the test.
        protocol: its section.
        place: the impact place, for messages.
        path: how far it is from the start to there, m.
        meeting: when the car's front is there, s since the start.
        times: s since the start.
    """
    if protocol.speed <= 0.0 or path <= protocol.acceleration_distance:
        raise UsageError(
            f"scenario {scenario.name}: the target cannot be at {place:g} % of the car's width at its speed: from its "
            f"start it is {path:.3g} m to there; move adversary.start_x, or change protocol.speed"
        )
    speeding = 2.0 * protocol.acceleration_distance / protocol.speed  # s, from standing to its speed
    begins = meeting - speeding - (path - protocol.acceleration_distance) / protocol.speed
    if protocol.acceleration_distance <= 0.0:
        return np.asarray(path - protocol.speed * (meeting - times))  # it has been moving before
    moved = np.clip(times - begins, 0.0, speeding)
    steady = np.maximum(0.0, times - begins - speeding)
    return np.asarray(protocol.acceleration_distance * (moved / speeding) ** 2 + protocol.speed * steady)


def changed_over(path: FloatArray, length: float, aside: float) -> tuple[FloatArray, FloatArray]:
    """Return how far one who changes lanes has got along the lane and across it, both of them m.

    Before the change and after it the path leads straight along the lane.

    Args:
        path: that has been covered since the change began, m; negative before it.
        length: of the change, m of the path.
        aside: by how much it leads across, m, at least 0 and at most half of the length.
    """
    angle = _angle(length, aside)
    arc, straight = 0.5 * (1.0 - _STRAIGHT) * length, _STRAIGHT * length
    radius = arc / angle
    within = np.clip(path, 0.0, length)
    first = np.minimum(within, arc) / radius
    between = np.clip(within - arc, 0.0, straight)
    second = angle - np.maximum(within - arc - straight, 0.0) / radius
    along = radius * (np.sin(first) + math.sin(angle) - np.sin(second)) + between * math.cos(angle)
    across = radius * (1.0 - np.cos(first) + np.cos(second) - math.cos(angle)) + between * math.sin(angle)
    return along + (path - within), across


def _angle(length: float, aside: float) -> float:
    """Return by how much the path is turned between the two arcs, rad."""

    def across(angle: float) -> float:
        arc = (1.0 - _STRAIGHT) * length * (1.0 - math.cos(angle)) / angle
        return arc + _STRAIGHT * length * math.sin(angle)

    low, high = 1e-9, 0.5 * math.pi
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if across(middle) < aside else (low, middle)
    return 0.5 * (low + high)
