"""Which files hold ways, of which format each is, and whose way is taken out of it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from skd_sim.errors import UsageError
from skd_sim.inputs.outside import is_there, read_json, read_xml
from skd_sim.world.episode import Mode

from skd_evaluator.bags.inventory import METADATA
from skd_evaluator.bags.mcap_file import Condition, read_messages
from skd_evaluator.bags.recording import ADVERSARY as ADVERSARY_TOPIC
from skd_evaluator.bags.recording import CAR as CAR_TOPIC
from skd_evaluator.extensions.exchange.coming_in import commonroad, openscenario, osi
from skd_evaluator.extensions.exchange.coming_in.found import Found, one_of, track_of
from skd_evaluator.extensions.exchange.coming_in.tables import is_beside_tracks, read_table
from skd_evaluator.extensions.exchange.names import ADVERSARY, ADVERSARY_ID, EGO, EGO_ID, EXPORT
from skd_evaluator.extensions.fusion.bag_tracks import BagTrack, bag_tracks
from skd_evaluator.extensions.fusion.recording import TABLE_CAR, TABLE_OTHER

_SUFFIXES = (".xosc", ".xml", ".csv", ".mcap")
_OSI_NAME = re.compile(r"\d{8}T\d{6}Z?_[a-z]+_\d+_\d+_\d+_")
_XML = {
    openscenario.ROOT: (openscenario.read_openscenario, "OpenSCENARIO XML", EGO, ADVERSARY),
    commonroad.ROOT: (commonroad.read_commonroad, "CommonRoad XML", str(EGO_ID), str(ADVERSARY_ID)),
}
"""By the root element: reader, what it is, and what `skd export` calls car and adversary there."""


@dataclass(frozen=True)
class Asked:
    """Whose ways are asked for.

    Attributes:
        road_user: name of the road user; None: the usual one, or every track of a kind.
        car: name of the car; None: the usual one, if it is needed.
        kind: kind of road user, where a file has many.
        needs_car: whether the car's way is needed.
        map_frame: frame of bags in which ways are wanted.
    """

    road_user: str | None = None
    car: str | None = None
    kind: str = "pedestrian"
    needs_car: bool = False
    map_frame: str | None = None


@dataclass(frozen=True, eq=False)
class Source:
    """A way that was found in a file.

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
    found: Found
    car: Found | None


def files_in(paths: Sequence[Path]) -> tuple[list[Path], list[Path]]:
    """Return the files, and folders of bags, that hold ways, of a folder those in it, by name; and those left out.

    Of a folder that `skd export` has written only safe trajectories are taken, for its export.json says which they are.

    Raises:
        UsageError: a path is not there, or a folder has no such file.
    """
    found: list[Path] = []
    beside: list[Path] = []
    for path in paths:
        if not is_there(path):
            raise UsageError(f"{path}: no such file or folder")
        if not path.is_dir() or (path / METADATA).exists():
            kept = _safe_in_export(path.parent)
            if kept is not None and path.name not in kept:
                raise UsageError(f"{path}: {EXPORT} beside it says that it is no safe trajectory; give one of its φ")
            found.append(path)
            continue
        inside = sorted(one for one in path.iterdir() if not one.name.startswith("."))
        files = [one for one in inside if _holds_ways(one)]
        if not files:
            raise UsageError(f"{path}: no file in it ends in {', '.join(_SUFFIXES)}, and none is a bag's folder")
        kept = _safe_in_export(path)
        if kept is not None:
            beside += [one for one in files if one.name not in kept]
            files = [one for one in files if one.name in kept]
        found += files
    return found, beside


def _safe_in_export(folder: Path) -> set[str] | None:
    """Return the names of the safe trajectories in a folder of `skd export`; None of any other folder."""
    path = folder / EXPORT
    if not is_there(path):
        return None
    content = read_json(path)
    try:
        return {str(one["file"]) for one in content["files"] if one["mode"] == Mode.SAFE.name.lower()}
    except (KeyError, TypeError) as error:
        raise UsageError(f"{path}: is not of skd export") from error


def _holds_ways(path: Path) -> bool:
    if path.is_dir():
        return (path / METADATA).exists()
    return path.suffix.lower() in _SUFFIXES and not is_beside_tracks(path) and path.is_file()


def read_sources(path: Path, asked: Asked) -> list[Source]:
    """Return the ways that are asked for out of a file or a bag's folder.

    Raises:
        UsageError: it cannot be read, is of no known format, or nobody in it is who is asked for.
    """
    stem = _OSI_NAME.sub("", path.stem)
    if path.is_dir() or path.suffix.lower() == ".mcap":
        return [_from_osi(path, asked, stem) if _is_osi(path) else _from_bag(path, asked, stem)]
    if path.suffix.lower() == ".csv":
        return _from_table(path, asked, stem)
    root = read_xml(path)
    if root.tag not in _XML:
        raise UsageError(f"{path}: its root is {root.tag[:40]!r}; read are {' and '.join(_XML)}")
    reader, said, ego, adversary = _XML[root.tag]
    return [_chosen(path, said, reader(root, str(path)), asked, stem, (ego, adversary))]


def _chosen(path: Path, said: str, found: Sequence[Found], asked: Asked, stem: str, usual: tuple[str, str]) -> Source:
    ego, adversary = usual
    others = [one for one in found if one.name != ego] if asked.road_user is None else found
    user = one_of(others, asked.road_user, adversary, "--road-user", str(path))
    return Source(stem, path, said, user, _car(path, found, asked, ego))


def _car(path: Path, found: Sequence[Found], asked: Asked, usual: str) -> Found | None:
    if not asked.needs_car:
        return None
    return one_of(found, asked.car or usual, usual, "--car", str(path))


def _from_table(path: Path, asked: Asked, stem: str) -> list[Source]:
    names = {asked.road_user, asked.car} - {None} if asked.road_user is not None else set()
    found, said = read_table(path, {str(one) for one in names}, asked.kind)
    usual = (TABLE_CAR, TABLE_OTHER)
    many = [one for one in found if one.kind]
    if asked.road_user is None and many:
        if asked.needs_car:
            raise UsageError(f"{path}: --frame car needs one --road-user and one --car of its tracks")
        return [Source(f"{stem}_{one.name}", path, said, one, None) for one in many]
    return [_chosen(path, said, found, asked, stem, usual)]


def _is_osi(path: Path) -> bool:
    """Return whether an MCAP file holds ground truth of OSI, by the type of its first message."""
    if path.is_dir():
        return False
    first = next(read_messages(path, lambda _topic: True, Condition()), None)
    return first is not None and first.schema.name == osi.SCHEMA


def _from_osi(path: Path, asked: Asked, stem: str) -> Source:
    return _chosen(path, "OSI ground truth", osi.read_osi(path), asked, stem, (EGO, ADVERSARY))


def _from_bag(path: Path, asked: Asked, stem: str) -> Source:
    user, car = asked.road_user or ADVERSARY_TOPIC, asked.car or CAR_TOPIC
    tracks = bag_tracks(path, [user, car] if asked.needs_car else [user], asked.map_frame)
    found = {name: _found(path, name, one) for name, one in tracks.items()}
    if asked.needs_car and found[user].frame != found[car].frame:
        raise UsageError(
            f"{path}: {user} in {found[user].frame!r} and {car} in {found[car].frame!r}: two frames; give --map-frame, "
            "if /tf was recorded"
        )
    return Source(stem, path, "a bag of ROS 2", found[user], found.get(car) if asked.needs_car else None)


def _found(path: Path, name: str, one: BagTrack) -> Found:
    rows = np.array([row[:3] for row in sorted({row[:3] for row in one.rows})], np.float64).reshape(-1, 3)
    return Found(name, track_of(rows[:, 0], rows[:, 1:], f"{path}, {name}"), frame=one.frame)
