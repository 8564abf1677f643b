"""A whole `skd episode` sends nothing beyond loopback: looked at on a second interface, in a network namespace."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
from graph_support import Program, skd_command

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "rosless"))

from test_rosless_loopback import namespace  # noqa: F401

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


@pytest.mark.usefixtures("namespace")
def test_an_episode_stays_on_this_machine(namespace: str, tmp_path: Path, safe: Path) -> None:  # noqa: F811
    script = tmp_path / "sniff.py"
    script.write_text(PROGRAM)
    command = skd_command("episode", "--safe", safe, "--simulations", 100, "--out", tmp_path / "out")
    program = Program(["ip", "netns", "exec", namespace, sys.executable, str(script), *command])
    finished = program.finish()
    assert finished.code == 0, finished.err
    result = json.loads(finished.out)
    assert result["code"] == 0, result["err"]
    assert result["probe"] > 0, "the sniffer hears nothing at all"
    assert result["during"] == []
