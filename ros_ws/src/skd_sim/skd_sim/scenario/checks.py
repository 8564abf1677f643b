"""What fits together in no scenario: road users inside each other, an obstacle in the car's path, and the like."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from skd_sim.arrays import FloatArray
from skd_sim.errors import UsageError
from skd_sim.options.car_dynamics import DYNAMICS
from skd_sim.scenario.definition import Obstacle, Scenario
from skd_sim.scenario.ending import NOWHERE
from skd_sim.scenario.road import HEADING_NORTH, right_and_along, road_pose
from skd_sim.world.contact import rectangle_distance, sweep, to_car_frame
from skd_sim.world.obstruction import clearance, runs_into
from skd_sim.world.state import RoadUserState
from skd_sim.world.trajectory import Trajectory

Shape = tuple[float, float, float]

_OBSTACLE_SPACING = 0.1  # m between the places of an obstacle that are held against the car's path
_START_SPACING = 0.05  # m between the places at which a car on a curved road is looked at before it starts


def check_scenario(scenario: Scenario, where: str) -> None:
    """Refuse a scenario whose sections do not go together.

    Args:
        scenario: each section of it is valid by itself.
        where: file or other origin, for messages.

    Raises:
        UsageError: names the keys.
    """
    if scenario.horizon < scenario.time_step:
        raise UsageError(f"{where}: horizon must be at least time_step ({scenario.time_step:g} s)")
    check_control_period(scenario, where)
    _check_destination(scenario, where)
    _check_dynamics(scenario, where)
    _check_obstacles(scenario, where)
    if not scenario.car.meet_safe_trajectory:
        _check_others(scenario, where)
        _check_start(scenario, where)


def _check_dynamics(scenario: Scenario, where: str) -> None:
    """Refuse a road that the car's dynamics know nothing of."""
    name, road = scenario.car.dynamics, scenario.road
    if not DYNAMICS[name].tyres and road.friction != 1.0:
        others = " or ".join(one for one, kind in DYNAMICS.items() if kind.tyres)
        raise UsageError(
            f"{where}: road.friction {road.friction:g} has no effect on car.dynamics {name}; "
            f"set car.dynamics to {others}, or leave road.friction out"
        )
    if not DYNAMICS[name].steers and not road.straight:
        others = " or ".join(one for one, kind in DYNAMICS.items() if kind.steers)
        raise UsageError(
            f"{where}: car.dynamics {name} does not steer, so it cannot follow the curves of road.parts; "
            f"set car.dynamics to {others}, or leave road.parts out"
        )


def _check_obstacles(scenario: Scenario, where: str) -> None:
    """Refuse obstacles in the car's path, which it does not steer around, and those where the adversary starts."""
    needed, adversary = scenario.car.half_width, scenario.adversary
    for index, (row, obstacle) in enumerate(zip(scenario.rectangles, scenario.obstacles, strict=False)):
        apart = float(np.abs(right_and_along(scenario.road.line, _filled(obstacle))[:, 0]).min())
        if apart <= needed:
            raise UsageError(
                f"{where}: obstacles[{index}] stands in the car's path: it comes within {apart:.2f} m of the lane's "
                f"centre line, and the car, which does not steer around it, takes {needed:g} m to each side; move it "
                "aside"
            )
        near = clearance(row[None], adversary.start_x, adversary.start_y)
        if not scenario.car.meet_safe_trajectory and near <= adversary.core:
            raise UsageError(
                f"{where}: the adversary starts in obstacles[{index}] (centre to its edge {near:.2f} m, must exceed "
                f"{adversary.core:g} m); move it, or adversary.start_x, start_y"
            )


def _filled(obstacle: Obstacle) -> FloatArray:
    """Return points all over an obstacle, edges and corners included, n × 2, m."""
    first, second, third, _ = obstacle.corners
    along, across = (
        np.linspace(0.0, 1.0, 2 + int(size / _OBSTACLE_SPACING))[:, None] for size in (obstacle.length, obstacle.width)
    )
    edge = first + along * (second - first)
    return np.asarray((edge[:, None] + across[None] * (third - second)).reshape(-1, 2))


def _standing(scenario: Scenario) -> list[str]:
    """Return what each row of `Scenario.rectangles` is called."""
    others = [f"others[{index}]" for index, other in enumerate(scenario.others) if other.stands]
    return [f"obstacles[{index}]" for index in range(len(scenario.obstacles))] + others


def _check_destination(scenario: Scenario, where: str) -> None:
    """Refuse an adversary that has no destination, or that starts at its destination."""
    adversary, endings = scenario.adversary, scenario.ending
    arrived = None if endings is None else endings.arrived
    if adversary.destination_x is None and arrived is None:
        raise UsageError(f"{where}: missing key adversary.destination_x (or a section ending with arrived)")
    if adversary.destination_x is not None and arrived is not None:
        raise UsageError(
            f"{where}: adversary.destination_x and ending.arrived both say where the adversary has arrived; leave one "
            "out"
        )
    if adversary.destination_x == adversary.start_x:
        raise UsageError(f"{where}: adversary.destination_x must differ from adversary.start_x")
    if arrived is not None and arrived.bounds == NOWHERE:
        raise UsageError(f"{where}: ending.arrived needs right_of, left_of, ahead_of or behind (m)")


def _check_others(scenario: Scenario, where: str) -> None:
    """Refuse others that are where the car or the adversary starts."""
    adversary = scenario.adversary
    for index, other in enumerate(scenario.others):
        section = f"others[{index}]"
        first = scenario.others_at(0)[index]
        if _inside_car(scenario, first, other.shape):
            raise UsageError(f"{where}: {section} is where the car starts; move it, or change car.start_gap")
        start = RoadUserState(adversary.start_x, adversary.start_y, 0.0, 0.0, adversary.first_heading)
        if _overlap(first, other.shape, start, adversary.shape):
            raise UsageError(
                f"{where}: {section} is where the adversary starts; move it, or adversary.start_x, start_y"
            )


def _overlap(one: RoadUserState, shape: Shape, other: RoadUserState, other_shape: Shape) -> bool:
    """Return whether two bodies are in the same place; shapes as `Body.shape`."""
    if shape[0] > 0.0 and other_shape[0] > 0.0:
        return math.hypot(one.x - other.x, one.y - other.y) <= shape[0] + other_shape[0]
    if shape[0] > 0.0:
        return _overlap(other, other_shape, one, shape)
    return _touches((one.x, one.y, one.heading), (shape[1], shape[1], shape[2]), other, other_shape)


def _touches(
    pose: tuple[float, float, float], footprint: tuple[float, float, float], body: RoadUserState, shape: Shape
) -> bool:
    """Return whether a rectangle (front, rear and half width from its pose, m) and a body are in the same place."""
    stands = np.array([(*pose, 0.0), (*pose, 0.0)])
    place = (body.x, body.y)
    share, _ = sweep(stands, place, place, (0.0, 0.0), body.heading, footprint, shape, 1.0, 0, 1)
    return bool(share <= 1.0)


def _inside_car(scenario: Scenario, body: RoadUserState, shape: Shape) -> bool:
    """Return whether a body is in the car's footprint, wherever in its start range the car starts."""
    car = scenario.car
    footprint = (car.front, car.rear, car.half_width)
    return any(_touches(pose, footprint, body, shape) for pose in _start_poses(scenario, car.start_gap))


def _start_poses(scenario: Scenario, gap: float) -> Iterator[tuple[float, float, float]]:
    """Yield poses (m, rad) all over the car's start range, whose least gap to the crossing line is `gap`, m."""
    car, nearest = scenario.car, -gap - scenario.car.front
    for place in np.linspace(nearest - car.start_gap_range, nearest, 2 + int(car.start_gap_range / _START_SPACING)):
        yield road_pose(scenario.road.line, place)


def check_way(scenario: Scenario, trajectory: Trajectory) -> None:
    """Refuse a way of the adversary that leads through an obstacle.

    Raises:
        UsageError: it does; says through which, and when.
    """
    points, core = trajectory.positions, scenario.adversary.core
    for name, row in zip(_standing(scenario), scenario.rectangles, strict=True):
        for tick in range(len(points)):
            before = points[max(0, tick - 1)]
            if runs_into(row[None], before[0], before[1], points[tick, 0], points[tick, 1], core):
                raise UsageError(
                    f"safe trajectory {trajectory.name!r} runs into {name} of scenario {scenario.name} at "
                    f"{tick * trajectory.time_step:.3g} s, at ({points[tick, 0]:.3g}, {points[tick, 1]:.3g}) m; a safe "
                    "trajectory leads around obstacles"
                )


def check_control_period(scenario: Scenario, where: str) -> None:
    """Refuse a control period that does not divide the time step."""
    period, step = scenario.control_period, scenario.time_step
    if period is not None and (
        scenario.control_periods < 1 or abs(scenario.control_periods * period - step) > 1e-9 * step
    ):
        count = max(1, scenario.control_periods)
        raise UsageError(
            f"{where}: control_period {period:g} s must divide time_step {step:g} s; {step / count:.6g} s does"
        )


def start_clearance(scenario: Scenario, x: float, y: float, gap: float) -> float:
    """Return the least distance (m) from a point (m) to the car's footprint, wherever in its start range it starts.

    Args:
        scenario: scenario whose road and car count.
        x: place of the point to the East, m.
        y: place of the point to the North, m.
        gap: least distance from the front bumper to the crossing line, m.
    """
    car = scenario.car
    if scenario.road.straight:
        ahead, left = to_car_frame(x, y, 0.0, -gap - car.front, HEADING_NORTH)
        return float(rectangle_distance(ahead, left, car.front, car.rear + car.start_gap_range, car.half_width))
    seen = [to_car_frame(x, y, *pose) for pose in _start_poses(scenario, gap)]
    return min(float(rectangle_distance(*here, car.front, car.rear, car.half_width)) for here in seen)


def _check_start(scenario: Scenario, where: str) -> None:
    """Refuse a start at which the car, anywhere in its start range, overlaps the adversary."""
    adversary = scenario.adversary
    gap = start_clearance(scenario, adversary.start_x, adversary.start_y, scenario.car.start_gap)
    if gap <= adversary.reach:
        what = "half of the adversary's diagonal," if adversary.is_box else "adversary.radius"
        raise UsageError(
            f"{where}: the car overlaps the adversary at the start (footprint to centre {gap:.2f} m, must exceed "
            f"{what} {adversary.reach:g} m); increase car.start_gap or move adversary.start_x, start_y"
        )
