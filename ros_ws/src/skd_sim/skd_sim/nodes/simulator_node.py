"""Node of any simulator: publishes where car and adversary are, and hands their commands to the simulator.

The rules of an episode are `skd_sim.lockstep.lockstep`, the motion is the simulator's. Here are topics, parameters and
timers.
"""

from __future__ import annotations

import math
import time
from array import array
from collections.abc import Callable, Sequence
from typing import Any

from geometry_msgs.msg import TwistStamped
from rclpy.clock import Clock, ClockType
from skd_msgs.msg import Episode as EpisodeMsg
from skd_msgs.msg import EpisodeResult

from skd_sim.choices.frames import MAP_FRAME
from skd_sim.choices.graph_options import REAL_TIME, CommandOptions, SimulatorOptions, StateOptions
from skd_sim.choices.options import values_of
from skd_sim.dynamics.limits import CommandLimits
from skd_sim.episode.aborts import AbortKind, abort_reason
from skd_sim.episode.command_ages import Schedule
from skd_sim.episode.episode import Episode, Outcome
from skd_sim.errors import UsageError
from skd_sim.lockstep.command_source import Source
from skd_sim.lockstep.commands import Quantity, follow_speed
from skd_sim.lockstep.lockstep import Action, End, Limits, Lockstep, Repeat, Start, Step, frame_stamp
from skd_sim.messages.command_messages import car_commands
from skd_sim.messages.from_messages import from_stamp, message_to_episode
from skd_sim.messages.seal import Seal
from skd_sim.messages.stream_cdr import read_linear
from skd_sim.messages.to_messages import to_stamp
from skd_sim.nodes.composition.place import ComposableNode, Place
from skd_sim.nodes.initial_pose import InitialPose
from skd_sim.nodes.receipts import Receipts
from skd_sim.nodes.state_publisher import StatePublisher
from skd_sim.nodes.support import (
    EPISODE,
    EPISODE_RESULT,
    LATCHED,
    STREAM,
    VELOCITY_COMMAND,
    Setting,
    declare,
    listen,
    settings_of,
)
from skd_sim.nodes.topic_senders import TopicSenders
from skd_sim.simulation.simulator import Frame, Simulator, SimulatorError, require_others
from skd_sim.simulation.world import Contact

SIMULATOR_SETTINGS = settings_of(SimulatorOptions)
"""Parameters of every simulator's node."""

_WATCH_PERIOD = 0.05  # s of wall time


class SimulatorNode(ComposableNode):
    """Ground truth of the graph; one episode at a time."""

    def __init__(
        self,
        name: str,
        make: Callable[[dict[str, Any]], Simulator],
        settings: Sequence[Setting] = SIMULATOR_SETTINGS,
        *,
        clock: bool = True,
        place: Place | None = None,
    ) -> None:
        """Declare parameters and topics, make the simulator; then wait for an episode.

        Args:
            name: name of the node, which messages use too.
            make: makes the simulator from the values of all parameters.
            settings: all parameters; a simulator's own beside `SIMULATOR_SETTINGS`.
            clock: whether it publishes `/clock`; a simulator may do so itself.
            place: where it runs; by default in a process of its own.
        """
        place = place or Place.alone()
        super().__init__(name, place)
        self._settings = declare(self, settings)
        self._name = name
        self._simulator = make(self._settings)
        self._states = StatePublisher(self, StateOptions(**values_of(StateOptions, self._settings)), clock=clock)
        self._result = self.create_publisher(EpisodeResult, EPISODE_RESULT, STREAM)
        self._seal = Seal(place.secret)
        self._receipts = Receipts(self, self._seal, "skd_sim")
        self._initial_pose = InitialPose(self) if self._settings["initial_pose"] else None
        self.create_subscription(EpisodeMsg, EPISODE, self._on_episode, LATCHED)
        self._lockstep = self._listen_to_commands()
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._watch = self.create_timer(_WATCH_PERIOD, self._on_watch, clock=self._steady)
        self._ticker: Any = None
        self._schedule: Schedule | None = None
        self._quiet: Any = None
        if self._settings["quiet_time"]:
            self._quiet = self.create_timer(self._settings["quiet_time"], self._on_quiet, clock=self._steady)
            self._quiet.cancel()
        self._announced: Any = None  # as it was published; `_message` is what it says to who has the key
        self._message: Any = None

    def _listen_to_commands(self) -> Lockstep:
        commands = car_commands(CommandOptions(**values_of(CommandOptions, self._settings)))
        topic = self._settings["command_topic"]
        drives, walks = TopicSenders(self, topic), TopicSenders(self, VELOCITY_COMMAND)
        drives.subscription = listen(self, commands.kind, topic, commands.read, self._on_car_command)
        walks.subscription = listen(self, TwistStamped, VELOCITY_COMMAND, read_linear, self._on_velocity)
        low, high = -self._settings["maximum_deceleration"], self._settings["maximum_acceleration"]
        self._follows = None if commands.format.quantity == Quantity.ACCELERATION else CommandLimits(low, high)
        real_time = self._settings["pacing"] == REAL_TIME
        if real_time and self._settings["quiet_time"]:
            raise UsageError("--quiet-time goes with --pacing lockstep: real time waits for nobody")
        return Lockstep(
            Source("the car controller", topic, drives),
            Source("the adversary", VELOCITY_COMMAND, walks),
            Limits(self._settings["command_timeout"], self._settings["startup_timeout"]),
            real_time=real_time,
            quiet_time=self._settings["quiet_time"],
        )

    # --- episodes

    def _on_episode(self, message: Any) -> None:
        if self._announced is not None and _identity(self._announced) == _identity(message):
            return
        self._stop()
        self._announced = self._message = message
        self._start = from_stamp(message.header.stamp)
        self._clipped = 0
        self._schedule = None
        try:
            self._message = self._seal.open(message)
            self._episode: Episode = message_to_episode(self._message)
            require_others(self._simulator, self.get_name(), self._episode)
            self._frame = self._simulator.reset(self._episode)
        except ValueError as error:
            self.get_logger().error(str(error))
            self._refuse(abort_reason(AbortKind.FAILED, f"{self._name}: {error}"))
            return
        except SimulatorError as fault:
            self._refuse(str(fault))
            return
        self._receipts.send(self._episode, message)
        self._states.begin(self._episode, self._start)
        if self._initial_pose is not None:
            self._initial_pose.publish(self._frame.car, self._start)
        begun = self._lockstep.begin(self._start, self._episode.scenario, self._frame, time.monotonic())
        self._publish_state()
        self._do(begun)

    def _refuse(self, reason: str) -> None:
        self._publish_result(Outcome.ABORTED, 0, self._start, None, reason)

    def _stop(self) -> None:
        self._lockstep.stop()
        if self._ticker is not None:
            self.destroy_timer(self._ticker)
            self._ticker = None
        if self._quiet is not None:
            self._quiet.cancel()

    # --- what arrives

    def _on_car_command(self, stamp: int | None, command: tuple[float, float]) -> None:
        self._do(self._lockstep.drive(stamp, *command, now=time.monotonic()))

    def _on_velocity(self, stamp: int, velocity: tuple[float, float]) -> None:
        self._do(self._lockstep.walk(stamp, velocity, now=time.monotonic()))

    def _on_ticker(self) -> None:
        now = time.monotonic()
        assert self._schedule is not None
        late, limit = self._schedule.late(now), max(self._settings["slip_limit"], 0.5 * self._schedule.period)
        if late <= limit:
            self._do(self._lockstep.go_on(now))
            return
        slipped = f"{self._name} came {late:.3f} s late to tick {self._frame.tick} (--slip-limit {limit:g} s)"
        self._do(self._lockstep.fail(abort_reason(AbortKind.SLIPPED, slipped)))

    def _on_quiet(self) -> None:
        self._quiet.cancel()
        self._do(self._lockstep.quiet(time.monotonic()))

    def _on_watch(self) -> None:
        self._do(self._lockstep.watch(time.monotonic()))

    # --- what comes of it

    def _do(self, action: Action | None) -> None:
        if isinstance(action, Step):
            self._step(action)
        elif isinstance(action, Start):
            period = self._episode.scenario.control_duration / self._settings["rate_factor"]
            self._schedule = Schedule(time.monotonic(), period)
            self._ticker = self.create_timer(period, self._on_ticker, clock=self._steady)
        elif isinstance(action, Repeat):
            self._publish_state()
        elif isinstance(action, End):
            self._end(action)

    def _step(self, commands: Step) -> None:
        try:
            self._frame = self._simulator.step(self._acceleration(commands), commands.velocity)
        except SimulatorError as fault:
            self._do(self._lockstep.fail(str(fault)))
            return
        end = self._lockstep.advance(self._frame, time.monotonic())
        self._publish_state()
        self._do(end)

    def _acceleration(self, commands: Step) -> float:
        """Return the acceleration (m/s²) that a command of the car means now."""
        if self._follows is None:
            return commands.drive
        duration = self._episode.scenario.control_duration
        return follow_speed(commands.drive, self._frame.car.speed, duration, self._follows, commands.limit)

    def _publish_state(self) -> None:
        stamp = frame_stamp(self._start, self._frame, self._episode.scenario)
        if self._quiet is None:
            self._states.tell_time(stamp - self._lockstep.lead)
            self._states.publish(self._frame, stamp)
        else:  # who decides by the clock is to know the state by then
            self._states.publish(self._frame, stamp)
            self._states.tell_time(stamp - self._lockstep.lead)
            self._quiet.reset()

    # --- results

    def _end(self, end: End) -> None:
        if end.outcome == Outcome.ABORTED:
            self.get_logger().warning(f"episode aborted: {end.reason}")
        self._clipped = self._simulator.clipped
        contact = end.frame.contact if end.outcome == Outcome.COLLISION else None
        self._publish_result(end.outcome, end.frame.tick, end.stamp, contact, end.reason)
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
        result.reason = reason
        result.commands_clipped = self._clipped
        result.command_ages = array("f", self._lockstep.ages.ages)
        result.commands_held = self._lockstep.ages.held
        result.greatest_delay = 0.0 if self._schedule is None else self._schedule.worst
        result.impact_time, result.impact_speed = math.nan, math.nan
        if contact is not None:
            frame = Frame(ticks, self._frame.car, self._frame.adversary, contact)
            result.impact_time, result.impact_speed = frame.impact(self._episode.scenario.time_step)
        self._result.publish(result)


def _identity(message: Any) -> tuple[str, int, int]:
    return str(message.campaign), int(message.episode_id), from_stamp(message.header.stamp)
