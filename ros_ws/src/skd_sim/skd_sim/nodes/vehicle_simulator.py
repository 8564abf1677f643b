"""Node `vehicle_simulator`: advances the world and tells everybody where car and pedestrian are.

`lockstep`: publishes the state of tick k and advances when both commands stamped t_k have arrived. `real_time`: ticks
on its own and holds the last commands. A command source that stays silent ends the episode as ABORTED, by name.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import Any

from geometry_msgs.msg import AccelStamped, Twist, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rosgraph_msgs.msg import Clock as ClockMsg
from sensor_msgs.msg import LaserScan
from skd_msgs.msg import Episode as EpisodeMsg
from skd_msgs.msg import EpisodeResult

from skd_sim.aborts import AbortKind, abort_reason
from skd_sim.episode import Episode, Outcome
from skd_sim.from_messages import from_stamp, message_to_episode
from skd_sim.nodes.command_source import CommandSource
from skd_sim.nodes.stream_cdr import read_linear, write_car, write_pedestrian
from skd_sim.nodes.support import (
    ACCELERATION_COMMAND,
    CLOCK,
    EGO_ODOMETRY,
    EGO_SCAN,
    EPISODE,
    EPISODE_RESULT,
    LATCHED,
    PEDESTRIAN_ODOMETRY,
    STREAM,
    VELOCITY_COMMAND,
    Setting,
    declare,
    listen,
    run_node,
)
from skd_sim.nodes.to_messages import MAP_FRAME, scan_to_message, to_stamp
from skd_sim.sensors import make_laser
from skd_sim.stamps import tick_stamp
from skd_sim.world import Contact, World, make_world

_COMMAND_TYPES: dict[str, type] = {"accel_stamped": AccelStamped, "twist_stamped": TwistStamped, "twist": Twist}
_SETTINGS = (
    Setting(
        "pacing",
        "lockstep",
        "lockstep: advance when both commands have arrived; real_time: tick by the wall clock",
        choices=("lockstep", "real_time"),
    ),
    Setting("rate_factor", 1.0, "real_time only: simulated seconds per second", 0.01, 100.0),
    Setting("command_timeout", 5.0, "wall seconds without a command after which the episode is aborted", 0.05, 3600.0),
    Setting("startup_timeout", 60.0, "the same for an episode's first command, while nodes start", 0.05, 3600.0),
    Setting(
        "command_type",
        "accel_stamped",
        "what the controller under test publishes: accel_stamped (linear.x in m/s²), or a speed target "
        "(linear.x in m/s) as twist_stamped or twist",
        choices=tuple(_COMMAND_TYPES),
    ),
    Setting("maximum_acceleration", 3.0, "bound on following a speed target, m/s²", 0.1, 20.0),
    Setting("maximum_deceleration", 8.0, "bound on following a speed target, m/s²", 0.1, 20.0),
)
_WATCH_PERIOD = 0.05  # s of wall time
_REPEAT_PERIOD = 0.2  # s of wall time between repetitions of tick 0, which a node that joins late has missed


class VehicleSimulator(Node):
    """Ground truth of the graph; one episode at a time."""

    def __init__(self) -> None:
        """Declare parameters and topics; then wait for an episode."""
        super().__init__("vehicle_simulator")
        self._settings = declare(self, _SETTINGS)
        self._real_time = self._settings["pacing"] == "real_time"
        kind = self._settings["command_type"]
        self._clock_publisher = self.create_publisher(ClockMsg, CLOCK, STREAM)
        self._car = self.create_publisher(Odometry, EGO_ODOMETRY, STREAM)
        self._scan = self.create_publisher(LaserScan, EGO_SCAN, STREAM)
        self._pedestrian = self.create_publisher(Odometry, PEDESTRIAN_ODOMETRY, STREAM)
        self._result = self.create_publisher(EpisodeResult, EPISODE_RESULT, STREAM)
        self.create_subscription(EpisodeMsg, EPISODE, self._on_episode, LATCHED)
        self._drives = CommandSource(self, ACCELERATION_COMMAND, "the car controller")
        self._walks = CommandSource(self, VELOCITY_COMMAND, "the pedestrian adversary")
        if kind == "twist":
            self._drives.subscription = self.create_subscription(Twist, ACCELERATION_COMMAND, self._on_twist, STREAM)
        else:
            on_car = self._on_acceleration if kind == "accel_stamped" else self._on_speed_target
            self._drives.subscription = listen(self, _COMMAND_TYPES[kind], ACCELERATION_COMMAND, read_linear, on_car)
        self._walks.subscription = listen(self, TwistStamped, VELOCITY_COMMAND, read_linear, self._on_velocity)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._watch = self.create_timer(_WATCH_PERIOD, self._on_watch, clock=steady)
        self._ticker: Any = None
        self._steady = steady
        self._world: World | None = None
        self._message: Any = None

    # --- episodes

    def _on_episode(self, message: Any) -> None:
        known = self._message
        if known is not None and _identity(known) == _identity(message):
            return
        self._stop()
        self._message = message
        self._start = from_stamp(message.header.stamp)
        try:
            self._episode: Episode = message_to_episode(message)
            self._world = make_world(self._episode)
            self._laser = make_laser(self._episode)
        except ValueError as error:
            self.get_logger().error(str(error))
            reason = abort_reason(AbortKind.FAILED, f"vehicle_simulator: {error}")
            self._publish_result(Outcome.ABORTED, 0, self._start, None, reason)
            return
        self._forget_commands()
        self._drives.begin()
        self._walks.begin()
        self._began = False
        self._progress = time.monotonic()
        self._publish_state()
        self._refuse_crowds()

    def _stop(self) -> None:
        self._world = None
        if self._ticker is not None:
            self.destroy_timer(self._ticker)
            self._ticker = None

    def _forget_commands(self) -> None:
        self._acceleration: float | None = None
        self._velocity: tuple[float, float] | None = None

    # --- commands

    def _accepts(self, source: CommandSource, stamp: int, command: tuple[float, ...]) -> bool:
        """Whether a command is for the tick now: lockstep takes no other, real time takes any of this episode."""
        if self._world is None:
            return False
        if self._real_time:
            wanted = stamp >= self._start
        else:
            now = self._stamp()
            wanted = stamp == now
            if self._start <= stamp <= now:
                problem = source.contradicts(stamp, command, self._start)
                if problem is not None:
                    self._abort(problem)
                    return False
        if not wanted:
            source.ignore(stamp)
        return wanted

    def _on_acceleration(self, stamp: int, linear: tuple[float, float]) -> None:
        if self._accepts(self._drives, stamp, linear[:1]):
            self._take_acceleration(linear[0])

    def _on_speed_target(self, stamp: int, linear: tuple[float, float]) -> None:
        if self._accepts(self._drives, stamp, linear[:1]):
            self._take_speed_target(linear[0])

    def _on_twist(self, message: Any) -> None:
        if self._world is not None:
            self._take_speed_target(float(message.linear.x))

    def _take_speed_target(self, target: float) -> None:
        assert self._world is not None
        wanted = (target - self._world.car.speed) / self._episode.scenario.time_step
        low, high = -self._settings["maximum_deceleration"], self._settings["maximum_acceleration"]
        self._take_acceleration(min(high, max(low, wanted)) if math.isfinite(target) else target)

    def _take_acceleration(self, acceleration: float) -> None:
        if not math.isfinite(acceleration):
            self._abort(abort_reason(AbortKind.NOT_FINITE, f"{self._drives.who} commanded {acceleration}"))
            return
        self._acceleration = acceleration
        self._advance_if_ready()

    def _on_velocity(self, stamp: int, velocity: tuple[float, float]) -> None:
        if not self._accepts(self._walks, stamp, velocity):
            return
        if not all(map(math.isfinite, velocity)):
            said = f"{self._walks.who} commanded {velocity[0]}, {velocity[1]}"
            self._abort(abort_reason(AbortKind.NOT_FINITE, said))
            return
        self._velocity = velocity
        self._advance_if_ready()

    # --- ticks

    def _stamp(self) -> int:
        assert self._world is not None
        return tick_stamp(self._start, self._world.tick, self._episode.scenario.time_step)

    def _advance_if_ready(self) -> None:
        if self._acceleration is None or self._velocity is None:
            return
        if not self._real_time:
            self._advance()
        elif not self._began:
            period = self._episode.scenario.time_step / self._settings["rate_factor"]
            self._ticker = self.create_timer(period, self._advance, clock=self._steady)
        self._began = True

    def _advance(self) -> None:
        if self._world is None or self._acceleration is None or self._velocity is None:
            return
        contact = self._world.step(self._acceleration, self._velocity)
        if not self._real_time:
            self._forget_commands()
        self._progress = time.monotonic()
        self._publish_state()
        outcome = self._episode.outcome(self._world.tick, self._world.pedestrian, collided=contact is not None)
        if outcome != Outcome.RUNNING and not self._refuse_crowds():
            self._end(outcome, contact, "")

    def _publish_state(self) -> None:
        assert self._world is not None
        stamp = self._stamp()
        self._published = time.monotonic()
        self._clock_publisher.publish(ClockMsg(clock=to_stamp(stamp)))
        if self._laser is not None and self._scan.get_subscription_count():  # nobody pays for a scan that nobody wants
            scan = self._laser.scan(self._world.car, self._world.pedestrian, self._world.tick)
            self._scan.publish(scan_to_message(scan, stamp))
        self._car.publish(write_car(self._world.car, stamp))
        self._pedestrian.publish(write_pedestrian(self._world.pedestrian, stamp))

    def _on_watch(self) -> None:
        if self._world is None or self._refuse_crowds():
            return
        if self._real_time and self._began:
            self._watch_real_time()
            return
        now = time.monotonic()
        limit = self._settings["command_timeout" if self._world.tick else "startup_timeout"]
        if now - self._progress > limit:
            silent = [(self._drives, self._acceleration), (self._walks, self._velocity)]
            reasons = [
                source.silence(self._stamp(), limit, self._world.tick) for source, command in silent if command is None
            ]
            self._abort(" and ".join(reasons))
        elif self._world.tick == 0 and now - self._published > _REPEAT_PERIOD:
            self._publish_state()

    def _refuse_crowds(self) -> bool:
        """Abort where more than one node sends one kind of command; to be asked now and then, not at each tick."""
        problem = self._drives.crowd() or self._walks.crowd()
        if problem is not None:
            self._abort(problem)
        return problem is not None

    def _watch_real_time(self) -> None:
        """In real time commands are held, so only a source that is gone altogether can be noticed."""
        for source in (self._drives, self._walks):
            if source.subscription.get_publisher_count() == 0:
                gone = f"{source.who} (publisher of {source.topic}) is gone"
                self._abort(abort_reason(AbortKind.ENDED, gone))
                return

    # --- results

    def _abort(self, reason: str) -> None:
        if self._world is not None:
            self.get_logger().warning(f"episode aborted: {reason}")
            self._end(Outcome.ABORTED, None, reason)

    def _end(self, outcome: Outcome, contact: Contact | None, reason: str) -> None:
        assert self._world is not None
        self._publish_result(outcome, self._world.tick, self._stamp(), contact, reason)
        self._stop()

    def _publish_result(self, outcome: Outcome, ticks: int, end: int, contact: Contact | None, reason: str) -> None:
        result = EpisodeResult()
        result.header.stamp = to_stamp(end)
        result.header.frame_id = MAP_FRAME
        result.campaign = self._message.campaign
        result.episode_id = int(self._message.episode_id)
        result.start = to_stamp(self._start)
        result.outcome = int(outcome)
        result.ticks = ticks
        result.impact_time = math.nan
        result.impact_speed = math.nan
        result.reason = reason
        result.commands_clipped = self._world.clipped if self._world else 0
        if contact is not None:
            result.impact_time = (ticks - 1 + contact.fraction) * self._episode.scenario.time_step
            result.impact_speed = float(contact.speed)
        self._result.publish(result)


def _identity(message: Any) -> tuple[str, int, int]:
    return str(message.campaign), int(message.episode_id), from_stamp(message.header.stamp)


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    return run_node(VehicleSimulator, args)


if __name__ == "__main__":
    raise SystemExit(main())
