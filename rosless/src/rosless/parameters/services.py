"""The services by which others read and set a node's parameters (``ros2 param``)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rosless.exceptions import ParameterNotDeclaredException, ParameterUninitializedException
from rosless.interfaces.classes import message_class, service_class
from rosless.parameters.parameter import Parameter
from rosless.qos import qos_profile_parameters

if TYPE_CHECKING:
    from rosless.node import Node


class ParameterServices:
    """Six services below the node's name."""

    def __init__(self, node: Node) -> None:
        self._node = node
        for name, service, callback in (
            ("describe_parameters", "DescribeParameters", self._describe),
            ("get_parameters", "GetParameters", self._get),
            ("get_parameter_types", "GetParameterTypes", self._get_types),
            ("list_parameters", "ListParameters", self._list),
            ("set_parameters", "SetParameters", self._set),
            ("set_parameters_atomically", "SetParametersAtomically", self._set_atomically),
        ):
            node.create_service(
                service_class("rcl_interfaces", service),
                f"~/{name}",
                callback,
                qos_profile=qos_profile_parameters,
            )

    def _describe(self, request: Any, response: Any) -> Any:
        for name in request.names:
            try:
                response.descriptors.append(self._node.describe_parameter(name))
            except ParameterNotDeclaredException:
                response.descriptors = []
                break
        return response

    def _get(self, request: Any, response: Any) -> Any:
        for name in request.names:
            try:
                parameter = self._node.get_parameter(name)
            except (ParameterNotDeclaredException, ParameterUninitializedException):
                response.values = []
                break
            response.values.append(parameter.get_parameter_value())
        return response

    def _get_types(self, request: Any, response: Any) -> Any:
        try:
            types = self._node.get_parameter_types(request.names)
        except ParameterNotDeclaredException:
            return response
        response.types = [type_.value if isinstance(type_, Parameter.Type) else type_ for type_ in types]
        return response

    def _list(self, request: Any, response: Any) -> Any:
        try:
            response.result = self._node.list_parameters(list(request.prefixes), request.depth)
        except (TypeError, ValueError) as error:
            self._node.get_logger().error(f"list_parameters: {error}")
        return response

    def _set(self, request: Any, response: Any) -> Any:
        for message in request.parameters:
            response.results.append(self._try_to_set([message]))
        return response

    def _set_atomically(self, request: Any, response: Any) -> Any:
        response.result = self._try_to_set(request.parameters)
        return response

    def _try_to_set(self, messages: list[Any]) -> Any:
        try:
            return self._node.set_parameters_atomically([Parameter.from_parameter_msg(message) for message in messages])
        except Exception as error:
            # whatever a caller sends, the node goes on
            return message_class("rcl_interfaces/msg/SetParametersResult")(successful=False, reason=str(error))
