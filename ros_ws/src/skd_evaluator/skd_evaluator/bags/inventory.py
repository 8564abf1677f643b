"""Which recordings a folder holds: what looks like one and cannot be read is refused, or left out and named."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from textwrap import dedent

import yaml
from skd_sim.errors import UsageError
from skd_sim.inputs.outside import is_there, read_text, real_path, sha256_of

from skd_evaluator.assessment.store.manifest import MANIFEST, read_manifest
from skd_evaluator.bags.acceptance import Damage

SUFFIX = ".mcap"
METADATA = "metadata.yaml"
_PACKED = (".mcap.zstd", ".mcap.zst", ".mcap.lz4", ".mcap.gz", ".mcap.bz2", ".mcap.xz")
_OTHER_STORAGE = (".db3", ".db3.zstd", ".bag", ".mcap.active", ".mcap.part")
_PATHS = re.compile(r"^ *relative_file_paths:.*(?:\n *- .*)*", re.MULTILINE)


def find_recordings(paths: Sequence[Path], damage: Damage | None = None) -> list[list[Path]]:
    """Return the recordings below `paths`, each as its .mcap files: a bag folder's together, a lone file by itself.

    Folders behind links are searched like others, each once. Files that a bag's metadata.yaml or a manifest names have
    to be there.

    Args:
        paths: bag folders, .mcap files, or folders of them.
        damage: told what is not read; by default what looks like a recording and cannot be read is refused.

    Raises:
        UsageError: a path does not exist, or holds no .mcap file; or something must not be left out.
    """
    damage = damage or Damage()
    recordings: dict[Path, list[Path]] = {}
    for path in paths:
        if not path.exists():
            raise UsageError(f"{path}: no such file or folder")
        if not path.is_dir() and path.suffix.lower() != SUFFIX:
            raise UsageError(f"{path}: is no .mcap file; give a bag folder, an .mcap file, or a folder of them")
        files = [path]
        if path.is_dir():
            found = sorted(_files_below(path, damage))
            files = [file for file in found if file.name.lower().endswith(SUFFIX)]
            _refuse_nothing(path, files, found)
            _check_complete(path, found, damage)
        for file in files:
            bag = file.parent if (file.parent / METADATA).exists() else file
            if file not in recordings.setdefault(bag, []):
                recordings[bag].append(file)
    return list(recordings.values())


def holds_recordings(folder: Path) -> bool:
    """Return whether there is an .mcap file, packed or not, at or below a folder."""
    return any(file.name.lower().endswith((SUFFIX, *_PACKED)) for file in _files_below(folder, Damage(skip=True)))


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


def _refuse_nothing(path: Path, files: Sequence[Path], found: Sequence[Path]) -> None:
    """Refuse a path below which there is nothing to read, and say what to do."""
    if files:
        return
    if any(file.name.lower().endswith(_PACKED) for file in found):
        raise UsageError(f"{path}: its files are compressed as a whole; unpack them first (zstd -d *.mcap.zstd)")
    raise UsageError(f"{path}: holds no .mcap file; record with the MCAP storage (ros2 bag record -s mcap)")


def _check_complete(path: Path, found: Sequence[Path], damage: Damage) -> None:
    """Name files that should be there, or should have been read, and are not."""
    inside = real_path(path)
    if inside.name == "bags":  # of an assessment, whose manifest is beside it
        found = [*found, inside.parent / MANIFEST]
    for file in found:
        name = file.name.lower()
        if name.endswith(_PACKED) and file.with_name(file.stem) not in found:
            damage.leave_out(f"{file}: is compressed as a whole and is not read; unpack it first (zstd -d)")
        elif name.endswith(_OTHER_STORAGE):
            damage.leave_out(f"{file}: is of another storage than MCAP, or unfinished; ros2 bag convert makes an .mcap")
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
        damage.warn(f"{file}: cannot be read ({said}): nobody knows which files belong to this bag")
        return
    for name in names:
        # Recorders of before wrote the folder's own name, too; a file that was unpacked has lost its ending.
        bare = name.removesuffix(".zstd")
        if not any(is_there(file.parent / one) for one in (name, bare, Path(name).name, Path(bare).name)):
            damage.leave_out(f"{file}: names {name:.200}, which is not there: what it held is missing")


def _check_manifest(folder: Path, inside: Path, damage: Damage) -> None:
    """See that every recording that SKD has written is there and unchanged."""
    for name, digest in (read_manifest(folder) or {}).items():
        file = folder / name
        if not name.lower().endswith(SUFFIX) or not (real_path(folder) / name).is_relative_to(inside):
            continue
        if not is_there(file):
            damage.leave_out(f"{file}: is in {MANIFEST}, and is not there")
        elif sha256_of(file) != digest:
            damage.leave_out(f"{file}: is not what was written: its SHA-256 is another than in {MANIFEST}")
