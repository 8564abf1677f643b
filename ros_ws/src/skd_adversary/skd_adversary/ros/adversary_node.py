"""The adversary's part in the graph, safe, kamikaze or replaying, and the node `adversary` that plays it alone."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from skd_sim.options.car_and_adversary import DEFAULT_OBJECTIVES
from skd_sim.options.options import MAP_FRAME, option
from skd_sim.ros.from_messages import from_stamp, message_to_episode, odometry_to_car
from skd_sim.ros.support import STREAM, EpisodeFollower, GraphNode, Topic, declare, run_node
from skd_sim.ros.to_messages import car_to_odometry, velocity_command
from skd_sim.scenario.road import HEADING_NORTH, road_pose
from skd_sim.world.episode import EpisodeSpec
from skd_sim.world.state import CarState, Pair

from skd_adversary.adversary import Adversary, BelievedCar, PlanningAdversary, make_adversary, warm_up_episodes


@dataclass(frozen=True)
class _AdversaryOptions:
    """The table of the node's parameters."""

    warm_up: bool = option(True, "load the compiled planner at the start rather than in the first episode")


TABLES = (_AdversaryOptions,)


class GraphAdversary:
    """Senses the car, through its sensor's noise, and answers with the velocity for the coming tick.

    It speaks through a node that may belong to others as well.
    """

    def __init__(self, node: Node, *, make: Callable[[EpisodeSpec], Adversary] = make_adversary) -> None:
        """Make the topics.

        Args:
            node: node that speaks.
            make: makes the adversary of each episode; by default the one that the episode says.
        """
        self._node, self._make = node, make
        self._adversary: Adversary | None = None
        self._next_tick = 0
        self._answer: tuple[int, Pair] | None = None
        self._command = node.create_publisher(TwistStamped, Topic.VELOCITY_COMMAND, STREAM)
        self._believed = node.create_publisher(Odometry, Topic.BELIEVED_CAR, STREAM)

    def begin(self, episode: EpisodeSpec) -> None:
        """Take the next episode."""
        self._episode = episode
        self._adversary = self._make(episode)
        self._next_tick, self._answer = 0, None

    def answer(self, tick: int, stamp: int, car: CarState) -> Pair | None:
        """Decide on a tick by the car's state, once; publish the velocity where a node listens, and return it.

        A tick that comes out of turn has no answer: this node joined in the middle, or could not keep up.
        """
        if self._answer is None or self._answer[0] != stamp:
            if tick != self._next_tick or self._adversary is None:
                self._node.get_logger().warning(
                    f"tick {tick} came where {self._next_tick} was due: this node joined in the middle of an episode, "
                    "or could not keep up; it waits for the next episode",
                    throttle_duration_sec=5.0,
                )
                return None
            east, north = self._adversary.act(car)
            self._answer = stamp, (float(east), float(north))
            self._next_tick = tick + 1
            if isinstance(self._adversary, PlanningAdversary) and self._believed.get_subscription_count():
                self._believed.publish(belief_to_odometry(self._adversary.believed_car, self._episode, stamp))
        velocity = self._answer[1]
        if self._command.get_subscription_count():
            self._command.publish(velocity_command(velocity, stamp))
        return velocity


class AdversaryNode(GraphNode):
    """The adversary as a node that follows episodes and states by their topics."""

    def __init__(self, *, make: Callable[[EpisodeSpec], Adversary] = make_adversary, **node_arguments: object) -> None:
        """Declare parameters and topics, and load the planner.

        Args:
            make: makes the adversary of each episode; by default the one that the episode says.
            node_arguments: further arguments of `rclpy.node.Node`.
        """
        super().__init__("adversary", **node_arguments)
        if declare(self, *TABLES)["warm_up"] and make is make_adversary:
            warm_up()
        self.adversary = GraphAdversary(self, make=make)
        self._follower = EpisodeFollower(self, message_to_episode, self.adversary.begin, self._on_frame)
        self.create_subscription(Odometry, Topic.EGO_ODOMETRY, self._on_odometry, STREAM)

    def _on_odometry(self, message: Odometry) -> None:
        self._follower.deliver(from_stamp(message.header.stamp), odometry_to_car(message))

    def _on_frame(self, tick: int, period: int, stamp: int, car: CarState) -> None:
        if not period:  # the car decides in between, the adversary does not
            self.adversary.answer(tick, stamp, car)


def belief_to_odometry(believed: BelievedCar, episode: EpisodeSpec, stamp: int) -> Odometry:
    """Return a belief as odometry in `map`: means as pose and speed, variances along the road as covariances."""
    x, y, heading = road_pose(episode.scenario.road.line, believed.position)
    message = copy.deepcopy(car_to_odometry(CarState(x, y, heading, believed.speed), stamp))  # which is used again
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
