"""rclpy.node."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from rosless import arguments, names
from rosless.callback_groups import CallbackGroup, MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rosless.clock import Clock, ROSClock
from rosless.context import Context
from rosless.exceptions import NodeNameNonExistentError, NotInitializedException
from rosless.graph_queries import GraphQueries
from rosless.logging import RcutilsLogger, get_logger
from rosless.node_entities import NodeEntities
from rosless.parameters.events import ParameterEvents
from rosless.parameters.node_parameters import NodeParameters
from rosless.parameters.parameter import Parameter
from rosless.parameters.services import ParameterServices
from rosless.time_source import TimeSource
from rosless.utilities import get_default_context

if TYPE_CHECKING:
    from rosless.executors import Executor

__all__ = ["Node", "NodeNameNonExistentError"]


class Node(NodeEntities, NodeParameters, GraphQueries):
    """A node: what a program sends, receives and can be configured with, under one name."""

    PARAM_REL_TOL = 1e-6

    def __init__(
        self,
        node_name: str,
        *,
        context: Context | None = None,
        cli_args: list[str] | None = None,
        namespace: str | None = None,
        use_global_arguments: bool = True,
        enable_rosout: bool = True,
        start_parameter_services: bool = True,
        parameter_overrides: list[Parameter] | None = None,
        allow_undeclared_parameters: bool = False,
        automatically_declare_parameters_from_overrides: bool = False,
        enable_logger_service: bool = False,
    ) -> None:
        self._context = get_default_context() if context is None else context
        if not self._context.ok():
            raise NotInitializedException("cannot create node")
        if enable_logger_service:
            raise NotImplementedError("rosless does not support enable_logger_service")
        # rules of the node itself come before those of the process
        local = arguments.parse(["--ros-args", *(cli_args or [])])
        self._argument_sets = [local, self._context.arguments] if use_global_arguments else [local]
        self._name, self._namespace = self._remapped_name(node_name, names.normalize_namespace(namespace or ""))
        names.validate_node_name(self._name)
        names.validate_namespace(self._namespace)
        NodeEntities.__init__(self)
        self._default_callback_group = MutuallyExclusiveCallbackGroup()
        self._rate_group = ReentrantCallbackGroup()
        self._executor: Callable[[], Executor | None] = lambda: None
        self._destroyed = False
        logger_name = names.join(self._namespace, self._name).strip("/").replace("/", ".")
        self._logger = get_logger(logger_name)
        self._clock = ROSClock()
        self._entry = self._context.graph.add_node(self._name, self._namespace)
        overrides = self._overrides()
        overrides.update({parameter.name: parameter for parameter in parameter_overrides or []})
        NodeParameters.__init__(self, overrides, allow_undeclared=allow_undeclared_parameters)
        self._parameter_events = ParameterEvents(self)
        if automatically_declare_parameters_from_overrides:
            self.declare_parameters("", [(name, item.value) for name, item in overrides.items()], True)
        self._time_source = TimeSource(self, self._clock)
        if start_parameter_services:
            self._parameter_services = ParameterServices(self)

    def _remapped_name(self, name: str, namespace: str) -> tuple[str, str]:
        for rules in self._argument_sets:
            if (remapped := rules.node_name(name)) != name:
                name = remapped
                break
        for rules in self._argument_sets:
            if (remapped := rules.namespace(namespace, name)) != namespace:
                return name, remapped
        return name, namespace

    def _overrides(self) -> dict[str, Parameter]:
        values: dict[str, Any] = {}
        for rules in reversed(self._argument_sets):
            values.update(rules.parameters_for(self.get_fully_qualified_name()))
        return {name: Parameter(name, value=value) for name, value in values.items()}

    # What it is

    def get_name(self) -> str:
        """The node's name."""
        return self._name

    def get_namespace(self) -> str:
        """The node's namespace."""
        return self._namespace

    def get_fully_qualified_name(self) -> str:
        """Namespace and name."""
        return names.join(self._namespace, self._name)

    def get_clock(self) -> Clock:
        """The node's clock: ROS time."""
        return self._clock

    def get_logger(self) -> RcutilsLogger:
        """The node's logger."""
        return self._logger

    @property
    def context(self) -> Context:
        """The context of this node."""
        return self._context

    @property
    def default_callback_group(self) -> CallbackGroup:
        """The group of whatever is created without one."""
        return self._default_callback_group

    @property
    def executor(self) -> Executor | None:
        """The executor that this node has been added to."""
        return self._executor()

    @executor.setter
    def executor(self, new_executor: Executor | None) -> None:
        current = self.executor
        if current is new_executor:
            return
        if current is not None:
            current.remove_node(self)
        if new_executor is None:
            self._executor = lambda: None
        else:
            self._executor = weakref.ref(new_executor)
            new_executor.add_node(self)

    def _node(self) -> Node:
        return self

    def destroy_node(self) -> None:
        """Destroy this node and all that it has created."""
        if self._destroyed:
            return
        self._destroyed = True
        self._parameter_events = None
        self._context.graph.remove_node(self._entry)
        self._destroy_entities()
        self._context.release()
        self._entities_changed()
