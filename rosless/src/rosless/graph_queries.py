"""The methods of rclpy's Node that ask about the graph."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from rosless import names
from rosless.endpoint_info import TopicEndpointInfo
from rosless.exceptions import NodeNameNonExistentError

if TYPE_CHECKING:
    from rosless.context import Context
    from rosless.discovery import Endpoint

NamesAndTypes = list[tuple[str, list[str]]]

_POLL_S = 0.02


class GraphQueries:
    """Asks the context's graph, with names as this node sees them."""

    _context: Context

    def get_name(self) -> str:
        """The node's name."""
        raise NotImplementedError

    def get_namespace(self) -> str:
        """The node's namespace."""
        raise NotImplementedError

    def resolve_topic_name(self, topic: str, *, only_expand: bool = False) -> str:
        """The topic, expanded and remapped."""
        raise NotImplementedError

    def count_publishers(self, topic_name: str) -> int:
        """Number of publishers of a topic."""
        return self._context.graph.count(self._dds_topic(topic_name), writers=True)

    def count_subscribers(self, topic_name: str) -> int:
        """Number of subscriptions of a topic."""
        return self._context.graph.count(self._dds_topic(topic_name), writers=False)

    def count_clients(self, service_name: str) -> int:
        """Number of clients of a service."""
        return self._context.graph.count(f"rq{self._expanded(service_name)}Request", writers=True)

    def count_services(self, service_name: str) -> int:
        """Number of servers of a service."""
        return self._context.graph.count(f"rq{self._expanded(service_name)}Request", writers=False)

    def get_publishers_info_by_topic(self, topic_name: str, no_mangle: bool = False) -> list[TopicEndpointInfo]:
        """What is known of each publisher of a topic."""
        return self._infos(topic_name, no_mangle, writers=True)

    def get_subscriptions_info_by_topic(self, topic_name: str, no_mangle: bool = False) -> list[TopicEndpointInfo]:
        """What is known of each subscription of a topic."""
        return self._infos(topic_name, no_mangle, writers=False)

    def _infos(self, topic_name: str, no_mangle: bool, *, writers: bool) -> list[TopicEndpointInfo]:
        if no_mangle:
            return self._context.graph.infos(topic_name, writers=writers)
        names.validate_full_topic_name(self._expanded(topic_name))
        return self._context.graph.infos(names.topic_to_dds(self.resolve_topic_name(topic_name)), writers=writers)

    def get_topic_names_and_types(self, no_demangle: bool = False) -> NamesAndTypes:
        """Every topic with its types."""
        graph = self._context.graph
        return _topics([*graph.endpoints(writers=True), *graph.endpoints(writers=False)], no_demangle)

    def get_publisher_names_and_types_by_node(
        self, node_name: str, node_namespace: str, no_demangle: bool = False
    ) -> NamesAndTypes:
        """The topics that a node publishes."""
        return _topics(self._of_node(node_name, node_namespace, writers=True), no_demangle)

    def get_subscriber_names_and_types_by_node(
        self, node_name: str, node_namespace: str, no_demangle: bool = False
    ) -> NamesAndTypes:
        """The topics that a node subscribes to."""
        return _topics(self._of_node(node_name, node_namespace, writers=False), no_demangle)

    def get_service_names_and_types(self) -> NamesAndTypes:
        """Every service with its types."""
        return _services(self._context.graph.endpoints(writers=False))

    def get_service_names_and_types_by_node(self, node_name: str, node_namespace: str) -> NamesAndTypes:
        """The services that a node offers."""
        return _services(self._of_node(node_name, node_namespace, writers=False))

    def get_client_names_and_types_by_node(self, node_name: str, node_namespace: str) -> NamesAndTypes:
        """The services that a node is a client of."""
        return _services(self._of_node(node_name, node_namespace, writers=True))

    def _of_node(self, node_name: str, node_namespace: str, *, writers: bool) -> list[Endpoint]:
        graph = self._context.graph
        if not graph.has_node(node_name, node_namespace):
            raise NodeNameNonExistentError(f"cannot find node {names.join(node_namespace, node_name)}")
        return graph.endpoints_of_node(node_name, node_namespace, writers=writers)

    def get_node_names(self) -> list[str]:
        """The names of all nodes."""
        return [name for name, _ in self.get_node_names_and_namespaces()]

    def get_node_names_and_namespaces(self) -> list[tuple[str, str]]:
        """Name and namespace of all nodes."""
        return self._context.graph.nodes()

    def get_node_names_and_namespaces_with_enclaves(self) -> list[tuple[str, str, str]]:
        """Name, namespace and enclave of all nodes; security is not supported, so the enclave is always /."""
        return [(name, namespace, "/") for name, namespace in self._context.graph.nodes()]

    def get_fully_qualified_node_names(self) -> list[str]:
        """The full names of all nodes."""
        return [names.join(namespace, name) for name, namespace in self._context.graph.nodes()]

    def wait_for_node(self, fully_qualified_node_name: str, timeout: float) -> bool:
        """Wait until there is such a node; False if that takes longer than the timeout in seconds."""
        wanted = names.normalize_namespace(fully_qualified_node_name)
        end = time.monotonic() + timeout
        while wanted not in self.get_fully_qualified_node_names():
            if time.monotonic() >= end:
                return False
            time.sleep(_POLL_S)
        return True

    def _expanded(self, name: str) -> str:
        return names.expand_topic_name(name, self.get_name(), self.get_namespace())

    def _dds_topic(self, topic_name: str) -> str:
        expanded = self._expanded(topic_name)
        names.validate_full_topic_name(expanded)
        return names.topic_to_dds(expanded)


def _topics(endpoints: list[Endpoint], no_demangle: bool) -> NamesAndTypes:
    found: dict[str, dict[str, None]] = {}
    for endpoint in endpoints:
        if no_demangle:
            found.setdefault(endpoint.topic, {})[endpoint.type_name] = None
            continue
        topic = names.topic_from_dds(endpoint.topic)
        if topic is not None:
            found.setdefault(topic, {})[endpoint.ros_type] = None
    return [(name, sorted(types)) for name, types in sorted(found.items())]


def _services(endpoints: list[Endpoint]) -> NamesAndTypes:
    found: dict[str, dict[str, None]] = {}
    for endpoint in endpoints:
        if endpoint.topic.startswith("rq/") and endpoint.topic.endswith("Request"):
            name = endpoint.topic[2 : -len("Request")]
            found.setdefault(name, {})[endpoint.ros_type.removesuffix("_Request")] = None
    return [(name, sorted(types)) for name, types in sorted(found.items())]
