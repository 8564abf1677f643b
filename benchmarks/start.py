"""How long programs take to start, and the first results after it.

    .venv/bin/python benchmarks/start.py            # each command in a Python of its own, the best of five
    .venv/bin/python benchmarks/start.py --cold     # also a first run: kernels compiled anew in an empty cache

Wall clock and processor time, s. The commands that read results read two small ones, which are made first. Nodes are
imported, not run: that is their start.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

_SMALL = "--safe-count 3 --kamikaze-count 5 --collision-runs 20 --quiet --no-pictures"
_NODES = {
    "vehicle_simulator": "skd_sim.ros.simulator_node",
    "car_controller": "skd_sim.ros.controller_node",
    "adversary": "skd_adversary.ros.adversary_node",
    "evaluator": "skd_evaluator.ros.evaluator_node",
}


def timed(words: list[str], environment: dict[str, str]) -> tuple[float, float]:
    """Run a command and return wall clock and processor time, s."""
    before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(words, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment)
    wall, after = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    """Time them and print a line each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repetitions", type=int, default=5)
    parser.add_argument("--cold", action="store_true")
    arguments = parser.parse_args()
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    skd = [sys.executable, "-m", "skd_evaluator"]

    def say(name: str, words: list[str], repetitions: int, variables: dict[str, str]) -> None:
        wall, processor = min(timed(words, variables) for _ in range(repetitions))
        print(f"{name:40} {wall:7.2f} {processor:9.2f}", flush=True)

    print(f"{'':40} {'wall, s':>7} {'cpu, s':>9}")
    with tempfile.TemporaryDirectory() as folder:
        one, two, out = (str(Path(folder, name)) for name in ("one", "two", "out"))
        for multiplier, place in (("1", one), ("1.1", two)):
            timed([*skd, "assess", "--multiplier", multiplier, "--out", place, *_SMALL.split()], environment)
        commands = {
            "skd --version": ["--version"],
            "skd --help": ["--help"],
            "skd assess --help": ["assess", "--help"],
            "skd plan --width 0.1": ["plan", "--width", "0.1"],
            "skd compare": ["compare", one, two, "--out", out, "--overwrite"],
            "skd compare --no-pictures": ["compare", one, two, "--out", out, "--overwrite", "--no-pictures"],
            "skd show": ["show", one, "--out", out, "--overwrite"],
            "skd report": ["report", one, "--out", f"{out}.html", "--overwrite"],
            "skd assess, one episode of each kind": [
                *("assess", "--safe-count", "1", "--kamikaze-count", "1", "--collision-runs", "1", "--no-pictures"),
                *("--out", out, "--overwrite"),
            ],
            "skd assess": ["assess", "--out", out, "--overwrite"],
        }
        for name, words in commands.items():
            say(name, [*skd, *words], arguments.repetitions if name != "skd assess" else 1, environment)
        ros = [sys.executable, "-m", "skd_sim.ros_environment", sys.executable, "-c"]
        for name, module in _NODES.items():
            program = f"from skd_sim.start import import_lasting; import_lasting({module!r})"
            say(f"node {name}", [*ros, program], arguments.repetitions, environment)
        if arguments.cold:
            cold = environment | {"SKD_CACHE_DIR": str(Path(folder, "cache"))}
            say("skd assess, first run", [*skd, "assess", "--out", out, "--overwrite"], 1, cold)


if __name__ == "__main__":
    main()
