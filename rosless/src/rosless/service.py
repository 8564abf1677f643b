"""rclpy.service."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from rosless import services_wire
from rosless.callback_groups import CallbackGroup
from rosless.qos import QoSProfile
from rosless.services_wire import RequestId, TwoWay

if TYPE_CHECKING:
    from rosless.node import Node


class Service:
    """Answers requests. Made by :meth:`Node.create_service`."""

    def __init__(
        self,
        node: Node,
        srv_type: type[Any],
        srv_name: str,
        resolved_name: str,
        callback: Callable[[Any, Any], Any],
        callback_group: CallbackGroup,
        qos_profile: QoSProfile,
    ) -> None:
        services_wire.check_service_type(srv_type)
        self.srv_type = srv_type
        self.srv_name = srv_name
        self.callback = callback
        self.callback_group = callback_group
        self.qos_profile = qos_profile
        self._resolved_name = resolved_name
        self._wire = TwoWay(
            node.context,
            srv_type.Request,
            services_wire.request_topic(resolved_name),
            srv_type.Response,
            services_wire.reply_topic(resolved_name),
            qos_profile,
        )
        self.reader_gid, self.writer_gid = self._wire.reader_gid, self._wire.writer_gid

    @property
    def wait_entity(self) -> int:
        """What a wait set attaches."""
        return self._wire.wait_entity

    @property
    def service_name(self) -> str:
        """The service's name, expanded and remapped."""
        return self._resolved_name

    def take(self) -> tuple[Callable[..., Any], tuple[Any, ...]] | None:
        """Take the next request, and say what to run."""
        received = self._wire.receive()
        return None if received is None else (self._answer, received)

    def _answer(self, request_id: RequestId, request: Any) -> Any:
        response = self.callback(request, self.srv_type.Response())
        if hasattr(response, "__await__"):
            return self._answer_later(request_id, response)
        self.send_response(response, request_id)
        return None

    async def _answer_later(self, request_id: RequestId, response: Any) -> None:
        self.send_response(await response, request_id)

    def send_response(self, response: Any, header: RequestId) -> None:
        """Send the response to one request."""
        self._wire.send(header, response)

    def destroy(self) -> None:
        """Destroy the service; nodes do it by :meth:`Node.destroy_service`."""
        self._wire.close()
