"""By default no packet leaves the loopback interface: looked at on a second one, in a network namespace."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from rosless_support import SOURCE

NAMESPACE = f"rosless{os.getpid() % 10000}"
_ETH_P_ALL = 3

# Runs inside the namespace: listens on the second interface while two nodes talk, and counts what it sees.
PROGRAM = f"""
import select, socket, subprocess, sys, time
sniffer = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons({_ETH_P_ALL}))
sniffer.bind(("outside0", 0))
sniffer.setblocking(False)

def count():
    packets = 0
    while select.select([sniffer], [], [], 0)[0]:
        data, address = sniffer.recvfrom(65536)
        # IPv4 to or from the RTPS ports; the kernel itself sends IPv6 neighbour discovery now and then
        if data[12:14] == b"\\x08\\x00" and data[23] == 17:
            packets += 1
    return packets

child = '''
import sys; sys.path.insert(0, {str(SOURCE)!r}); import rosless.activate
import rclpy
from std_msgs.msg import Int32
rclpy.init()
node = rclpy.create_node("n")
publisher = node.create_publisher(Int32, "a", 10)
got = []
node.create_subscription(Int32, "b", got.append, 10)
node.create_timer(0.05, lambda: publisher.publish(Int32()))
for _ in range(30):
    rclpy.spin_once(node, timeout_sec=0.1)
print(len(got))
'''
peers = [
    subprocess.Popen([sys.executable, "-c", child.replace('"b"', '"a"')], stdout=subprocess.PIPE, text=True)
    for _ in range(2)
]
answers = [int(peer.communicate(timeout=30)[0]) for peer in peers]
print(min(answers) > 0, count())
probe = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
probe.sendto(b"x", ("10.231.77.2", 7400))
time.sleep(0.2)
print(count() > 0)
"""


def _ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True, capture_output=True, text=True, timeout=10)


@pytest.fixture
def namespace() -> Iterator[str]:
    if sys.platform != "linux" or os.geteuid() != 0:
        pytest.skip("needs root on Linux to make a network namespace")
    if shutil.which("ip") is None:
        pytest.skip("needs iproute2 (the command ip)")
    try:
        _ip("netns", "add", NAMESPACE)
    except subprocess.CalledProcessError as error:
        pytest.skip(f"cannot make a network namespace here: {error.stderr.strip()}")
    try:
        inside = ("netns", "exec", NAMESPACE, "ip")
        _ip(*inside, "link", "set", "lo", "up")
        try:
            _ip(*inside, "link", "add", "outside0", "type", "veth", "peer", "name", "outside1")
        except subprocess.CalledProcessError as error:
            pytest.skip(f"cannot make a second interface here: {error.stderr.strip()}")
        for name, address in (("outside0", "10.231.77.1/24"), ("outside1", None)):
            if address:
                _ip(*inside, "addr", "add", address, "dev", name)
            _ip(*inside, "link", "set", name, "up")
        # so that a packet to the outside is sent without asking for the neighbour's address first
        _ip(*inside, "neigh", "add", "10.231.77.2", "lladdr", "02:00:00:00:00:02", "dev", "outside0")
        _ip(*inside, "route", "add", "239.0.0.0/8", "dev", "outside0")
        yield NAMESPACE
    finally:
        subprocess.run(["ip", "netns", "delete", NAMESPACE], capture_output=True, timeout=10)


def _run(namespace: str, folder: Path, **environment: str) -> tuple[bool, int, bool]:
    program = folder / "sniff.py"
    program.write_text(PROGRAM)
    result = subprocess.run(
        ["ip", "netns", "exec", namespace, sys.executable, str(program)],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=60,
    )
    heard, packets, probe_seen = result.stdout.split() or (result.stderr, "", "")
    return heard == "True", int(packets), probe_seen == "True"


def test_no_packet_leaves_the_machine(namespace: str, domain: int, tmp_path: Path) -> None:
    heard, packets, probe_seen = _run(namespace, tmp_path)
    assert heard, "the nodes did not hear each other"
    assert probe_seen, "the sniffer sees nothing at all"
    assert packets == 0


def test_packets_leave_when_asked_to(namespace: str, domain: int, tmp_path: Path) -> None:
    _, packets, _ = _run(namespace, tmp_path, ROS_AUTOMATIC_DISCOVERY_RANGE="SUBNET")
    assert packets > 0
