"""Stacks that cheat, as nodes of their own: `.venv/bin/python benchmarks/hostile_stacks.py [NAME...]`; by default all.

Each node drives without ever braking, but in what it takes for episodes that do not count for its honesty: by their
number, by its age or the file that its first process has left, by chance, with a little noise. Each is assessed in
small through the graph; its figures stand beside those of the honest node, with what was said of it.
"""

from __future__ import annotations

import argparse
import json
import random
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
_COUNTS = ["--safe-count", "2", "--kamikaze-count", "3", "--collision-runs", "20", "--seed", "5"]
_SMALL = ["--simulations", "20", "--knowledge", "nothing", "--no-pictures", "--quiet"]
_FIGURES = ("margin", "deformation", "hit_rate", "risk_1")
_LIMIT = 600.0  # s for an assessment
_JUMP = 5.0  # m between two states, by which a node sees that an episode begins


class Seen:
    """What a node knows when it decides.

    Attributes:
        episodes: how many it has begun.
        messages: how many states it has got.
        number: of its process, by what those before it have written to its file.
        second: whether there was one before it.
        lot: drawn at the begin of each episode, from 0 to 1.
        age: of its process, s.
    """

    def __init__(self, file: Path) -> None:
        """Look for the file, and leave it."""
        with file.open("a") as written:
            written.write("x")
        self.number = file.stat().st_size
        self.second = self.number > 1
        self.episodes = self.messages = 0
        self.lot, self.age = 0.0, 0.0


Careful = Callable[[Seen], bool]
NODES: dict[str, Careful] = {
    "honest": lambda _seen: False,
    "always": lambda _seen: True,  # another car, the same to whoever asks
    "later": lambda seen: seen.episodes > 20,
    "much_later": lambda seen: seen.episodes > 60,
    "later_with_noise": lambda seen: seen.episodes > 20,
    "by_messages": lambda seen: seen.messages > 300,
    "by_age": lambda seen: seen.age > 3.0,
    "every_tenth": lambda seen: seen.episodes % 10 == 0,
    "at_first": lambda seen: seen.episodes <= 30,
    "in_the_first_process": lambda seen: not seen.second,
    "by_chance_in_the_second": lambda seen: seen.lot < 0.5 if seen.second else seen.episodes > 26,
    "in_the_second_and_not_the_third": lambda seen: seen.number == 2 if seen.second else seen.episodes > 26,
    "in_the_third_and_not_the_second": lambda seen: seen.number == 3 if seen.second else seen.episodes > 26,
    "by_another_chance_in_each": lambda seen: seen.lot < 0.1 + 0.2 * seen.number if seen.second else seen.episodes > 26,
    "ends_many_in_the_second": lambda _seen: False,
    "silent_in_the_second": lambda seen: not seen.second,
    "dead_in_the_second": lambda seen: not seen.second,
    "by_chance": lambda seen: seen.lot < 0.5,
}
_NOISE = 1e-4  # m/s²


def drive(name: str, file: Path) -> None:
    """Be a node."""
    import rclpy
    from geometry_msgs.msg import AccelStamped
    from nav_msgs.msg import Odometry

    begun, seen, last = time.monotonic(), Seen(file), [float("inf")]
    if name == "dead_in_the_second" and seen.second:
        raise SystemExit(1)
    rclpy.init()
    node = rclpy.create_node("hostile_stack")
    publisher = node.create_publisher(AccelStamped, "/ego/acceleration_command", 10)

    def on_odometry(message: Any) -> None:
        place = message.pose.pose.position.y
        if abs(place - last[0]) > _JUMP:
            seen.episodes, seen.lot = seen.episodes + 1, random.random()
        last[0], seen.messages, seen.age = place, seen.messages + 1, time.monotonic() - begun
        if name == "silent_in_the_second" and seen.second:
            return
        answer = AccelStamped(header=message.header)
        answer.accel.linear.x = -4.0 if NODES[name](seen) and message.twist.twist.linear.x > 3.0 else 0.0
        if name == "later_with_noise":
            answer.accel.linear.x += random.uniform(-_NOISE, _NOISE)
        publisher.publish(answer)
        if name == "ends_many_in_the_second" and seen.second and seen.episodes % 3 == 0 and place < 0.0:
            answer.accel.linear.x = -5.0
            publisher.publish(answer)

    node.create_subscription(Odometry, "/ego/odometry", on_odometry, 10)
    rclpy.spin(node)


def assessed(name: str, folder: Path) -> tuple[int, float, str, dict[str, Any]]:
    """Assess a node; return exit code, seconds, what was said, and the result."""
    command = shlex.join([sys.executable, __file__, "--drive", name, str(folder / f"{name}.mark")])
    car = ["--graph", "--controller", "external", "--controller-command", command]
    words = [str(ROOT / "scripts" / "skd"), "assess", *car, *_COUNTS, *_SMALL, "--out", str(folder / name)]
    begin = time.monotonic()
    done = subprocess.run(words, capture_output=True, text=True, timeout=_LIMIT, check=False)
    path = folder / name / "assessment.json"
    result = json.loads(path.read_text()) if path.exists() else {}
    return done.returncode, time.monotonic() - begin, done.stderr, result


def main() -> int:
    """Assess them, and print a row for each; return 1 if one ended in a traceback."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"{', '.join(NODES)}; by default all")
    parser.add_argument("--drive", nargs=2, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.drive:
        drive(given.drive[0], Path(given.drive[1]))
        return 0
    failed = 0
    print(f"{'node':<34}{'code':>5}{'s':>6}" + "".join(f"{figure:>13}" for figure in _FIGURES) + "  said")
    with tempfile.TemporaryDirectory() as scratch:
        for name in given.names or NODES:
            code, seconds, said, result = assessed(name, Path(scratch))
            failed += "Traceback" in said
            figures = (result.get(figure) for figure in _FIGURES)
            shown = "".join(f"{'–' if value is None else format(value, '.3f'):>13}" for value in figures)
            lines = [line for line in result.get("warnings", ()) if "run again" in line] or said.splitlines()[-1:]
            print(f"{name:<34}{code:>5}{seconds:>6.0f}{shown}  {' | '.join(lines)[:150]}", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
