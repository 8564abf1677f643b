"""What it costs that a user's controller runs in a process apart: SKD's own cars, as they are and as a user's class.

The same law is assessed under its own name, by which it is asked within the worker, and as `package.module:Class`, by
which it is kept apart and asked again; in pairs, one after the other, so that what else the machine does concerns both.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
from skd_evaluator.cli.arguments import whole_number
from skd_sim.apart.apart import apart, close_all, made_in
from skd_sim.apart.car_process import ApartCar
from skd_sim.apart.guard import guard
from skd_sim.choices.car_under_test import CarUnderTest
from skd_sim.controllers import Controller, make_controller
from skd_sim.encounter.road import HEADING_NORTH
from skd_sim.encounter.scenario import load_scenario
from skd_sim.state import AdversaryState, CarState


class Keeps:
    """A user's class that needs nothing: neither kernels nor a library."""

    def reset(self, scenario: object, rng: object) -> None:
        """Begin."""

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        """Keep the speed."""
        return 0.0


CARS = {"carla": "skd_sim.controllers.carla_agent:CarlaAgent", "cal": "skd_sim.controllers.cal:CalController"}
_BLOCK = 1000  # calls between two looks at the clock


class Cost(NamedTuple):
    """What an assessment took, s."""

    wall: float
    processor: float


def call_time(controller: Controller) -> float:
    """Return what a call of `command` takes, µs, over a block of them."""
    car, adversary = CarState(0.0, -20.0, HEADING_NORTH, 8.0), AdversaryState(-3.0, 0.0, 1.0, 0.0, 0.0)
    begin = time.perf_counter()
    for _ in range(_BLOCK):
        controller.command(car, adversary)
    return 1e6 * (time.perf_counter() - begin) / _BLOCK


def calls(blocks: int) -> tuple[float, float]:
    """Return medians of what a call takes within a process and apart, µs."""
    law = CARS["carla"]
    both = guard(make_controller(law), law), apart(CarUnderTest(law))
    for controller in both:
        controller.reset(load_scenario("crossing"), np.random.default_rng(1))
    times = [[call_time(controller) for controller in both] for _ in range(blocks)]
    close_all()
    within, outside = (statistics.median(column) for column in zip(*times, strict=True))
    return within, outside


def start(controller: str, repeats: int) -> Cost:
    """Return what it takes until a new process has loaded a controller, medians; its end is in the processor time."""
    found = []
    for _ in range(repeats):
        begin, before = time.perf_counter(), os.times()
        process = ApartCar(CarUnderTest(controller))
        made_in(process)
        wall = time.perf_counter() - begin
        process.close()
        after = os.times()
        spent = after.children_user + after.children_system - before.children_user - before.children_system
        found.append(Cost(wall, spent))
    return Cost(*(statistics.median(column) for column in zip(*found, strict=True)))


def assess(controller: str, folder: Path, options: list[str]) -> Cost:
    """Return what an assessment of a car takes; its result is left in `folder`."""
    begin, before = time.perf_counter(), os.times()
    command = [sys.executable, "-m", "skd_evaluator", "assess", "--controller", controller, "--out", str(folder)]
    subprocess.run([*command, "--overwrite", *options], check=True, stdout=subprocess.DEVNULL)
    after = os.times()
    return Cost(
        time.perf_counter() - begin,
        after.children_user + after.children_system - before.children_user - before.children_system,
    )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=whole_number(1), default=3, metavar="N", help="of assessments for each car")
    parser.add_argument("--blocks", type=whole_number(1), default=20, metavar="N", help=f"of {_BLOCK} calls")
    parser.add_argument("--car", choices=sorted(CARS), action="append", help="by default all")
    parser.add_argument("--margin-limit", type=whole_number(0), default=64, metavar="TICKS")
    arguments = parser.parse_args()
    within, outside = calls(arguments.blocks)
    print(f"a call of command: {within:.1f} µs within the process, {outside:.1f} µs apart")
    for said, name in (
        ("that law, whose kernels take numba", CARS["carla"]),
        ("one of nothing else", "apart_cost:Keeps"),
    ):
        cost = start(name, 5)
        print(f"a process for a class: {cost.wall:.2f} s, {cost.processor:.2f} s of processor time ({said})")
    options = ["--safe-count", "6", "--kamikaze-count", "20", "--collision-runs", "20", "--knowledge", "nothing"]
    options += ["--margin-limit", str(arguments.margin_limit)]
    print(f"skd assess {' '.join(options)}; s, medians of {arguments.pairs} pairs")
    print(f"{'car':8}{'wall':>8}{'apart':>8}{'ratio':>8}{'processor':>12}{'apart':>8}{'ratio':>8}")
    for name in arguments.car or sorted(CARS):
        with tempfile.TemporaryDirectory() as folder:
            assess(name, Path(folder, "warm"), options)  # kernels are compiled once
            pairs = [
                [assess(one, Path(folder, str(number)), options) for number, one in enumerate((name, CARS[name]))]
                for _ in range(arguments.pairs)
            ]
        print(f"{name:8}", end="")
        for field, width in (("wall", 8), ("processor", 12)):
            own, theirs = (statistics.median(getattr(pair[side], field) for pair in pairs) for side in (0, 1))
            ratio = statistics.median(getattr(pair[1], field) / getattr(pair[0], field) for pair in pairs)
            print(f"{own:{width}.1f}{theirs:8.1f}{ratio:8.2f}", end="")
        print()


if __name__ == "__main__":
    main()
