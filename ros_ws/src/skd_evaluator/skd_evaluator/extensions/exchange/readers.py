"""Finds tracks in files of other tools: OpenSCENARIO, CommonRoad, OSI, csv, inD and rounD, and recordings of ROS.

Each reader returns every object that a file has: its track, or why it is not read. The layout of inD (Bock et al. 2020)
and rounD (Krajewski et al. 2020): NN_tracks.csv with trackId, frame, xCenter, yCenter (m) for each object and frame,
NN_tracksMeta.csv with the class of each track, and NN_recordingMeta.csv with frameRate (1/s). Such files have millions
of rows: of these only the requested tracks are kept.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
from skd_adversary.safe_trajectories.recordings import csv_rows, header_of
from skd_sim.errors import UsageError
from skd_sim.inputs.files import finite_number, is_there, read_json, read_xml
from skd_sim.inputs.yaml_file import short
from skd_sim.scenario.road_user import ROAD_USERS
from skd_sim.world.episode import Mode

from skd_evaluator.bags import tracks
from skd_evaluator.bags.checks import Damage
from skd_evaluator.bags.files import STORAGES, find_recordings, is_recording, joined, name_of
from skd_evaluator.bags.messages import read_messages
from skd_evaluator.bags.read import ADVERSARY as ADVERSARY_TOPIC
from skd_evaluator.bags.read import CAR as CAR_TOPIC
from skd_evaluator.bags.tracks import LONGEST_GAP, TF, Listed, Track, listed, track_or_why
from skd_evaluator.extensions.exchange.openscenario import OPENSCENARIO, STANDS, read_openscenario
from skd_evaluator.extensions.exchange.osi import SCHEMA, TRACE, read_osi
from skd_evaluator.extensions.exchange.scene import ADVERSARY, ADVERSARY_ID, EGO, EGO_ID, EXPORT

_SUFFIXES = (".xosc", ".xml", ".csv", TRACE)
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
        tf: topic of a bag's transforms.
        longest_gap: time over which nothing is filled in, s.
        begin: time on the file's clock before which nothing is taken, s; None: none.
        end: the same at the end.
    """

    road_user: str | None = None
    car: str | None = None
    kind: str = "pedestrian"
    needs_car: bool = False
    map_frame: str | None = None
    tf: str = TF
    longest_gap: float = LONGEST_GAP
    begin: float | None = None
    end: float | None = None


@dataclass(frozen=True, eq=False)
class TrackSource:
    """A road user's track that was found in a file.

    Attributes:
        stem: name for its file, without ending.
        path: where it was found.
        format: what the file is.
        found: the road user: its track, or why there is none.
        car: the car; None where it is not needed.
    """

    stem: str
    path: Path
    format: str
    found: Track | Listed
    car: Track | None


def files_in(paths: Sequence[Path], damage: Damage) -> tuple[list[list[Path]], list[Path]]:
    """Return what holds tracks, each as its files (of one recording several), of a folder by name; and those left out.

    Of a folder that `skd export` has written only safe trajectories are taken, by its export.json.

    Args:
        paths: files, bags' folders, or folders of them.
        damage: takes note of what is missing.

    Raises:
        UsageError: a path is not there, or a folder has no such file.
    """
    single: list[list[Path]] = []
    recordings: list[Path] = []
    left_out: list[Path] = []
    for path in paths:
        if not is_there(path):
            raise UsageError(f"{path}: no such file or folder")
        inside = path.is_dir() and not is_recording(path)
        files = sorted(one for one in path.iterdir() if _has_tracks(one)) if inside else [path]
        if not files:
            read = f"{', '.join(_SUFFIXES)}, or is a recording"
            raise UsageError(f"{path}: no file in it ends in {read} (ros2 bag record, or skd export, makes some)")
        for one in files:
            if not _is_safe(one):
                if not inside:
                    raise UsageError(f"{one}: {EXPORT} beside it says that it is no safe trajectory; give one of its φ")
                left_out.append(one)
            elif one.is_dir():
                single += find_recordings([one], damage)
            elif is_recording(one):
                recordings.append(one)
            else:
                single.append([one])
    return [*joined(list(dict.fromkeys(recordings)), damage), *single], left_out


def _has_tracks(path: Path) -> bool:
    if path.name.startswith("."):
        return False
    is_table = path.suffix.lower() in _SUFFIXES and not path.name.endswith((_META, _RECORDING)) and path.is_file()
    return is_table or is_recording(path)


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


def listing(files: Sequence[Path], damage: Damage, topics: Collection[str] = ()) -> list[Listed]:
    """Return what a file, or the files of a recording, hold: every object, whether read or not.

    Args:
        files: as `files_in` returns them.
        damage: takes note of what is left out.
        topics: only these of a recording; empty: all.
    """
    if is_recording(files[0]) and not _is_osi(files[0]):
        return tracks.bag_listing(files, damage, topics)
    _, found, _ = _objects_in(files[0], ImportRequest(), damage, every=True)
    return [Listed.of(one) if isinstance(one, Track) else one for one in found]


def read_sources(files: Sequence[Path], request: ImportRequest, damage: Damage | None = None) -> list[TrackSource]:
    """Return the requested tracks of a file, or of the files of one recording.

    Args:
        files: as `files_in` returns them.
        request: whose tracks.
        damage: takes note of what is left out; by default that is refused.

    Raises:
        UsageError: it cannot be read, is of no known format, or lacks a requested track.
    """
    path, damage = files[0], damage or Damage()
    if is_recording(path) and not _is_osi(path):
        return [_from_recording(files, request, damage)]
    form, found, usual = _objects_in(path, request, damage)
    ends = request.begin, request.end
    if form == LEVELX and request.road_user is None:
        if request.needs_car:
            raise UsageError(f"{path}: --frame car needs one --road-user and one --car of its tracks")
        found = [
            one if isinstance(one, Listed) else track_or_why(one.where, one.name, one.form, one.cut, *ends)
            for one in found
        ]
        return [TrackSource(f"{path.stem}_{one.name}", path, form, one, None) for one in found]
    others = [one for one in found if one.name != usual[0]] if request.road_user is None else found
    if found and not others:
        raise UsageError(f"{path}: has no object but {usual[0]!r}, the car: name one by --road-user")
    user = _one_of(others, request.road_user, usual[1], "--road-user", path)
    car = _one_of(found, request.car or usual[0], usual[0], "--car", path) if request.needs_car else None
    return [TrackSource(_OSI_NAME.sub("", path.stem), path, form, user.cut(*ends), car and car.cut(*ends))]


def _objects_in(
    path: Path, request: ImportRequest, damage: Damage, *, every: bool = False
) -> tuple[str, list[Track | Listed], tuple[str, str]]:
    """Return what a file is, its objects, and the usual names of car and road user."""
    suffix, usual = path.suffix.lower(), (EGO, ADVERSARY)
    if suffix == TRACE or is_recording(path):
        return "OSI ground truth", read_osi(path, damage), usual
    if suffix == ".csv":
        form, found = _read_table(path, request, every=every)
        return form, found, (tracks.TABLE_CAR, tracks.TABLE_OTHER)
    if suffix not in (".xosc", ".xml"):
        raise UsageError(f"{path}: is of no format that is read; files end in {', '.join((*_SUFFIXES, *STORAGES))}")
    root = read_xml(path)
    if root.tag == OPENSCENARIO:
        return "OpenSCENARIO XML", read_openscenario(root, path), usual
    if root.tag == COMMONROAD:
        return "CommonRoad XML", read_commonroad(root, str(path)), (str(EGO_ID), str(ADVERSARY_ID))
    raise UsageError(f"{path}: its root is {root.tag[:40]!r}; read are {OPENSCENARIO} and {COMMONROAD}")


def _one_of(found: Sequence[Track | Listed], name: str | None, usual: str, option: str, path: Path) -> Track:
    """Return the track with a name; without one the usual one, else the only one there is."""
    read = {one.name: one for one in found if isinstance(one, Track)}
    known = {one.name: one for one in found if name is not None or one.form != STANDS}
    if name is not None and name not in known:
        raise UsageError(f"{path}: has no {name!r}; it has {listed(known)}: name one by {option}")
    if name is None and usual not in known and len(read) != 1:
        why = "; ".join(f"{one.name!r} ({one.form}): {one.why}" for one in found[:3] if isinstance(one, Listed))
        none = f"no object whose track is read: {why}"
        raise UsageError(f"{path}: has {none if found and not read else f'{listed(read)}: name one by {option}'}")
    one = known.get(usual if name is None else name) or next(iter(read.values()))
    if isinstance(one, Listed):
        raise UsageError(f"{path}, {one.name}: {one.why}")
    return one


def _is_osi(path: Path) -> bool:
    """Return whether an MCAP file holds ground truth of OSI, by the type of its first message."""
    if path.is_dir() or path.suffix.lower() != ".mcap":
        return False
    first = next(read_messages(path, lambda _topic: True, Damage(skip=True)), None)
    return first is not None and first.type == SCHEMA


def _from_recording(files: Sequence[Path], request: ImportRequest, damage: Damage) -> TrackSource:
    user, car = request.road_user or ADVERSARY_TOPIC, request.car or CAR_TOPIC
    path = files[0] if len(files) == 1 else files[0].parent
    names = [user, car] if request.needs_car else [user]
    gap, tf = request.longest_gap, request.tf
    found = tracks.bag_tracks(files, names, request.map_frame, longest_gap=gap, tf=tf, damage=damage)
    tracks.one_frame(path, *found.values())
    cut = {name: one.cut(request.begin, request.end) for name, one in found.items()}
    return TrackSource(name_of(files), path, "a bag of ROS", cut[user], cut[car] if request.needs_car else None)


# --- csv

LEVELX = "tracks in the layout of inD and rounD"
_TRACKS, _META, _RECORDING = "_tracks.csv", "_tracksMeta.csv", "_recordingMeta.csv"
_TIMED, _NAMED, _FRAMED = ("t", "x", "y"), ("t", "id", "x", "y"), ("trackId", "frame", "xCenter", "yCenter")


def _read_table(path: Path, request: ImportRequest, *, every: bool) -> tuple[str, list[Track | Listed]]:
    """Return what a csv file is, and its tracks."""
    names = [one for one in (request.road_user, request.car) if one] if request.road_user else []
    header = header_of(path)
    if set(_FRAMED) <= set(header):
        return LEVELX, _levelx(path, names, None if every else request.kind)
    if set(_NAMED) <= set(header):
        return "a table of tracked objects", list(tracks.table_tracks(path, names).values())
    if set(_TIMED) <= set(header):
        rows = [row for _, _, row in csv_rows(path, _TIMED, ())]
        return "a track (t, x, y)", [Track.of_rows(rows, f"{path}, {path.stem}", path.stem, form="t, x, y")]
    layouts = " or ".join(map(",".join, (_TIMED, _NAMED, _FRAMED)))
    raise UsageError(f"{path}, line 1: the header must name {layouts}, got {short(','.join(header))}")


def _levelx(path: Path, names: Collection[str], kind: str | None) -> list[Track | Listed]:
    rate, classes = _rate(path), _classes(path)
    chosen = set(names) or set(classes)
    if missing := sorted(chosen - set(classes)):
        raise UsageError(f"{path}: has no track {listed(missing)}; its tracks are {listed(classes)}")
    if not names and kind is not None:
        word = ROAD_USERS.find(kind).names.get("levelxdata")
        chosen = {name for name, one in classes.items() if one == word}
        if not chosen:
            raise UsageError(f"{path}: has no {word or kind}; it has {listed(sorted(set(classes.values())))}")
    kept: dict[str, list[tuple[float, float, float]]] = {}
    for _, (name,), (frame, x, y) in csv_rows(path, ("frame", "xCenter", "yCenter"), ("trackId",)):
        if name in chosen:
            kept.setdefault(name, []).append((frame / rate, x, y))
    if not kept:
        raise UsageError(f"{path}: has no row of track {listed(sorted(chosen))}")
    found = []
    for name, rows in kept.items():
        where = f"{path}, {name}"
        found.append(track_or_why(where, name, "frames", Track.of_rows, rows, where, name, classes[name], "frames"))
    return found


def _rate(path: Path) -> float:
    """Return the frames per second of a recording."""
    beside = _beside(path, _RECORDING)
    for _, _, (rate,) in csv_rows(beside, ("frameRate",), ()):
        if not 1.0 <= rate <= 1000.0:
            raise UsageError(f"{beside}: frameRate must be from 1 to 1000 1/s, got {rate:g}")
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


# --- CommonRoad

COMMONROAD = "commonRoad"


def read_commonroad(root: Element, where: str) -> list[Track | Listed]:
    """Return every dynamic obstacle, of versions 2018b and 2020a, at its places, which are the middle of its shape.

    Args:
        root: root of the document.
        where: name of the file, for messages.

    Raises:
        UsageError: the time step is none.
    """
    step = finite_number(root.get("timeStepSize", ""), f"{where}: timeStepSize")
    if not 0.0 < step < 1e3:
        raise UsageError(f"{where}: timeStepSize must be above 0 s, got {step:g}")
    dynamic = root.findall("dynamicObstacle")
    dynamic += [one for one in root.findall("obstacle") if (one.findtext("role") or "").strip() == "dynamic"]
    names, found = [one.get("id", "") for one in dynamic], []
    for one, name in zip(dynamic, names, strict=True):
        here = f"{where}, obstacle {name}"
        found.append(track_or_why(here, name, _form(one), _obstacle, one, name, names.count(name), step, here))
    return found


def _form(obstacle: Element) -> str:
    """Return how an obstacle says where it is."""
    known = ("trajectory", "occupancySet", "setBasedPrediction", "probabilityDistribution", "hypothesisPrediction")
    return next((one for one in known if obstacle.find(one) is not None), "an initial state alone")


def _obstacle(obstacle: Element, name: str, count: int, step: float, here: str) -> Track:
    if count > 1:
        raise UsageError(f"{here}: {count} obstacles have this id; give a file in which each has its own")
    first, rest = obstacle.find("initialState"), obstacle.findall("trajectory/state")
    if first is None or not rest:
        raise UsageError(f"{here}: has {_form(obstacle)}, which is not read; read are trajectories")
    rows = np.array([_state(one, here) for one in (first, *rest)], np.float64) * [step, 1.0, 1.0]
    return Track.of_rows(rows, here, name, (obstacle.findtext("type") or "").strip(), _form(obstacle))


def _state(state: Element, where: str) -> tuple[float, float, float]:
    values = []
    for path in ("time/exact", "position/point/x", "position/point/y"):
        said = state.findtext(path)
        if said is None:
            raise UsageError(f"{where}: a state has no {path}; sets of places or times are not read")
        values.append(finite_number(said.strip(), f"{where}: {path}"))
    tick, x, y = values
    return tick, x, y
