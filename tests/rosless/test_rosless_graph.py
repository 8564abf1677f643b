"""The graph as nodes of one process see it: who is there, in which domain, and from init to shutdown."""

from __future__ import annotations

import threading
import time

import pytest
from common import PATIENCE, new_domain, wait_until
from rosless.context import Context
from rosless.exceptions import (
    InvalidNodeNameException,
    NotInitializedException,
    RCLError,
)
from rosless.executors import ExternalShutdownException, SingleThreadedExecutor
from rosless.interfaces.classes import message_class
from rosless.node import Node
from rosless.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data

from rosless import domain as domain_module

Int32 = message_class("std_msgs/msg/Int32")
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def test_the_graph(node: Node, context: Context) -> None:
    other = Node("bus", context=context)
    publisher = node.create_publisher(Int32, "~/numbers", LATCHED)
    other.create_subscription(Int32, "/ns/car/numbers", print, qos_profile_sensor_data)
    assert set(other.get_node_names_and_namespaces()) == {("car", "/ns"), ("bus", "/")}
    assert set(node.get_fully_qualified_node_names()) == {"/ns/car", "/bus"}
    assert dict(other.get_topic_names_and_types())["/ns/car/numbers"] == ["std_msgs/msg/Int32"]
    assert (node.count_publishers("~/numbers"), other.count_subscribers("/ns/car/numbers")) == (1, 1)
    (info,) = other.get_publishers_info_by_topic("/ns/car/numbers")
    assert (info.node_name, info.node_namespace, info.topic_type) == ("car", "/ns", "std_msgs/msg/Int32")
    assert info.endpoint_gid == list(publisher.gid)
    assert info.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
    assert str(info.topic_type_hash).startswith("RIHS01_")
    assert "Topic type hash: RIHS01_" in str(info)
    (info,) = node.get_subscriptions_info_by_topic("~/numbers")
    assert info.node_name == "bus"
    assert info.qos_profile.reliability == qos_profile_sensor_data.reliability
    assert "/ns/car/numbers" in dict(other.get_publisher_names_and_types_by_node("car", "/ns"))
    assert "/ns/car/get_parameters" in dict(other.get_service_names_and_types_by_node("car", "/ns"))
    node.destroy_publisher(publisher)
    assert wait_until(lambda: other.count_publishers("/ns/car/numbers") == 0)
    other.destroy_node()
    assert node.get_node_names() == ["car"]
    assert not node.wait_for_node("/bus", 0.05)


def test_names_and_remapping(context: Context) -> None:
    node = Node("car", context=context, cli_args=["-r", "in:=/elsewhere", "-r", "__ns:=/space", "-r", "__node:=bus"])
    assert node.get_fully_qualified_name() == "/space/bus"
    assert node.get_logger().name == "space.bus"
    assert node.resolve_topic_name("in") == "/elsewhere"
    assert node.resolve_topic_name("in", only_expand=True) == "/space/in"
    assert node.resolve_topic_name("~/in") == "/space/bus/in"
    assert node.create_subscription(Int32, "in", print, 1).topic_name == "/elsewhere"
    with pytest.raises(InvalidNodeNameException):
        Node("not valid", context=context)


def test_two_domains_in_one_process_do_not_meet(context: Context) -> None:
    other = Context()
    other.init(args=[], domain_id=new_domain())
    here, there = Node("here", context=context), Node("there", context=other)
    publisher = here.create_publisher(Int32, "/a", 1)
    there.create_subscription(Int32, "/a", print, 1)
    time.sleep(0.3)
    assert publisher.get_subscription_count() == 0
    assert here.get_node_names() == ["here"]
    other.destroy()


@pytest.mark.parametrize("text", ["abc", "-1", "233", "1.5", "٣"])
def test_a_malformed_domain_id_is_one_clear_line(text: str) -> None:
    with pytest.raises(RCLError) as caught:
        domain_module.domain_id(None, {"ROS_DOMAIN_ID": text})
    assert "ROS_DOMAIN_ID" in str(caught.value)
    assert text in str(caught.value)
    assert "\n" not in str(caught.value)


def test_domain_ids() -> None:
    assert domain_module.domain_id(None, {}) == 0
    assert domain_module.domain_id(None, {"ROS_DOMAIN_ID": " 42 "}) == 42
    assert domain_module.domain_id(7, {"ROS_DOMAIN_ID": "42"}) == 7


def test_discovery_ranges() -> None:
    configuration = domain_module.configuration
    assert 'address="127.0.0.1" multicast="false"' in configuration({})
    assert configuration({"CYCLONEDDS_URI": "file:///x.xml"}) == "file:///x.xml"
    subnet = configuration({"ROS_AUTOMATIC_DISCOVERY_RANGE": "subnet", "ROS_STATIC_PEERS": "10.0.0.1;10.0.0.2"})
    assert "NetworkInterface" not in subnet
    assert '<Peer address="10.0.0.1"/><Peer address="10.0.0.2"/>' in subnet
    assert "NetworkInterface" not in configuration({"ROS_STATIC_PEERS": "10.0.0.1"})
    assert "<Tag>" in configuration({"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"})
    assert configuration({"ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT"}) == ""
    with pytest.raises(RCLError, match="must be one of"):
        configuration({"ROS_AUTOMATIC_DISCOVERY_RANGE": "GALAXY"})


def test_a_context_leaves_the_domain_when_its_nodes_are_gone(context: Context) -> None:
    watcher = Node("watcher", context=context)
    other = Context()
    other.init(args=[], domain_id=context.get_domain_id())
    node = Node("short_lived", context=other)
    publisher = node.create_publisher(Int32, "a", 1)
    assert wait_until(lambda: "short_lived" in watcher.get_node_names())
    assert wait_until(lambda: watcher.count_publishers("a") == 1)
    other.shutdown()
    assert not other.participant.closed
    node.destroy_node()
    assert other.participant.closed
    assert not node.destroy_publisher(publisher)
    assert wait_until(lambda: watcher.get_node_names() == ["watcher"])
    assert wait_until(lambda: watcher.count_publishers("a") == 0)


def test_shutdown_ends_spin(domain: int) -> None:
    context = Context()
    context.init(args=[], domain_id=domain)
    node = Node("car", context=context)
    publisher = node.create_publisher(Int32, "a", 1)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    threading.Timer(0.1, context.shutdown).start()
    with pytest.raises(ExternalShutdownException):
        executor.spin()
    assert not context.ok()
    with pytest.raises(RCLError, match="already called"):
        context.shutdown()
    with pytest.raises(RCLError, match="context is invalid"):
        publisher.publish(Int32())
    context.try_shutdown()
    with pytest.raises(NotInitializedException):
        Node("bus", context=context)
    with pytest.raises(RuntimeError, match="once"):
        context.init(args=[])


def test_init_and_shutdown_can_be_repeated(domain: int) -> None:
    from rosless import api

    for number in range(3):
        api.init(args=[], domain_id=domain)
        node = api.create_node(f"node_{number}")
        calls: list[int] = []
        node.create_timer(0.0, lambda calls=calls: calls.append(1))  # type: ignore[misc]
        api.spin_once(node, timeout_sec=PATIENCE)
        assert calls == [1]
        assert node.get_node_names() == [f"node_{number}"]
        node.destroy_node()
        api.shutdown()
        assert not api.ok()
