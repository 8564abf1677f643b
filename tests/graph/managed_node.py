"""A car under test that is a managed node, plain rclpy: once it has braked it brakes until it is cleaned up."""

import sys
from typing import Any

import rclpy
from geometry_msgs.msg import AccelStamped, PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.executors import ExternalShutdownException
from rclpy.lifecycle import LifecycleNode, State, TransitionCallbackReturn
from rclpy.qos import DurabilityPolicy, QoSProfile


class LatchingBrake(LifecycleNode):
    """Brakes from 9 m to the adversary on, and never again lets go; parameter `refuse` names what it fails at."""

    def __init__(self, **options: Any) -> None:
        super().__init__("latching_brake", **options)
        self._refuse = self.declare_parameter("refuse", "nothing").value
        self._latched = False
        self._adversary: tuple[float, float] | None = None
        print("transitions: created", flush=True)

    def _answer(self, name: str) -> TransitionCallbackReturn:
        print(f"transitions: {name}", flush=True)
        return TransitionCallbackReturn.FAILURE if name == self._refuse else TransitionCallbackReturn.SUCCESS

    def on_configure(self, state: State) -> TransitionCallbackReturn:
        answer = self._answer("configure")
        if answer == TransitionCallbackReturn.SUCCESS:
            latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
            self._publisher = self.create_lifecycle_publisher(AccelStamped, "/ego/acceleration_command", 10)
            self._made = [
                self.create_subscription(Odometry, "/adversary/odometry", self._on_adversary, 10),
                self.create_subscription(Odometry, "/ego/odometry", self._on_car, 10),
                self.create_subscription(PoseWithCovarianceStamped, "/initialpose", self._on_pose, latched),
            ]
        return answer

    def on_activate(self, state: State) -> TransitionCallbackReturn:
        super().on_activate(state)
        return self._answer("activate")

    def on_deactivate(self, state: State) -> TransitionCallbackReturn:
        super().on_deactivate(state)
        return self._answer("deactivate")

    def on_cleanup(self, state: State) -> TransitionCallbackReturn:
        self.destroy_publisher(self._publisher)
        for one in self._made:
            self.destroy_subscription(one)
        self._latched, self._adversary = False, None
        return self._answer("cleanup")

    def _on_pose(self, pose: PoseWithCovarianceStamped) -> None:
        where = pose.pose.pose
        stamp = pose.header.stamp
        print(f"pose: {stamp.sec} {pose.header.frame_id} {where.position.x!r} {where.position.y!r}", flush=True)

    def _on_adversary(self, odometry: Odometry) -> None:
        self._adversary = odometry.pose.pose.position.x, odometry.pose.pose.position.y

    def _on_car(self, odometry: Odometry) -> None:
        ahead = -odometry.pose.pose.position.y  # φ runs along y = 0
        self._latched = self._latched or ahead < 9.0
        message = AccelStamped(header=odometry.header)
        message.accel.linear.x = -5.0 if self._latched else 0.0
        self._publisher.publish(message)


def main(args: list[str]) -> int:
    rclpy.init(args=args)
    node: Any = LatchingBrake()
    node.create_timer(0.2, lambda: None)  # rclpy now and then misses SIGTERM in a wait without end
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
