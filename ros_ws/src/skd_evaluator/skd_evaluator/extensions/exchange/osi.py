"""ASAM OSI ground truth in MCAP, and in traces: reads tracks of moving objects and writes episodes.

OSI's reference point of an object is the middle of its bounding box. Metadata of file and channel are those that the
standard asks for or recommends ("OSI multi channel trace file format", OSI 3.8); so is the file's name. ASAM's own
libraries, the optional extra `exchange`, are imported when OSI is requested.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from skd_sim.errors import UsageError
from skd_sim.inputs.files import one_line, open_regular
from skd_sim.start import installing
from skd_sim.world.state import FloatArray

from skd_evaluator.bags.checks import Damage
from skd_evaluator.bags.messages import read_messages
from skd_evaluator.bags.tracks import Listed, Track, listed, track_or_why
from skd_evaluator.extensions.exchange.scene import EGO, EGO_ID, ROAD_FILE, SOURCE, Actor, ExportedEpisode, lanes_of


def _version() -> tuple[int, int, int]:
    """Return the version of OSI that its messages are of."""
    module = _found("osi3.osi_version_pb2")
    said = module.DESCRIPTOR.GetOptions().Extensions[module.current_interface_version]
    return int(said.version_major), int(said.version_minor), int(said.version_patch)


def osi_writer() -> Any:
    """Return the class that writes traces as MCAP.

    Raises:
        UsageError: the library is not installed.
    """
    return _found("osi_utilities.tracefile.writers.multi").MultiTraceWriter


def _ground_truth() -> Any:
    return _found("osi3.osi_groundtruth_pb2").GroundTruth


def _found(name: str) -> Any:
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        raise UsageError(f"OSI needs osi-python and asam-osi-utilities: {installing('exchange')}") from error


SCHEMA = "osi3.GroundTruth"
TRACE = ".osi"
"""Ending of traces of one message after the other, each behind its length in four bytes."""
_NANOSECONDS = 1e-9


def read_osi(path: Path, damage: Damage | None = None) -> list[Track | Listed]:
    """Return every moving object; one that SKD has exported bears its name there, any other its id.

    Args:
        path: an MCAP file, or a trace; one of sensor views has the ground truth in them.
        damage: takes note of what of the file is damaged; by default that is refused.

    Raises:
        UsageError: the library is not installed, a message is none of ground truth, or several topics have some, whose
            ids need not be of the same objects.
    """
    _ground_truth()  # that its libraries are there
    damage = damage or Damage()
    rows: dict[int, list[tuple[float, float, float]]] = {}
    roles: dict[int, str] = {}
    kinds: dict[int, str] = {}
    for message in _trace(path, damage) if path.suffix.lower() == TRACE else _of_mcap(path, damage):
        time = message.timestamp.seconds + _NANOSECONDS * message.timestamp.nanos
        for one in message.moving_object:
            number = int(one.id.value)
            rows.setdefault(number, []).append((time, one.base.position.x, one.base.position.y))
            if number not in roles:
                roles[number] = "".join(_said(one)[:1]) or (
                    EGO if message.host_vehicle_id.value == number else str(number)
                )
                kinds[number] = _kind(one)
    if not rows:
        raise UsageError(f"{path}: has no moving object in ground truth of OSI")
    if len(set(roles.values())) < len(roles):  # two that say they are the same
        roles = {number: str(number) for number in roles}
    form = "moving object"
    return [
        track_or_why(
            where := f"{path}, {roles[number]}", roles[number], form,
            Track.of_rows, states, where, roles[number], kinds[number], form, times=[one[0] for one in states],
        )
        for number, states in rows.items()
    ]  # fmt: skip


def _of_mcap(path: Path, damage: Damage) -> Iterator[Any]:
    """Yield the ground truth of an MCAP file."""
    topics: dict[str, None] = {}
    for received in read_messages(path, lambda _topic: True, damage):
        if received.type == SCHEMA:
            topics[received.topic] = None
            if len(topics) > 1:
                raise UsageError(f"{path}: has ground truth on {listed(topics)}; give a file with one of them")
            yield _parsed(_ground_truth(), received.data, path)


def _trace(path: Path, damage: Damage) -> Iterator[Any]:
    """Yield the ground truth of a trace: of its messages, or by its name of the sensor views in it."""
    of_views = "_sv_" in path.name
    kind = _found("osi3.osi_sensorview_pb2").SensorView if of_views else _ground_truth()
    with open_regular(path) as stream:
        while prefix := stream.read(4):
            length = int.from_bytes(prefix, "little")
            data = stream.read(length)
            if len(prefix) < 4 or len(data) < length:
                damage.leave_out(f"{path}: it is cut short; what is whole of it is read")
                return
            message = _parsed(kind, data, path)
            yield message.global_ground_truth if of_views else message


def _parsed(kind: Any, data: bytes, path: Path) -> Any:
    try:
        message = kind()
        message.ParseFromString(data)
    except Exception as error:  # google.protobuf's DecodeError, and whatever damaged bytes make it raise
        what = f"a message is no {kind.DESCRIPTOR.name} of OSI"
        raise UsageError(f"{path}: {what} (traces of sensor views have _sv_ in their names)") from error
    return message


def _said(found: Any) -> list[str]:
    """Return what SKD has called an object, and its kind; empty if it has not."""
    return next((list(map(str, one.identifier)) for one in found.source_reference if one.type == SOURCE), [])


def _kind(found: Any) -> str:
    if len(said := _said(found)) > 1:
        return said[1]
    if found.type == found.TYPE_VEHICLE:
        return str(found.vehicle_classification.Type.Name(found.vehicle_classification.type))
    return str(found.Type.Name(found.type))


TOPIC = "ground_truth"
_FORMAT = "osi"
_ON_FOOT = "TYPE_PEDESTRIAN"
_FIRST_LANE, _FIRST_BOUNDARY = 10_001, 11_001


def osi_name(recorded: ExportedEpisode) -> str:
    """Return the name of an episode's file, as the standard recommends it."""
    stamp = "".join(one for one in recorded.date.partition("+")[0].rstrip("Z") if one.isalnum()) + "Z"
    versions = "".join(map(str, _version())), _found("google.protobuf").__version__.replace(".", "")
    frames = max(len(one.times) for one in recorded.actors)
    return f"{stamp}_gt_{versions[0]}_{versions[1]}_{frames}_{recorded.stem}.mcap"


def write_osi(path: Path, recorded: ExportedEpisode) -> None:
    """Write an episode.

    Raises:
        OSError: it cannot be written.
    """
    version, protobuf = ".".join(map(str, _version())), str(_found("google.protobuf").__version__)
    about = {
        **dict.fromkeys(("version", "min_osi_version", "max_osi_version"), version),
        **dict.fromkeys(("min_protobuf_version", "max_protobuf_version"), protobuf),
        "zero_time": "1970-01-01T00:00:00Z",
        "creation_time": recorded.date,
        "description": recorded.title,
        "authors": "SKD",
        "data_sources": one_line(f"SKD, scenario {recorded.scenario.name}"),
    }
    said = {"osi_version": version, "protobuf_version": protobuf, "description": "all road users and obstacles"}
    channel = {f"net.asam.osi.trace.channel.{key}": value for key, value in said.items()}
    writer = osi_writer()()
    if not writer.open(path, about):
        raise OSError(f"{path}: cannot be written")
    try:
        messages = ground_truth(recorded)
        writer.add_channel(TOPIC, type(messages[0]), channel)
        for message in messages:
            if not writer.write_message(message, TOPIC):
                raise OSError(f"{path}: cannot be written")
    finally:
        writer.close()


def ground_truth(recorded: ExportedEpisode) -> list[Any]:
    """Return the messages of an episode, in the order of their times."""
    kind, parsed = _ground_truth(), _found("google.protobuf.json_format").ParseDict
    lanes, boundaries = _lanes(recorded)
    standing = {
        "version": dict(zip(("version_major", "version_minor", "version_patch"), _version(), strict=True)),
        "map_reference": ROAD_FILE,
        "lane": lanes,
        "lane_boundary": boundaries,
        "stationary_object": [
            {**_object(one, one.centres[0], float(one.states[0, 2])), "classification": {"type": "TYPE_OTHER"}}
            for one in recorded.actors
            if one.is_obstacle
        ],
    }
    if recorded.ego is not None:
        standing["host_vehicle_id"] = {"value": EGO_ID}
    always = parsed(standing, kind())
    users = [one for one in recorded.actors if not one.is_obstacle]
    times = max((one.times for one in users), key=len)
    every = [(one, *_motion(one, times)) for one in users]
    messages = []
    for row, time in enumerate(times.tolist()):
        message = kind()
        message.CopyFrom(always)
        message.timestamp.seconds, message.timestamp.nanos = divmod(round(time * 1e9), 1_000_000_000)
        moving = [_user(actor, states[row].tolist(), motion[row].tolist()) for actor, states, motion in every]
        messages.append(parsed({"moving_object": moving}, message))
    return messages


def _motion(actor: Actor, times: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return middle of the box and heading of an actor at each time, n × 3; velocity, acceleration, turning, n × 5.

    Between two times an actor moves as it does at the first; the last acceleration is that before it.
    """
    if actor.stands:
        state = np.column_stack([actor.centres, actor.states[:, 2]])
        return np.repeat(state, len(times), axis=0), np.zeros((len(times), 5))
    heading, speed = actor.states[:, 2], actor.states[:, 3]
    velocity = speed[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])
    lasting = np.diff(times)[:, None]
    change = np.diff(np.column_stack([velocity, np.unwrap(heading)]), axis=0) / lasting
    change = np.concatenate([change, change[-1:]]) if len(change) else np.zeros((1, 3))
    return np.column_stack([actor.centres, heading]), np.column_stack([velocity, change])


def _user(actor: Actor, state: Sequence[float], motion: Sequence[float]) -> dict[str, Any]:
    """Return a moving object by rows of `_motion`."""
    found = _object(actor, state[:2], state[2])
    found["base"]["velocity"] = _vector(*motion[:2], 0.0)
    found["base"]["acceleration"] = _vector(*motion[2:4], 0.0)
    found["base"]["orientation_rate"] = _vector(0.0, 0.0, motion[4], names=_TURNS)
    word, (length, _, height), wheel = actor.word(_FORMAT), actor.size, 0.3
    if word == _ON_FOOT:
        return {**found, "type": "TYPE_PEDESTRIAN"}
    rear = _vector(-0.3 * length, 0.0, wheel - 0.5 * height)
    return {
        **found,
        "type": "TYPE_VEHICLE",
        "vehicle_classification": {"type": word},
        "vehicle_attributes": {"bbcenter_to_rear": rear, "radius_wheel": wheel},
    }


_TURNS = "roll", "pitch", "yaw"


def _vector(*values: float, names: Sequence[str] = "xyz") -> dict[str, float]:
    return dict(zip(names, values, strict=True))


def _object(actor: Actor, centre: Sequence[float] | FloatArray, heading: float) -> dict[str, Any]:
    """Return what moving and stationary objects have in common."""
    base = {
        "dimension": _vector(*actor.size, names=("length", "width", "height")),
        "position": _vector(float(centre[0]), float(centre[1]), 0.5 * actor.size[2]),
        "orientation": _vector(0.0, 0.0, math.remainder(heading, math.tau), names=_TURNS),
    }
    role = [actor.name] if actor.body is None else [actor.name, actor.body.kind]
    return {"id": {"value": actor.number}, "base": base, "source_reference": [{"type": SOURCE, "identifier": role}]}


def _lanes(recorded: ExportedEpisode) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return the lanes, each between two boundaries of its own, and these, as long as the episode needs them."""
    every, lanes, boundaries = lanes_of(recorded), [], []
    ids = {lane.number: {"value": _FIRST_LANE + index} for index, lane in enumerate(every)}
    for index, lane in enumerate(every):
        own = [{"value": _FIRST_BOUNDARY + 2 * index + place} for place in (0, 1)]
        left, right = lane.beside
        classification = {
            "type": "TYPE_DRIVING",
            "subtype": "SUBTYPE_NORMAL",
            "is_host_vehicle_lane": lane.number == 0,
            "centerline_is_driving_direction": True,
            "centerline": [_vector(x, y, 0.0) for x, y in (0.5 * (lane.left + lane.right)).tolist()],
            "left_lane_boundary_id": own[:1],
            "right_lane_boundary_id": own[1:],
            "left_adjacent_lane_id": [] if left is None else [ids[left]],
            "right_adjacent_lane_id": [] if right is None else [ids[right]],
        }
        lanes.append({"id": ids[lane.number], "classification": classification})
        line = {"type": "TYPE_SOLID_LINE", "color": "COLOR_WHITE"}
        for id_, edge in zip(own, (lane.left, lane.right), strict=True):
            points = [{"position": _vector(x, y, 0.0)} for x, y in edge.tolist()]
            boundaries.append({"id": id_, "classification": line, "boundary_line": points})
    return lanes, boundaries
