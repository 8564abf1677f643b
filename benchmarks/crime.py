"""Surrogate safety measures held against CommonRoad CriMe's, an independent program, where definitions agree.

It is a gigabyte with what it needs, so it gets an environment of its own, in which the scenes are drawn and measured:

    python3.11 -m venv crime && crime/bin/pip install commonroad-crime==0.4.5
    crime/bin/python benchmarks/crime.py measure crime.json
    .venv/bin/python benchmarks/crime.py compare crime.json

*Following*: a car behind another, both at constant speeds on one straight lane; HW is our gap, TTC the time to
collision, ALongReq the required deceleration with another sign, BTN the brake threat number. *Anywhere*: two boxes with
any headings that move uniformly; DCE is the least clearance at the moments, TTCE when that is. CriMe rounds to two to
four digits, which is switched off; a lane that leads just 0 rad, which it takes for one that was not found, leads 2π.

Its ALongReq and BTN count one who gets away as one who comes near, for v² has no sign: such scenes are in TTC alone.
Not held against it are THW, which it counts in whole time steps, PET, which it has at intersections alone, ΔV, which
takes velocities of opposite headings for those of one, and WTTC and AReq, which we have not.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np

DT, STEPS, SCENES = 0.1, 20, 200
LENGTH, WIDTH = 4.5, 1.8
DECELERATION = 11.5  # m/s², that CriMe gives a car


def draw(scenes: int, seed: int) -> list[dict[str, Any]]:
    """Return scenes: kind, and (x, y, heading, speed, length, width) of the two; the first is the car."""
    rng, found = np.random.default_rng(seed), []
    for _ in range(scenes):
        gap, own, other = rng.uniform(0.5, 60.0), rng.uniform(1.0, 20.0), rng.uniform(0.0, 20.0)
        length = rng.uniform(0.6, 8.0)
        ahead = (0.5 * LENGTH + gap + 0.5 * length, 0.0, 0.0, other, length, rng.uniform(0.5, 2.5))
        found.append({"kind": "following", "users": [(0.0, 0.0, 0.0, own, LENGTH, WIDTH), ahead]})
        place, turned = rng.uniform(-15.0, 15.0, 2).tolist(), rng.uniform(-math.pi, math.pi)
        aside = (*place, turned, rng.uniform(0.0, 10.0), length, rng.uniform(0.5, 2.5))
        found.append({"kind": "anywhere", "users": [(0.0, 0.0, 0.0, own, LENGTH, WIDTH), aside]})
    return found


def measured(scene: dict[str, Any]) -> dict[str, float]:
    """Return CriMe's figures of a scene."""
    from commonroad.geometry.shape import Rectangle
    from commonroad.prediction.prediction import TrajectoryPrediction
    from commonroad.scenario.lanelet import Lanelet
    from commonroad.scenario.obstacle import DynamicObstacle, ObstacleType
    from commonroad.scenario.scenario import Scenario
    from commonroad.scenario.state import CustomState, InitialState
    from commonroad.scenario.trajectory import Trajectory
    from commonroad_crime.data_structure.configuration import CriMeConfiguration
    from commonroad_crime.measure import BTN, DCE, HW, TTC, TTCE, ALongReq

    world = Scenario(DT)
    reach = np.linspace(-100.0, 400.0, 51)
    left, middle, right = (np.column_stack([reach, np.full(51, side)]) for side in (3.0, 0.0, -3.0))
    world.add_objects(Lanelet(left, middle, right, 1))
    for number, (x, y, heading, speed, length, width) in enumerate(scene["users"], 10):
        shape = Rectangle(length, width)
        states = [
            {
                "time_step": step,
                "position": np.array([x, y]) + step * DT * speed * np.array([math.cos(heading), math.sin(heading)]),
                "orientation": heading,
                "velocity": speed,
                "velocity_y": 0.0,
                "acceleration": 0.0,
                "acceleration_y": 0.0,
                "yaw_rate": 0.0,
                "slip_angle": 0.0,
            }
            for step in range(STEPS + 1)
        ]
        first = InitialState(
            **{name: one for name, one in states[0].items() if name not in ("velocity_y", "acceleration_y")}
        )
        first.velocity_y, first.acceleration_y = 0.0, 0.0
        lanes = {step: {1} for step in range(STEPS + 1)}
        way = TrajectoryPrediction(Trajectory(1, [CustomState(**one) for one in states[1:]]), shape, lanes, lanes)
        body = DynamicObstacle(number, ObstacleType.CAR, shape, first, way, {1}, {1})
        world.add_objects(body)
    config = CriMeConfiguration()
    config.vehicle.ego_id = 10
    config.update(ego_id=10, sce=world)
    of_kind = {"following": (HW, TTC, ALongReq, BTN), "anywhere": (DCE, TTCE)}[scene["kind"]]
    return {one.__name__: float(one(config).compute(11, 0, verbose=False)) for one in of_kind}


def ours(scene: dict[str, Any]) -> dict[str, float]:
    """Return the same figures by SKD's measures."""
    from skd_evaluator.metrics.surrogate_measures import (
        brake_threat_numbers,
        clearances,
        collision_times,
        required_decelerations,
    )
    from skd_evaluator.metrics.surrogate_scenes import Interaction

    times = DT * np.arange(STEPS + 1, dtype=np.float64)
    (x, y, heading, speed, length, width), (a, b, turned, pace, long, wide) = scene["users"]
    steps = np.column_stack([np.cos([heading, turned]), np.sin([heading, turned])]) * np.array([[speed], [pace]])
    count = len(times)
    car = np.column_stack([np.array([x, y]) + times[:, None] * steps[0], np.tile([heading, speed], (count, 1))])
    other = np.array([a, b]) + times[:, None] * steps[1]
    footprint, shape = (0.5 * length, 0.5 * length, 0.5 * width), (0.0, 0.5 * long, 0.5 * wide)
    found = Interaction(times, car, other, np.tile(steps[1], (count, 1)), np.full(count, turned), footprint, shape)
    if scene["kind"] == "following":
        return {
            "HW": float(found.gap[0]),
            "TTC": float(collision_times(found)[0]),
            "ALongReq": -float(required_decelerations(found)[0]),
            "BTN": float(brake_threat_numbers(found, DECELERATION)[0]),
        }
    apart = clearances(found)[:-1]  # CriMe leaves the last moment out
    return {"DCE": float(apart.min()), "TTCE": float(times[int(np.argmin(apart))])}


def compare(path: Path) -> int:
    """Print how far the two are apart; return 1 if anywhere further than 1e-6."""
    from skd_evaluator.metrics.surrogate_measures import HORIZON

    worst: dict[str, list[float]] = {}
    for scene in json.loads(path.read_text(encoding="utf-8")):
        mine = ours(scene)
        away = scene["kind"] == "following" and scene["users"][0][3] <= scene["users"][1][3]
        for name, value in scene["found"].items():
            late = scene["found"].get("TTC", 0.0) > HORIZON  # nobody is foreseen to touch then
            if name in ("ALongReq", "BTN") and (away or late):
                continue
            said = math.inf if name == "TTC" and late else value
            worst.setdefault(name, []).append(0.0 if said == mine[name] else abs(said - mine[name]))
    for name, found in worst.items():
        print(f"{name:9} {len(found):4} scenes, furthest apart {max(found):.2g}")
    return int(max(map(max, worst.values())) > 1e-6)


def main() -> int:
    parser = argparse.ArgumentParser(description="Hold surrogate safety measures against CommonRoad CriMe's.")
    parser.add_argument("what", choices=("measure", "compare"))
    parser.add_argument("file", type=Path)
    parser.add_argument("--scenes", type=int, default=SCENES, help="of each kind (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    if arguments.what == "compare":
        return compare(arguments.file)
    from commonroad_crime.utility import general, solver

    of_lane = solver.compute_lanelet_width_orientation
    general.int_round = lambda value, _digits=1: value
    solver.compute_lanelet_width_orientation = lambda *where: (of_lane(*where)[0], of_lane(*where)[1] or 2.0 * math.pi)
    scenes = draw(arguments.scenes, arguments.seed)
    for scene in scenes:
        scene["found"] = measured(scene)
    arguments.file.write_text(json.dumps(scenes), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
