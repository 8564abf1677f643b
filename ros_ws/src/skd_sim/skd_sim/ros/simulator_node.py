"""Node `vehicle_simulator`, and the part of a simulator in the graph: states go out, commands come in.

The rules of an episode are `skd_sim.ros.lockstep`, the motion is the simulator's. Here are topics, parameters and
timers. `lockstep`: publishes the state of tick k and advances when both commands stamped t_k have arrived. `real_time`:
ticks on its own and holds the last commands. A command source that stays silent ends the episode as ABORTED, by name.
"""

from __future__ import annotations

import math
import time
from array import array
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from geometry_msgs.msg import AccelStamped, TwistStamped
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from skd_msgs.msg import Episode as EpisodeMsg
from skd_msgs.msg import EpisodeResult

from skd_sim.errors import UsageError
from skd_sim.options.options import MAP_FRAME, REAL_TIME, CommandOptions, SimulatorOptions, StateOptions, values_of
from skd_sim.ros import lockstep
from skd_sim.ros.commands import Quantity, angle_of_yaw_rate, car_commands, follow_speed
from skd_sim.ros.diagnosis import Awaited, Evidence, diagnose, kind_name, second_publisher
from skd_sim.ros.from_messages import from_stamp, message_to_episode
from skd_sim.ros.state_publisher import StatePublisher
from skd_sim.ros.support import LATCHED, STREAM, GraphNode, Topic, declare, run_node
from skd_sim.ros.to_messages import acceleration_command, header, to_stamp
from skd_sim.simulators.simulator import Frame, NamedSimulator, Simulator, SimulatorError, require_others
from skd_sim.world.dynamics.basic import Command, CommandLimits, wheels
from skd_sim.world.episode import AbortKind, EpisodeSpec, Outcome, abort_reason
from skd_sim.world.state import AdversaryState, CarState
from skd_sim.world.timing import Schedule

TABLES = (SimulatorOptions,)
"""Of every simulator's parameters."""

_WATCH_PERIOD = 0.05  # s of wall time
_NOWHERE = Frame(0, CarState(0.0, 0.0, 0.0, 0.0), AdversaryState(0.0, 0.0, 0.0, 0.0))  # of an episode that is refused


class _Publishers(lockstep.Senders):
    """Which nodes publish on a topic of commands, as the middleware sees it."""

    def __init__(self, node: Node, subscription: Any) -> None:
        self._node, self._subscription = node, subscription

    def count(self) -> int:
        return int(self._subscription.get_publisher_count())

    def crowd(self) -> str | None:
        return second_publisher(self._node, self._subscription.topic_name)

    def absence(self) -> str:
        awaited = Awaited(self._subscription.topic_name, kind_name(self._subscription.msg_type))
        return diagnose(Evidence(self._node, awaited)).text


class GraphSimulator:
    """Ground truth of the graph; one episode at a time.

    It speaks through a node that may belong to others as well. Objects of the same process hear states and results by
    a call, and call `begin` and `walk`; others use the topics.

    Attributes:
        on_frame: called with each state and its stamp (ns).
        on_result: called with the result of an episode, a skd_msgs/EpisodeResult.
    """

    def __init__(
        self, node: Node, simulator: Simulator, values: Mapping[str, Any], *, clock: bool = True, alone: bool = True
    ) -> None:
        """Make the topics; then wait for an episode.

        Args:
            node: node that speaks and listens.
            simulator: simulator that moves car and adversary.
            values: values of `TABLES` by name.
            clock: whether it publishes `/clock`; a simulator may do so itself.
            alone: whether evaluator and adversary are in other processes.
        """
        self._node, self._simulator, self._values = node, simulator, values
        self.on_frame: Callable[[int, Frame], None] = lambda _stamp, _frame: None
        self.on_result: Callable[[EpisodeResult], None] = lambda _result: None
        self._states = StatePublisher(
            node, StateOptions(**values_of(StateOptions, values)), clock=clock, initial_pose=values["initial_pose"]
        )
        self._result = node.create_publisher(EpisodeResult, Topic.EPISODE_RESULT, STREAM)
        self._applied = node.create_publisher(AccelStamped, Topic.COMMAND, STREAM)
        self._lockstep = self._listen_to_commands(alone=alone)
        if alone:
            node.create_subscription(EpisodeMsg, Topic.EPISODE, self.begin, LATCHED)
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._watch = node.create_timer(
            _WATCH_PERIOD, lambda: self._do(self._lockstep.watch(time.monotonic())), clock=self._steady
        )
        self._ticker: Any = None
        self._schedule: Schedule | None = None
        self._quiet: Any = None
        if values["quiet_time"]:
            self._quiet = node.create_timer(values["quiet_time"], self._on_quiet, clock=self._steady)
            self._quiet.cancel()
        self._message: Any = None

    def _listen_to_commands(self, *, alone: bool) -> lockstep.Lockstep:
        values, node = self._values, self._node
        commands = car_commands(CommandOptions(**values_of(CommandOptions, values)))
        topic = values["command_topic"]

        def on_command(message: Any) -> None:
            try:
                stamp, command = commands.read(message)
            except IndexError as error:
                said = f"a message on {topic} is left out: {commands.format.field}: {error}"
                node.get_logger().warning(said, throttle_duration_sec=5.0)
                return
            self._do(self._lockstep.drive(stamp, *command, now=time.monotonic()))

        def on_velocity(message: TwistStamped) -> None:
            linear = message.twist.linear
            self.walk(from_stamp(message.header.stamp), (linear.x, linear.y))

        drives = _Publishers(node, node.create_subscription(commands.kind, topic, on_command, STREAM))
        walks = lockstep.Senders()
        if alone:
            walks = _Publishers(
                node, node.create_subscription(TwistStamped, Topic.VELOCITY_COMMAND, on_velocity, STREAM)
            )
        low, high = -values["maximum_deceleration"], values["maximum_acceleration"]
        self._follows = None if commands.format.quantity == Quantity.ACCELERATION else CommandLimits(low, high)
        self._yaw_rate = commands.format.is_yaw_rate
        real_time = values["pacing"] == REAL_TIME
        if real_time and values["quiet_time"]:
            raise UsageError("quiet_time goes with --pacing lockstep: real time does not wait")
        return lockstep.Lockstep(
            lockstep.CommandSource("the car controller", topic, drives),
            lockstep.CommandSource("the adversary", Topic.VELOCITY_COMMAND, walks),
            lockstep.WaitLimits(values["command_timeout"], values["startup_timeout"]),
            real_time=real_time,
            quiet_time=values["quiet_time"],
        )

    # --- episodes

    def begin(self, message: EpisodeMsg) -> None:
        """Begin an episode, unless it has begun."""
        if self._message is not None and _identity(self._message) == _identity(message):
            return
        self._stop()
        self._message = message
        self._start = from_stamp(message.header.stamp)
        self._schedule = None
        self._commands: list[tuple[float, float]] = []
        try:
            self._episode: EpisodeSpec = message_to_episode(message)
            require_others(self._simulator, self._node.get_name(), self._episode)
            self._frame = self._simulator.reset(self._episode)
        except ValueError as error:
            self._refuse(abort_reason(AbortKind.FAILED, f"{self._node.get_name()}: {error}"))
            return
        except SimulatorError as fault:
            self._refuse(str(fault))
            return
        self._states.begin(self._episode, self._frame.car, self._start)
        begun = self._lockstep.begin(self._start, self._episode.scenario, self._frame, time.monotonic())
        self._publish_state()
        self._do(begun)

    def _refuse(self, reason: str) -> None:
        self._publish_result(lockstep.End(Outcome.ABORTED, _NOWHERE, self._start, reason), 0)

    def _stop(self) -> None:
        self._lockstep.stop()
        if self._ticker is not None:
            self._node.destroy_timer(self._ticker)
            self._ticker = None
        if self._quiet is not None:
            self._quiet.cancel()

    # --- what arrives

    def walk(self, stamp: int, velocity: tuple[float, float]) -> None:
        """Take the adversary's velocity, (East, North), m/s, for the tick of a stamp (ns)."""
        self._do(self._lockstep.walk(stamp, velocity, now=time.monotonic()))

    def _on_ticker(self) -> None:
        now = time.monotonic()
        assert self._schedule is not None
        late, limit = self._schedule.late(now), max(self._values["slip_limit"], 0.5 * self._schedule.period)
        if late <= limit:
            self._do(self._lockstep.go_on(now))
            return
        slipped = f"{self._node.get_name()} came {late:.3f} s late to tick {self._frame.tick} (slip_limit {limit:g} s)"
        self._do(self._lockstep.fail(abort_reason(AbortKind.SLIPPED, slipped)))

    def _on_quiet(self) -> None:
        self._quiet.cancel()
        self._do(self._lockstep.quiet(time.monotonic()))

    # --- what comes of it

    def _do(self, action: lockstep.Action | None) -> None:
        if isinstance(action, lockstep.ControlStep):
            self._step(action)
        elif isinstance(action, lockstep.Start):
            period = self._episode.scenario.control_duration / self._values["rate_factor"]
            self._schedule = Schedule(time.monotonic(), period)
            self._ticker = self._node.create_timer(period, self._on_ticker, clock=self._steady)
        elif isinstance(action, lockstep.Repeat):
            self._publish_state()
        elif isinstance(action, lockstep.End):
            self._publish_result(action, self._simulator.clipped)
            self._stop()

    def _step(self, commands: lockstep.ControlStep) -> None:
        acceleration, steering, car = commands.drive, commands.steering, self._frame.car
        if self._yaw_rate:
            steering = angle_of_yaw_rate(steering, car.speed, wheels(self._episode.scenario.car)[0])
        if self._follows is not None:
            duration = self._episode.scenario.control_duration
            acceleration = follow_speed(commands.drive, car.speed, duration, self._follows, commands.limit)
        if self._applied.get_subscription_count():
            stamp = lockstep.frame_stamp(self._start, self._frame, self._episode.scenario)
            self._applied.publish(acceleration_command((acceleration, steering), stamp))
        self._commands.append((acceleration, steering))
        try:  # a simulator that does not steer takes a float
            command: Command = (acceleration, steering) if steering else acceleration
            self._frame = self._simulator.step(command, commands.velocity)
        except (SimulatorError, UsageError) as fault:
            self._do(self._lockstep.fail(_reason(fault)))
            return
        end = self._lockstep.advance(self._frame, time.monotonic())
        self._publish_state()
        self._do(end)

    def _publish_state(self) -> None:
        stamp = lockstep.frame_stamp(self._start, self._frame, self._episode.scenario)
        if self._quiet is None:
            self._states.tell_time(stamp - self._lockstep.lead)
            self._states.publish(self._frame, stamp)
        else:  # who decides by the clock is to know the state by then
            self._states.publish(self._frame, stamp)
            self._states.tell_time(stamp - self._lockstep.lead)
            self._quiet.reset()
        self.on_frame(stamp, self._frame)

    # --- results

    def _publish_result(self, end: lockstep.End, clipped: int) -> None:
        result = EpisodeResult(outcome=int(end.outcome), ticks=end.frame.tick, reason=end.reason)
        result.header = header(end.stamp, MAP_FRAME)
        result.campaign = self._message.campaign
        result.episode_id = int(self._message.episode_id)
        result.start = to_stamp(self._start)
        result.commands_clipped = clipped
        result.commands = [acceleration_command(one, 0).accel for one in self._commands]
        result.command_ages = array("f", self._lockstep.ages.ages)
        result.commands_held = self._lockstep.ages.held
        result.greatest_delay = 0.0 if self._schedule is None else self._schedule.worst
        result.impact_time, result.impact_speed = math.nan, math.nan
        if end.outcome == Outcome.COLLISION:
            result.impact_time, result.impact_speed = end.frame.impact(self._episode.scenario.time_step)
        if self._result.get_subscription_count():
            self._result.publish(result)
        self.on_result(result)


def _reason(fault: Exception) -> str:
    return str(fault) if isinstance(fault, SimulatorError) else abort_reason(AbortKind.FAILED, str(fault))


def _identity(message: Any) -> tuple[str, int, int]:
    return str(message.campaign), int(message.episode_id), from_stamp(message.header.stamp)


class VehicleSimulator(GraphNode):
    """The world, and its clock."""

    def __init__(self, **node_arguments: Any) -> None:
        """Declare parameters, with arguments of `rclpy.node.Node`; then wait for an episode."""
        super().__init__("vehicle_simulator", **node_arguments)
        self.simulator = GraphSimulator(self, NamedSimulator(), declare(self, *TABLES))


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    return run_node(VehicleSimulator, args)


if __name__ == "__main__":
    raise SystemExit(main())
