"""Where a node runs: in a process of its own, or with others in one."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import wraps
from pathlib import Path
from typing import Any

from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile

from skd_sim.nodes.composition.exchange import CalledSubscription, Exchange
from skd_sim.program.secret import handed_secret


class LogFile:
    """What a node logs where it does not print: the calls of rclpy's logger that our nodes use, into a file."""

    def __init__(self, path: Path, name: str) -> None:
        """Begin the file, or go on with it, for the node of a name."""
        self._path, self._name = path, name
        self._said: dict[str, float] = {}
        self._path.open("a").close()

    def info(self, text: str, *, throttle_duration_sec: float = 0.0) -> None:
        """Log what is worth knowing."""
        self._log("INFO", text, throttle_duration_sec)

    def warning(self, text: str, *, throttle_duration_sec: float = 0.0) -> None:
        """Log what should not be, at most once in so many seconds of each level."""
        self._log("WARN", text, throttle_duration_sec)

    def error(self, text: str, *, throttle_duration_sec: float = 0.0) -> None:
        """Log what must not be."""
        self._log("ERROR", text, throttle_duration_sec)

    def _log(self, level: str, text: str, throttle: float) -> None:
        now = time.monotonic()
        if throttle and now - self._said.get(level, -throttle) < throttle:
            return
        self._said[level] = now
        with self._path.open("a", encoding="utf-8") as file:
            file.write(f"[{level}] [{time.time():.9f}] [{self._name}]: {text}\n")


@dataclass(frozen=True)
class Place:
    """Where and how a node runs.

    Attributes:
        context: ROS context; by default that of the process.
        values: values of parameters, beside those of the command line.
        secret: what the node was handed, see `skd_sim.program.secret`.
        exchange: how it speaks with others of its process; none if it is alone.
        log: what it logs to; by default it prints.
        failed: called with the node's name and an error of one of its callbacks, which then is not raised.
    """

    context: Context | None = None
    values: Mapping[str, Any] = field(default_factory=dict)
    secret: bytes | None = field(default=None, repr=False)
    exchange: Exchange | None = None
    log: LogFile | None = None
    failed: Callable[[str, Exception], None] | None = None

    @classmethod
    def alone(cls) -> Place:
        """Return the place of a node that is the only one of its process."""
        return cls(secret=handed_secret())


class ComposableNode(Node):
    """A node that may share its process; by itself it is as any other."""

    def __init__(self, name: str, place: Place) -> None:
        """Make the node of a name at a place."""
        self._place = place
        overrides = [Parameter(key, value=value) for key, value in place.values.items()]
        super().__init__(name, context=place.context, parameter_overrides=overrides)

    def get_logger(self) -> Any:
        """Return what the node logs to."""
        return self._place.log or super().get_logger()

    def create_publisher(self, msg_type: Any, topic: str, qos_profile: Any, **more: Any) -> Any:
        """As a node's, and for the nodes of its process by a call."""
        real = super().create_publisher(msg_type, topic, qos_profile, **more)
        exchange = self._place.exchange
        return real if exchange is None else exchange.publisher(self, real, qos_profile)

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Callable[[Any], None], qos_profile: Any, **more: Any
    ) -> Any:
        """As a node's, or by a call where nodes of its process speak."""
        callback = self._guarded(callback)
        subscribe = super().create_subscription
        exchange = self._place.exchange
        if exchange is None:
            return subscribe(msg_type, topic, callback, qos_profile, **more)
        raw, name = bool(more.get("raw")), self.resolve_topic_name(topic)
        called = exchange.subscription(self, msg_type, name, callback, raw=raw)
        if called is not None:
            return called
        if raw and isinstance(qos_profile, QoSProfile):
            return exchange.join(
                msg_type,
                name,
                qos_profile,
                callback,
                lambda heard: subscribe(msg_type, topic, heard, qos_profile, **more),
            )
        return subscribe(msg_type, topic, callback, qos_profile, **more)

    def destroy_subscription(self, subscription: Any) -> bool:
        """As a node's."""
        if isinstance(subscription, CalledSubscription):
            assert self._place.exchange is not None
            self._place.exchange.leave(subscription)
            return True
        return bool(super().destroy_subscription(subscription))

    def create_timer(self, timer_period_sec: float, callback: Any, *args: Any, **more: Any) -> Any:
        """As a node's."""
        return super().create_timer(timer_period_sec, self._guarded(callback), *args, **more)

    def later(self, work: Callable[[], None]) -> None:
        """Do work that takes long: now, or when the nodes of its process have heard what was said by now."""
        if self._place.exchange is None:
            work()
        else:
            self._place.exchange.later(self._guarded(work))

    def _guarded(self, callback: Any) -> Any:
        """Return a callback whose errors are told, where somebody is to be told."""
        failed = self._place.failed
        if failed is None:
            return callback

        @wraps(callback)
        def guarded(*arguments: Any) -> None:
            try:
                callback(*arguments)
            except Exception as error:
                self.get_logger().error("".join(traceback.format_exception(error)).rstrip())
                failed(self.get_name(), error)

        return guarded
