"""ASAM OSI ground truth in MCAP, and in traces: reads tracks of moving objects and writes episodes.

OSI's reference point of an object is the middle of its bounding box. Metadata of file and channel are those that the
standard asks for or recommends ("OSI multi channel trace file format", OSI 3.8); so is the file's name. ASAM's own
libraries, the optional extra `exchange`, are imported when OSI is asked for.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.errors import UsageError
from skd_sim.inputs.files import one_line, open_regular
from skd_sim.start import installing

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


def _protobuf() -> str:
    """Return the version of protobuf that messages are written with."""
    return str(_found("google.protobuf").__version__)


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
    found, form = [], "moving object"
    for number, states in rows.items():
        name, where, times = roles[number], f"{path}, {roles[number]}", [one[0] for one in states]
        given = states, where, name, kinds[number], form
        found.append(track_or_why(where, name, form, Track.of_rows, *given, times=times))
    return found


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
    versions = "".join(map(str, _version())), _protobuf().replace(".", "")
    frames = max(len(one.times) for one in recorded.actors)
    return f"{stamp}_gt_{versions[0]}_{versions[1]}_{frames}_{recorded.stem}.mcap"


def write_osi(path: Path, recorded: ExportedEpisode) -> None:
    """Write an episode.

    Raises:
        OSError: it cannot be written.
    """
    version, protobuf = ".".join(map(str, _version())), _protobuf()
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
    kind = _ground_truth()
    standing = kind()
    standing.version.version_major, standing.version.version_minor, standing.version.version_patch = _version()
    standing.map_reference = ROAD_FILE
    if recorded.ego is not None:
        standing.host_vehicle_id.value = EGO_ID
    _add_lanes(standing, recorded)
    for actor in recorded.actors:
        if actor.is_obstacle:
            found = standing.stationary_object.add()
            found.id.value = actor.number
            found.classification.type = found.classification.TYPE_OTHER
            x, y = actor.centres[0].tolist()
            _set_base(found.base, actor, x, y, float(actor.states[0, 2]))
            _say_role(found, actor)
    users = [one for one in recorded.actors if not one.is_obstacle]
    times = max((one.times for one in users), key=len)
    every = [(one, *_motion(one, times)) for one in users]
    messages = []
    for row, time in enumerate(times.tolist()):
        message = kind()
        message.CopyFrom(standing)
        nanoseconds = round(time * 1e9)
        message.timestamp.seconds, message.timestamp.nanos = divmod(nanoseconds, 1_000_000_000)
        for actor, states, motion in every:
            _add_user(message, actor, states[row], motion[row])
        messages.append(message)
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


def _add_user(message: Any, actor: Actor, state: FloatArray, motion: FloatArray) -> None:
    found = message.moving_object.add()
    found.id.value = actor.number
    x, y, heading = state.tolist()
    _set_base(found.base, actor, x, y, heading)
    _set(found.base.velocity, *motion[:2].tolist(), 0.0)
    _set(found.base.acceleration, *motion[2:4].tolist(), 0.0)
    _set(found.base.orientation_rate, 0.0, 0.0, float(motion[4]), names=_TURNS)
    word = actor.word(_FORMAT)
    if word == _ON_FOOT:
        found.type = found.TYPE_PEDESTRIAN
    else:
        found.type, wheel, (length, _, height) = found.TYPE_VEHICLE, 0.3, actor.size
        found.vehicle_classification.type = found.vehicle_classification.Type.Value(word)
        _set(found.vehicle_attributes.bbcenter_to_rear, -0.3 * length, 0.0, wheel - 0.5 * height)
        found.vehicle_attributes.radius_wheel = wheel
    _say_role(found, actor)


_TURNS = "roll", "pitch", "yaw"


def _set(vector: Any, *values: float, names: Sequence[str] = "xyz") -> None:
    """Set the fields of a vector."""
    for name, value in zip(names, values, strict=True):
        setattr(vector, name, value)


def _set_base(base: Any, actor: Actor, x: float, y: float, heading: float) -> None:
    _set(base.dimension, *actor.size, names=("length", "width", "height"))
    _set(base.position, x, y, 0.5 * actor.size[2])
    _set(base.orientation, 0.0, 0.0, math.remainder(heading, math.tau), names=_TURNS)


def _say_role(found: Any, actor: Actor) -> None:
    said = found.source_reference.add()
    said.type = SOURCE
    said.identifier.append(actor.name)
    if actor.body is not None:
        said.identifier.append(actor.body.kind)


def _add_lanes(message: Any, recorded: ExportedEpisode) -> None:
    """Add the lanes, each between two boundaries of its own, as long as the episode needs them."""
    every = lanes_of(recorded)
    ids = {lane.number: _FIRST_LANE + index for index, lane in enumerate(every)}
    for index, lane in enumerate(every):
        found = message.lane.add()
        found.id.value = ids[lane.number]
        said = found.classification
        said.type, said.subtype = said.TYPE_DRIVING, said.SUBTYPE_NORMAL
        said.is_host_vehicle_lane, said.centerline_is_driving_direction = lane.number == 0, True
        for x, y in (0.5 * (lane.left + lane.right)).tolist():
            said.centerline.add(x=x, y=y, z=0.0)
        sides = (lane.left, said.left_lane_boundary_id), (lane.right, said.right_lane_boundary_id)
        for place, (edge, edge_ids) in enumerate(sides):
            boundary = message.lane_boundary.add()
            boundary.id.value = _FIRST_BOUNDARY + 2 * index + place
            edge_ids.add().value = boundary.id.value
            boundary.classification.type = boundary.classification.TYPE_SOLID_LINE
            boundary.classification.color = boundary.classification.COLOR_WHITE
            for x, y in edge.tolist():
                _set(boundary.boundary_line.add().position, x, y, 0.0)
        adjacent = said.left_adjacent_lane_id, said.right_adjacent_lane_id
        for other, those in zip(lane.beside, adjacent, strict=True):
            if other is not None:
                those.add().value = ids[other]
