"""What rclpy has and rosless has not, so that asking for it says so."""

from __future__ import annotations

from typing import Any


class MissingFeatureError(NotImplementedError, ImportError):
    """Raised when a part of rclpy is imported that rosless does not have."""


# module -> what it is for
MODULES = {
    "rclpy.action": "actions",
    "rclpy.action.client": "actions",
    "rclpy.action.server": "actions",
    "rclpy.lifecycle": "lifecycle nodes",
    "rclpy.parameter_client": "parameter clients",
    "rclpy.parameter_event_handler": "parameter event handlers",
    "rclpy.service_introspection": "service introspection",
    "rclpy.waitable": "waitables",
    "rclpy.logging_service": "logger level services",
    "rclpy.type_description_service": "type description services",
}


def refuse(module: str) -> None:
    """Raise for a module of :data:`MODULES`."""
    raise MissingFeatureError(f"rosless does not support {MODULES[module]} ({module}); a ROS 2 installation does")


class QoSOverridingOptions:
    """Not supported."""

    def __init__(self, *_: Any, **__: Any) -> None:
        raise NotImplementedError("rosless does not support QoS overriding options")
