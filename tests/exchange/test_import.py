"""Ways that come in: what went out comes back, look-alikes of data sets and bags are placed, what is wrong is said."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from exchange_support import recorded, safe, walk
from mcap.writer import Writer
from skd_adversary.safe_trajectories.sources import load_safe_trajectories
from skd_evaluator.assessment.files.episodes_npz import read_episodes
from skd_evaluator.bags.mcap_file import complete, typestore
from skd_evaluator.bags.tracks import RecordingFrame, Track
from skd_evaluator.extensions.exchange.exports import FORMATS
from skd_evaluator.extensions.exchange.imports import UnusableError, by_car, trajectory_of
from skd_evaluator.extensions.exchange.readers import ImportRequest, read_sources
from skd_sim.errors import UsageError
from skd_sim.scenario.scenario import load_scenario


@pytest.mark.parametrize("name", FORMATS)
def test_import_of_an_export_gives_the_phi_that_went_out(result: Path, skd_here, tmp_path: Path, name: str):
    assert skd_here("export", result, "--format", name, "--out", "out").returncode == 0
    done = skd_here("import", "out", "--out", "in", "--scenario", "bystanders", "--json")
    assert done.returncode == 0, done.stderr
    content = json.loads(done.stdout)
    phis = read_episodes(result).safe
    assert [Path(one["file"]).stem for one in content["files"]] == [f"phi_{index:03d}" for index in range(len(phis))]
    assert len(content["left_out"]) == 8  # kamikazes are no safe trajectories
    kamikaze = next(path for path in sorted((tmp_path / "out").iterdir()) if "kamikaze" in path.name)
    done = skd_here("import", kamikaze, "--out", "none")
    assert (done.returncode, "it is no safe trajectory" in done.stderr) == (2, True)
    scenario = load_scenario("bystanders")
    found = load_safe_trajectories(tmp_path / "in" / "safe", scenario, len(phis))
    for one, phi in zip(found, phis, strict=True):
        assert one.positions == pytest.approx(phi, abs=1e-9)
        assert len(one) == len(phi)


@pytest.mark.parametrize("name", FORMATS)
def test_every_kind_comes_back(tmp_path: Path, name: str):
    """A bicycle, cars and children, on curves and on crossing roads; times to a nanosecond."""
    kind = FORMATS[name]
    for scenario in ("cbna", "cccscp", "right_turn", "child", "oncoming_turn"):
        one = recorded(scenario, whole_ticks=kind.whole_ticks, stem=scenario)
        path = tmp_path / kind.name(one)
        kind.write(path, one)
        (source,) = read_sources(path, ImportRequest(needs_car=True))
        assert source.stem == scenario
        user = next(actor for actor in one.actors if actor.name == "Adversary")
        assert source.found.times == pytest.approx(user.times, abs=1e-9)
        assert source.found.places == pytest.approx(user.states[:, :2], abs=1e-9)
        assert source.car is not None
        assert len(source.car.times) == len(user.times)


def look_alike(folder: Path, *, rate: float = 25.0, drop: tuple[int, ...] = (), mirror: float = 1.0) -> Path:
    """A recording in the layout of inD: a car that drives along a street, a pedestrian, a cyclist; made up here."""
    folder.mkdir(exist_ok=True)
    turned, origin = 0.6, np.array([120.0, -45.0])
    to_file = np.array([[math.cos(turned), -math.sin(turned)], [math.sin(turned), math.cos(turned)]])
    frames = np.arange(0, 251)
    ways = {  # in a frame in which the car drives North
        "3": ("car", np.column_stack([0.0 * frames, -30.0 + 8.0 * frames / rate])),
        "5": ("pedestrian", np.column_stack([mirror * (-4.0 + 1.2 * frames / rate), 0.3 * np.sin(frames / 40.0)])),
        "7": ("bicycle", np.column_stack([-6.0 + 4.0 * frames / rate, 0.0 * frames + 9.0])),
    }
    further = "trackLifetime,width,length,xVelocity,yVelocity,xAcceleration,yAcceleration,lonVelocity,latVelocity"
    lines = [f"recordingId,trackId,frame,xCenter,yCenter,heading,{further}"]
    for id_, (_, way) in ways.items():
        for frame, (x, y) in zip(frames.tolist(), (way @ to_file.T + origin).tolist(), strict=True):
            if not (id_ == "5" and frame in drop):
                lines.append(f"18,{id_},{frame + 100},{x!r},{y!r},0.0,{frame},0,0,0,0,0,0,0,0")
    (folder / "18_tracks.csv").write_text("\n".join(lines) + "\n")
    meta = ["recordingId,trackId,initialFrame,finalFrame,numFrames,width,length,class"]
    meta += [f"18,{id_},100,350,251,0,0,{kind}" for id_, (kind, _) in ways.items()]
    (folder / "18_tracksMeta.csv").write_text("\n".join(meta) + "\n")
    (folder / "18_recordingMeta.csv").write_text(f"recordingId,locationId,frameRate\n18,1,{rate:g}\n")
    return folder


def test_data_sets_of_levelx_are_placed_by_a_frame_or_by_the_car(tmp_path: Path, skd_here):
    look_alike(tmp_path / "ind", drop=(40, 41))
    frame = f"120,-45,{math.degrees(0.6)!r}"
    done = skd_here("import", "ind", "--frame", frame, "--out", "a", "--json")
    assert done.returncode == 0, done.stderr
    (one,) = json.loads(done.stdout)["files"]
    assert (one["road_user"], one["kind"], one["positions"], one["gaps"]) == ("5", "pedestrian", 249, 1)
    assert one["rate"] == pytest.approx(25.0)
    assert one["longest_step"] == one["filled"] == pytest.approx(3 / 25)
    table = np.loadtxt(tmp_path / "a" / "safe" / "18_tracks_5.csv", delimiter=",", skiprows=1)
    assert table[:, 1] == pytest.approx(-4.0 + 1.2 * table[:, 0], abs=1e-9)
    assert table[:, 2] == pytest.approx(0.3 * np.sin(25.0 * table[:, 0] / 40.0), abs=1e-9)
    scenario = ("--scenario", "crossing")
    done = skd_here("import", "ind", "--road-user", 5, "--car", 3, "--frame", "car", *scenario, "--out", "b", "--json")
    assert done.returncode == 0, done.stderr
    by_car = np.loadtxt(tmp_path / "b" / "safe" / "18_tracks.csv", delimiter=",", skiprows=1)
    assert by_car[:, 1] == pytest.approx(table[:, 1], abs=1e-9)
    moved = by_car[:, 2] - table[:, 2]
    assert np.ptp(moved) < 1e-9  # y = 0 where it crosses the car's line
    assert np.interp(0.0, by_car[:, 1], by_car[:, 2]) == pytest.approx(0.0, abs=1e-9)
    look_alike(tmp_path / "west", mirror=-1.0)
    done = skd_here("import", "west", "--road-user", 5, "--car", 3, "--frame", "car", "--out", "c")
    assert "mirrored to cross eastwards" in done.stdout
    bikes = skd_here("import", "ind", "--kind", "cyclist", "--out", "d", "--json")
    assert [one["road_user"] for one in json.loads(bikes.stdout)["files"]] == ["7"]


def test_long_gaps_jumps_and_what_safe_refuses_are_left_out(tmp_path: Path, skd_here):
    look_alike(tmp_path / "ind", drop=tuple(range(40, 60)))
    done = skd_here("import", "ind", "--out", "a")
    assert (done.returncode, "a gap of 0.84 s" in done.stderr, (tmp_path / "a").exists()) == (2, True, False)
    done = skd_here("import", "ind", "--longest-gap", 1, "--out", "a")
    assert "1 gap, 0.84 s in all, filled in straight lines" in done.stdout
    done = skd_here("import", "ind", "--longest-gap", 1, "--scenario", "crossing", "--out", "b")
    assert (done.returncode, "nothing is left" in done.stderr) == (2, True)  # 120 m away
    look_alike(tmp_path / "slow", rate=15.0)
    frame = f"120,-45,{math.degrees(0.6)!r}"
    done = skd_here("import", "slow", "--frame", frame, "--scenario", "crossing", "--out", "c", "--json")
    (one,) = json.loads(done.stdout)["files"]
    assert one["cut"].startswith("cut to the horizon")  # 16.7 s, of which 12 s are around the crossing
    table = np.loadtxt(tmp_path / "c" / one["file"], delimiter=",", skiprows=1)
    assert table[-1, 0] <= 12.0 + 1e-9
    assert table[0, 1] < 0.0 < table[-1, 1]


def test_the_same_way_comes_in_once(tmp_path: Path, skd_here):
    """`--safe` refuses a way that is there twice, and some of the φ that SKD draws are the same."""
    times = np.arange(0.0, 2.41, 0.3)
    for name, rate in (("first", 1), ("second", 1), ("finer", 2)):
        at = np.linspace(0.0, times[-1], rate * (len(times) - 1) + 1)
        rows = [f"{t!r},{x!r},0.0" for t, x in zip(at.tolist(), (2.5 * at - 3.0).tolist(), strict=True)]
        (tmp_path / f"{name}.csv").write_text("\n".join(["t,x,y", *rows]) + "\n")
    files = ["first.csv", "finer.csv", "second.csv"]
    done = skd_here("import", *files, "--out", "a", "--json")
    content = json.loads(done.stdout)
    assert [one["source"] for one in content["files"]] == ["first.csv", "finer.csv"]
    (one,) = content["left_out"]
    assert (one["source"], one["why"].split(",")[0]) == ("second.csv", "is the way of first.csv once more")
    done = skd_here("import", *files, "--scenario", "crossing", "--out", "b")  # at its ticks all three are the same
    assert sorted(path.name for path in (tmp_path / "b" / "safe").iterdir()) == ["first.csv"]
    assert done.stderr.count("left out: is the way of first.csv once more") == 2
    assert "--safe-count 1 " in done.stdout
    assert len(load_safe_trajectories(tmp_path / "b" / "safe", load_scenario("crossing"), 1)) == 1


# --- bags


def _stamp(time: float) -> dict[str, int]:
    whole = round(1e9 * time)
    return {"sec": whole // 10**9, "nanosec": whole % 10**9}


def _message(kind: str, **fields: Any) -> Any:
    complete(typestore(), kind)
    return typestore().types[kind](**fields)


def _header(time: float, frame: str) -> Any:
    stamp = _message("builtin_interfaces/msg/Time", **_stamp(time))
    return _message("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def _point(x: float, y: float, z: float = 0.0) -> Any:
    return _message("geometry_msgs/msg/Point", x=x, y=y, z=z)


def _turn(heading: float) -> Any:
    return _message("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=math.sin(0.5 * heading), w=math.cos(0.5 * heading))


def _pose(x: float, y: float, heading: float) -> Any:
    return _message("geometry_msgs/msg/Pose", position=_point(x, y), orientation=_turn(heading))


def _transform(time: float, parent: str, child: str, x: float, y: float, heading: float) -> Any:
    vector = _message("geometry_msgs/msg/Vector3", x=x, y=y, z=0.0)
    transform = _message("geometry_msgs/msg/Transform", translation=vector, rotation=_turn(heading))
    header = _header(time, parent)
    return _message("geometry_msgs/msg/TransformStamped", header=header, child_frame_id=child, transform=transform)


def _detection(time: float, frame: str, id_: str, x: float, y: float) -> Any:
    box = _message(
        "vision_msgs/msg/BoundingBox3D",
        center=_pose(x, y, 0.0),
        size=_message("geometry_msgs/msg/Vector3", x=0.5, y=0.5, z=1.8),
    )
    return _message("vision_msgs/msg/Detection3D", header=_header(time, frame), results=[], bbox=box, id=id_)


def write_bag(path: Path, messages: Iterator[tuple[str, str, float, Any]]) -> Path:
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        channels: dict[str, int] = {}
        for topic, kind, time, message in messages:
            if topic not in channels:
                schema = writer.register_schema(kind, "ros2msg", b"")
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            data = bytes(typestore().serialize_cdr(message, kind))
            writer.add_message(channels[topic], round(1e9 * time), data, round(1e9 * time))
        writer.finish()
    return path


def drive(rate: float = 20.0) -> Iterator[tuple[str, str, float, Any]]:
    """A car that turns while it drives, whose sensor sees a pedestrian; map, odom, base_link and lidar."""
    fixed = _message("tf2_msgs/msg/TFMessage", transforms=[_transform(0.0, "base_link", "lidar", 1.5, 0.2, 0.3)])
    yield "/tf_static", "tf2_msgs/msg/TFMessage", 0.0, fixed
    for tick in range(121):
        time = 100.0 + tick / rate
        x, y, heading = car_at(time)
        moves = [
            _transform(time, "map", "odom", 5.0, -2.0, 0.4),
            _transform(time, "odom", "base_link", *_in_odom(x, y), heading - 0.4),
        ]
        yield "/tf", "tf2_msgs/msg/TFMessage", time, _message("tf2_msgs/msg/TFMessage", transforms=moves)
        px, py = walker_at(time)
        lx, ly = _in_lidar(px, py, x, y, heading)
        array = _message(
            "vision_msgs/msg/Detection3DArray",
            header=_header(time, "lidar"),
            detections=[_detection(time, "lidar", "42", lx, ly), _detection(time, "lidar", "7", 3.0, 0.0)],
        )
        yield "/tracks", "vision_msgs/msg/Detection3DArray", time, array


def car_at(time: float) -> tuple[float, float, float]:
    passed = time - 100.0
    heading = 0.5 * math.pi + 0.02 * passed
    return 0.1 * passed, -25.0 + 6.0 * passed, heading


def walker_at(time: float) -> tuple[float, float]:
    return -3.5 + 1.3 * (time - 100.0), 0.2


def _in_odom(x: float, y: float) -> tuple[float, float]:
    dx, dy = x - 5.0, y + 2.0
    return math.cos(0.4) * dx + math.sin(0.4) * dy, math.cos(0.4) * dy - math.sin(0.4) * dx


def _in_lidar(px: float, py: float, x: float, y: float, heading: float) -> tuple[float, float]:
    dx, dy = px - x, py - y
    bx, by = math.cos(heading) * dx + math.sin(heading) * dy, math.cos(heading) * dy - math.sin(heading) * dx
    bx, by = bx - 1.5, by - 0.2
    return math.cos(0.3) * bx + math.sin(0.3) * by, math.cos(0.3) * by - math.sin(0.3) * bx


def test_tracked_objects_of_a_bag_come_from_the_sensor_into_the_map(tmp_path: Path):
    path = write_bag(tmp_path / "a.mcap", drive())
    asked = ImportRequest("/tracks:42", "/tf:base_link", needs_car=True, map_frame="map")
    (source,) = read_sources(path, asked)
    wanted = np.array([walker_at(time) for time in source.found.times.tolist()])
    assert len(wanted) == 121
    assert source.found.places == pytest.approx(wanted, abs=1e-6)
    assert source.car is not None
    car = np.array([car_at(time)[:2] for time in source.car.times.tolist()])
    assert source.car.places == pytest.approx(car, abs=1e-6)
    (alone,) = read_sources(path, ImportRequest("/tf:base_link"))  # in the highest frame above it
    assert alone.found.frame == "map"
    assert alone.found.places == pytest.approx(source.car.places, abs=1e-9)


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        (ImportRequest("/tracks"), "several objects; it has 42, 7: name one as /tracks:ID"),
        (ImportRequest("/tracks:43"), "several objects; it has 42, 7"),
        (ImportRequest("/nothing"), "has no message on /nothing"),
        (ImportRequest("/tf:wheel"), "/tf has no frame 'wheel' but lidar, odom, base_link"),
        (ImportRequest("/tf:lidar", map_frame="moon"), "--map-frame moon: /tf and /tf_static do not know it"),
        (
            ImportRequest("/tracks:42", "/tf:base_link", needs_car=True),
            "'lidar' and /tf:base_link in 'map': two frames",
        ),
    ],
)
def test_bags_that_lack_what_is_asked_for(tmp_path: Path, asked: ImportRequest, says: str):
    path = write_bag(tmp_path / "a.mcap", drive())
    with pytest.raises(UsageError) as caught:
        read_sources(path, asked)
    assert says in str(caught.value)


# --- what is wrong


def _xosc(folder: Path) -> str:
    one = safe("crossing", walk(load_scenario("crossing")))
    FORMATS["openscenario"].write(folder / "a.xosc", one)
    return (folder / "a.xosc").read_text("utf-8")


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda text: text.replace('<Vertex time="0.3">', "<Vertex>"), "a vertex has no time"),
        (lambda text: text.replace('<Vertex time="0.3">', '<Vertex time="0.0">'), "times must increase"),
        (lambda text: text.replace('<Vertex time="0.3">', '<Vertex time="nan">'), "must be finite"),
        (lambda text: text.replace("WorldPosition", "LanePosition"), "not at a WorldPosition"),
        (lambda text: text.replace('entityRef="Adversary"', 'entityRef="B"') + " ", "of no use"),
        (lambda text: text.replace("<OpenSCENARIO>", "<Other>").replace("</OpenSCENARIO>", "</Other>"), "its root is"),
        (lambda text: text[:400], "not XML that SKD reads"),
        (lambda text: text.replace('scale="1.0"', 'scale="0"'), "scale of Timing must be above 0"),
        (
            lambda text: text.replace("<FollowTrajectoryAction", '<FollowTrajectoryAction initialDistanceOffset="1.5"'),
            "begins within its polyline",
        ),
    ],
)
def test_scenarios_that_say_no_way(tmp_path: Path, change: Callable[[str], str], says: str):
    (tmp_path / "a.xosc").write_text(change(_xosc(tmp_path)), "utf-8")
    if says == "of no use":  # another name: it is the only one there is
        (source,) = read_sources(tmp_path / "a.xosc", ImportRequest())
        assert source.found.name == "B"
        return
    with pytest.raises(UsageError) as caught:
        read_sources(tmp_path / "a.xosc", ImportRequest())
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("a,b\n1,2\n", "line 1: the header must name"),
        ("", "the header must name"),
        ("t,x,y\n0,0,0\n", "1 position; a track has at least two"),
        ("t,x,y\n0,0,0\n1,zero,0\n", "line 3: x must be a number"),
        ("t,x,y\n0,0,0\n0,1,0\n", "times must increase"),
        ("t,id,x,y\n0,a,0,0\n1,a,1,0\n0,b,0,0\n1,b,1,0\n", "name one by --road-user"),
        ("trackId,frame,xCenter,yCenter\n1,0,0,0\n", "called NN_tracks.csv"),
        ("t,x,y\n0,0\n", "2 values where the header names 3"),
        ("t,x,y\n0,0,-3,5,0,2\n1,0,-2,5,0,2\n", "6 values where the header names 3"),  # decimal commas
        ("t,x,y,x\n0,0,0,9\n1,1,0,9\n", "two columns 'x'"),
    ],
)
def test_tables_that_say_no_way(tmp_path: Path, text: str, says: str):
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(UsageError) as caught:
        read_sources(tmp_path / "a.csv", ImportRequest())
    assert says in str(caught.value)


def test_two_of_one_name_are_nobody(tmp_path: Path):
    """Whichever of both were taken, it would be somebody else's way without a word."""
    one = safe("crossing", walk(load_scenario("crossing")))
    FORMATS["commonroad"].write(tmp_path / "a.xml", one)
    text = (tmp_path / "a.xml").read_text("utf-8")
    begin, end = text.index("<dynamicObstacle"), text.index("</dynamicObstacle>") + len("</dynamicObstacle>")
    twice = text[:end] + text[begin:end].replace("<x>", "<x>1") + text[end:]
    (tmp_path / "a.xml").write_text(twice, "utf-8")
    with pytest.raises(UsageError, match="two obstacles have this id"):
        read_sources(tmp_path / "a.xml", ImportRequest())
    folder = look_alike(tmp_path / "ind")
    with (folder / "18_tracksMeta.csv").open("a") as stream:
        stream.write("18,3,100,350,251,0,0,pedestrian\n")
    with pytest.raises(UsageError, match="track '3' has two classes"):
        read_sources(folder / "18_tracks.csv", ImportRequest())


def test_a_bag_of_two_drives_is_not_one(tmp_path: Path):
    """Sorted by their stamps two drives would be one way that leaps between both."""
    path = write_bag(tmp_path / "a.mcap", itertools.chain(drive(), drive(10.0)))
    with pytest.raises(UsageError, match=r"the clock of /tracks goes back from 106\.00 to 100\.00 s"):
        read_sources(path, ImportRequest("/tracks:42"))


def test_a_car_that_turns_does_not_say_where_north_is():
    times = np.linspace(0.0, 8.0, 81)
    turned = 0.5 * np.pi * times / 8.0
    car = Track(times, 20.0 * np.column_stack([1.0 - np.cos(turned), np.sin(turned)]), "car")
    user = Track(times, np.column_stack([-4.0 + times, np.full(81, 10.0)]), "user")
    with pytest.raises(UnusableError, match=r"the car is up to 3.82 m off a straight line"):
        by_car(car, user, 1.0)


def test_a_way_that_jumps_is_unusable(tmp_path: Path):
    (tmp_path / "a.csv").write_text("t,x,y\n0,0,0\n1,1,0\n2,900,0\n3,901,0\n")
    (source,) = read_sources(tmp_path / "a.csv", ImportRequest())
    with pytest.raises(UnusableError, match="moves 899 m in 1 s"):
        trajectory_of(source, RecordingFrame(), 0.5, None)


def test_what_the_commands_refuse(result: Path, skd_here, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    for words, says in (
        (("export", result, "--format", "csv", "--episode", 7, "--out", "x"), "holds no such episode"),
        (("export", result, "--format", "csv", "--objective", "none", "--out", "x"), "no episode of that kind"),
        (("export", tmp_path, "--format", "csv", "--out", "x"), "holds no assessment.json"),
        (("import", "nothing", "--out", "x"), "no such file or folder"),
        (("import", tmp_path, "--out", "x"), "no file in it ends in"),
        (("import", result, "--kind", "horse", "--out", "x"), "unknown road user 'horse'"),
    ):
        done = skd_here(*words)
        assert (done.returncode, says in done.stderr, done.stderr.count("\n")) == (2, True, 1), done.stderr
    assert not (tmp_path / "x").exists()

    def missing(name: str) -> None:
        raise ModuleNotFoundError(name)

    monkeypatch.setattr("skd_evaluator.extensions.exchange.osi.import_module", missing)
    done = skd_here("export", result, "--format", "osi", "--out", "x")
    assert (done.returncode, "skd[exchange]" in done.stderr) == (2, True)
    assert skd_here("export", result, "--format", "csv", "--worst", 1, "--out", "x").returncode == 0
