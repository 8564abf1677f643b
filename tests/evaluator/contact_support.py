"""What happened within the ticks of an episode, by a brute force that shares nothing with the contact test.

Everything that the world asks of the car's dynamics is written down: where the car was every few milliseconds, after a
contact, too. Who was touched first, where and how fast is then looked up moment by moment.
"""

import math
from typing import NamedTuple

import numpy as np
from skd_evaluator.assessment.run.episodes import run_episode
from skd_evaluator.metrics.risks import Touch
from skd_sim.controllers.protocol import Controller
from skd_sim.scenario.scenario import Scenario
from skd_sim.simulators.simulator import Frame, WorldSimulator
from skd_sim.world.episode import EpisodeLog, EpisodeSpec

STEP = 5e-4  # s between the moments that are looked at
UNSURE = 2e-3  # m to the corner's beginning within which it is not said which side touches


class Seen(NamedTuple):
    """What the car and whom it touched did: who (−1: the adversary), when (s), the car's pose and speed, which side."""

    who: int
    time: float
    car: tuple[float, float, float, float]
    touch: Touch | None  # None: it is too near to the corner's beginning to say


class Driven:
    """A car's dynamics that write down where the car was."""

    def __init__(self, dynamics) -> None:
        self.dynamics = dynamics
        self.times, self.states = [0.0], []

    def advance(self, acceleration, duration, noise):
        path = self.dynamics.advance(acceleration, duration, noise)
        if not self.states:
            self.states.append(path[0])
        for part in range(1, len(path)):
            self.times.append(self.times[0] + duration * part / (len(path) - 1))
            self.states.append(path[part])
        self.times[0] = self.times[-1]
        return path

    def __getattr__(self, name):
        return getattr(self.dynamics, name)


class WatchedWorld(WorldSimulator):
    """SKD's own world, whose car is watched within the ticks."""

    def reset(self, episode: EpisodeSpec) -> Frame:
        frame = super().reset(episode)
        self.driven = Driven(self._world._dynamics)
        self._world._dynamics = self.driven
        return frame

    def course(self) -> tuple[np.ndarray, np.ndarray]:
        """Moments, s, and x, y, heading and speed then."""
        states = np.array(self.driven.states)
        states[:, 2] = np.unwrap(states[:, 2])
        return np.array([0.0, *self.driven.times[1:]]), states


def watched(episode: EpisodeSpec, controller: Controller | None = None) -> tuple[EpisodeLog, Seen | None]:
    """Run an episode, and return its log and what was seen: None where nobody was touched."""
    world = WatchedWorld()
    log = run_episode(episode, controller, simulator=world)
    return log, seen(log, *world.course())


def seen(log: EpisodeLog, times: np.ndarray, states: np.ndarray) -> Seen | None:
    """Return the first touch in an episode of discs in which the car was in these states at these times."""
    scenario = log.episode.scenario
    last = scenario.time_step * (len(log.adversary) - 1)
    standing = [scenario.others_at(tick) for tick in range(len(log.adversary))]

    def car(moments):
        return np.column_stack([np.interp(moments, times, column) for column in states.T])

    def apart(moments):
        poses, walked = car(moments), np.arange(len(log.adversary)) * scenario.time_step
        body = np.column_stack([np.interp(moments, walked, column) for column in log.adversary.T])
        found = [distances(poses, body, scenario) - scenario.adversary.reach]
        for number, other in enumerate(scenario.others):
            ends = np.array([(one[number].x, one[number].y) for one in standing])
            body = np.column_stack([np.interp(moments, walked, column) for column in ends.T])
            found.append(distances(poses, body, scenario) - other.reach)
        return np.array(found)

    moments = np.append(np.arange(0.0, last, STEP), last)
    touched = (apart(moments) <= 0.0).any(axis=0)
    if not touched.any():
        return None
    first = int(np.argmax(touched))
    low, high = moments[max(0, first - 1)], moments[first]
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if (apart(np.array([middle])) <= 0.0).any() else (middle, high)
    at = np.array([high])
    who = int(np.argmin(apart(at)[:, 0])) - 1
    pose = car(at)[0]
    walked = np.arange(len(log.adversary)) * scenario.time_step
    body = np.array([[np.interp(high, walked, column) for column in log.adversary.T]])
    touch = Touch.NONE if who >= 0 else side(pose, body, scenario)
    return Seen(who, float(high), tuple(pose.tolist()), touch)


def in_frame(poses: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return how far ahead and to the left of the car places are."""
    ahead = np.column_stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])])
    off = places - poses[:, :2]
    return (off * ahead).sum(axis=1), off[:, 1] * ahead[:, 0] - off[:, 0] * ahead[:, 1]


def distances(poses: np.ndarray, places: np.ndarray, scenario: Scenario) -> np.ndarray:
    """Return how far places are from the nearest point of the car's rectangle."""
    ahead, left = in_frame(poses, places)
    car = scenario.car
    return np.hypot(ahead - np.clip(ahead, -car.rear, car.front), left - np.clip(left, -car.half_width, car.half_width))


def side(pose: np.ndarray, body: np.ndarray, scenario: Scenario) -> Touch | None:
    """Return which side of the car a disc touches: the one that holds the nearest point of the rectangle."""
    ahead, left = (float(one[0]) for one in in_frame(pose[None], body))
    car, speed = scenario.car, pose[3]
    if abs(speed - scenario.collision.hit_speed) < 1e-6:
        return None
    if speed < scenario.collision.hit_speed:
        return Touch.STANDING
    if abs(left) > car.half_width and abs(ahead - car.front) < UNSURE:
        return None
    assert math.isfinite(ahead)
    return Touch.FRONT if ahead > car.front else Touch.FLANK
