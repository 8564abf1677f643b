"""Start and end the four nodes again and again, in the middle of anything, and count how they ended.

    .venv/bin/python -m skd_sim.ros_environment .venv/bin/python benchmarks/node_ends.py --count 300

Every third time the nodes run an episode first; else they are told to end while they load kernels and find each other.
"""

from __future__ import annotations

import argparse
import collections
import faulthandler
import importlib
import multiprocessing
import os
import random
import sys
import tempfile
import time
from multiprocessing.context import ForkServerProcess
from pathlib import Path

from skd_evaluator.ros.domains import _in_use, _reserve, _reserved

NODES = (
    "skd_sim.nodes.vehicle_simulator",
    "skd_sim.nodes.car_controller",
    "skd_adversary.nodes.adversary_node",
    "skd_evaluator.ros.evaluator_main",
)
FINE = (0, 130, -15)  # the last: SIGTERM came before the node's program had begun
LONGEST = 20.0  # s that is waited for an end


def run(module: str, arguments: list[str], domain: int, log: str) -> None:
    """Be a node."""
    os.environ["ROS_DOMAIN_ID"] = str(domain)
    output = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    os.dup2(output, 1)
    os.dup2(output, 2)
    faulthandler.enable()
    sys.exit(importlib.import_module(module).main(arguments))


def ended(processes: list[ForkServerProcess]) -> float:
    """End all and return how long the last one took, s; one that does not end is killed."""
    for process in processes:
        process.terminate()
    begin = time.monotonic()
    while any(process.exitcode is None for process in processes) and time.monotonic() - begin < LONGEST:
        time.sleep(0.005)
    took = time.monotonic() - begin
    for process in processes:
        process.kill()
        process.join()
    return took


def main() -> int:
    """Run the loop and print a line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=300, help="how often all four are started (300)")
    count = parser.parse_args().count
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(list(NODES))
    codes: collections.Counter[int | None] = collections.Counter()
    longest = 0.0
    with tempfile.TemporaryDirectory() as folder:
        for number in range(count):
            domain = next(one for one in random.sample(range(1, 102), 101) if not _in_use(one) and _reserve(one))
            out = Path(folder, str(number))
            out.mkdir()
            task = {"task": "episode", "mode": "replay", "simulations": "100", "safe_count": "1", "out": f"{out}/out"}
            asked = ["--ros-args", *(word for name, value in task.items() for word in ("-p", f"{name}:={value}"))]
            started = []
            for module in NODES:
                arguments = asked if module.endswith("evaluator_main") else []
                log = str(out / module)
                started.append(context.Process(target=run, args=(module, arguments, domain, log), daemon=True))
                started[-1].start()
                time.sleep(0.05)
            if number % 3 == 0:
                started[-1].join(60.0)
            else:
                time.sleep(0.2 + 0.15 * (number % 7))
            longest = max(longest, ended(started))
            _reserved.pop().close()
            codes.update(process.exitcode for process in started)
            for module, process in zip(NODES, started, strict=True):
                if process.exitcode not in FINE:
                    print(
                        f"{number}: {module} ended with {process.exitcode}:\n{(out / module).read_text()}", flush=True
                    )
    wrong = sum(many for code, many in codes.items() if code not in FINE)
    shown = ", ".join(f"{code}: {many}" for code, many in sorted(codes.items(), key=str))
    print(f"{4 * count} ends, {wrong} wrong ones; exit codes {shown}; the longest took {longest:.2f} s")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
