"""Tracks of recordings: the same however a drive was stored, and no hole, leap or clock without a word."""

import math
import shutil
from collections.abc import Iterable, Iterator
from itertools import pairwise
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

import numpy as np
import pytest
import zstandard
from common import refused
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, Writer
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_typestore
from skd_evaluator.bags.checks import Damage
from skd_evaluator.bags.files import find_recordings
from skd_evaluator.bags.messages import complete, typestore
from skd_evaluator.bags.tracks import Track, bag_listing, bag_tracks
from skd_sim.errors import UsageError

ROS1 = get_typestore(Stores.ROS1_NOETIC)
TFS, DETECTIONS = "tf2_msgs/msg/TFMessage", "vision_msgs/msg/Detection3DArray"
ODOMETRY, USER = "nav_msgs/msg/Odometry", "/adversary/odometry"


class Sent(NamedTuple):
    """A message as it was sent; the recorder's time is that of the stamp, but for `late` (s)."""

    topic: str
    kind: str
    time: float
    message: Any
    late: float = 0.0

    @property
    def logged(self) -> int:
        return nanoseconds(self.time) + nanoseconds(self.late)


def nanoseconds(time: float) -> int:
    """Return a time (s) of whole milliseconds in ns."""
    return round(1e3 * time) * 10**6


def made(kind: str, **fields: Any) -> Any:
    complete(typestore(), kind)
    return typestore().types[kind](**fields)


def header(time: float, frame: str) -> Any:
    sec, nanosec = divmod(nanoseconds(time), 10**9)
    stamp = made("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
    return made("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def pose(x: float, y: float, heading: float) -> Any:
    turn = {"x": 0.0, "y": 0.0, "z": math.sin(0.5 * heading), "w": math.cos(0.5 * heading)}
    point = made("geometry_msgs/msg/Point", x=x, y=y, z=0.0)
    return made("geometry_msgs/msg/Pose", position=point, orientation=made("geometry_msgs/msg/Quaternion", **turn))


def transform(time: float, parent: str, child: str, x: float, y: float, heading: float, **late: float) -> Sent:
    """A transform on /tf, or where it has no time on /tf_static."""
    vector = made("geometry_msgs/msg/Vector3", x=x, y=y, z=0.0)
    moved = made("geometry_msgs/msg/Transform", translation=vector, rotation=pose(0.0, 0.0, heading).orientation)
    one = made("geometry_msgs/msg/TransformStamped", header=header(time, parent), child_frame_id=child, transform=moved)
    return Sent("/tf", TFS, time, made(TFS, transforms=[one]), **late)


def fixed(sent: Sent) -> Sent:
    return sent._replace(topic="/tf_static")


def detected(time: float, objects: Iterable[tuple[str, float, float]], frame: str = "lidar") -> Sent:
    size = made("geometry_msgs/msg/Vector3", x=0.5, y=0.5, z=1.8)
    found = [
        made(
            "vision_msgs/msg/Detection3D",
            header=header(0.0, ""),  # time and frame stand in the array's header alone
            results=[],
            bbox=made("vision_msgs/msg/BoundingBox3D", center=pose(x, y, 0.0), size=size),
            id=id_,
        )
        for id_, x, y in objects
    ]
    return Sent("/tracks", DETECTIONS, time, made(DETECTIONS, header=header(time, frame), detections=found))


def walking(time: float, x: float, y: float = 0.2, *, stamp: float | None = None, frame: str = "odom") -> Sent:
    zero = made("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
    twist = made("geometry_msgs/msg/Twist", linear=made("geometry_msgs/msg/Vector3", x=1.3, y=0.0, z=0.0), angular=zero)
    message = made(
        ODOMETRY,
        header=header(time if stamp is None else stamp, frame),
        child_frame_id="user",
        pose=made("geometry_msgs/msg/PoseWithCovariance", pose=pose(x, y, 0.0), covariance=np.zeros(36)),
        twist=made("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
    )
    return Sent(USER, ODOMETRY, time, message)


def walk(begin: float = 100.0, count: int = 81, rate: float = 20.0) -> list[Sent]:
    """A pedestrian who walks across at 1.3 m/s."""
    return [walking(begin + tick / rate, -3.0 + 1.3 * tick / rate) for tick in range(count)]


def car_at(time: float) -> tuple[float, float, float]:
    passed = time - 100.0
    return 0.1 * passed, -25.0 + 6.0 * passed, 0.5 * math.pi + 0.02 * passed


def walker_at(time: float) -> tuple[float, float]:
    return -3.5 + 1.3 * (time - 100.0), 0.2


def within(x: float, y: float, frame: tuple[float, float, float]) -> tuple[float, float]:
    """A place in a frame that lies somewhere."""
    dx, dy, turned = x - frame[0], y - frame[1], frame[2]
    return math.cos(turned) * dx + math.sin(turned) * dy, math.cos(turned) * dy - math.sin(turned) * dx


def drive(ticks: int = 121, offset: float = 0.0) -> Iterator[Sent]:
    """A car that turns while it drives, whose lidar sees a pedestrian; map, odom, base_link, lidar, and a wheel."""
    yield fixed(transform(offset + 100.0, "base_link", "lidar", 1.5, 0.2, 0.3))
    for tick in range(ticks):
        time = 100.0 + tick / 20.0
        x, y, heading = car_at(time)
        yield transform(offset + time, "map", "odom", 5.0, -2.0, 0.4)
        yield transform(offset + time, "odom", "base_link", *within(x, y, (5.0, -2.0, 0.4)), heading - 0.4)
        yield transform(offset + time, "base_link", "wheel", math.nan, 0.0, 0.0)
        seen = within(*within(*walker_at(time), (x, y, heading)), (1.5, 0.2, 0.3))
        yield detected(offset + time, [("42", *seen), ("7", 3.0, 0.0)])


def write(path: Path, messages: Iterable[Sent], *, compression: CompressionType = CompressionType.ZSTD,
          chunk: int = 1 << 20, packed: bool = False) -> Path:  # fmt: skip
    """Write an MCAP file; `packed`: with each message compressed by itself."""
    with path.open("wb") as stream:
        writer = Writer(stream, compression=compression, chunk_size=chunk)
        writer.start(profile="ros2")
        channels: dict[str, int] = {}
        for one in messages:
            if one.topic not in channels:
                schema = writer.register_schema(one.kind, "ros2msg", b"")
                channels[one.topic] = writer.register_channel(one.topic, "cdr", schema)
            data = bytes(typestore().serialize_cdr(one.message, one.kind))
            data = zstandard.compress(data) if packed else data
            writer.add_message(channels[one.topic], one.logged, data, one.logged)
        writer.finish()
    return path


def write_sqlite(path: Path, messages: Iterable[Sent]) -> Path:
    with Ros2Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connections: dict[str, Any] = {}
        for one in messages:
            if one.topic not in connections:
                connections[one.topic] = writer.add_connection(one.topic, one.kind, typestore=typestore())
            writer.write(connections[one.topic], one.logged, bytes(typestore().serialize_cdr(one.message, one.kind)))
    return path


def write_ros1(path: Path, messages: Iterable[Sent]) -> Path:
    """Write a bag of ROS 1 with odometry, whose headers count their messages."""
    with Ros1Writer(path) as writer:
        connections: dict[str, Any] = {}
        for number, one in enumerate(messages):
            if one.topic not in connections:
                connections[one.topic] = writer.add_connection(one.topic, one.kind, typestore=ROS1)
            said = one.message.header
            own = ROS1.types["std_msgs/msg/Header"](seq=number, stamp=said.stamp, frame_id=said.frame_id)
            fields = {name: getattr(one.message, name) for name in ("child_frame_id", "pose", "twist")}
            message = ROS1.types[one.kind](header=own, **fields)
            writer.write(connections[one.topic], one.logged, bytes(ROS1.serialize_ros1(message, one.kind)))
    return path


def read(path: Path, *names: str, damage: Damage | None = None, **options: Any) -> list[Track]:
    (files,) = find_recordings([path])
    return list(bag_tracks(files, names or [USER], damage=damage or Damage(skip=True), **options).values())


def bits(*tracks: Track) -> list[bytes]:
    return [part.tobytes() for one in tracks for part in (one.times, one.places)]


def split(folder: Path, messages: list[Sent], random: Random) -> None:
    """Write a recording as several files, each in an order, storage and packing of its own."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    cuts = sorted(random.sample(range(1, len(messages)), random.randrange(13)))
    for number, (low, high) in enumerate(pairwise([0, *cuts, len(messages)])):
        part = messages[low:high]
        if random.random() < 0.5:
            random.shuffle(part)
        kind = random.choice([*CompressionType, "each", "whole", "sqlite"])
        path = folder / f"drive_{number}.mcap"
        if kind == "sqlite":
            written = write_sqlite(folder / "bag", part)
            (written / "bag.db3").rename(path.with_suffix(".db3"))
            shutil.rmtree(written)
        elif isinstance(kind, CompressionType):
            write(path, part, compression=kind, chunk=random.choice([300, 1 << 20]))
        else:
            write(path, part, packed=kind == "each")
            if kind == "whole":
                path.with_suffix(".mcap.zstd").write_bytes(zstandard.compress(path.read_bytes()))
                path.unlink()


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 2**32), offset=st.sampled_from([0, 1, 86_400, 1_732_787_000]))
def test_a_drive_has_the_same_tracks_however_it_is_split_ordered_packed_and_timed(tmp_path, seed, offset):
    split(tmp_path / "drive", list(drive(41, float(offset))), Random(seed))
    whole = write(tmp_path / "whole.mcap", drive(41))
    asked = ("/tracks:42", "/tf:base_link")
    assert bits(*read(tmp_path / "drive", *asked, map_frame="map")) == bits(*read(whole, *asked, map_frame="map"))


def test_a_bag_of_ros_1_also_as_mcap_says_the_same_as_one_of_ros_2(tmp_path: Path):
    bag, converted = write_ros1(tmp_path / "a.bag", walk()), tmp_path / "b.mcap"
    with Ros1Reader(bag) as reader, converted.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros1")
        (one,) = reader.connections
        kind, definition = one.msgtype.replace("/msg/", "/"), one.msgdef.data.encode()
        channel = writer.register_channel(one.topic, "ros1", writer.register_schema(kind, "ros1msg", definition))
        for _, logged, data in reader.messages():
            writer.add_message(channel, logged, bytes(data), logged)
        writer.finish()
    plain = bits(*read(write(tmp_path / "a.mcap", walk())))
    assert bits(*read(bag)) == bits(*read(converted)) == plain


def test_files_of_two_drives_are_two_and_a_missing_one_is_said(tmp_path: Path):
    """Trials one after the other in a folder are not one; files between which one is missing look like it."""
    for number, begin in ((0, 100.0), (1, 200.0), (2, 209.0)):
        write(tmp_path / f"trial_{number}.mcap", walk(begin))
    damage = Damage()
    assert [len(one) for one in find_recordings([tmp_path], damage)] == [1, 1, 1]
    (line,) = damage.warnings
    assert "trial_2.mcap begins 5.00 s after trial_1.mcap ends" in line


def test_a_recording_that_was_cut_short_gives_its_whole_chunks_and_a_warning(tmp_path: Path):
    whole = write(tmp_path / "a.mcap", walk(), chunk=2000)
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    damage = Damage(skip=True)
    (track,) = read(cut, damage=damage)
    assert 10 < len(track.times) < 81
    assert bits(track)[0] == bits(*read(whole))[0][: 8 * len(track.times)]
    assert damage.lines == [f"{cut}: it is cut short; what is whole of it is read"]
    cut.write_bytes(whole.read_bytes()[:60])
    with pytest.raises(UsageError, match=f"what is whole of it is read: nothing of {USER}"):
        read(cut)


def test_objects_come_from_the_sensor_into_the_map(tmp_path: Path):
    path = write(tmp_path / "a.mcap", drive())
    user, car = read(path, "/tracks:42", "/tf:base_link", map_frame="map")
    for track, place in ((user, walker_at), (car, lambda time: car_at(time)[:2])):
        wanted = np.array([place(track.origin + time) for time in track.times.tolist()])
        assert len(wanted) == 121
        assert track.places == pytest.approx(wanted, abs=1e-6)
    (alone,) = read(path, "/tf:base_link")
    assert (alone.frame, bits(alone)) == ("map", bits(car))  # in the highest frame above it


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    link=st.sampled_from(["odom", "base_link"]),
    begin=st.integers(1, 60),
    length=st.integers(1, 40),
    longest=st.sampled_from([0.3, 0.5, 1.0]),
)
def test_any_hole_in_a_transform_longer_than_the_limit_is_found(tmp_path, link, begin, length, longest):
    def lacking() -> Iterator[Sent]:
        for one in drive():
            tick = round((one.time - 100.0) * 20)
            names = [each.child_frame_id for each in one.message.transforms] if one.topic == "/tf" else []
            if not (names == [link] and begin <= tick < begin + length):
                yield one

    path = write(tmp_path / "a.mcap", lacking())
    for name in ("/tracks:42", "/tf:base_link"):
        if link == "base_link" and name.startswith("/tf"):
            continue  # its own samples are those that are missing: a gap of its own
        (track,) = read(path, name, map_frame="map", longest_gap=longest)
        hole = (length + 1) / 20.0
        gap = float(np.diff(track.times).max())
        assert gap == pytest.approx(hole if hole > longest + 1e-9 else 0.05)
        assert (f"nothing says how '{link}' lies in " in track.gap(longest)) == (hole > longest + 1e-9)


def test_frames_that_nobody_asks_for_spoil_nothing(tmp_path: Path):
    """A wheel that is no number is in `drive`; a box hangs on two frames one after the other."""
    box = [transform(100.0 + k / 20, "base_link" if k < 60 else "map", "box", 0.1, 0.0, 0.0) for k in range(121)]
    plain, more = write(tmp_path / "a.mcap", drive()), write(tmp_path / "b.mcap", [*drive(), *box])
    assert bits(*read(plain, "/tf:base_link")) == bits(*read(more, "/tf:base_link"))
    (track,) = read(more, "/tf:box", map_frame="map")
    assert track.places[-1] == pytest.approx([0.1, 0.0])
    assert track.places[0] == pytest.approx([0.0, -24.9], abs=1e-6)


@pytest.mark.parametrize(
    ("more", "says"),
    [
        (lambda time: [fixed(transform(time, "map", "odom", 9.0, 0.0, 0.0))], "to be fixed (/tf_static) and to move"),
        (lambda time: [transform(time + 0.001, "map", "odom", 5.0, -1.7, 0.4)], "leaps to and fro by 0.3 m"),
        (lambda time: [transform(time, "map", "odom", 5.0, -1.7, 0.4)], "leaps to and fro by 0.3 m"),
    ],
    ids=["fixed and moving", "two publishers", "two publishers at one time"],
)
def test_a_frame_that_is_said_in_two_ways_is_refused(tmp_path: Path, more: Any, says: str):
    sent = [*drive(), *(each for tick in range(121) for each in more(100.0 + tick / 20))]
    with refused(says):
        read(write(tmp_path / "a.mcap", sent), "/tf:base_link", map_frame="map")


@pytest.mark.parametrize(
    ("sent", "count", "says"),
    [
        ([one._replace(message=walking(0.0, 0.05 * n).message) for n, one in enumerate(walk())], 81,
         "the stamps of 81 of 81 messages are 0 (not filled in): the recorder's times are taken"),
        ([walking(0.0, -3.2), walking(0.0, -3.1), *walk()], 81,
         "the stamps of 2 of 83 messages are 0 (before the clock began): left out"),
        ([walking(100.0 + n / 20, math.nan if n < 5 else 0.05 * n) for n in range(81)], 76,
         "5 of 81 positions are no numbers (the first at 100.00 s): left out"),
    ],
    ids=["none", "before the clock", "no numbers"],
)  # fmt: skip
def test_stamps_and_places_of_no_use_are_counted(tmp_path: Path, sent: list[Sent], count: int, says: str):
    damage = Damage(skip=True)
    (track,) = read(write(tmp_path / "a.mcap", sent), damage=damage)
    assert len(track.times) == count
    assert says in damage.lines[0]


@pytest.mark.parametrize(
    ("sent", "name", "says"),
    [
        ([walking(100.0 + n / 20, 0.05 * n, stamp=100.0 + n // 2 / 10) for n in range(80)], USER,
         "the stamp 100.00 s is there twice, with places 0.05 m apart (40 of 80 messages repeat one)"),
        ([detected(100.0 + n / 20, [("", 0.0, n), ("", 5.0, n)]) for n in range(9)], "/tracks",
         "several objects of one message have the id ''"),
        ([*walk(), *(one._replace(late=50.0) for one in walk(rate=10.0))], USER,
         "the clock goes back from 104.00 to 100.00 s"),
        (list(drive()), "/tracks", "several objects; it has 42, 7: name one as /tracks:ID"),
        (list(drive()), "/tracks:43", "several objects; it has 42, 7"),
        (list(drive()), "/nothing", "has no message on /nothing; it has"),
        (list(drive()), "/tf:axle", "/tf has no frame 'axle' but 'base_link', 'lidar'"),
        (walk()[:1], USER, "1 position; a track has at least two"),
    ],
    ids=["slow clock", "no ids", "two drives", "no id", "another id", "another topic", "another frame", "one message"],
)  # fmt: skip
def test_tracks_that_a_recording_does_not_say_are_refused_with_the_cause(tmp_path, sent, name, says):
    with refused(says):
        read(write(tmp_path / "a.mcap", sent), name)


def test_a_listing_names_everything_that_a_recording_holds(tmp_path: Path):
    costmap = Sent("/costmap", "std_msgs/msg/String", 100.0, made("std_msgs/msg/String", data="x"))
    path = write(tmp_path / "a.mcap", [costmap, *drive(), *walk()])
    found = {one.name: one.as_dict() for one in bag_listing([path], Damage())}
    assert set(found) == {"/costmap", USER, "/tracks:42", "/tracks:7", *(f"/tf:{name}" for name in ("lidar", "odom",
                          "base_link", "wheel"))}  # fmt: skip
    one = found[USER]
    assert (one["count"], one["gaps"], one["begins"], one["ends"], one["frame"]) == (81, 0, 100.0, 104.0, "odom")
    assert one["rate"] == pytest.approx(20.0)
    assert found["/costmap"]["why"] == "of a type that is not read"
    assert found["/tf:lidar"]["form"] == "a fixed frame"
