"""Which files below some paths are recordings, which of them are one recording, and what is missing."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from textwrap import dedent

import yaml
from skd_sim.errors import UsageError
from skd_sim.inputs.files import is_there, read_text, real_path, sha256_of

from skd_evaluator.assessment.files.result_folder import MANIFEST, read_manifest
from skd_evaluator.bags.checks import Damage
from skd_evaluator.bags.messages import span_of

METADATA = "metadata.yaml"
STORAGES = (".mcap", ".db3", ".bag")
"""Endings of files that are read; behind each may be one of `PACKED`."""
PACKED = (".zstd", ".zst")
_SUFFIXES = (*STORAGES, *(one + packed for one in STORAGES for packed in PACKED))
_NOT_READ = (*(f"{one}{packed}" for one in STORAGES for packed in (".lz4", ".gz", ".bz2", ".xz")),
             *(f"{one}{state}" for one in STORAGES for state in (".active", ".part")))  # fmt: skip
_PATHS = re.compile(r"^ *relative_file_paths:.*(?:\n *- .*)*", re.MULTILINE)
_NUMBERED = re.compile(r"(.*?)[_-]?(\d+)")
_FOLLOWS = 0.5  # s from the last message of a file to the first of the next that goes on with it
_NEAR = 30.0  # s from which on two recordings are not taken for one


def is_recording(path: Path) -> bool:
    """Return whether a path is a bag's folder, or a file of a storage that is read, by its name."""
    return is_there(path / METADATA) if path.is_dir() else path.name.lower().endswith(_SUFFIXES)


def find_recordings(paths: Sequence[Path], damage: Damage | None = None) -> list[list[Path]]:
    """Return the recordings below `paths`, each as its files in order.

    One recording are the files of a bag's folder, and files that follow each other: of one name but for a number, each
    beginning as the one before ends. Folders behind links are searched like others, each once. Files that a bag's
    metadata.yaml or a manifest names have to be there.

    Args:
        paths: bag folders, files, or folders of them.
        damage: takes note of what is not read; by default what looks like a recording and cannot be read is refused.

    Raises:
        UsageError: a path does not exist, or holds no recording; or something must not be left out.
    """
    damage = damage or Damage()
    found: list[Path] = []
    for path in paths:
        if not path.exists():
            raise UsageError(f"{path}: no such file or folder")
        if not path.is_dir():
            if not path.name.lower().endswith(_SUFFIXES):
                raise UsageError(f"{path}: is no recording; give a bag's folder, {_listed()}, or a folder of them")
            found.append(path)
            continue
        below = sorted(_files_below(path, damage), key=_in_order)
        files = [
            file
            for file in below
            if file.name.lower().endswith(_SUFFIXES) and not (_is_packed(file) and file.with_name(file.stem) in below)
        ]
        if not files:
            others = [file for file in below if file.name.lower().endswith(_NOT_READ)]
            what = f"{others[0]} is packed or unfinished: unpack it first" if others else f"holds no {_listed()}"
            raise UsageError(f"{path}: {what}")
        _check_complete(path, below, damage)
        found += files
    return joined(list(dict.fromkeys(found)), damage)


def joined(files: Sequence[Path], damage: Damage) -> list[list[Path]]:
    """Return recordings of files: those of a bag's folder, and those that follow each other, are one.

    Args:
        files: files of recordings, none twice.
        damage: takes note of files that look as if they belonged together, and do not follow each other.
    """
    groups: dict[tuple[Path, str], list[Path]] = {}
    for file in files:
        name = "" if is_there(file.parent / METADATA) else _shared(file) or file.name
        groups.setdefault((file.parent, name), []).append(file)
    found: list[list[Path]] = []
    for (_, name), group in groups.items():
        if len(group) == 1 or not name:
            found.append(sorted(group, key=_in_order))
            continue
        spans = {file: span for file in group if (span := span_of(file)) is not None}
        found += [[file] for file in group if file not in spans]
        end, last = -math.inf, group[0]
        for file in sorted(spans, key=lambda one: spans[one]):
            pause = (spans[file][0] - end) / 1e9
            if 0.0 <= pause <= _FOLLOWS:
                found[-1].append(file)
            else:
                found.append([file])
            if _FOLLOWS < pause <= _NEAR:
                read = "they are read as two recordings; is one of between missing?"
                damage.warn(f"{file} begins {pause:.2f} s after {last.name} ends: {read}")
            end, last = spans[file][1], file
    return found


def name_of(files: Sequence[Path]) -> str:
    """Return the name of a recording, without ending: of a bag its folder's, of several files what they share."""
    if is_there(files[0].parent / METADATA):
        return files[0].parent.name
    return (_shared(files[0]) if len(files) > 1 else "") or _stem(files[0])


def _shared(file: Path) -> str:
    """Return the name of a file without a number at its end; empty if it has none, or nothing else."""
    numbered = _NUMBERED.fullmatch(_stem(file))
    return numbered.group(1) if numbered else ""


def holds_recordings(folder: Path) -> bool:
    """Return whether there is a recording, packed or not, at or below a folder."""
    endings = (*_SUFFIXES, *_NOT_READ)
    return any(file.name.lower().endswith(endings) for file in _files_below(folder, Damage(skip=True)))


def _listed() -> str:
    return f"{', '.join(STORAGES)} (or with {PACKED[0]})"


def _is_packed(file: Path) -> bool:
    return file.suffix.lower() in PACKED


def _stem(file: Path) -> str:
    return Path(file.stem).stem if _is_packed(file) else file.stem


def _in_order(file: Path) -> list[tuple[int, str]]:
    """Return what files are sorted by: their paths, numbers in them as numbers."""
    return [(int(one), "") if one.isdigit() else (-1, one) for one in re.split(r"(\d+)", str(file))]


def _files_below(folder: Path, damage: Damage) -> Iterator[Path]:
    """Yield the files at and below a folder, of each folder once, whatever links lead there."""
    seen: set[Path] = set()
    unread = lambda error: damage.leave_out(f"{error.filename}: cannot be looked into ({error.strerror})")  # noqa: E731
    for path, inside, files in os.walk(folder, onerror=unread, followlinks=True):
        real = real_path(Path(path))
        if real in seen:
            inside.clear()
            continue
        seen.add(real)
        yield from (Path(path, name) for name in files)


def _check_complete(path: Path, found: Sequence[Path], damage: Damage) -> None:
    """Name files that should be there, or should have been read, and are not."""
    inside = real_path(path)
    if inside.name == "bags":  # of an assessment, whose manifest is beside it
        found = [*found, inside.parent / MANIFEST]
    for file in found:
        name = file.name.lower()
        if name.endswith(_NOT_READ) and file.with_name(file.stem) not in found:
            damage.leave_out(f"{file}: is packed or unfinished, and is not read; unpack it first")
        elif name == METADATA:
            _check_metadata(file, damage)
        elif name == MANIFEST:
            _check_manifest(file.parent, inside, damage)


def _check_metadata(file: Path, damage: Damage) -> None:
    """See that every file that a bag's metadata names is there; the rest of it takes a YAML parser long."""
    try:
        names = yaml.safe_load(dedent(_PATHS.findall(read_text(file))[0]))["relative_file_paths"]
        names = [str(name) for name in names]
    except (UsageError, yaml.YAMLError, LookupError, TypeError) as error:
        said = type(error).__name__
        damage.warn(f"{file}: cannot be read ({said}): which files belong to this bag is unknown")
        return
    for name in names:
        # Recorders of before wrote the folder's own name, too; a file may have been packed or unpacked since.
        bare = name.removesuffix(".zstd")
        every = [one for each in (bare, Path(bare).name) for one in (each, *(each + packed for packed in PACKED))]
        if not any(is_there(file.parent / one) for one in every):
            damage.leave_out(f"{file}: names {name:.200}, which is not there: what it held is missing")


def _check_manifest(folder: Path, inside: Path, damage: Damage) -> None:
    """See that every recording that SKD has written is there and unchanged."""
    for name, digest in (read_manifest(folder) or {}).items():
        file = folder / name
        if not name.lower().endswith(_SUFFIXES) or not (real_path(folder) / name).is_relative_to(inside):
            continue
        if not is_there(file):
            damage.leave_out(f"{file}: is in {MANIFEST}, and is not there")
        elif sha256_of(file) != digest:
            damage.leave_out(f"{file}: is not what was written: its SHA-256 is another than in {MANIFEST}")
