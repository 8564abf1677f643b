"""Stands in for a day on a proving ground: physical trials on some φ of an assessment, as bags and a table.

    python examples/proving_ground/drive.py skd_results/simulated skd_results/trials

The physical car is the multi-body car: tyres on a damp road and a brake that acts late, of which the simulation knows
nothing. What is recorded is what a proving ground records: positions of car and dummy in a frame of the site, each at a
rate of its own, with noise of a centimetre, and a contact that the dummy's carrier feels.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from skd_evaluator import Plan, load_result, run_episode
from skd_sim import Mode, Trajectory
from skd_sim.scenario.scenario import scenario_from_dict

TRIALS = 12
SITE = (420.0, -35.0, np.radians(30.0))
"""Where the scenario's frame `map` lies in the site's: its origin, m, and the direction of its x axis."""
ON_THE_GROUND = {
    "dynamics": "multi_body",
    "brake_delay": 0.15,
    "brake_rate": 50.0,
    "brake_limit": 15.0,
    "antilock": True,
}
NOISE = 0.01  # m
CAR, DUMMY = "/car/odometry", "/dummy/pose"
RATES = {CAR: 50.0, DUMMY: 20.0}  # Hz

STORE = get_typestore(Stores.ROS2_JAZZY)
HEADER, TIME = STORE.types["std_msgs/msg/Header"], STORE.types["builtin_interfaces/msg/Time"]
POINT, QUATERNION = STORE.types["geometry_msgs/msg/Point"], STORE.types["geometry_msgs/msg/Quaternion"]
POSE, VECTOR = STORE.types["geometry_msgs/msg/Pose"], STORE.types["geometry_msgs/msg/Vector3"]


def on_site(places: np.ndarray) -> np.ndarray:
    """Return places of `map` in the site's frame, n × 2, m."""
    x, y, turned = SITE
    cos, sin = np.cos(turned), np.sin(turned)
    return places @ np.array([[cos, sin], [-sin, cos]]) + np.array([x, y])


def message(topic: str, seconds: float, place: np.ndarray, heading: float, speed: float) -> bytes:
    """Return an odometry of the car, or a pose of the dummy, as bytes."""
    header = HEADER(TIME(int(seconds), int(seconds % 1.0 * 1e9)), "site")
    turned = QUATERNION(0.0, 0.0, float(np.sin(0.5 * heading)), float(np.cos(0.5 * heading)))
    pose = POSE(POINT(float(place[0]), float(place[1]), 0.0), turned)
    if topic == DUMMY:
        kind = "geometry_msgs/msg/PoseStamped"
        return bytes(STORE.serialize_cdr(STORE.types[kind](header, pose), kind))
    kind, none = "nav_msgs/msg/Odometry", np.zeros(36)
    twist = STORE.types["geometry_msgs/msg/Twist"](VECTOR(float(speed), 0.0, 0.0), VECTOR(0.0, 0.0, 0.0))
    posed = STORE.types["geometry_msgs/msg/PoseWithCovariance"](pose, none)
    twisted = STORE.types["geometry_msgs/msg/TwistWithCovariance"](twist, none)
    return bytes(STORE.serialize_cdr(STORE.types[kind](header, "car", posed, twisted), kind))


def record(bag: Path, times: np.ndarray, car: np.ndarray, dummy: np.ndarray, rng: np.random.Generator) -> None:
    """Write the bag of a trial; its clock has nothing to do with the beginning of φ."""
    begin = float(rng.uniform(100.0, 200.0))
    heading = 0.5 * np.pi + SITE[2]
    with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for topic, rate in RATES.items():
            kind = "geometry_msgs/msg/PoseStamped" if topic == DUMMY else "nav_msgs/msg/Odometry"
            connection = writer.add_connection(topic, kind, typestore=STORE)
            places, moments = (dummy if topic == DUMMY else car), np.arange(0.0, times[-1], 1.0 / rate)
            x, y = (np.interp(moments, times, column) for column in places[:, :2].T)
            seen = on_site(np.column_stack([x, y])) + NOISE * rng.standard_normal((len(moments), 2))
            speeds = np.interp(moments, times, car[:, 3])
            for moment, place, speed in zip(moments, seen, speeds, strict=True):
                stamp = begin + float(moment)
                writer.write(connection, int(stamp * 1e9), message(topic, stamp, place, heading, speed))


def main(simulated: Path, out: Path) -> None:
    """Play the trials, and write a bag of each and the table."""
    result, figures = load_result(simulated), json.loads((simulated / "assessment.json").read_text())
    data = figures["scenario"]
    wet = {**data, "car": {**data["car"], **ON_THE_GROUND}, "road": {**data["road"], "friction": 0.8}}
    plan = Plan(scenario=scenario_from_dict(wet), seed=2024, multiplier=figures["multiplier"], safe_count=TRIALS)
    with np.load(simulated / "episodes.npz") as arrays:
        names = [str(name) for name in arrays["safe_name"]]
    rng = np.random.default_rng(1)
    out.mkdir(parents=True, exist_ok=True)
    lines = ["phi,file,hit"]
    for number in rng.choice(len(names), TRIALS, replace=False).tolist():
        phi = Trajectory(result.safe[number], plan.scenario.time_step, names[number])
        log = run_episode(plan.episode(Mode.REPLAY, number, 0, phi))
        times = np.arange(len(log.car)) * plan.scenario.time_step
        record(out / f"phi_{number}", times, log.car, log.adversary, rng)
        lines.append(f"{phi.name},phi_{number},{int(log.hit)}")
    (out / "trials.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    print(f"{TRIALS} trials in {out}")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
