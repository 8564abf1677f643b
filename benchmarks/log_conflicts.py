"""How well `skd log` finds and rates conflicts in recordings whose truth is known.

    nice .venv/bin/python benchmarks/log_conflicts.py --recordings 50

A drive has 20 conflicts, one after the other: the car comes at a steady speed, and a pedestrian crosses so that the two
would meet. The car brakes as the basic car does that decides each 0.05 s, and drives on when the lane is free. Others
walk along, or cross behind. Recordings are MCAP, SQLite, bags of ROS 1 and csv, in several frames, at 10 to 50 Hz, with
noise of 2 cm (car) and 3 cm (others), gaps of up to 0.35 s, and messages that are logged up to 0.3 s late. The true
margin is that of the same car from the same moment on along the trajectories without noise: exact of the basic car of
the paper, searched of the car that drove, for which the bounds must hold.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_typestore
from skd_evaluator.assessment.stages.margin import exact_or_found
from skd_evaluator.cli.main import main as skd
from skd_evaluator.margin.search.rounds import one_by_one
from skd_evaluator.margin.search.search import search_margins
from skd_sim.scenario.scenario import changed_scenario
from skd_sim.world.episode import EpisodeSpec, Mode
from skd_sim.world.state import Trajectory

FORMATS = ("mcap", "sqlite", "ros1", "csv")
CONFLICTS, CYCLE, TICK, STEP = 20, 14.0, 0.01, 0.3
FRONT, BRAKE, MULTIPLIER, PERIOD = 2.25, 3.5, 1.1, 0.05
ODOMETRY, POSE, TFS = "nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped", "tf2_msgs/msg/TFMessage"
PACKAGES = ("geometry_msgs", "nav_msgs", "tf2_msgs", "builtin_interfaces", "std_msgs/msg/Header")


class Truth(NamedTuple):
    """A drive: times (s); the car's place along its line (m) and its speed; each road user's times and places, m."""

    times: np.ndarray
    car: np.ndarray
    users: dict[str, tuple[np.ndarray, np.ndarray]]


def drive(rng: np.random.Generator) -> Truth:
    """Return a drive; road users in conflict are called c0, c1, …, others a0, … and b0, …."""
    times = TICK * np.arange(round(CONFLICTS * CYCLE / TICK))
    car, users = np.empty((len(times), 2)), dict[str, tuple[np.ndarray, np.ndarray]]()
    s, cruise, lasts = 0.0, float(rng.uniform(6.0, 13.0)), TICK * np.arange(round(10.0 / TICK))
    speed, trigger, brakes = cruise, MULTIPLIER * cruise**2 / (2 * BRAKE), False
    for row, now in enumerate(times.tolist()):
        number, passed = divmod(row, round(CYCLE / TICK))
        if passed == 0:
            walk, meets, off, drift = rng.uniform((0.9, 4.5, -0.9, -0.15), (1.8, 5.5, 0.9, 0.15)).tolist()
            side, right = float(rng.choice([-1.0, 1.0])), off + walk * (lasts - meets)
            along = s + FRONT + meets * speed + drift * (lasts - meets)
            users[f"c{number}"] = now + lasts, np.column_stack([side * right, along])
            users[f"a{number}"] = now + lasts, np.column_stack([0 * lasts - side * 3.2, s + 20.0 + 1.3 * lasts])
            users[f"b{number}"] = now + lasts, np.column_stack([side * (1.4 * lasts - 5.0), 0 * lasts + s - 15.0])
        car[row] = s, speed
        if row % round(PERIOD / TICK) == 0:
            near = passed < len(lasts) and 0.0 <= along[passed] - s - FRONT <= trigger
            brakes = near and right[min(passed, len(lasts) - 1)] < 1.5
        after = max(0.0, speed - BRAKE * TICK) if brakes else min(cruise, speed + 2.0 * TICK)
        s, speed = s + 0.5 * TICK * (speed + after), after
    return Truth(times, car, users)


class Recorder:
    """Writes a drive as a recording: what was seen when, in which frame, and when it was logged."""

    def __init__(self, truth: Truth, rng: np.random.Generator) -> None:
        self.truth, self.rng, self.number = truth, rng, 0
        self.origin, self.turned = rng.uniform(-500.0, 500.0, 2), float(rng.uniform(-math.pi, math.pi))
        self.map, self.begin = rng.uniform(-3.0, 3.0, 3).tolist(), float(rng.uniform(1e9, 1.7e9))

    def seen(self, times: np.ndarray, values: np.ndarray, noise: float) -> Iterator[tuple[float, np.ndarray]]:
        """Yield when something is seen, and its values then; the first two are a place, here in the frame `odom`, m."""
        rate, cos, sin = float(self.rng.uniform(10.0, 50.0)), math.cos(self.turned), math.sin(self.turned)
        at = np.arange(times[0], times[-1], 1.0 / rate)
        at = at + self.rng.uniform(0.0, 0.1 / rate, len(at))
        for gap in self.rng.uniform(times[0], times[-1], max(1, round((times[-1] - times[0]) / 15.0))):
            at = at[(at < gap) | (at > gap + self.rng.uniform(0.1, 0.35))]
        right, along, *rest = (np.interp(at, times, column) for column in values.T)
        places = self.origin + np.column_stack([cos * along + sin * right, sin * along - cos * right])
        places += self.rng.normal(0.0, noise, places.shape)
        yield from zip(at.tolist(), np.column_stack([places, *rest]), strict=True)

    def rows(self) -> Iterator[tuple[float, str, np.ndarray]]:
        """Yield when who is seen where."""
        values = np.column_stack([np.zeros(len(self.truth.times)), self.truth.car])
        yield from ((now, "car", one) for now, one in self.seen(self.truth.times, values, 0.02))
        for name, (times, places) in self.truth.users.items():
            yield from ((now, name, one) for now, one in self.seen(times, places, 0.03))

    def csv(self, path: Path) -> None:
        """Write a table of tracked objects."""
        lines = (f"{self.begin + now:.4f},{name},{one[0]:.4f},{one[1]:.4f}" for now, name, one in self.rows())
        path.with_suffix(".csv").write_text("\n".join(["t,id,x,y", *lines, ""]), encoding="utf-8")

    def bag(self, path: Path, form: str) -> None:
        """Write a recording of ROS: the car in `odom`, or by tf alone; road users in `map`, or of ROS 1 in `odom`."""
        ros1, by_tf = form == "ros1", form == "sqlite"
        store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_JAZZY)
        types = {name.rsplit("/", 1)[-1]: kind for name, kind in store.types.items() if name.startswith(PACKAGES)}
        frame, (x0, y0, turned) = ("odom", (0.0, 0.0, 0.0)) if ros1 else ("map", self.map)
        cos, sin = math.cos(turned), math.sin(turned)

        def header(now: float, frame: str) -> Any:
            self.number += 1
            stamp = types["Time"](sec=int(self.begin + now), nanosec=int((self.begin + now) % 1.0 * 1e9))
            return types["Header"](**({"seq": self.number} if ros1 else {}), stamp=stamp, frame_id=frame)

        def pose(x: float, y: float, heading: float) -> Any:
            turn = types["Quaternion"](x=0.0, y=0.0, z=math.sin(heading / 2), w=math.cos(heading / 2))
            return types["Pose"](position=types["Point"](x=float(x), y=float(y), z=0.0), orientation=turn)

        def transform(now: float, parent: str, child: str, x: float, y: float, heading: float) -> Any:
            vector = types["Vector3"](x=float(x), y=float(y), z=0.0)
            moved = types["Transform"](translation=vector, rotation=pose(0, 0, heading).orientation)
            one = types["TransformStamped"](header=header(now, parent), child_frame_id=child, transform=moved)
            return types["TFMessage"](transforms=[one])

        def odometry(now: float, x: float, y: float, speed: float) -> Any:
            zero, ahead = (types["Vector3"](x=float(one), y=0.0, z=0.0) for one in (0.0, speed))
            twist, nothing = types["Twist"](linear=ahead, angular=zero), np.zeros(36)
            where = types["PoseWithCovariance"](pose=pose(x, y, self.turned), covariance=nothing)
            moves = types["TwistWithCovariance"](twist=twist, covariance=nothing)
            return types["Odometry"](header=header(now, "odom"), child_frame_id="base", pose=where, twist=moves)

        sent = [] if ros1 else [(0.0, "/tf_static", TFS, transform(0.0, "map", "odom", *self.map))]
        for now, name, (x, y, *rest) in self.rows():
            if name != "car":
                place = pose(x0 + cos * x - sin * y, y0 + sin * x + cos * y, 0.0)
                sent.append((now, f"/tracks/{name}", POSE, types["PoseStamped"](header=header(now, frame), pose=place)))
            elif by_tf:
                sent.append((now, "/tf", TFS, transform(now, "odom", "base_link", x, y, self.turned)))
            else:
                sent.append((now, "/state", ODOMETRY, odometry(now, x, y, rest[0] + self.rng.normal(0.0, 0.05))))
        late = [(now + float(self.rng.uniform(0.0, 0.3)), *rest) for now, *rest in sent]
        storage = StoragePlugin.SQLITE3 if by_tf else StoragePlugin.MCAP
        make = Ros1Writer(path.with_suffix(".bag")) if ros1 else Ros2Writer(path, version=9, storage_plugin=storage)
        with make as writer:
            topics, write = dict[str, Any](), store.serialize_ros1 if ros1 else store.serialize_cdr
            for now, topic, kind, message in sorted(late, key=lambda one: one[0]):
                topics[topic] = topics.get(topic) or writer.add_connection(topic, kind, typestore=store)
                writer.write(topics[topic], round(1e9 * (self.begin + now)), bytes(write(message, kind)))


def true_trial(truth: Truth, user: str, begins: float, period: float | None) -> EpisodeSpec:
    """Return the trial that a conflict is, from a moment on (s), by the truth."""
    times, places = truth.users[user]
    s, speed = (float(np.interp(begins, truth.times, column)) for column in truth.car.T)
    ticks = np.arange(begins, times[-1], STEP)
    right, along = (np.interp(ticks, times, column) for column in places.T)
    right = right if right[-1] > right[0] else -right
    line = float(np.interp(0.0, right, along))
    still = {"speed_noise": 0.0, "acceleration_noise": 0.0, "start_gap_range": 0.0}
    changes = {f"car.{key}": one for key, one in {**still, "start_speed": speed, "start_gap": line - s - FRONT}.items()}
    ends = {"adversary.start_x": float(right[0]), "adversary.destination_x": 3.0}
    scenario = changed_scenario("crossing", {**changes, **ends, **({"control_period": period} if period else {})})
    phi = Trajectory(np.column_stack([right, along - line]), STEP)
    return EpisodeSpec(scenario, Mode.KAMIKAZE, 0, 0, phi, controller="basic", multiplier=MULTIPLIER)


def least_deviation(trial: EpisodeSpec) -> float:
    """Return the margin of a trial, m: exact, or searched of a car that decides more often than once a tick."""
    exact = trial.scenario.control_period is None
    hit = exact_or_found(trial) if exact else search_margins([trial], {}, one_by_one).hits[0]
    return trial.scenario.eta_max if hit is None else min(hit.distance, trial.scenario.eta_max)


def main() -> None:
    """Write recordings, look through them, and print what was found."""
    parser = argparse.ArgumentParser(description="How well skd log finds and rates conflicts")
    parser.add_argument("--recordings", type=int, default=50)
    parser.add_argument("--bounds", type=int, default=100, help="how many bounds are compared with a searched margin")
    arguments = parser.parse_args()
    truths, starts, total = dict[str, Truth](), dict[str, float](), CONFLICTS * arguments.recordings
    with tempfile.TemporaryDirectory() as folder:
        for number in range(arguments.recordings):
            rng, name = np.random.default_rng([59, number]), f"drive_{number}x"
            recorder, form = Recorder(drive(rng), rng), FORMATS[number % len(FORMATS)]
            truths[name], starts[name] = recorder.truth, recorder.begin
            recorder.csv(Path(folder, name)) if form == "csv" else recorder.bag(Path(folder, name), form)
        begin = time.perf_counter()
        skd(["log", folder, "--controller", "basic", "--multiplier", str(MULTIPLIER), "--out", f"{folder}/out", "-q"])
        seconds = time.perf_counter() - begin
        rows = json.loads(Path(folder, "out", "log.json").read_text(encoding="utf-8"))["conflicts"]
    found: dict[tuple[str, str], dict[str, Any]] = {}
    for row in rows:
        found.setdefault((row["drive"], row["user"].rsplit("/", 1)[-1]), row)
    right = {key: row for key, row in found.items() if key[1].startswith("c")}
    print(f"{len(right)} of {total} found, {len(rows) - len(right)} invented, {seconds:.0f} s")
    late, pairs, held = [], [], []
    each = max(1, len(right) // max(1, arguments.bounds))
    for number, ((name, user), row) in enumerate(right.items()):
        begins = row["begins"] - starts[name]
        trial = true_trial(truths[name], user, begins, None)
        if row["margin"] is not None:
            late.append((row["gap"] - trial.scenario.car.start_gap) / row["speed"])
            pairs.append((row["margin"], least_deviation(trial)))
        if number % each == 0 and arguments.bounds:
            margin = least_deviation(true_trial(truths[name], user, begins, PERIOD))
            held.append((row["least"] - 0.02 <= margin <= row["most"] + 0.02, margin <= row["recorded"] + 0.02))
    margins, true = np.array(pairs).T
    close = np.abs(margins - true) <= 0.05 * np.maximum(true, 0.4)
    print(
        f"{len(pairs)} driven again; timing: {np.abs(late).max():.3f} s at most, {np.median(np.abs(late)):.3f} s median"
    )
    print(f"margin {margins.mean():.3f} m, true {true.mean():.3f} m; within 5 % or 2 cm: {close.mean():.3f}")
    print(f"off by {np.percentile(np.abs(margins - true), [50, 90, 95])} m; zero {np.mean(true < 1e-6):.2f}")
    print(f"bounds hold in {np.mean(held, axis=0)} of {len(held)} (least to most; at most as recorded)")


if __name__ == "__main__":
    main()
