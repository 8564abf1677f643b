"""The road users and obstacles of an exported episode, with their states over time, and their names in files."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from skd_adversary.safe_trajectories.recordings import interpolated
from skd_sim.scenario.road import ONCOMING, right_and_along, road_pose
from skd_sim.scenario.road_user import CAR, Body, called, height_of
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.episode import EpisodeSpec, Mode
from skd_sim.world.state import FloatArray, IntArray, Trajectory

from skd_evaluator.metrics.surrogate_scenes import EpisodeMotion, scene_of, velocities

EGO, ADVERSARY = "Ego", "Adversary"
OTHER, OBSTACLE = "Other_{}", "Obstacle_{}"
ROAD_FILE = "road.xodr"
EXPORT, IMPORT = "export.json", "import.json"
SOURCE = "skd.role"
"""Type of OSI's external references that say which road user an object is."""
EGO_ID, ADVERSARY_ID, FIRST_OTHER_ID = 1, 2, 3
"""Ids of OSI and CommonRoad; the others follow in the scenario's order, then the obstacles."""


_CAR = Body(kind=CAR, length=4.5, width=1.8)  # formats ask for its kind alone


@dataclass(frozen=True, eq=False)
class Actor:
    """A road user or an obstacle.

    Attributes:
        name: what files call it.
        number: its id in formats that number objects.
        body: says shape and kind; None of the car under test, and of an obstacle, which is no road user.
        size: length, width and height of its box, m; the box of a disc is as long as it is wide.
        centre: how far ahead of its reference point the middle of its box is, m.
        times: n times, s; one of what stands all the time.
        states: n × 4: reference point (x, y), m, where it points, rad, and speed, m/s, in the frame `map`.
    """

    name: str
    number: int
    body: Body | None
    size: tuple[float, float, float]
    centre: float
    times: FloatArray
    states: FloatArray

    @property
    def stands(self) -> bool:
        """Whether one state says all."""
        return len(self.times) == 1

    @property
    def is_obstacle(self) -> bool:
        """Whether it is no road user."""
        return self.body is None and self.name != EGO

    @property
    def centres(self) -> FloatArray:
        """Middle of its box, n × 2, m."""
        if self.centre == 0.0:
            return self.states[:, :2]
        heading = self.states[:, 2]
        return np.asarray(self.states[:, :2] + self.centre * np.column_stack([np.cos(heading), np.sin(heading)]))

    def word(self, where: str) -> str:
        """Return what a format calls a road user of its kind."""
        return called(_CAR if self.body is None else self.body, where)


@dataclass(frozen=True, eq=False)
class ExportedEpisode:
    """An episode or a φ, ready to go out.

    Attributes:
        stem: name of its file, without an ending.
        title: what it is, in a line.
        scenario: scenario of the test.
        actors: car under test (first, if it is in it), adversary, others, obstacles.
        start: state of the car at the beginning: reference point (x, y), m, heading, rad, speed, m/s.
        duration: time of the last state, s.
        date: when the result was made, as ISO 8601 has it.
        whole_ticks: whether the last state is that of the tick in which the contact was, and not of the contact itself.
        about: what export.json says of it.
    """

    stem: str
    title: str
    scenario: Scenario
    actors: tuple[Actor, ...]
    start: tuple[float, float, float, float]
    duration: float
    date: str
    whole_ticks: bool = False
    about: Mapping[str, Any] = field(default_factory=dict)

    @property
    def ego(self) -> Actor | None:
        """The car under test; None where it is not in it."""
        return next((one for one in self.actors if one.name == EGO), None)


def actors_of(scenario: Scenario, course: EpisodeMotion, *, with_car: bool) -> tuple[Actor, ...]:
    """Return all road users and obstacles of an episode.

    Args:
        scenario: road and shapes.
        course: how it went; without the car its column may hold anything.
        with_car: whether the car is one of them.
    """
    car, found = scenario.car, []
    if with_car:
        scene = scene_of(scenario, *course)
        size = (car.front + car.rear, car.width, height_of(CAR))
        found.append(Actor(EGO, EGO_ID, None, size, 0.5 * (car.front - car.rear), course.times, scene.car))
    found.append(_moving(ADVERSARY, ADVERSARY_ID, scenario.adversary, course.times, course.adversary))
    for index, other in enumerate(scenario.others):
        ticks = max(1, math.ceil(course.times[-1] / scenario.time_step - 1e-9))
        states = np.array([one[:2] for one in other.states(ticks, scenario.time_step)])
        grid = scenario.time_step * np.arange(ticks + 1)
        times = course.times[:1] if other.stands else course.times
        places = interpolated(times, grid, states)
        found.append(_moving(OTHER.format(index + 1), FIRST_OTHER_ID + index, other, times, places))
    number = FIRST_OTHER_ID + len(scenario.others)
    for index, one in enumerate(scenario.obstacles):
        # One that hides nothing is as low as a guard rail.
        size = (one.length, one.width, height_of(CAR) if one.hides in (None, True) else 0.5)
        state = np.array([[one.x, one.y, one.heading, 0.0]])
        found.append(Actor(OBSTACLE.format(index + 1), number + index, None, size, 0.0, course.times[:1], state))
    return tuple(found)


def _moving(name: str, number: int, body: Body, times: FloatArray, places: FloatArray) -> Actor:
    velocity = velocities(times, places, np.array([0, len(times)]))
    states = np.column_stack([places, pointing(body, velocity), np.hypot(*velocity.T)])
    radius, half_length, half_width = body.shape
    size = (2.0 * (radius or half_length), 2.0 * (radius or half_width), height_of(body.kind))
    return Actor(name, number, body, size, 0.0, times, states)


def pointing(body: Body, velocity: FloatArray) -> FloatArray:
    """Return where a body points at each moment (rad), by its velocities then, n × 2, m/s.

    Formats want a heading of all: a disc, which points nowhere, looks where it goes, and before it goes where it
    will.
    """
    moves = np.flatnonzero((velocity != 0.0).any(axis=1))
    if not moves.size:
        return np.full(len(velocity), body.start_heading or 0.0)
    towards = np.arctan2(velocity[:, 1], velocity[:, 0])
    before: IntArray = np.searchsorted(moves, np.arange(len(velocity)), side="right") - 1
    first = body.first_heading if body.is_box else float(towards[moves[0]])
    return np.where(before < 0, first, towards[moves[np.maximum(before, 0)]])


def start_of(scenario: Scenario, phi: FloatArray) -> tuple[float, float, float, float]:
    """Return where the car begins when it meets φ (n × 2, m), before an episode's draw: x, y (m), heading, speed."""
    episode = EpisodeSpec(scenario, Mode.REPLAY, 0, 0, safe_trajectory=Trajectory(phi, scenario.time_step))
    x, y, heading = road_pose(scenario.road.line, -(episode.start_gap + scenario.car.front))
    return float(x), float(y), math.remainder(float(heading), math.tau), scenario.car.start_speed


def stretch(scenario: Scenario, recorded: Sequence[ExportedEpisode], lane: int = 0) -> tuple[float, float]:
    """Return the path coordinates of a lane, m, between which the road of some episodes is described."""
    line = scenario.road.line_of(lane)
    places = [one.states[:, :2] for each in recorded for one in each.actors]
    places += [np.array([each.start[:2]]) for each in recorded]
    along = right_and_along(line, np.ascontiguousarray(np.concatenate(places)))[:, 1]
    return math.floor(along.min() / 10.0) * 10.0 - _BEYOND, math.ceil(along.max() / 10.0) * 10.0 + _BEYOND


class DrawnLane(NamedTuple):
    """A lane as far as an episode needs it, as its drivers see it.

    Attributes:
        number: of it.
        left: its left edge in the direction of travel, n × 2, m.
        right: its right edge.
        beside: numbers of the lanes to its left and right; None: none.
    """

    number: int
    left: FloatArray
    right: FloatArray
    beside: tuple[int | None, int | None]


def lanes_of(recorded: ExportedEpisode) -> list[DrawnLane]:
    """Return every lane of an episode, by number."""
    road, found = recorded.scenario.road, []
    for number, lane in sorted(road.every_lane.items()):
        low, high = stretch(recorded.scenario, [recorded], 0 if lane.beside else number)
        edges, step = [road.edge(side, low, high, number) for side in (-1.0, 1.0)], 1
        if lane.direction == ONCOMING:  # its own left is the road's right
            edges, step = [edges[1][::-1], edges[0][::-1]], -1
        known = {one for one, other in road.every_lane.items() if lane.beside and other.beside}
        left, right = (one if one in known else None for one in (number - step, number + step))
        found.append(DrawnLane(number, edges[0], edges[1], (left, right)))
    return found


_BEYOND = 50.0
"""m of road before and behind all road users."""
