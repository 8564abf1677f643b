"""What a node creates and destroys: publishers, subscriptions, services, clients, timers, guard conditions."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from rosless import names
from rosless.callback_groups import CallbackGroup
from rosless.client import Client
from rosless.clock import Clock
from rosless.constants import S_TO_NS
from rosless.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rosless.guard_condition import GuardCondition
from rosless.interfaces.classes import Message
from rosless.publisher import Publisher
from rosless.qos import QoSProfile, qos_profile_services_default
from rosless.service import Service
from rosless.subscription import Subscription
from rosless.timer import Rate, Timer

if TYPE_CHECKING:
    from rosless.arguments import Arguments
    from rosless.context import Context
    from rosless.discovery import NodeEntry
    from rosless.executors import Executor
    from rosless.node import Node


class NodeEntities:
    """The methods of rclpy's Node that create and destroy."""

    _name: str
    _namespace: str
    _context: Context
    _clock: Clock
    _entry: NodeEntry
    _argument_sets: list[Arguments]
    _default_callback_group: CallbackGroup
    _rate_group: CallbackGroup

    def __init__(self) -> None:
        self._publishers: list[Publisher] = []
        self._subscriptions: list[Subscription] = []
        self._clients: list[Client] = []
        self._services: list[Service] = []
        self._timers: list[Timer] = []
        self._guards: list[GuardCondition] = []

    @property
    def executor(self) -> Executor | None:
        """The executor that this node has been added to."""
        raise NotImplementedError

    def _node(self) -> Node:
        """This object, as the node that it is."""
        raise NotImplementedError

    @property
    def publishers(self) -> Iterator[Publisher]:
        """The publishers of this node."""
        yield from self._publishers

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """The subscriptions of this node."""
        yield from self._subscriptions

    @property
    def clients(self) -> Iterator[Client]:
        """The clients of this node."""
        yield from self._clients

    @property
    def services(self) -> Iterator[Service]:
        """The services of this node."""
        yield from self._services

    @property
    def timers(self) -> Iterator[Timer]:
        """The timers of this node."""
        yield from self._timers

    @property
    def guards(self) -> Iterator[GuardCondition]:
        """The guard conditions of this node."""
        yield from self._guards

    def wait_items(self) -> list[Any]:
        """Everything but timers that an executor has to wait for."""
        items: list[Any] = [*self._subscriptions, *self._guards, *self._clients, *self._services]
        endpoints: list[Any] = [*self._publishers, *self._subscriptions]
        for endpoint in endpoints:
            items += endpoint.event_handlers
        return items

    def _entities_changed(self) -> None:
        executor = self.executor
        if executor is not None:
            executor._entities_changed()

    # Topics

    def resolve_topic_name(self, topic: str, *, only_expand: bool = False) -> str:
        """The topic, expanded and remapped."""
        return self._resolve(topic, only_expand=only_expand, is_service=False)

    def resolve_service_name(self, service: str, *, only_expand: bool = False) -> str:
        """The service, expanded and remapped."""
        return self._resolve(service, only_expand=only_expand, is_service=True)

    def _resolve(self, name: str, *, only_expand: bool, is_service: bool) -> str:
        names.validate_topic_name(name, is_service=is_service)
        full = names.expand(name, self._name, self._namespace)
        if not only_expand:
            for rules in self._argument_sets:
                remapped = rules.topic(full, self._name, self._namespace, is_service=is_service)
                if remapped is not None:
                    full = remapped
                    break
        names.validate_full_topic_name(full, is_service=is_service)
        return full

    def create_publisher(
        self,
        msg_type: type[Any],
        topic: str,
        qos_profile: QoSProfile | int,
        *,
        callback_group: CallbackGroup | None = None,
        event_callbacks: PublisherEventCallbacks | None = None,
        qos_overriding_options: Any = None,
        publisher_class: type[Publisher] = Publisher,
    ) -> Publisher:
        """Create a publisher; an int as QoS is the depth of KEEP_LAST."""
        if qos_overriding_options is not None:
            raise NotImplementedError("rosless does not support qos_overriding_options")
        publisher = publisher_class(
            self._node(),
            _message_type(msg_type),
            topic,
            self.resolve_topic_name(topic),
            _profile(qos_profile),
            event_callbacks or PublisherEventCallbacks(),
            callback_group or self._default_callback_group,
        )
        self._publishers.append(publisher)
        self._context.graph.add_endpoint(self._entry, publisher.gid, is_writer=True)
        self._entities_changed()
        return publisher

    def create_subscription(
        self,
        msg_type: type[Any],
        topic: str,
        callback: Callable[..., Any],
        qos_profile: QoSProfile | int,
        *,
        callback_group: CallbackGroup | None = None,
        event_callbacks: SubscriptionEventCallbacks | None = None,
        qos_overriding_options: Any = None,
        raw: bool = False,
        content_filter_options: Any = None,
    ) -> Subscription:
        """Create a subscription; an int as QoS is the depth of KEEP_LAST."""
        if qos_overriding_options is not None:
            raise NotImplementedError("rosless does not support qos_overriding_options")
        if content_filter_options is not None:
            raise NotImplementedError("rosless does not support content_filter_options")
        subscription = Subscription(
            self._node(),
            _message_type(msg_type),
            topic,
            self.resolve_topic_name(topic),
            callback,
            callback_group or self._default_callback_group,
            _profile(qos_profile),
            raw,
            event_callbacks or SubscriptionEventCallbacks(),
        )
        subscription.callback_group.add_entity(subscription)
        self._subscriptions.append(subscription)
        self._context.graph.add_endpoint(self._entry, subscription.gid, is_writer=False)
        self._entities_changed()
        return subscription

    # Services

    def create_service(
        self,
        srv_type: type[Any],
        srv_name: str,
        callback: Callable[[Any, Any], Any],
        *,
        qos_profile: QoSProfile = qos_profile_services_default,
        callback_group: CallbackGroup | None = None,
    ) -> Service:
        """Offer a service."""
        resolved = self.resolve_service_name(srv_name)
        group = callback_group or self._default_callback_group
        service = Service(self._node(), srv_type, srv_name, resolved, callback, group, qos_profile)
        group.add_entity(service)
        self._services.append(service)
        self._announce(service, add=True)
        return service

    def create_client(
        self,
        srv_type: type[Any],
        srv_name: str,
        *,
        qos_profile: QoSProfile = qos_profile_services_default,
        callback_group: CallbackGroup | None = None,
    ) -> Client:
        """Create a client of a service."""
        resolved = self.resolve_service_name(srv_name)
        group = callback_group or self._default_callback_group
        client = Client(self._node(), srv_type, srv_name, resolved, group, qos_profile)
        group.add_entity(client)
        self._clients.append(client)
        self._announce(client, add=True)
        return client

    def _announce(self, endpoint: Service | Client, *, add: bool) -> None:
        graph = self._context.graph
        change = graph.add_endpoint if add else graph.remove_endpoint
        change(self._entry, endpoint.reader_gid, is_writer=False)
        change(self._entry, endpoint.writer_gid, is_writer=True)
        self._entities_changed()

    # Timers and the like

    def create_timer(
        self,
        timer_period_sec: float,
        callback: Callable[..., Any] | None,
        callback_group: CallbackGroup | None = None,
        clock: Clock | None = None,
        autostart: bool = True,
    ) -> Timer:
        """Call a function each time a period of the node's clock (or of another) has passed."""
        group = callback_group or self._default_callback_group
        period = int(float(timer_period_sec) * S_TO_NS)
        timer = Timer(callback, group, period, clock or self._clock, context=self._context, autostart=autostart)
        group.add_entity(timer)
        self._timers.append(timer)
        self._entities_changed()
        return timer

    def create_guard_condition(
        self, callback: Callable[[], Any], callback_group: CallbackGroup | None = None
    ) -> GuardCondition:
        """Call a function each time the condition is triggered."""
        group = callback_group or self._default_callback_group
        guard = GuardCondition(callback, group, context=self._context)
        group.add_entity(guard)
        self._guards.append(guard)
        self._entities_changed()
        return guard

    def create_rate(self, frequency: float, clock: Clock | None = None) -> Rate:
        """An object whose sleep() keeps a frequency; use it in a thread other than the one that spins."""
        if frequency <= 0:
            raise ValueError("frequency must be > 0")
        return Rate(self.create_timer(1.0 / frequency, None, self._rate_group, clock), context=self._context)

    def add_waitable(self, waitable: Any) -> None:
        """Not supported: rclpy's waitables work on rcl's wait sets."""
        raise NotImplementedError("rosless does not support waitables (actions, for instance, are built on them)")

    # Destruction

    def destroy_publisher(self, publisher: Publisher) -> bool:
        """Destroy a publisher of this node."""
        if publisher not in self._publishers:
            return False
        self._publishers.remove(publisher)
        publisher.destroy()
        self._context.graph.remove_endpoint(self._entry, publisher.gid, is_writer=True)
        self._entities_changed()
        return True

    def destroy_subscription(self, subscription: Subscription) -> bool:
        """Destroy a subscription of this node."""
        if subscription not in self._subscriptions:
            return False
        self._subscriptions.remove(subscription)
        subscription.destroy()
        self._context.graph.remove_endpoint(self._entry, subscription.gid, is_writer=False)
        self._entities_changed()
        return True

    def destroy_service(self, service: Service) -> bool:
        """Destroy a service of this node."""
        return self._destroy_two_way(service, self._services)

    def destroy_client(self, client: Client) -> bool:
        """Destroy a client of this node."""
        return self._destroy_two_way(client, self._clients)

    def _destroy_two_way(self, endpoint: Any, owned: list[Any]) -> bool:
        if endpoint not in owned:
            return False
        owned.remove(endpoint)
        endpoint.destroy()
        self._announce(endpoint, add=False)
        return True

    def destroy_timer(self, timer: Timer) -> bool:
        """Destroy a timer of this node."""
        return self._destroy_simple(timer, self._timers)

    def destroy_guard_condition(self, guard: GuardCondition) -> bool:
        """Destroy a guard condition of this node."""
        return self._destroy_simple(guard, self._guards)

    def destroy_rate(self, rate: Rate) -> bool:
        """Destroy a rate of this node."""
        success = self.destroy_timer(rate._timer)
        rate.destroy()
        return success

    def _destroy_simple(self, entity: Any, owned: list[Any]) -> bool:
        if entity not in owned:
            return False
        owned.remove(entity)
        entity.destroy()
        self._entities_changed()
        return True

    def _destroy_entities(self) -> None:
        owned: list[Any] = [*self._publishers, *self._subscriptions, *self._services, *self._clients]
        for entity in (*owned, *self._timers, *self._guards):
            entity.destroy()
        for entities in (self._publishers, self._subscriptions, self._services, self._clients):
            entities.clear()
        self._timers.clear()
        self._guards.clear()


def _profile(qos_or_depth: QoSProfile | int) -> QoSProfile:
    if isinstance(qos_or_depth, QoSProfile):
        return qos_or_depth
    if isinstance(qos_or_depth, int):
        if qos_or_depth < 0:
            raise ValueError("history depth must be greater than or equal to zero")
        return QoSProfile(depth=qos_or_depth)
    raise TypeError(f"Expected QoSProfile or int, but received {type(qos_or_depth)!r}")


def _message_type(msg_type: type[Any]) -> type[Any]:
    if not (isinstance(msg_type, type) and issubclass(msg_type, Message)):
        raise TypeError(f"Expected a message class, got {msg_type!r}")
    return msg_type
