"""A whole `skd episode` sends nothing beyond loopback: looked at on a second interface, in a network namespace."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from graph_support import Program, skd_command

NAMESPACE = f"skd{os.getpid() % 10000}"

# Runs inside the namespace: listens on the second interface while the command runs, then checks that it can hear.
PROGRAM = """
import json, select, socket, subprocess, sys, time
sniffer = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(3))
sniffer.bind(("outside0", 0))
sniffer.setblocking(False)

def heard():
    packets = []
    while select.select([sniffer], [], [], 0)[0]:
        data, _ = sniffer.recvfrom(65536)
        if data[12:14] != b"\\x86\\xdd":  # the kernel itself sends IPv6 neighbour discovery now and then
            packets.append(data[:64].hex())
    return packets

done = subprocess.run(sys.argv[1:], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, timeout=50)
during = heard()
probe = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
probe.sendto(b"x", ("10.231.77.2", 7400))
time.sleep(0.2)
print(json.dumps({"code": done.returncode, "err": done.stderr, "during": during, "probe": len(heard())}))
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


def sniffed(namespace: str, folder: Path, safe: Path, **environment: str | None) -> list[str]:
    """Run an episode, and return the packets that were heard on the second interface meanwhile."""
    script = folder / "sniff.py"
    script.write_text(PROGRAM)
    command = skd_command("episode", "--safe", safe, "--simulations", 100, "--out", folder / "out")
    program = Program(["ip", "netns", "exec", namespace, sys.executable, str(script), *command], environment)
    finished = program.finish()
    assert finished.code == 0, finished.err
    result = json.loads(finished.out)
    assert result["code"] == 0, result["err"]
    assert result["probe"] > 0, "the sniffer hears nothing at all"
    return list(result["during"])


def test_an_episode_stays_on_this_machine(namespace: str, tmp_path: Path, safe: Path) -> None:
    assert sniffed(namespace, tmp_path, safe, ROS_AUTOMATIC_DISCOVERY_RANGE=None) == []
