"""Simulated time: while the parameter use_sim_time is true, a node's clock follows /clock."""

from __future__ import annotations

import weakref
from typing import TYPE_CHECKING, Any

from rosless.clock import ROSClock
from rosless.constants import S_TO_NS
from rosless.interfaces.classes import message_class
from rosless.parameters.parameter import Parameter
from rosless.qos import QoSProfile, ReliabilityPolicy

if TYPE_CHECKING:
    from rosless.node import Node
    from rosless.subscription import Subscription

CLOCK_TOPIC = "/clock"
USE_SIM_TIME_NAME = "use_sim_time"


class TimeSource:
    """Connects the clock of one node with /clock."""

    def __init__(self, node: Node, clock: ROSClock) -> None:
        self._node = weakref.ref(node)
        self._clock = clock
        self._subscription: Subscription | None = None
        if not node.has_parameter(USE_SIM_TIME_NAME):
            node.declare_parameter(USE_SIM_TIME_NAME, False)
        parameter = node.get_parameter(USE_SIM_TIME_NAME)
        if parameter.type_ is Parameter.Type.BOOL:
            self._activate(parameter.value)
        else:
            node.get_logger().error(
                f"Invalid type for parameter '{USE_SIM_TIME_NAME}' {parameter.type_!r} should be bool"
            )
        node.add_on_set_parameters_callback(self._on_set_parameters)

    def _activate(self, enabled: bool) -> None:
        node = self._node()
        if node is None or enabled == self._clock.ros_time_is_active:
            return
        self._clock._set_ros_time_is_active(enabled)
        if enabled:
            self._subscription = node.create_subscription(
                message_class("rosgraph_msgs/msg/Clock"),
                CLOCK_TOPIC,
                self._on_clock,
                QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT),
            )
        elif self._subscription is not None:
            node.destroy_subscription(self._subscription)
            self._subscription = None

    def _on_clock(self, message: Any) -> None:
        self._clock._override_ns = message.clock.sec * S_TO_NS + message.clock.nanosec

    def _on_set_parameters(self, parameters: list[Parameter]) -> Any:
        result = message_class("rcl_interfaces/msg/SetParametersResult")
        for parameter in parameters:
            if parameter.name != USE_SIM_TIME_NAME:
                continue
            if parameter.type_ is not Parameter.Type.BOOL:
                reason = f"{USE_SIM_TIME_NAME} parameter set to something besides a bool"
                node = self._node()
                if node is not None:
                    node.get_logger().error(reason)
                return result(successful=False, reason=reason)
            self._activate(parameter.value)
        return result(successful=True)
