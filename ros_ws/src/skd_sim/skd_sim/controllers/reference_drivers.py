"""Published drivers: UN R157's careful and competent one, Reg157, RSS, fuzzy safety model, brakes, IDM, Krauss.

A driver sees each road user along the road's centre line (`RelativeState`), and reacts to what its law calls critical:
it brakes after a delay, with a bounded jerk. Laws and constants are published, each beside its source. They are stepped
ten times a second, as in the public code of the JRC (github.com/ec-jrc/JRC-FSM, 2021).

What SKD adds is in `ReferenceDriver`. Published runs end with one emergency; here the driver goes back to its speed
when its path is free. Published laws speak of cars; a pedestrian or a cyclist is to them another car of its size. That
is SKD's own variant: where such a road user is seen first stands for the centre of its lane.
"""

from __future__ import annotations

import functools
import json
import math
from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from skd_sim.scenario.road import road_pose, road_position
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.state import CarState, FloatArray, Scene, to_body

PERIOD = 0.1  # s between two decisions, as in the JRC's code
GRAVITY = 9.81  # m/s²
FULL_BRAKING = 0.774 * GRAVITY  # m/s², R157
JERK = 12.65  # m/s³: full braking within 0.6 s, R157
DELAY = 0.75  # s, R157: from the end of perception to the brake
RESUME = 1.0  # m/s², with which a car goes back to its speed (JRC)


class RelativeState(NamedTuple):
    """A car and a road user ahead of its centre, along the road.

    Attributes:
        gap: from the car's front to the road user, m; negative beside the car.
        length: of both together, along the road, m.
        aside: from the car's side to the road user, m; negative where the road user is in the car's path.
        speed: of the car, m/s.
        lead: speed of the road user along the road, m/s.
        closing: its speed across the road towards the car's path, m/s.
        strayed: how far it has come towards the path since it was seen first, m.
    """

    gap: float
    length: float
    aside: float
    speed: float
    lead: float
    closing: float
    strayed: float

    @property
    def approach(self) -> float:
        """By how much the car is faster, m/s."""
        return self.speed - self.lead

    @property
    def time_to_collision(self) -> float:
        """Time to collision along the road, s."""
        return self.gap / self.approach if self.approach > 0.0 else math.inf

    @property
    def enters(self) -> bool:
        """Whether it is in the car's path, or will be before the car has passed it (FSM's lateral check)."""
        if self.aside <= 0.0:
            return True
        if self.closing <= 0.0 or self.approach <= 0.0:
            return False
        return self.aside / self.closing <= (self.gap + self.length) / self.approach + PERIOD


class ReferenceDriver(ABC):
    """A driver who keeps the speed, brakes for what is critical, and goes back to the speed when the path is free."""

    control_period = PERIOD
    delay, release = DELAY, 0.0
    """Time (s) for which something is critical before the brake, and deceleration (m/s²) in it."""
    jerk, braking = JERK, FULL_BRAKING
    """Bound of the jerk (m/s³), and deceleration that the driver brakes with in the end (m/s²)."""

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Take road, footprint and speed from the scenario; no law draws anything."""
        car = scenario.car
        self._line, self._desired = scenario.road.line, car.start_speed
        self._front, self._middle, self._half_width = car.front, 0.5 * (car.front - car.rear), car.half_width
        self._length = car.front + car.rear
        self._shapes = [body.shape for body in (scenario.adversary, *scenario.others)]
        self._first: list[float] = []
        self._applied = 0.0
        self._calm_down()

    def _calm_down(self) -> None:
        self._waited = self._deceleration = 0.0
        self._reacts = False

    def command(self, car: CarState, scene: Scene) -> float:
        """Return the acceleration, m/s²."""
        self._applied = self._answer(car.speed, self._situations(car, scene))
        return self._applied

    def _answer(self, speed: float, found: list[RelativeState]) -> float:
        critical = [one for one in found if self.is_critical(one)]
        if critical:
            self._reacts = True
            if self._waited < self.delay:
                self._waited += PERIOD
                return -self.release
            demand = max(map(self.demand, critical))
            self._deceleration = min(self._deceleration + self.jerk * PERIOD, demand)
            return -self._deceleration
        if self._reacts and any(one.aside <= 0.0 or one.closing > 0.0 for one in found):
            return 0.0
        self._calm_down()
        return min(RESUME, max(-RESUME, (self._desired - speed) / PERIOD))

    @abstractmethod
    def is_critical(self, one: RelativeState) -> bool:
        """Tell whether the driver reacts."""

    def demand(self, one: RelativeState) -> float:
        """Return the deceleration (m/s²) that the driver brakes with in the end."""
        return self.braking

    def _situations(self, car: CarState, scene: Scene) -> list[RelativeState]:
        """Return those of the road users that are ahead of the car's centre."""
        here, side = road_position(self._line, car.x, car.y)
        users = (scene.adversary, *scene.others)
        places = [road_position(self._line, one.x, one.y) for one in users]
        self._first = self._first or [abs(left - side) for _, left in places]
        found = []
        for (along, left), first, one, shape in zip(places, self._first, users, self._shapes, strict=True):
            if along - here <= self._middle:
                continue
            radius, half_length, half_width = shape
            _, _, heading = road_pose(self._line, along)
            cos, sin = abs(math.cos(one.heading - heading)), abs(math.sin(one.heading - heading))
            half_along = radius or half_length * cos + half_width * sin
            half_across = radius or half_length * sin + half_width * cos
            lead, to_left = to_body(one.vx, one.vy, heading)
            beside = left - side
            found.append(
                RelativeState(
                    gap=along - here - self._front - half_along,
                    length=self._length + 2.0 * half_along,
                    aside=abs(beside) - self._half_width - half_across,
                    speed=car.speed,
                    lead=lead,
                    closing=-math.copysign(1.0, beside) * to_left,
                    strayed=first - abs(beside),
                )
            )
        return found


class CarefulDriver(ReferenceDriver):
    """R157's careful and competent driver (Annex 4, Appendix 3; in the 01 series Annex 3, performance model 1)."""

    WANDERING = 0.375  # m to the side that cars drive without a meaning
    PERCEPTION = 0.4  # s to perceive the risk
    TIME_TO_COLLISION = 2.0  # s, above which there is no danger
    release = 0.4  # m/s² of a released pedal (JRC)

    def is_critical(self, one: RelativeState) -> bool:
        """Tell whether it is in the path or perceived to come over, and less than 2 s away."""
        comes = one.closing > 0.0 and one.strayed >= self.WANDERING + self.PERCEPTION * one.closing
        return (one.aside <= 0.0 or comes) and one.time_to_collision <= self.TIME_TO_COLLISION


class Reg157(ReferenceDriver):
    """R157's limit for cut-ins (5.2.5.2): who brakes no earlier than it has to, at 6 m/s² after 0.35 s."""

    braking = 6.0  # m/s²
    BESIDE = 0.5  # m from the car's path, where a road user has intruded (JRC)
    delay, jerk = 0.35, math.inf

    def is_critical(self, one: RelativeState) -> bool:
        """Tell whether it has intruded, and the time to collision is down to v/(2·6 m/s²) + 0.35 s."""
        least = one.approach / (2.0 * self.braking) + self.delay + PERIOD
        return one.aside <= self.BESIDE and one.time_to_collision <= least


class RssDriver(ReferenceDriver):
    """Responsibility-Sensitive Safety (Shalev-Shwartz et al. 2017, arXiv 1708.06374); constants of the JRC's code."""

    RESPONSE = 0.75  # s
    ACCELERATION, BRAKING = 3.0, 6.0  # m/s², of the car and of who leads
    ACROSS = 1.0  # m/s², acceleration and braking to the side
    FLUCTUATION = 0.3  # m, μ

    def is_critical(self, one: RelativeState) -> bool:
        """Tell whether both distances are less than safe (definitions 1 and 6)."""
        along = self._covered(one.speed, self.ACCELERATION, self.BRAKING)
        along -= max(0.0, one.lead) ** 2 / (2.0 * self.BRAKING)
        across = self.FLUCTUATION + max(0.0, self._covered(one.closing, self.ACROSS, self.ACROSS))
        return one.gap < along and one.aside < across

    def _covered(self, speed: float, acceleration: float, braking: float) -> float:
        """Return what one covers who accelerates for the response time and then brakes, m."""
        after = speed + self.RESPONSE * acceleration
        return 0.5 * (speed + after) * self.RESPONSE + max(0.0, after) ** 2 / (2.0 * braking)


class FuzzyDriver(ReferenceDriver):
    """The fuzzy safety model (Mattas et al. 2020, 2022; R157, 01 series, Annex 3, performance model 2)."""

    COMFORTABLE, HARD = 4.0, 6.0  # m/s² of the car
    LEAD = 7.0  # m/s², of who leads
    STANDING, MARGIN = 2.0, 2.0  # m, between two who stand, and more to be safe

    def is_critical(self, one: RelativeState) -> bool:
        """Tell whether it is in the path, or will be, and either metric says that it is not wholly safe."""
        return one.enters and self.proactive(one) + self.critical(one) > 0.0

    def demand(self, one: RelativeState) -> float:
        """Return a deceleration between comfortable and hard where a collision is near, below comfortable if not."""
        critical = self.critical(one)
        if critical > 0.0:
            return self.COMFORTABLE + critical * (self.HARD - self.COMFORTABLE)
        return self.proactive(one) * self.COMFORTABLE

    def proactive(self, one: RelativeState) -> float:
        """Return the proactive metric PFS, from 0 (safe even if who leads brakes fully) to 1."""
        base = one.speed * DELAY - max(0.0, one.lead) ** 2 / (2.0 * self.LEAD)
        safe = base + one.speed**2 / (2.0 * self.COMFORTABLE) + self.MARGIN
        return _share(one.gap - self.STANDING, safe, base + one.speed**2 / (2.0 * self.HARD))

    def critical(self, one: RelativeState) -> float:
        """Return the critical metric CFS, from 0 (safe if who leads keeps its speed) to 1."""
        if one.approach <= 0.0:
            return 0.0
        acceleration = max(self._applied, -self.COMFORTABLE)
        then = one.approach + DELAY * acceleration
        if then < 0.0:
            return float(one.gap < one.approach**2 / (2.0 * abs(self._applied)))
        base = (one.approach + 0.5 * DELAY * acceleration) * DELAY
        return _share(one.gap, base + then**2 / (2.0 * self.COMFORTABLE), base + then**2 / (2.0 * self.HARD))


def _share(gap: float, safe: float, unsafe: float) -> float:
    """Return 0 above the safe gap, 1 below the unsafe one, and a line in between."""
    if gap > safe:
        return 0.0
    return 1.0 if gap < unsafe else (safe - gap) / (safe - unsafe)


# --- emergency brakes by a distance, and the Intelligent Driver Model
# Formulas and constants of the brakes are those that Seiler, Song and Hedrick compare ("Development of a collision
# avoidance system", SAE 980853, 1998), for a car ahead in the lane. SKD's own variant takes pedestrians, cyclists and
# cars that cut in as ahead where `RelativeState.enters` says so.


class DistanceBrake(ReferenceDriver):
    """Brakes at once and fully when who is ahead is nearer than a distance."""

    delay, jerk = 0.0, math.inf

    def is_critical(self, one: RelativeState) -> bool:
        """Tell whether who is ahead is that near, and slower."""
        return one.enters and one.approach > 0.0 and one.gap <= self.distance(one.speed, max(0.0, one.lead))

    @abstractmethod
    def distance(self, speed: float, lead: float) -> float:
        """Return the distance (m) at which to brake, from the speeds of the car and of who leads, m/s."""


class MazdaBrake(DistanceBrake):
    """Doi et al., "Development of a rear-end collision avoidance system with automatic brake control", JSAE 1994."""

    braking = 6.0  # m/s², α1
    LEAD = 8.0  # m/s², α2
    SYSTEM, DRIVER = 0.1, 0.6  # s, τ1 and τ2
    STANDING = 5.0  # m, R_min

    def distance(self, speed: float, lead: float) -> float:
        """Return what both need to stop, and the delays."""
        stops = 0.5 * (speed**2 / self.braking - lead**2 / self.LEAD)
        return stops + speed * self.SYSTEM + (speed - lead) * self.DRIVER + self.STANDING


class HondaBrake(DistanceBrake):
    """Fujita, Akuzawa and Sato, "Radar brake system", ITS America 1995; it does not avoid all collisions."""

    braking = 7.8  # m/s², α1 and α2
    SYSTEM, BRAKING_TIME = 0.5, 1.5  # s, τ1 and τ2

    def distance(self, speed: float, lead: float) -> float:
        """Return the distance from the two times; shorter where who leads stands before the second."""
        first, second, braking = self.SYSTEM, self.BRAKING_TIME, self.braking
        if lead / braking >= second:
            return second * (speed - lead) + first * second * braking - 0.5 * braking * first**2
        return second * speed - 0.5 * braking * (second - first) ** 2 - lead**2 / (2.0 * braking)


class BerkeleyBrake(DistanceBrake):
    """Seiler, Song and Hedrick 1998: brakes when a collision can only be made weaker."""

    braking = 6.0  # m/s², α
    DELAY = 1.2  # s, τ1 + τ2: driver and brake

    def distance(self, speed: float, lead: float) -> float:
        """Return the distance that is lost in the delay, who leads braking."""
        return (speed - lead) * self.DELAY + 0.5 * self.braking * self.DELAY**2


class TimeToCollisionBrake(ReferenceDriver):
    """The emergency brake of F1TENTH (`safety_node` of CL2-UWaterloo/f1tenth_ws): below 1 s of r/max(−ṙ, 0), it stops.

    What a laser sees stands, to it. SKD's own variant asks the beam to the nearest corner of each road user alone.
    """

    THRESHOLD = 1.0  # s
    braking = 8.0  # m/s²: standstill is commanded, and a dry road gives this
    delay, jerk = 0.0, math.inf

    def is_critical(self, one: RelativeState) -> bool:
        """Tell whether range by range rate is below the threshold."""
        squared = one.gap**2 + max(0.0, one.aside + self._half_width) ** 2
        return one.gap > 0.0 and squared <= self.THRESHOLD * one.speed * one.gap


class CollisionMonitor(ReferenceDriver):
    """Nav2's collision monitor with the polygons of examples/collision_monitor, below a planner that sees nobody.

    `Approach` scales the requested speed by the time until its polygon is touched, over 2 s, if nothing but the car
    moves. `Bumper` stops. SKD's own variant: road users are rectangles, no laser, no rounding to steps of 0.05 s.
    """

    AHEAD, BESIDE = 3.0, 0.6  # m, of Bumper from the front; of both polygons from the sides
    BEFORE_COLLISION = 2.0  # s

    def _answer(self, speed: float, found: list[RelativeState]) -> float:
        """Return the acceleration (m/s²) to the speed that the monitor lets through."""
        gap = min((one.gap for one in found if self.is_critical(one)), default=math.inf)
        passed = 0.0 if gap <= self.AHEAD else min(self._desired, gap / self.BEFORE_COLLISION)
        return min(RESUME, (passed - speed) / PERIOD)

    def is_critical(self, one: RelativeState) -> bool:
        """Tell whether it is in the strip of the polygons."""
        return one.aside <= self.BESIDE


EXPONENT = 4  # δ
_LEAST_GAP = 0.01  # m, where the law would divide by nothing


class IdmConstants(NamedTuple):
    """What distinguishes one driver from another in the model; by default table I of its paper.

    Attributes:
        headway: T, s.
        acceleration: a, m/s².
        braking: b, comfortable, m/s².
        standing_gap: s₀, m.
    """

    headway: float = 1.6
    acceleration: float = 0.73
    braking: float = 1.67
    standing_gap: float = 2.0


PUBLISHED = IdmConstants()


def idm_acceleration(
    speed: float, desired_speed: float, gap: float, approach: float, driver: IdmConstants = PUBLISHED
) -> float:
    """Return v̇ (m/s²) of the model, without a bound: v̇ = a·[1 − (v/v₀)⁴ − (s*/s)²], s* = s₀ + v·T + v·Δv/(2√(ab)).

    Args:
        speed: v, m/s.
        desired_speed: v₀, m/s.
        gap: s, from the front bumper to what is ahead, m; infinity: nothing is.
        approach: Δv, by how much faster the car is than that, m/s.
        driver: constants of the model.
    """
    dynamic = speed * approach / (2.0 * math.sqrt(driver.acceleration * driver.braking))
    desired = driver.standing_gap + speed * driver.headway + dynamic
    interaction = max(0.0, desired) / max(gap, _LEAST_GAP)
    return driver.acceleration * (1.0 - (speed / desired_speed) ** EXPONENT - interaction * interaction)


class IdmDriver(ReferenceDriver):
    """The Intelligent Driver Model (Treiber, Hennecke and Helbing 2000): follows who is ahead and in its lane.

    v₀, 120 km/h in table I, is the scenario's speed. The model has no bound: the car's brake is one. SKD's own variant
    for pedestrians and cyclists takes them for cars as soon as they are in the lane, wherever they go.
    """

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Take the lane, too."""
        super().reset(scenario, rng)
        self._beside = 0.5 * scenario.road.lane_width - self._half_width

    def _answer(self, speed: float, found: list[RelativeState]) -> float:
        """Return the least acceleration (m/s²) that any road user calls for."""
        gaps = [(one.gap, one.approach) for one in found if self.is_critical(one)] or [(math.inf, 0.0)]
        return min(self._acceleration(speed, gap, approach) for gap, approach in gaps)

    def _acceleration(self, speed: float, gap: float, approach: float) -> float:
        """Return the acceleration of the law (m/s²) behind one road user: gap in m, approach in m/s."""
        return idm_acceleration(speed, self._desired, gap, approach)

    def is_critical(self, one: RelativeState) -> bool:
        """Tell whether it is ahead in the lane."""
        return one.gap >= 0.0 and one.aside <= self._beside


class EnhancedIdmDriver(IdmDriver):
    """The Enhanced IDM (Kesting, Treiber and Helbing 2010, arXiv 0912.3613), which SUMO's EIDM is built on.

    Less braking for what cuts in: IDM gives way to the heuristic of constant accelerations. SKD knows no acceleration
    of who is ahead, so that is 0. SUMO's reaction times and errors of estimation are left out.
    """

    CAR = IdmConstants(headway=1.5, acceleration=1.4, braking=2.0, standing_gap=2.0)  # table 1
    COOLNESS = 0.99  # c

    def _acceleration(self, speed: float, gap: float, approach: float) -> float:
        """Return the acceleration of the model (equations 2.5 and 2.6), m/s²."""
        plain = idm_acceleration(speed, self._desired, gap, approach, self.CAR)
        constant = -(max(0.0, approach) ** 2) / (2.0 * max(gap, _LEAST_GAP))
        if plain >= constant:
            return plain
        braking = self.CAR.braking
        softened = constant + braking * math.tanh((plain - constant) / braking)
        return (1.0 - self.COOLNESS) * plain + self.COOLNESS * softened


class KraussDriver(IdmDriver):
    """Krauss (thesis, Cologne 1998), with constants of SUMO's passenger cars; σ = 0: who drives does not dawdle."""

    ACCELERATION, BRAKING, EMERGENCY = 2.6, 4.5, 9.0  # m/s²: accel, decel, emergencyDecel
    REACTION = 1.0  # s, tau
    STANDING_GAP = 2.5  # m, minGap

    def _acceleration(self, speed: float, gap: float, approach: float) -> float:
        """Return the acceleration (m/s²) to the safe speed, v_l + (g − v_l·τ)/((v + v_l)/(2b) + τ)."""
        lead = max(0.0, speed - approach)
        left = gap - self.STANDING_GAP - lead * self.REACTION
        safe = lead + left / ((speed + lead) / (2.0 * self.BRAKING) + self.REACTION) if gap < math.inf else gap
        target = max(0.0, min(safe, self._desired))
        return min(self.ACCELERATION, max(-self.EMERGENCY, (target - speed) / PERIOD))


# --- two policies of reinforcement learning: one of many crossings, and one overtrained on three
# scripts/train_policy.py trains them (PPO of stable-baselines3) and writes their weights beside this module: two layers
# of 16. They are small, and no match for what others train: they show what a rating says of such a car.

WEIGHTS = Path(__file__).with_name("learned_policies.json")
HARDEST = 8.0  # m/s², braking at an output of −1; an output of 1 is `RESUME`
_SCALES = np.array([20.0, 3.0, 8.0, 2.5, 2.5])


def features(one: RelativeState) -> FloatArray:
    """Return what a policy sees of a road user: gap, distance aside, and the speeds, 5 numbers of about 1."""
    seen = np.array([one.gap, one.aside, one.speed, one.lead, one.closing]) / _SCALES
    return np.asarray(np.minimum(np.maximum(seen, -2.0), 2.0))


def acceleration_of(output: float) -> float:
    """Return the acceleration (m/s²) for an output of a policy, which is clipped to −1 … 1."""
    return RESUME - 0.5 * (HARDEST + RESUME) * (1.0 - min(1.0, max(-1.0, output)))


class LearnedPolicy(ReferenceDriver):
    """A policy that brakes for each road user ahead as it was trained to."""

    policy = "broad"

    def _answer(self, speed: float, found: list[RelativeState]) -> float:
        """Return the least acceleration (m/s²) that any road user calls for."""
        free = min(RESUME, max(-RESUME, (self._desired - speed) / PERIOD))
        return min([free, *(acceleration_of(self._output(features(one))) for one in found)])

    def is_critical(self, one: RelativeState) -> bool:
        """Tell that the policy decides about everybody."""
        return True

    def _output(self, values: FloatArray) -> float:
        layers = _layers(self.policy)
        for weights, bias in layers[:-1]:
            values = np.maximum(_dot(weights, values) + bias, 0.0)
        weights, bias = layers[-1]
        return float((_dot(weights, values) + bias)[0])


class OvertrainedPolicy(LearnedPolicy):
    """The same network, trained on three crossings alone."""

    policy = "narrow"


def _dot(weights: FloatArray, values: FloatArray) -> FloatArray:
    """Return a product, summed input by input: the same bits on every machine, which no BLAS promises."""
    return np.asarray(np.sum(weights * values[:, None], axis=0))


@functools.cache
def _layers(policy: str) -> list[tuple[FloatArray, FloatArray]]:
    """Return weights, inputs × outputs, and bias of each layer."""
    found: list[Any] = json.loads(WEIGHTS.read_text(encoding="utf-8"))[policy]
    return [(np.array(one["weights"]), np.array(one["bias"])) for one in found]
