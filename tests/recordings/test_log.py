"""`skd log`: conflicts in recordings, against drives whose geometry is known exactly."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from skd_adversary.safe_trajectories.sources import read_csv_trajectory
from skd_evaluator.assessment.stages.margin import exact_or_found
from skd_evaluator.bags.checks import Damage
from skd_evaluator.bags.tracks import Track
from skd_evaluator.cli.main import main
from skd_evaluator.extensions.campaign.cells import read_campaign
from skd_evaluator.extensions.log.conflicts import Conflict, ConflictRequest, conflicts_in
from skd_evaluator.extensions.log.drives import DriveRequest, RecordedDrive, path_at, read_drives, steady_state
from skd_sim import EpisodeSpec, Mode, Trajectory, load_scenario
from skd_sim.scenario.scenario import changed_scenario
from test_recorded_tracks import USER, Sent, car_at, drive, header, made, pose, walk, walking, write, write_sqlite

SPEED, WALK, MEETS, CLOCK = 8.0, 1.4, 7.0, 1000.0  # m/s, m/s, s after the beginning, s
REQUEST = ConflictRequest(load_scenario("crossing"))
Place = Callable[[np.ndarray], np.ndarray]


def placed(right: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Places in the recording's frame of a road that leads another way there."""
    cos, sin = math.cos(2.1), math.sin(2.1)
    return np.array([300.0, -40.0]) + np.column_stack([cos * along + sin * right, sin * along - cos * right])


def straight(times: np.ndarray) -> np.ndarray:
    return placed(0.0 * times, SPEED * times)


def standing(times: np.ndarray) -> np.ndarray:
    return placed(0.0 * times, 1.5 * np.maximum(times - 3.0, 0.0) ** 2 + 10.0)


def crossing(off: float = 0.0, side: float = 1.0, line: float = SPEED * MEETS + 2.25) -> Place:
    """Someone who is `off` (m) beyond the middle of the lane when the car comes to the line unbraked."""
    return lambda times: placed(side * (off + WALK * (times - MEETS)), line + 0.0 * times)


def track(name: str, place: Place, begin: float = 0.0, end: float = 10.0, rate: float = 20.0) -> Track:
    times = begin + np.arange(round((end - begin) * rate)) / rate
    return Track(times, place(times), f"drive, {name}", name=name, origin=CLOCK)


def found(*users: Track, car: Place = straight, request: ConflictRequest = REQUEST) -> list[Conflict]:
    return conflicts_in(RecordedDrive("drive", track("car", car), users, ()), request)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_conflict_becomes_the_scenario_that_it_was(side: float):
    (one,) = found(track("p", crossing(0.5, side)))
    assert one.why == ""
    assert one.scenario is not None
    assert one.safe is not None
    passed = one.begins - CLOCK
    assert one.speed == pytest.approx(SPEED, abs=1e-6)
    crosses = MEETS - 0.5 / WALK
    assert one.gap == pytest.approx(SPEED * (MEETS - passed), abs=1e-6)
    times = passed + one.scenario.time_step * np.arange(len(one.safe))
    assert one.safe.positions == pytest.approx(np.column_stack([WALK * (times - crosses), 0.0 * times]), abs=1e-6)
    assert one.nearest - CLOCK == pytest.approx(MEETS, abs=1.0)
    assert one.recorded == one.least == 0.0  # nobody brakes in this recording


@pytest.mark.parametrize(
    ("place", "why"),
    [
        (crossing(6.0), "crosses well ahead of the car"),
        (crossing(0.0, line=-30.0), "crosses behind it"),
        (lambda times: placed(3.0 + 0.0 * times, 20.0 + 1.3 * times), "walks along the road"),
        (lambda times: placed(3.0 + 0.0 * times, 50.0 + 0.0 * times), "stands beside it"),
    ],
)
def test_who_does_not_come_near_is_no_conflict(place: Place, why: str):
    assert found(track("p", place)) == [], why


def hole(times: np.ndarray) -> np.ndarray:
    return (times < 5.0) | (times > 6.0)


def with_hole(one: Track) -> Track:
    kept = hole(one.times)
    return Track(one.times[kept], one.places[kept], one.where, name=one.name, origin=one.origin)


@pytest.mark.parametrize(
    ("users", "car", "reason"),
    [
        ([track("p", crossing())], lambda t: placed(0.04 * np.maximum(t - 2.0, 0.0) ** 3, SPEED * t), "the car turns"),
        ([track("p", crossing()), track("q", crossing(0.3, -1.0))], straight, "several conflicts at once"),
        ([with_hole(track("p", crossing()))], straight, "is not tracked for more than 0.5 s"),
        ([track("p", lambda times: placed(14.0 * (times - MEETS), SPEED * MEETS + 0.0 * times))], straight, "14.0 m/s"),
        ([track("p", lambda times: placed(0.9 * (times - 7.0), 29.0 + 0.0 * times))], standing, "the car stands"),
    ],
)
def test_what_cannot_be_driven_again_is_listed_with_its_reason(users: list[Track], car: Place, reason: str):
    several = found(*users, car=car)
    assert len(several) == len(users)
    assert all(reason in one.why and one.scenario is None for one in several)


@pytest.mark.parametrize("off", [1.6, 1.3, -2.2])
def test_bounds_hold_for_a_car_that_does_not_brake(off: float):
    """The pedestrian is beyond the middle of the lane by `off`, or before it, when the car comes: it is missed."""
    (one,) = found(track("p", crossing(off)))
    assert one.recorded == pytest.approx(max(off, -off - WALK * 4.5 / SPEED) - 1.15, abs=0.03)
    never = EpisodeSpec(one.scenario, Mode.KAMIKAZE, 0, 0, one.safe, controller="basic", multiplier=0.0)
    hit = exact_or_found(never)
    assert one.least - 0.03 <= hit.distance <= one.recorded + 0.15  # steps are whole ticks
    assert one.recorded <= one.most


def braking(times: np.ndarray) -> np.ndarray:
    """A car that brakes by 4 m/s² from 3.5 s on, until it stands 8 m before the line on which it would meet someone."""
    passed = np.clip(times - 4.0, 0.0, 2.0)
    return placed(0.0 * times, SPEED * np.minimum(times, 4.0) + SPEED * passed - 2.0 * passed**2)


def test_bounds_of_a_car_that_braked_say_that_it_may_not_brake_the_next_time():
    (one,) = found(track("p", crossing()), car=braking)
    assert one.least == 0.0
    assert 2.0 < one.recorded <= one.most


def noisy(place: Place, sigma: float, rng: np.random.Generator) -> Track:
    one = track("noisy", place, rate=10.0)
    return Track(one.times, one.places + rng.normal(0.0, sigma, one.places.shape), one.where, name=one.name)


@pytest.mark.parametrize(("car", "at", "speed"), [(straight, 5.0, SPEED), (braking, 3.5, SPEED), (braking, 5.0, 4.0)])
def test_the_speed_of_a_steady_drive_is_known_through_noise_and_brakes_do_not_blur_it(car, at, speed):
    rng = np.random.default_rng(3)
    found = [steady_state(noisy(car, 0.02, rng), at, 0.5) for _ in range(20)]
    off = np.array([math.hypot(*one[2:]) - speed for one in found if one is not None])
    assert len(off) == 20
    assert math.sqrt((off**2).mean()) < (0.005 if speed == SPEED else 0.04)  # a parabola over 2 s gives 0.008 at best


@pytest.mark.parametrize(("stops", "most"), [(9.0, 0.008), (5.0, 0.015)])
def test_the_path_of_a_road_user_is_smooth_but_its_stop_stays(stops: float, most: float):
    rng, times = np.random.default_rng(4), np.arange(1.0, 9.0, 0.3)

    def place(at: np.ndarray) -> np.ndarray:
        return placed(1.4 * np.minimum(at, stops), 0.0 * at)

    off = [path_at(noisy(place, 0.02, rng), times, 0.5) - place(times) for _ in range(20)]
    assert math.sqrt(np.mean(np.square(off))) < most


def written(path: Path, place: Place, rate: float = 20.0) -> Path:
    rows = [(t, name, *xy) for name, of in (("car", straight), ("p", place)) for t, xy in moments(of, rate)]
    lines = [f"{CLOCK + t!r},{name},{x!r},{y!r}" for t, name, x, y in rows]
    path.write_text("\n".join(["t,id,x,y", *lines, ""]), encoding="utf-8")
    return path


def moments(place: Place, rate: float) -> list[tuple[float, list[float]]]:
    times = np.arange(round(10.0 * rate)) / rate
    return list(zip(times.tolist(), place(times).tolist(), strict=True))


def test_conflicts_are_ranked_exported_and_rated_the_same_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    for name, off in (("near", 0.2), ("far", 1.0), ("none", 8.0)):
        written(tmp_path / f"{name}.csv", crossing(off))
    (tmp_path / "other.csv").write_text("t,x,y\n0,1,2\n", encoding="utf-8")
    (tmp_path / "no_car.csv").write_text("t,id,x,y\n0,7,1,2\n1,7,1,2\n", encoding="utf-8")
    out = tmp_path / "out"
    words = ["log", str(tmp_path), "--controller", "basic", "--multiplier", "1.15", "--export", "2", "--workers", "1"]
    assert main([*words, "--out", str(out), "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    rows = content["conflicts"]
    assert content == json.loads((out / "log.json").read_text("utf-8"))
    assert {row["drive"] for row in rows} == {"near", "far"}
    margins = [row["margin"] for row in rows]
    assert margins == sorted(margins)
    assert margins[-1] > 0.0
    assert [(one["what"], "--car: 7" in one["why"]) for one in content["left_out"]] == [("no_car", True)]
    assert main(["log", str(tmp_path / "no_car.csv"), "--out", str(tmp_path / "nothing")]) == 1
    assert "no recording could be read" in capsys.readouterr().err
    cells = read_campaign(out / "campaign.yaml")
    assert [cell.values["multiplier"] for cell in cells] == [1.15, 1.15]
    for row, cell in zip(rows, cells, strict=True):
        scenario = load_scenario(str(cell.scenario))
        phi = read_csv_trajectory(cell.values["safe"], scenario)
        trial = EpisodeSpec(scenario, Mode.KAMIKAZE, 0, 0, phi, controller="basic", multiplier=1.15)
        hit = exact_or_found(trial)
        assert hit.distance == pytest.approx(row["margin"], abs=1e-9)


def test_a_car_of_a_file_is_searched_for_and_exported_with_the_whole_path(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    car = "class Never:\n    def reset(self, *_): pass\n    def command(self, *_): return 0.0\n"
    Path("never.py").write_text(car, encoding="utf-8")
    written(tmp_path / "drive.csv", crossing(1.4))
    words = ["--controller", "never.py:Never", "--margin-limit", "16", "--export", "1", "--workers", "1"]
    assert main(["log", "drive.csv", *words, "--out", "out"]) == 0
    assert "at most 0.2" in capsys.readouterr().out  # from 0.25 m beyond the side of the car that passes
    (cell,) = read_campaign(tmp_path / "out" / "campaign.yaml")
    assert cell.values["controller"] == f"{tmp_path}/never.py:Never"


def test_the_margin_is_that_of_the_true_scenario(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    written(tmp_path / "drive.csv", crossing(1.0))
    words = ["--controller", "basic", "--multiplier", "1.15", "--workers", "1", "--out", str(tmp_path / "out")]
    assert main(["log", str(tmp_path / "drive.csv"), *words, "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)["conflicts"]
    begins = row["begins"] - CLOCK
    ticks = np.arange(begins, 9.95, 0.3)
    still = {"start_gap_range": 0.0, "speed_noise": 0.0, "acceleration_noise": 0.0, "start_speed": SPEED}
    car = {f"car.{key}": value for key, value in {**still, "start_gap": SPEED * (MEETS - begins)}.items()}
    x = 1.0 + WALK * (ticks - MEETS)
    scenario = changed_scenario("crossing", {**car, "adversary.start_x": float(x[0]), "adversary.destination_x": 3.0})
    phi = Trajectory(np.column_stack([x, 0.0 * x]), 0.3)
    hit = exact_or_found(EpisodeSpec(scenario, Mode.KAMIKAZE, 0, 0, phi, controller="basic", multiplier=1.15))
    assert row["margin"] == pytest.approx(hit.distance, abs=0.01)


def test_a_bag_whose_car_is_a_frame_and_whose_objects_are_seen_by_its_lidar(tmp_path: Path):
    """The car is a frame of tf; stamps count, not when messages were logged; one object moves with the car."""
    late = [one._replace(late=0.1 * (number % 4)) for number, one in enumerate(drive())]
    write(tmp_path / "drive.mcap", sorted(late, key=lambda one: one.logged))
    (read,) = read_drives([tmp_path], DriveRequest(), Damage(skip=True))
    (one,) = conflicts_in(read, REQUEST)
    assert (one.user, one.why) == ("/tracks:42", "")
    (x, y, _), speed = car_at(one.begins), math.hypot(0.1, 6.0)
    time = (0.2 - y) / 6.0  # s, from `begins` on, until the car is on the line on which the pedestrian walks
    crosses = (x + 0.1 * time, 0.2)
    assert one.speed == pytest.approx(speed, abs=1e-3)
    assert one.gap == pytest.approx(math.dist((x, y), crosses) - 2.25, abs=0.01)


def test_objects_of_autoware_are_the_road_users_of_a_drive(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Their types stand in the bag alone; here with the fields that are read."""
    store, package = get_typestore(Stores.ROS2_JAZZY), "autoware_perception_msgs/msg/"
    uuid = "unique_identifier_msgs/msg/UUID"
    defined = {
        f"{package}TrackedObjectKinematics": "geometry_msgs/PoseWithCovariance pose_with_covariance",
        f"{package}TrackedObject": f"{uuid} object_id\n{package}TrackedObjectKinematics kinematics",
        f"{package}TrackedObjects": f"std_msgs/Header header\n{package}TrackedObject[] objects",
        uuid: "uint8[16] uuid",
    }
    for name, text in defined.items():
        if name not in store.types:
            store.register(get_types_from_msg(text, name))
    monkeypatch.setattr("test_recorded_tracks.typestore", lambda: store)
    sent = []
    for tick in range(200):
        time = CLOCK + tick / 20.0
        (ego,), (user,) = (place(np.array([tick / 20.0])) for place in (straight, crossing()))
        at = made("geometry_msgs/msg/PoseWithCovariance", pose=pose(*user.tolist(), 0.0), covariance=np.zeros(36))
        one = made(
            f"{package}TrackedObject",
            object_id=made(uuid, uuid=np.arange(16, dtype=np.uint8)),
            kinematics=made(f"{package}TrackedObjectKinematics", pose_with_covariance=at),
        )
        objects = made(f"{package}TrackedObjects", header=header(time, "odom"), objects=[one])
        sent += [walking(time, *ego.tolist()), Sent("/objects", f"{package}TrackedObjects", time, objects)]
    write_sqlite(tmp_path / "drive", sent)
    (read,) = read_drives([tmp_path], DriveRequest(), Damage(skip=True))
    (one,) = conflicts_in(read, REQUEST)
    assert one.user == f"/objects:{bytes(range(16)).hex()}"
    assert one.speed == pytest.approx(SPEED, abs=1e-6)
    assert one.nearest - CLOCK == pytest.approx(MEETS, abs=1.0)


def test_a_recording_that_does_not_say_which_is_the_car_is_left_out_with_the_reason(tmp_path: Path):
    write(tmp_path / "a.mcap", walk())
    two = [one._replace(topic="/other/odometry") for one in walk()]
    write(tmp_path / "b.mcap", [*walk(), *two])
    found = list(read_drives([tmp_path], DriveRequest(), Damage(skip=True)))
    assert found[0].car.name == USER
    assert found[1][0] == "b"
    assert "name it by --car" in found[1][1]
    (named,) = read_drives([tmp_path / "b.mcap"], DriveRequest(car=USER), Damage(skip=True))
    assert named.left_out == (("/other/odometry", "is where the car is, all the time: the car itself"),)
