"""Node `adversary`: the safe, kamikaze or replaying adversary."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from skd_msgs.msg import EpisodeResult
from skd_sim.choices.frames import MAP_FRAME
from skd_sim.choices.objective import DEFAULT_OBJECTIVES
from skd_sim.encounter.road import HEADING_NORTH, road_pose
from skd_sim.episode.episode import Episode
from skd_sim.messages.from_messages import message_to_episode
from skd_sim.messages.seal import Seal
from skd_sim.messages.stream_cdr import read_car, write_velocity
from skd_sim.messages.to_messages import car_to_odometry
from skd_sim.nodes.composition.place import ComposableNode, Place
from skd_sim.nodes.episode_follower import EpisodeFollower
from skd_sim.nodes.receipts import Receipts
from skd_sim.nodes.support import (
    BELIEVED_CAR,
    EGO_ODOMETRY,
    EPISODE_RESULT,
    STREAM,
    VELOCITY_COMMAND,
    Setting,
    declare,
    listen,
    run_node,
)
from skd_sim.state import CarState

from skd_adversary.adversary import Adversary, BelievedCar, PlanningAdversary, make_adversary
from skd_adversary.warm_up import warm_up_episodes

_SETTINGS = (Setting("warm_up", True, "load the compiled planner at the start rather than in the first episode"),)


class AdversaryNode(ComposableNode):
    """Senses the car, through its sensor's noise, and answers with the velocity for the coming tick."""

    def __init__(self, place: Place | None = None, *, make: Callable[[Episode], Adversary] | None = None) -> None:
        """Declare parameters and topics.

        Args:
            place: where it runs; by default in a process of its own.
            make: makes the adversary of each episode; by default the one that the episode says, whose planner is
                compiled first.
        """
        place = place or Place.alone()
        super().__init__("adversary", place)
        seal = Seal(place.secret)
        settings = declare(self, _SETTINGS)
        if make is None and settings["warm_up"]:
            warm_up()
        self._make = make
        self._adversary: Adversary | None = None
        self._over = False
        self._next_tick = 0
        self._answer: tuple[int, bytes] | None = None
        self._command = self.create_publisher(TwistStamped, VELOCITY_COMMAND, STREAM)
        # A belief tells that somebody plans, so it is said only where everybody may know.
        self._believed = self.create_publisher(Odometry, BELIEVED_CAR, STREAM) if seal.is_open else None
        self._receipts = Receipts(self, seal, "skd_adversary", "skd_sim")
        self._follower = EpisodeFollower(
            self, lambda message: message_to_episode(seal.open(message)), self._on_begin, self._on_frame
        )
        listen(self, Odometry, EGO_ODOMETRY, read_car, self._follower.deliver)
        if place.exchange is not None:  # on the wire a result comes when the last state is answered already
            self.create_subscription(EpisodeResult, EPISODE_RESULT, self._on_result, STREAM)

    def _on_begin(self, episode: Episode) -> None:
        self._adversary = (self._make or make_adversary)(episode)
        self._next_tick = 0
        self._answer = None
        self._over = False
        self._receipts.send(episode, self._follower.announced)

    def _on_result(self, result: Any) -> None:
        start = self._follower.announced
        if start is not None and (result.campaign, result.start) == (start.campaign, start.header.stamp):
            self._over = True

    def _on_frame(self, tick: int, period: int, stamp: int, car: CarState) -> None:
        if not period:  # the car decides in between, the adversary does not
            self.later(partial(self._decide, tick, stamp, car))

    def _decide(self, tick: int, stamp: int, car: CarState) -> None:
        if self._over:
            return  # nobody waits for an answer to the last state
        if self._answer is not None and self._answer[0] == stamp:
            self._command.publish(self._answer[1])  # a tick repeated while other nodes start
            return
        if tick != self._next_tick:
            self.get_logger().warning(
                f"tick {tick} came where {self._next_tick} was due: this node joined in the middle of an episode, or "
                "could not keep up; it waits for the next episode",
                throttle_duration_sec=5.0,
            )
            return
        assert self._adversary is not None
        velocity = self._adversary.act(car)
        self._answer = (stamp, write_velocity(velocity, stamp))
        self._next_tick = tick + 1
        self._command.publish(self._answer[1])
        self._say_belief(stamp)

    def _say_belief(self, stamp: int) -> None:
        """Publish where the adversary believes the car to be, if somebody listens and it believes anything."""
        if self._believed is None or not isinstance(self._adversary, PlanningAdversary):
            return
        if self._believed.get_subscription_count():
            assert self._follower.episode is not None
            self._believed.publish(belief_to_odometry(self._adversary.believed_car, self._follower.episode, stamp))


def belief_to_odometry(believed: BelievedCar, episode: Episode, stamp: int) -> Odometry:
    """Return a belief as odometry in `map`: means as pose and speed, variances along the road as covariances."""
    x, y, heading = road_pose(episode.scenario.road.line, believed.position)
    message = car_to_odometry(CarState(x, y, heading, believed.speed), stamp)
    message.header.frame_id, message.child_frame_id = MAP_FRAME, ""
    ahead = np.zeros(6)
    ahead[:2] = np.cos(heading), np.sin(heading)
    message.pose.covariance = (believed.position_deviation**2 * np.outer(ahead, ahead)).ravel()
    message.twist.covariance = np.diag([believed.speed_deviation**2, 0.0, 0.0, 0.0, 0.0, 0.0]).ravel()
    return message


def warm_up() -> None:
    """Compile, or load from the cache, every kernel of the planners that an assessment has by default."""
    for objective in DEFAULT_OBJECTIVES:
        for episode in warm_up_episodes(objective=objective):
            adversary = make_adversary(episode)
            for _ in range(2):  # the belief moves from the second on
                adversary.act(CarState(0.0, -20.0, HEADING_NORTH, 8.0))


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    return run_node(AdversaryNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
