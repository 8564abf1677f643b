"""Finds tracks in files of others: OpenSCENARIO, CommonRoad, OSI, csv, inD and rounD, and bags of ROS 2.

The layout of inD (Bock et al. 2020) and rounD (Krajewski et al. 2020): NN_tracks.csv with trackId, frame, xCenter,
yCenter (m) for each object and frame, NN_tracksMeta.csv with the class of each track, and NN_recordingMeta.csv with
frameRate (1/s). Such files have millions of rows: of these only the requested tracks are kept.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
from skd_sim.errors import UsageError
from skd_sim.inputs.files import finite_number, is_there, read_json, read_xml
from skd_sim.scenario.road_user import ROAD_USERS
from skd_sim.world.episode import Mode

from skd_evaluator.bags.checks import METADATA
from skd_evaluator.bags.mcap_file import Condition, read_messages
from skd_evaluator.bags.read import ADVERSARY as ADVERSARY_TOPIC
from skd_evaluator.bags.read import CAR as CAR_TOPIC
from skd_evaluator.bags.tracks import (
    TABLE_CAR,
    TABLE_OTHER,
    Track,
    bag_tracks,
    csv_rows,
    header_of,
    listed,
    table_tracks,
)
from skd_evaluator.extensions.exchange.osi import SCHEMA, read_osi
from skd_evaluator.extensions.exchange.scene import ADVERSARY, ADVERSARY_ID, EGO, EGO_ID, EXPORT

_SUFFIXES = (".xosc", ".xml", ".csv", ".mcap")
_OSI_NAME = re.compile(r"\d{8}T\d{6}Z?_[a-z]+_\d+_\d+_\d+_")


@dataclass(frozen=True)
class ImportRequest:
    """Whose tracks are to be read.

    Attributes:
        road_user: name of the road user; None: the usual one, or every track of a kind.
        car: name of the car; None: the usual one, if it is needed.
        kind: kind of road user, where a file has many.
        needs_car: whether the car's track is needed.
        map_frame: frame in which tracks of bags are taken.
    """

    road_user: str | None = None
    car: str | None = None
    kind: str = "pedestrian"
    needs_car: bool = False
    map_frame: str | None = None


@dataclass(frozen=True, eq=False)
class TrackSource:
    """A road user's track that was found in a file.

    Attributes:
        stem: name for its file, without ending.
        path: where it was found.
        format: what the file is.
        found: the road user.
        car: the car; None where it is not needed.
    """

    stem: str
    path: Path
    format: str
    found: Track
    car: Track | None


def files_in(paths: Sequence[Path]) -> tuple[list[Path], list[Path]]:
    """Return the files and folders of bags that hold tracks, of a folder those in it by name; and those left out.

    Of a folder that `skd export` has written only safe trajectories are taken, by its export.json.

    Raises:
        UsageError: a path is not there, or a folder has no such file.
    """
    found: list[Path] = []
    left_out: list[Path] = []
    for path in paths:
        if not is_there(path):
            raise UsageError(f"{path}: no such file or folder")
        if not path.is_dir() or (path / METADATA).exists():
            if not _is_safe(path):
                raise UsageError(f"{path}: {EXPORT} beside it says that it is no safe trajectory; give one of its φ")
            found.append(path)
            continue
        files = sorted(one for one in path.iterdir() if not one.name.startswith(".") and _has_tracks(one))
        if not files:
            raise UsageError(f"{path}: no file in it ends in {', '.join(_SUFFIXES)}, and none is a bag's folder")
        found += [one for one in files if _is_safe(one)]
        left_out += [one for one in files if not _is_safe(one)]
    return found, left_out


def _has_tracks(path: Path) -> bool:
    if path.is_dir():
        return (path / METADATA).exists()
    return path.suffix.lower() in _SUFFIXES and not path.name.endswith((_META, _RECORDING)) and path.is_file()


def _is_safe(path: Path) -> bool:
    """Return whether a file is no export, or by export.json beside it a safe trajectory."""
    export = path.parent / EXPORT
    if not is_there(export):
        return True
    content = read_json(export)
    try:
        return path.name in {one["file"] for one in content["files"] if one["mode"] == Mode.SAFE.name.lower()}
    except (KeyError, TypeError) as error:
        raise UsageError(f"{export}: is not of skd export") from error


def read_sources(path: Path, request: ImportRequest) -> list[TrackSource]:
    """Return the requested tracks of a file or a bag's folder.

    Raises:
        UsageError: it cannot be read, is of no known format, or lacks a requested track.
    """
    suffix, usual = path.suffix.lower(), (EGO, ADVERSARY)
    if path.is_dir() or suffix == ".mcap":
        if not _is_osi(path):
            return [_from_bag(path, request)]
        kind, found = "OSI ground truth", read_osi(path)
    elif suffix == ".csv":
        kind, found = _read_table(path, request)
        usual = TABLE_CAR, TABLE_OTHER
        if request.road_user is None and any(one.kind for one in found):
            if request.needs_car:
                raise UsageError(f"{path}: --frame car needs one --road-user and one --car of its tracks")
            return [TrackSource(f"{path.stem}_{one.name}", path, kind, one, None) for one in found]
    else:
        root = read_xml(path)
        if root.tag == OPENSCENARIO:
            kind, found = "OpenSCENARIO XML", read_openscenario(root, str(path))
        elif root.tag == COMMONROAD:
            kind, found = "CommonRoad XML", read_commonroad(root, str(path))
            usual = str(EGO_ID), str(ADVERSARY_ID)
        else:
            raise UsageError(f"{path}: its root is {root.tag[:40]!r}; read are {OPENSCENARIO} and {COMMONROAD}")
    others = [one for one in found if one.name != usual[0]] if request.road_user is None else found
    user = _one_of(others, request.road_user, usual[1], "--road-user", path)
    car = _one_of(found, request.car or usual[0], usual[0], "--car", path) if request.needs_car else None
    return [TrackSource(_OSI_NAME.sub("", path.stem), path, kind, user, car)]


def _one_of(found: Sequence[Track], name: str | None, usual: str, option: str, path: Path) -> Track:
    """Return the track with a name; without one the usual one, else the only one there is."""
    known = {one.name: one for one in found}
    if name is not None and name not in known:
        raise UsageError(f"{path}: has no {name!r} that moves; it has {listed(known)}: name one by {option}")
    if name is None and usual not in known and len(known) != 1:
        raise UsageError(f"{path}: has {listed(known)}: name one by {option}")
    return known.get(usual if name is None else name) or found[0]


def _is_osi(path: Path) -> bool:
    """Return whether an MCAP file holds ground truth of OSI, by the type of its first message."""
    if path.is_dir():
        return False
    first = next(read_messages(path, lambda _topic: True, Condition()), None)
    return first is not None and first.schema.name == SCHEMA


def _from_bag(path: Path, request: ImportRequest) -> TrackSource:
    user, car = request.road_user or ADVERSARY_TOPIC, request.car or CAR_TOPIC
    tracks = bag_tracks(path, [user, car] if request.needs_car else [user], request.map_frame)
    if request.needs_car and tracks[user].frame != tracks[car].frame:
        raise UsageError(
            f"{path}: {user} in {tracks[user].frame!r} and {car} in {tracks[car].frame!r}: two frames; give "
            "--map-frame, if /tf was recorded"
        )
    return TrackSource(path.stem, path, "a bag of ROS 2", tracks[user], tracks[car] if request.needs_car else None)


# --- csv

_TRACKS, _META, _RECORDING = "_tracks.csv", "_tracksMeta.csv", "_recordingMeta.csv"
_TIMED, _NAMED, _FRAMED = ("t", "x", "y"), ("t", "id", "x", "y"), ("trackId", "frame", "xCenter", "yCenter")


def _read_table(path: Path, request: ImportRequest) -> tuple[str, list[Track]]:
    """Return what a csv file is, and its tracks."""
    names = [one for one in (request.road_user, request.car) if one] if request.road_user else []
    header = header_of(path)
    if set(_FRAMED) <= set(header):
        return "tracks in the layout of inD and rounD", _levelx(path, names, request.kind)
    if set(_NAMED) <= set(header):
        return "a table of tracked objects", list(table_tracks(path, names).values())
    if set(_TIMED) <= set(header):
        rows = [row for _, _, row in csv_rows(path, _TIMED, ())]
        return "a track (t, x, y)", [Track.of_rows(rows, f"{path}, {path.stem}", path.stem)]
    raise UsageError(
        f"{path}, line 1: the header must name {','.join(_TIMED)} or {','.join(_NAMED)} or {','.join(_FRAMED)}, got "
        f"{' '.join(','.join(header).split())[:160] or 'nothing'}"
    )


def _levelx(path: Path, names: Collection[str], kind: str) -> list[Track]:
    rate, classes = _rate(path), _classes(path)
    chosen = set(names)
    if missing := sorted(chosen - set(classes)):
        raise UsageError(f"{path}: has no track {listed(missing)}; its tracks are {listed(classes)}")
    if not chosen:
        word = ROAD_USERS.find(kind).names.get("levelxdata")
        chosen = {name for name, one in classes.items() if one == word}
        if not chosen:
            raise UsageError(f"{path}: has no {word or kind}; it has {listed(sorted(set(classes.values())))}")
    kept: dict[str, list[tuple[float, float, float]]] = {}
    for _, (name,), (frame, x, y) in csv_rows(path, ("frame", "xCenter", "yCenter"), ("trackId",)):
        if name in chosen:
            kept.setdefault(name, []).append((frame / rate, x, y))
    found = [
        Track.of_rows(rows, f"{path}, {name}", name, classes[name]) for name, rows in kept.items() if len(rows) > 1
    ]
    if not found:
        raise UsageError(f"{path}: has no row of track {listed(sorted(chosen))}")
    return found


def _rate(path: Path) -> float:
    """Return the frames per second of a recording."""
    beside = _beside(path, _RECORDING)
    for _, _, (rate,) in csv_rows(beside, ("frameRate",), ()):
        if not 0.1 <= rate <= 1000.0:
            raise UsageError(f"{beside}: frameRate must be from 0.1 to 1000 1/s, got {rate:g}")
        return rate
    raise UsageError(f"{beside}: has no row")


def _classes(path: Path) -> Mapping[str, str]:
    """Return the class of each track, by its id."""
    beside, found = _beside(path, _META), dict[str, str]()
    for _, (name, kind), _ in csv_rows(beside, (), ("trackId", "class")):
        if found.setdefault(name, kind) != kind:
            raise UsageError(f"{beside}: track {listed([name])} has two classes")
    return found


def _beside(path: Path, ending: str) -> Path:
    if not path.name.endswith(_TRACKS):
        raise UsageError(f"{path}: has columns of inD and rounD, whose files are called NN{_TRACKS}; give it that name")
    found = path.with_name(path.name.removesuffix(_TRACKS) + ending)
    if not is_there(found):
        raise UsageError(f"{path}: {found.name}, which belongs to it, is not beside it")
    return found


# --- XML

OPENSCENARIO = "OpenSCENARIO"


def read_openscenario(root: Element, where: str) -> list[Track]:
    """Return every entity that follows a polyline with times, in a position of the world at each vertex.

    Args:
        root: root of the document.
        where: name of the file, for messages.

    Raises:
        UsageError: an entity has two such ways, or begins within one, a vertex has no time or no place of the world, or
            times are not those of the simulation.
    """
    found: dict[str, Track] = {}
    kinds = {one.get("name", ""): _kind(one) for one in root.iter("ScenarioObject")}
    for names, follow in _followed(root):
        trajectory = next(iter(follow.iter("Trajectory")), None)
        line = None if trajectory is None else trajectory.find("Shape/Polyline")
        if line is None:
            continue  # a clothoid, a spline, or one of a catalogue
        for name in names:
            here = f"{where}, {name}"
            if name in found:
                raise UsageError(f"{here}: follows two polylines; give a file in which it follows one")
            rows = [_vertex(one, here) for one in line.findall("Vertex")]
            scale, offset = _timing(follow, here)
            if follow.get("initialDistanceOffset", "0").strip() not in ("0", "0.0"):
                raise UsageError(f"{here}: begins within its polyline (initialDistanceOffset), whose times do not")
            table = np.array(rows, np.float64).reshape(-1, 3) * [scale, 1.0, 1.0] + [offset, 0.0, 0.0]
            found[name] = Track.of_rows(table, here, name, kinds.get(name, ""))
    return list(found.values())


def _followed(root: Element) -> Iterator[tuple[list[str], Element]]:
    """Yield who follows which trajectory: by an event, or from the beginning."""
    for group in root.iter("ManeuverGroup"):
        names = [one.get("entityRef", "") for one in group.findall("Actors/EntityRef")]
        for follow in group.iter("FollowTrajectoryAction"):
            yield names, follow
    for private in root.iter("Private"):
        for follow in private.iter("FollowTrajectoryAction"):
            yield [private.get("entityRef", "")], follow


def _kind(entity: Element) -> str:
    """Return what an entity says it is: its own word for SKD, else its category."""
    for one in entity.iter("Property"):
        if one.get("name") == "skd.kind":
            return one.get("value", "")
    for tag, key in (("Vehicle", "vehicleCategory"), ("Pedestrian", "pedestrianCategory")):
        body = entity.find(tag)
        if body is not None:
            return body.get(key, "")
    return ""


def _vertex(vertex: Element, where: str) -> tuple[float, float, float]:
    place = vertex.find("Position/WorldPosition")
    if place is None:
        raise UsageError(
            f"{where}: a vertex is not at a WorldPosition, and nothing else says where it is without a map"
        )
    if vertex.get("time") is None:
        raise UsageError(f"{where}: a vertex has no time, so nothing says when it is there")
    time, x, y = (
        finite_number(one.get(key, ""), f"{where}: {key} of a vertex")
        for one, key in ((vertex, "time"), (place, "x"), (place, "y"))
    )
    return time, x, y


def _timing(follow: Element, where: str) -> tuple[float, float]:
    """Return scale and offset of a trajectory's times, s."""
    timing = follow.find("TimeReference/Timing")
    if timing is None:
        raise UsageError(f"{where}: its polyline is followed without times (TimeReference), so nothing says when")
    scale, offset = (finite_number(timing.get(key, ""), f"{where}: {key} of Timing") for key in ("scale", "offset"))
    if not 1e-6 < scale < 1e6:
        raise UsageError(f"{where}: scale of Timing must be above 0, got {scale:g}")
    return scale, offset


COMMONROAD = "commonRoad"


def read_commonroad(root: Element, where: str) -> list[Track]:
    """Return every dynamic obstacle that has a trajectory, at its places, which are the middle of its shape.

    Args:
        root: root of the document.
        where: name of the file, for messages.

    Raises:
        UsageError: the time step is none, two obstacles have one id, or a state has no exact time or place.
    """
    step = finite_number(root.get("timeStepSize", ""), f"{where}: timeStepSize")
    if not 0.0 < step < 1e3:
        raise UsageError(f"{where}: timeStepSize must be above 0 s, got {step:g}")
    found: dict[str, Track] = {}
    for obstacle in root.findall("dynamicObstacle"):
        name = obstacle.get("id", "")
        here = f"{where}, obstacle {name}"
        first, rest = obstacle.find("initialState"), obstacle.findall("trajectory/state")
        if first is None or not rest:
            continue  # occupancies, or nothing
        if name in found:
            raise UsageError(f"{here}: two obstacles have this id; give a file in which each has its own")
        rows = np.array([_state(one, here) for one in (first, *rest)], np.float64) * [step, 1.0, 1.0]
        found[name] = Track.of_rows(rows, here, name, (obstacle.findtext("type") or "").strip())
    return list(found.values())


def _state(state: Element, where: str) -> tuple[float, float, float]:
    values = []
    for path in ("time/exact", "position/point/x", "position/point/y"):
        said = state.findtext(path)
        if said is None:
            raise UsageError(f"{where}: a state has no {path}; sets of places or times are not read")
        values.append(finite_number(said.strip(), f"{where}: {path}"))
    tick, x, y = values
    return tick, x, y
