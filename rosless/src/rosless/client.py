"""rclpy.client."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from rosless import services_wire
from rosless.callback_groups import CallbackGroup
from rosless.qos import QoSProfile
from rosless.services_wire import RequestId, TwoWay
from rosless.task import Future

if TYPE_CHECKING:
    from rosless.node import Node

_POLL_S = 0.01


class Client:
    """Sends requests. Made by :meth:`Node.create_client`."""

    def __init__(
        self,
        node: Node,
        srv_type: type[Any],
        srv_name: str,
        resolved_name: str,
        callback_group: CallbackGroup,
        qos_profile: QoSProfile,
    ) -> None:
        services_wire.check_service_type(srv_type)
        self.srv_type = srv_type
        self.srv_name = srv_name
        self.callback_group = callback_group
        self.qos_profile = qos_profile
        self._context = node.context
        self._resolved_name = resolved_name
        self._wire = TwoWay(
            node.context,
            srv_type.Response,
            services_wire.reply_topic(resolved_name),
            srv_type.Request,
            services_wire.request_topic(resolved_name),
            qos_profile,
        )
        self.reader_gid, self.writer_gid = self._wire.reader_gid, self._wire.writer_gid
        # replies to all clients arrive at every client; this number tells whose they are
        self._id = int.from_bytes(self.writer_gid[:8], "little") ^ int.from_bytes(self.writer_gid[8:], "little")
        self._lock = threading.Lock()
        self._sequence = 0
        self._pending: dict[int, Future] = {}

    @property
    def wait_entity(self) -> int:
        """What a wait set attaches."""
        return self._wire.wait_entity

    @property
    def service_name(self) -> str:
        """The service's name, expanded and remapped."""
        return self._resolved_name

    def call_async(self, request: Any) -> Future:
        """Send a request; the future gets the response while an executor spins."""
        if not isinstance(request, self.srv_type.Request):
            raise TypeError
        with self._lock:
            self._sequence += 1
            sequence = self._sequence
            future = Future()
            self._pending[sequence] = future
        try:
            self._wire.send(RequestId(self._id, sequence), request)
        except BaseException:
            self._pending.pop(sequence, None)
            raise
        return future

    def call(self, request: Any, timeout_sec: float | None = None) -> Any:
        """Send a request and wait for the response, while another thread spins."""
        done = threading.Event()
        future = self.call_async(request)
        future.add_done_callback(lambda _: done.set())
        if not done.wait(timeout_sec):
            raise TimeoutError
        return future.result()

    def take(self) -> tuple[Callable[..., Any], tuple[Any, ...]] | None:
        """Take the next response, and say what to run."""
        received = self._wire.receive()
        if received is None or received[0].client != self._id:
            return None
        future = self._pending.pop(received[0].sequence, None)
        return None if future is None else (future.set_result, (received[1],))

    def remove_pending_request(self, future: Future) -> None:
        """Forget a request."""
        for sequence, pending in list(self._pending.items()):
            if pending is future:
                del self._pending[sequence]

    def service_is_ready(self) -> bool:
        """True if there is a server."""
        return min(self._wire.matched) > 0

    def wait_for_service(self, timeout_sec: float | None = None) -> bool:
        """Wait until there is a server; False if that takes longer than the timeout."""
        end = None if timeout_sec is None or timeout_sec < 0 else time.monotonic() + timeout_sec
        while not self.service_is_ready():
            if not self._context.ok() or (end is not None and time.monotonic() >= end):
                return False
            time.sleep(_POLL_S)
        return True

    def destroy(self) -> None:
        """Destroy the client; nodes do it by :meth:`Node.destroy_client`."""
        for future in self._pending.values():
            future.cancel()
        self._wire.close()
