"""The MetaDrive engine of this process, and its frames behind `FramedSimulator`. Imports MetaDrive.

A straight road with the car on it, built anew for another car or road. Panda3D has one engine a process. It belongs to
the process that started it, and a fork of that cannot use it. The car always starts at the same place of MetaDrive's
road, where its numbers, which have 24 bits, are the same each time; where the crossing lies is different instead.
"""

from __future__ import annotations

import logging
import math
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, ClassVar, Final

from metadrive.engine.base_engine import BaseEngine
from metadrive.engine.engine_utils import close_engine
from metadrive.envs.metadrive_env import MetaDriveEnv
from panda3d.core import Vec3

from skd_sim.errors import UsageError
from skd_sim.scenario.road import HEADING_NORTH, SAME, Road
from skd_sim.scenario.scenario import Scenario
from skd_sim.simulators.metadrive.pedals import FULL_SPEED, LEAST_SPEED, MeasuredPedal, Pedals
from skd_sim.simulators.metadrive.vehicle import FULL_LOCK, Cast, Placed, VehicleSpec
from skd_sim.simulators.simulator import SimulatorError, States
from skd_sim.world.dynamics.basic import CommandLimits
from skd_sim.world.episode import AbortKind
from skd_sim.world.state import AdversaryState, CarState, Pair, RoadUserState, Triple, on_grid, velocity_on_grid

PHYSICS_STEP: Final = 0.02
"""MetaDrive's own step of the physics, s; the longest that is taken."""
START: Final = 20.0
"""How far along MetaDrive's road the car starts, m."""
_AHEAD: Final = -90.0  # degrees about the vertical, of a car of MetaDrive that points along its road
_SETTLING: Final = 4.0  # s in which a car that was dropped comes to rest on its springs
_SHORTEST_BLOCK: Final = 40.0  # m of MetaDrive's blocks of straight road
_FIRST_BLOCK: Final = 50.0  # m
_BLOCKS_AT_ONCE: Final = 8  # so that scenarios of about the same length share a road


@dataclass(frozen=True)
class StageSpec:
    """On what MetaDrive's world depends.

    Attributes:
        vehicle: the car.
        lane_width: width of each lane, m.
        left: number of lanes to the left of the car's own.
        right: number of lanes to its right.
        blocks: number of MetaDrive's blocks of straight road.
    """

    vehicle: VehicleSpec
    lane_width: float
    left: int
    right: int
    blocks: int

    @classmethod
    def of(cls, scenario: Scenario) -> StageSpec:
        """Return that of a scenario."""
        vehicle = VehicleSpec.of(scenario)
        furthest = START + scenario.horizon * vehicle.top_speed / 3.6 + scenario.car.front - _FIRST_BLOCK
        blocks = max(1, math.ceil(furthest / _SHORTEST_BLOCK / _BLOCKS_AT_ONCE)) * _BLOCKS_AT_ONCE
        beside = _same_direction(scenario.road)
        left, right = sum(number < 0 for number in beside), sum(number > 0 for number in beside)
        return cls(vehicle, scenario.road.lane_width, left, right, blocks)


def _same_direction(road: Road) -> list[int]:
    """Return the numbers of the lanes beside the car's that are driven its way, as far as nothing is between."""
    numbers = {lane.number for lane in road.lanes if lane.beside and lane.direction == SAME}
    between = {number: range(1, number) if number > 0 else range(number + 1, 0) for number in numbers}
    return [number for number in numbers if numbers.issuperset(between[number])]


@dataclass(frozen=True)
class Decided:
    """What a driver within MetaDrive has decided.

    Attributes:
        steering: in [−1, 1], to the left.
        pedal: in [−1, 1], the throttle's or, below 0, the brake's.
        acceleration: what the pedal stands for, m/s², by which its driver tells SKD.
    """

    steering: float
    pedal: float
    acceleration: float


class _Env(MetaDriveEnv):
    """MetaDrive's environment, which lets the car be given what it otherwise draws."""

    @classmethod
    def default_config(cls) -> Any:
        config = super().default_config()
        added = ("wheel_friction", "max_engine_force", "max_brake_force", "max_steering", "max_speed_km_h")
        config["vehicle_config"].update(dict.fromkeys(added), allow_add_new_key=True)
        return config


LIDAR: Final = {"num_lasers": 240, "distance": 50.0, "num_others": 4, "gaussian_noise": 0.0, "dropout_prob": 0.0}
"""What MetaDrive's expert sees: 240 beams of 50 m, and the four nearest vehicles."""


def environment_config(spec: StageSpec) -> dict[str, Any]:
    """Return MetaDrive's configuration of a stage: a straight road without traffic, physics alone, no picture."""
    lane = (">>", ">>>", spec.left)
    return {
        "traffic_density": 0.0,
        "log_level": logging.CRITICAL,
        "random_spawn_lane_index": False,
        "map_config": {
            "lane_num": 1 + spec.left + spec.right,
            "lane_width": spec.lane_width,
            "type": "block_sequence",
            "config": "S" * spec.blocks,
            "exit_length": _FIRST_BLOCK,
            "start_position": [0, 0],
        },
        "vehicle_config": {**spec.vehicle.config, "lidar": dict(LIDAR), "show_navi_mark": False},
        "agent_configs": {"default_agent": {"use_special_color": True, "spawn_lane_index": lane}},
    }


@contextmanager
def without_assets() -> Iterator[None]:
    """Have an engine that starts fetch nothing: the physics alone uses none of MetaDrive's pictures and models."""
    fetches = BaseEngine.try_pull_asset
    BaseEngine.try_pull_asset = lambda self: None
    try:
        yield
    finally:
        BaseEngine.try_pull_asset = fetches


class MetaDriveStage:
    """MetaDrive with one car on one road.

    Attributes:
        spec: on what it depends.
        step: length of a step of the physics, s.
        owner: id of the process to which it belongs.
        across: where the centre of the car's lane is across MetaDrive's road, m.
        cast: bodies of everybody but the car; None before there are any.
        decided: what a driver within MetaDrive has decided, until it is done.
    """

    def __init__(self, spec: StageSpec) -> None:
        """Start the engine."""
        self.spec, self.owner, self.step = spec, os.getpid(), PHYSICS_STEP
        self.env = env = _Env(environment_config(spec))
        with without_assets():
            env.reset(seed=0)
        self.engine: Any = env.engine
        lane = env.current_map.road_network.get_lane((">>", ">>>", spec.left))
        self.across = float(lane.position(0.0, 0.0)[1])
        self.cast: Cast | None = None
        self.decided: Decided | None = None
        self._rest = (0.5 * self.car.HEIGHT, 0.0)
        self._settle()

    @property
    def car(self) -> Any:
        """MetaDrive's vehicle."""
        return self.env.agent

    def cast_for(self, scenario: Scenario) -> Cast:
        """Return the bodies of a scenario, made if these are another's."""
        if self.cast is not None and not self.cast.fits(scenario):
            self.cast.close()
            self.cast = None
        if self.cast is None:
            self.cast = Cast(self.engine, scenario)
        return self.cast

    def place(self, speed: float) -> None:
        """Put the car at its start, at rest on its springs and at a speed (m/s)."""
        car = self.car
        car.reset(position=[START, self.across], heading=0.0)
        # All at once: angles that are set one by one keep a rounding of what they were before.
        car.origin.setPosHpr(START, self.across, self._rest[0], _AHEAD, self._rest[1], 0.0)
        for wheel in (car.system.getWheel(number) for number in range(4)):
            wheel.setRotation(0.0)
            wheel.setDeltaRotation(0.0)
        car.body.setLinearVelocity(Vec3(speed, 0.0, 0.0))
        car.last_velocity, car.last_speed = car.velocity, car.speed
        self._behind = 0.0, 0.0, 0.0

    def show_anew(self, cast: Cast) -> None:
        """Have rays find bodies where they are: without a step of the physics they look where these were before."""
        world = self.engine.physics_world.dynamic_world
        for body in cast.everybody:
            world.remove(body.body)
            world.attach(body.body)

    def drive(self, steering: float, pedal: float) -> None:
        """Turn the wheel and press a pedal, both in [−1, 1], from the next step on, as MetaDrive's drivers do."""
        self.car.before_step((steering, pedal))

    def press(self, pedal: float) -> None:
        """Press a pedal in [−1, 1] from the next step on, without a decision."""
        self.car.set_throttle_brake(pedal)

    def advance(self) -> None:
        """Take one step of the physics."""
        velocity, turning = self.car.body.getLinearVelocity(), self.car.body.getAngularVelocity()
        self._behind = velocity[0] * self.step, velocity[1] * self.step, turning[2] * self.step
        self.engine.global_config["physics_world_step_size"] = self.step
        self.engine.step_physics_world()

    @property
    def pose(self) -> Triple:
        """Where the centre of the car's body is now (x, y; m), and its heading, rad.

        Bullet tells where bodies were a step of the physics ago (`btDiscreteDynamicsWorld` interpolates with latency).
        In that step they went on at the velocity that they had before it.
        """
        (x, y), (dx, dy, turn) = self.car.position, self._behind
        return float(x) + dx, float(y) + dy, float(self.car.heading_theta) + turn

    @property
    def speed(self) -> float:
        """Speed of the car along its heading, m/s; below zero backwards."""
        ahead, left = self.car.heading
        velocity = self.car.body.getLinearVelocity()
        return float(velocity[0] * ahead + velocity[1] * left)

    def touches(self, body: Any) -> bool:
        """Return whether by MetaDrive's own shapes the car touches a body now."""
        world = self.engine.physics_world.dynamic_world
        return bool(world.contactTestPair(self.car.chassis.node(), body.body).getNumContacts() > 0)

    def _settle(self) -> None:
        """Find how the car stands on its springs."""
        self.place(0.0)
        self.drive(0.0, 0.0)
        for _ in range(round(_SETTLING / self.step)):
            self.advance()
        self._rest = (float(self.car.origin.getZ()), float(self.car.origin.getP()))

    def measure(self, start_speed: float) -> Pedals:
        """Drive the car with each pedal, and return what each does; see `Pedals`.

        Args:
            start_speed: speed from which it brakes, m/s.
        """
        speed = max(start_speed, FULL_SPEED)
        return Pedals(
            tuple(MeasuredPedal(pedal, self._braked(pedal, speed)) for pedal in Pedals.BRAKES),
            tuple(MeasuredPedal(pedal, self._pushed(pedal)) for pedal in Pedals.THROTTLES),
            self._pushed(0.0),
        )

    def _braked(self, brake: float, speed: float) -> float:
        """Return the mean acceleration of a stop, by its distance, m/s²."""
        self.place(speed)
        self.drive(0.0, -brake)
        begin, first = self.pose[0], self.speed
        while self.speed > LEAST_SPEED:
            self.advance()
        return (self.speed**2 - first**2) / (2.0 * (self.pose[0] - begin))

    def _pushed(self, throttle: float) -> float:
        """Return the mean acceleration of half a second, m/s²."""
        self.place(0.5 * FULL_SPEED)
        self.drive(0.0, throttle)
        steps, first = round(0.5 / self.step), self.speed
        for _ in range(steps):
            self.advance()
        return (self.speed - first) / (steps * self.step)


class _Running:
    """What this process has: its stage, and what pedals were found to do, by car, step and start speed."""

    stage: MetaDriveStage | None = None
    pedals: ClassVar[dict[tuple[StageSpec, float, float], Pedals]] = {}


def running() -> MetaDriveStage | None:
    """Return the stage that this process has, if any."""
    stage = _Running.stage
    return stage if stage is not None and stage.owner == os.getpid() else None


def stage_for(scenario: Scenario) -> MetaDriveStage:
    """Return the stage of this process, for a scenario and its step of the physics; started if need be.

    Raises:
        UsageError: this process is a fork of one that has an engine.
    """
    spec, stage = StageSpec.of(scenario), _Running.stage
    if stage is not None and stage.owner != os.getpid():
        raise UsageError(
            "simulator metadrive: this process was forked from one in which MetaDrive runs, and its engine does not "
            "survive that; run episodes in one of the two alone"
        )
    if stage is None or stage.spec != spec:
        if stage is not None:
            _Running.stage = None
            close_engine()
        _Running.stage = stage = MetaDriveStage(spec)
    stage.step = step_of(scenario)
    return stage


def end() -> None:
    """End the engine of this process, if it has one."""
    if running() is not None:
        _Running.stage = None
        close_engine()


def step_of(scenario: Scenario) -> float:
    """Return the longest step of the physics (s) that divides a scenario's control period: MetaDrive's own, or less."""
    duration = scenario.control_duration
    return duration / math.ceil(duration / PHYSICS_STEP - 1e-9)


def pedals_of(stage: MetaDriveStage, scenario: Scenario) -> Pedals:
    """Return what the pedals of a stage's car do, measured once in this process, before an episode begins."""
    what = stage.spec, stage.step, scenario.car.start_speed
    if what not in _Running.pedals:
        _Running.pedals[what] = stage.measure(scenario.car.start_speed)
    return _Running.pedals[what]


_POSITION_ERROR: Final = 0.01  # m


class MetaDriveFrames:
    """A `FrameSource`; MetaDrive's frame has the road along x and its left along y.

    Attributes:
        frame_step: time between frames, s.
        limits: least and greatest acceleration of the car, as measured.
        position_error: greatest distance in this episode between where MetaDrive has the adversary and where it was
            commanded to be, m.
    """

    def __init__(self, scenario: Scenario) -> None:
        """Build road and car of a scenario, and measure the car's pedals.

        Raises:
            UsageError: MetaDrive cannot run in this process.
        """
        self._stage: MetaDriveStage = stage_for(scenario)
        self._pedals = pedals_of(self._stage, scenario)
        self.frame_step: float = self._stage.step
        self.limits: CommandLimits = self._pedals.limits
        self.position_error = 0.0

    def prepare(self, scenario: Scenario) -> None:
        """Bring the road users of a scenario on."""
        self._scenario, self._cast = scenario, self._stage.cast_for(scenario)
        self._middle = 0.5 * (scenario.car.front - scenario.car.rear)  # of the car's body, ahead of its reference point

    def show(self, others: Sequence[RoadUserState]) -> None:
        """Put the others where they are at the next frame's end, or at the start."""
        self._others = tuple(others)

    def place(self, car: CarState, adversary: AdversaryState) -> States:
        """Put car and adversary at the start; the car stands on its springs there."""
        self._ahead = START - self._middle - car.y  # how far along MetaDrive's road the crossing point is
        self._stage.place(car.speed)
        self._stage.decided = None
        self._at = adversary
        for body, one in zip(self._cast.standing, self._scenario.obstacles, strict=True):
            self._put(body, one.x, one.y, one.heading)
        self._put_moving()
        self._stage.show_anew(self._cast)
        self.position_error = 0.0
        return self._states()

    def control(self, acceleration: float, steering: float, velocity: Pair) -> None:
        """Press the pedal that stands for an acceleration, or do what a driver within MetaDrive has decided."""
        decided, self._stage.decided = self._stage.decided, None
        self._velocity, self._acceleration = velocity, acceleration
        if decided is not None and decided.acceleration == acceleration:
            self._holds = False
            self._stage.drive(decided.steering, decided.pedal)
        else:
            self._holds = acceleration < 0.0
            self._stage.drive(steering / FULL_LOCK, self._pedals.pedal(acceleration))

    def advance(self) -> States:
        """Take a step of the physics, at whose end all road users are where they are to be."""
        if self._holds:
            self._hold()
        vx, vy = self._velocity
        heading = float(on_grid(self._scenario.adversary.heading(self._at.heading, vx, vy)))
        x, y = self._at.x + self.frame_step * vx, self._at.y + self.frame_step * vy
        if self._scenario.adversary.is_box:
            vx, vy = velocity_on_grid(vx, vy)
        self._at = AdversaryState(x, y, vx, vy, heading)
        self._put_moving()
        self._stage.advance()
        return self._states()

    def touching(self) -> bool:
        """Return whether by MetaDrive's own shapes the car touches the adversary or one of the others."""
        return any(self._stage.touches(body) for body in (self._cast.adversary, *self._cast.others))

    def _hold(self) -> None:
        """Brake as much as it takes to stand, where the car comes to: under more, MetaDrive's trembles and creeps."""
        needed = abs(self._stage.speed) / self.frame_step
        if needed < -self._acceleration or self._stage.speed < 0.0:
            brakes = min(needed, -self._acceleration)
            self._stage.press(self._pedals.pedal(-brakes) if brakes > -self._pedals.coasting else 0.0)

    def _put_moving(self) -> None:
        self._put(self._cast.adversary, self._at.x, self._at.y, self._at.heading)
        for body, other in zip(self._cast.others, self._others, strict=True):
            self._put(body, other.x, other.y, other.heading)

    def _put(self, body: Placed, x: float, y: float, heading: float) -> None:
        body.put(self._ahead + y, self._stage.across - x, heading - HEADING_NORTH)

    def _states(self) -> States:
        """Return where MetaDrive has car and adversary, in the world's frame."""
        x, y, heading = self._stage.pose
        reference = (
            self._stage.across - y + self._middle * math.sin(heading),
            x - self._ahead - self._middle * math.cos(heading),
        )
        heading = float(on_grid(heading + HEADING_NORTH))
        self._check_adversary()
        return CarState(*reference, heading, max(0.0, self._stage.speed)), self._at

    def _check_adversary(self) -> None:
        """Hold MetaDrive's place of the adversary against where it is to be: its numbers have 24 bits, ours 53.

        Raises:
            SimulatorError: MetaDrive has it elsewhere.
        """
        x, y = self._cast.adversary.position
        error = math.hypot(self._stage.across - float(y) - self._at.x, float(x) - self._ahead - self._at.y)
        self.position_error = max(self.position_error, error)
        if not error <= _POSITION_ERROR:
            raise SimulatorError(
                AbortKind.FAILED, f"MetaDrive has the adversary {error:.3g} m from where it was commanded to be"
            )
