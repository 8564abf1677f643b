"""Node `carla_bridge` against a small stand-in for CARLA and its ROS bridge: the same topics, stepped the same way.

What it cannot show is how CARLA itself behaves; docs/scenarios.md says what has not been run.
"""

import contextlib
import ctypes
import importlib
import math
import sys
import sysconfig
import threading
import time
import uuid
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import rclpy
from common import PATIENCE, new_domain
from geometry_msgs.msg import AccelStamped, Pose, Twist, TwistStamped
from graph_support import HERE, in_domain
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from skd_msgs.msg import Episode as EpisodeMsg
from skd_msgs.msg import EpisodeResult
from skd_sim import AdversaryState, EpisodeSpec, Mode, Outcome, load_scenario
from skd_sim.ros.carla_bridge import Placement
from skd_sim.ros.from_messages import from_stamp, odometry_to_adversary, odometry_to_car
from skd_sim.ros.support import LATCHED, STREAM, Topic
from skd_sim.ros.to_messages import acceleration_command, episode_to_message, to_stamp, velocity_command
from skd_sim.ros_environment.installation import ensure_messages, is_sourced
from skd_sim.world.world import make_world

FRAME = 0.05
VELOCITY = (2.5, 0.0)
PLACE = (120.0, -40.0, 0.8)  # of the crossing in the map: x, y, yaw


@pytest.fixture(scope="session")
def messages() -> Iterator[Any]:
    """carla_msgs: the one that is sourced, or messages of the same fields that are built with those of another test."""
    if is_sourced():
        yield pytest.importorskip("carla_msgs.msg", reason="this ROS 2 has no carla_msgs")
        return
    prefix = ensure_messages([str(HERE / "messages")], "vendor_control_msgs")
    for _ in range(2):  # each time those whose own needs are met: the loader looks in no folder that is not on its path
        for library in prefix.glob("lib/*.so"):
            with contextlib.suppress(OSError):
                ctypes.CDLL(str(library), ctypes.RTLD_GLOBAL)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(sysconfig.get_path("purelib", vars={"base": str(prefix)}))
        patch.setitem(sys.modules, "carla_msgs.msg", importlib.import_module("vendor_base_msgs.msg"))
        yield sys.modules["carla_msgs.msg"]


class StandIn(Node):
    """Two points on a plane in the map, and others who stay where they are put; a step of 0.05 s on every STEP_ONCE."""

    def __init__(self, messages: Any, others: tuple[str, ...] = ()) -> None:
        super().__init__("stand_in")
        self.frame = 1000
        self.car = [0.0, 0.0, 0.0, 0.0]  # x, y, yaw, speed
        self.adversary = [0.0, 0.0, 0.0]  # x, y, yaw
        self.put: dict[str, list[tuple[float, float, float]]] = {role: [] for role in ("adversary", *others)}
        self.acceleration = 0.0
        self.walking = (0.0, 0.0)
        self.pedals_seen: set[tuple[float, float]] = set()
        ego, adversary = "/carla/ego_vehicle", "/carla/adversary"
        self.outputs = [self.create_publisher(Odometry, f"{actor}/odometry", 10) for actor in (ego, adversary)]
        self.create_subscription(messages.CarlaControl, "/carla/control", self.on_control, 10)
        self.create_subscription(messages.CarlaEgoVehicleControl, f"{ego}/vehicle_control_cmd", self.on_pedals, 10)
        self.create_subscription(messages.CarlaWalkerControl, f"{adversary}/walker_control_cmd", self.on_walk, 10)
        self.create_subscription(Pose, f"{ego}/control/set_transform", self.on_car_pose, 10)
        self.create_subscription(Twist, f"{ego}/control/set_target_velocity", self.on_car_twist, 10)
        for role in self.put:
            self.create_subscription(
                Pose, f"/carla/{role}/control/set_transform", lambda pose, role=role: self.on_pose(role, pose), 10
            )

    def on_car_pose(self, pose: Any) -> None:
        self.car[:3] = [pose.position.x, pose.position.y, 2.0 * math.atan2(pose.orientation.z, pose.orientation.w)]

    def on_car_twist(self, twist: Any) -> None:
        self.car[3] = twist.linear.x

    def on_pose(self, role: str, pose: Any) -> None:
        place = pose.position.x, pose.position.y, 2.0 * math.atan2(pose.orientation.z, pose.orientation.w)
        self.put[role].append(place)
        if role == "adversary":
            self.adversary = list(place)

    def on_pedals(self, message: Any) -> None:
        self.pedals_seen.add((round(message.throttle, 6), round(message.brake, 6)))
        self.acceleration = 4.0 * message.throttle - 8.0 * message.brake

    def on_walk(self, message: Any) -> None:
        self.walking = (message.speed * message.direction.x, message.speed * message.direction.y)

    def on_control(self, message: Any) -> None:
        assert message.command == message.STEP_ONCE
        self.frame += 1
        x, y, yaw, speed = self.car
        after = max(0.0, speed + FRAME * self.acceleration)
        way = 0.5 * FRAME * (speed + after)
        self.car = [x + way * math.cos(yaw), y + way * math.sin(yaw), yaw, after]
        self.adversary[0] += FRAME * self.walking[0]
        self.adversary[1] += FRAME * self.walking[1]
        facing = self.adversary[2]
        along = math.cos(facing) * self.walking[0] + math.sin(facing) * self.walking[1]
        aside = math.cos(facing) * self.walking[1] - math.sin(facing) * self.walking[0]
        self.report(0, self.car[:3], (after, 0.0))
        self.report(1, self.adversary, (along, aside))

    def report(self, output: int, pose: list[float], velocity: tuple[float, float]) -> None:
        message = Odometry()
        message.header.stamp = to_stamp(round(self.frame * FRAME * 1e9))
        message.header.frame_id = "map"
        message.pose.pose.position.x, message.pose.pose.position.y = pose[0], pose[1]
        message.pose.pose.orientation.z = math.sin(0.5 * pose[2])
        message.pose.pose.orientation.w = math.cos(0.5 * pose[2])
        message.twist.twist.linear.x, message.twist.twist.linear.y = velocity
        self.outputs[output].publish(message)


class Others(Node):
    """Evaluator, controller and adversary in one: one episode, the same command in each tick."""

    def __init__(self, episode: EpisodeSpec, acceleration: float) -> None:
        super().__init__("others")
        self.start = 5_000_000_000
        self.acceleration = acceleration
        self.result: Any = None
        self.cars: dict[int, Any] = {}
        self.adversaries: dict[int, AdversaryState] = {}
        self.commands = self.create_publisher(AccelStamped, Topic.ACCELERATION_COMMAND, STREAM)
        self.walks = self.create_publisher(TwistStamped, Topic.VELOCITY_COMMAND, STREAM)
        self.create_subscription(Odometry, Topic.EGO_ODOMETRY, self.on_car, STREAM)
        self.create_subscription(Odometry, Topic.ADVERSARY_ODOMETRY, self.on_adversary, STREAM)
        self.create_subscription(EpisodeResult, Topic.EPISODE_RESULT, self.on_result, STREAM)
        self.episodes = self.create_publisher(EpisodeMsg, Topic.EPISODE, LATCHED)
        self.episodes.publish(episode_to_message(episode, "test", self.start))

    def on_car(self, message: Any) -> None:
        stamp = from_stamp(message.header.stamp)
        self.cars[stamp] = odometry_to_car(message)
        self.commands.publish(acceleration_command(self.acceleration, stamp))

    def on_adversary(self, message: Any) -> None:
        stamp = from_stamp(message.header.stamp)
        self.adversaries[stamp] = odometry_to_adversary(message)
        self.walks.publish(velocity_command(VELOCITY, stamp))

    def on_result(self, message: Any) -> None:
        self.result = message


def run(
    messages: Any, episode: EpisodeSpec, acceleration: float, *, others_there: tuple[str, ...] = ()
) -> tuple[Any, Others, StandIn]:
    """Run one episode to its result, with some actors in the map beside car and adversary."""
    x, y, yaw = PLACE
    arguments = ["--ros-args", "-p", f"crossing_x:={x}", "-p", f"crossing_y:={y}", "-p", f"crossing_yaw:={yaw}"]
    if not others_there and episode.scenario.others:
        arguments += ["-p", "startup_timeout:=0.5"]
    with in_domain(new_domain(), uuid.uuid4().hex):
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
        executor, ours = SingleThreadedExecutor(), SingleThreadedExecutor()
        done = threading.Event()
        try:
            bridge = importlib.import_module("skd_sim.ros.carla_bridge").CarlaBridge()
            ours.add_node(bridge)
            stand_in, others = StandIn(messages, others_there), Others(episode, acceleration)
            for node in (others, stand_in):
                executor.add_node(node)
            # The bridge waits for CARLA, which is another process: here, another thread.
            thread = threading.Thread(target=spin, args=(ours, done))
            thread.start()
            end = time.monotonic() + PATIENCE
            while others.result is None and time.monotonic() < end:
                executor.spin_once(timeout_sec=0.1)
            done.set()
            thread.join()
            return others.result, others, stand_in
        finally:
            done.set()
            for node in (*ours.get_nodes(), *executor.get_nodes()):
                node.destroy_node()
            rclpy.try_shutdown()


def spin(executor: SingleThreadedExecutor, done: threading.Event) -> None:
    while not done.is_set():
        executor.spin_once(timeout_sec=0.05)


def _episode(name: str, gap: float = 60.0, **changes: Any) -> EpisodeSpec:
    """A shipped scenario whose car drives on without noise, by default far away."""
    base = load_scenario(name)
    car = replace(base.car, speed_noise=0.0, acceleration_noise=0.0, start_gap=gap)
    return EpisodeSpec(replace(base, car=car, **changes), Mode.SAFE, 3, 4)


@pytest.mark.parametrize("gap", [9.0, 30.0])
def test_an_episode_ends_as_in_the_world(messages: Any, gap: float) -> None:
    """A car that drives on, so that the stand-in's motion and the world's are the same but for one frame of placing."""
    episode = _episode("crossing", gap)
    result, others, stand_in = run(messages, episode, 0.0)
    world = make_world(episode)
    # Tick 0 is what the first frame after the placing shows: the car has rolled for that frame.
    shifted = replace(episode.scenario.car, start_gap=gap - FRAME * world.car.speed)
    world = make_world(replace(episode, scenario=replace(episode.scenario, car=shifted)))
    contact, outcome = None, Outcome.RUNNING
    first = world.car
    while outcome == Outcome.RUNNING:
        contact = world.step(0.0, VELOCITY)
        outcome = episode.outcome(world.tick, world.adversary, collided=contact is not None)
    assert outcome == (Outcome.COLLISION if gap < 20.0 else Outcome.ARRIVED)
    assert (result.outcome, result.ticks, result.reason) == (outcome, world.tick, "")
    assert others.cars[others.start] == pytest.approx(first, abs=1e-6)
    assert len(others.cars) == world.tick + 1
    if contact is not None:
        # Controls and steps come by different topics: now and then one is a frame late.
        assert result.impact_time == pytest.approx((world.tick - 1 + contact.fraction) * 0.3, abs=FRAME + 1e-6)
        assert result.impact_speed == pytest.approx(contact.speed)
    else:
        assert math.isnan(result.impact_time)
    assert stand_in.pedals_seen == {(0.0, 0.0)}


def test_who_does_not_walk_is_put_where_its_velocity_takes_it(messages: Any) -> None:
    """A cyclist points the way it rides, in each frame of a tick, and its state in SKD is that of the world."""
    episode = _episode("cyclist")
    result, others, stand_in = run(messages, episode, 0.0)
    assert (result.outcome, result.reason) == (Outcome.ARRIVED, "")
    world = make_world(episode)
    states = [world.adversary]
    while world.tick < result.ticks:
        world.step(0.0, VELOCITY)
        states.append(world.adversary)
    seen = [state for _, state in sorted(others.adversaries.items())]
    np.testing.assert_allclose(seen, states, atol=1e-6)
    frames = 6 * result.ticks
    ways = np.array(stand_in.put["adversary"][-frames:])
    step = FRAME * np.array(Placement(*PLACE).vector_to_map(*VELOCITY))
    np.testing.assert_allclose(np.diff(ways[:, :2], axis=0), np.tile(step, (frames - 1, 1)), atol=1e-9)
    np.testing.assert_allclose(ways[:, 2], PLACE[2], atol=1e-6)  # East, in the crossing's frame
    assert stand_in.walking == (0.0, 0.0)


def test_others_and_obstacles_are_put_in_place(messages: Any) -> None:
    parked = load_scenario("child").obstacles
    episode = _episode("bystanders", obstacles=parked)
    names = (*(f"other_{index}" for index in range(4)), "obstacle_0", "obstacle_1")
    result, _, stand_in = run(messages, episode, 0.0, others_there=names)
    assert (result.outcome, result.reason) == (Outcome.ARRIVED, "")
    place = Placement(*PLACE)
    for index, one in enumerate(parked):
        assert stand_in.put[f"obstacle_{index}"][-1][:2] == pytest.approx(place.point_to_map(one.x, one.y))
    end = result.ticks * episode.scenario.time_step
    for index, state in enumerate(episode.scenario.others_after(end)):
        x, y, yaw = stand_in.put[f"other_{index}"][-1]
        assert (x, y) == pytest.approx(place.point_to_map(state.x, state.y))
        assert math.cos(yaw - PLACE[2] - state.heading) == pytest.approx(1.0)
    van = np.array(stand_in.put["other_3"][-6 * result.ticks :])
    steps = np.hypot(*np.diff(van[:, :2], axis=0).T)
    np.testing.assert_allclose(steps, 10.0 * FRAME, atol=1e-6)  # moves in every frame, not in every tick
