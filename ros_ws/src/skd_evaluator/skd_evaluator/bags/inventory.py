"""What a folder of recordings holds: every file of it is read, or named as not read, with the reason.

Folders behind links are searched like others, each once. A file that looks like a recording and cannot be read is
refused, or left out and named (`--skip-damaged`); other files are listed.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from skd_sim.errors import UsageError
from skd_sim.inputs.outside import is_there, real_path, sha256_of
from skd_sim.inputs.yaml_file import parse_yaml, read_text

from skd_evaluator.bags.validation import Damage
from skd_evaluator.campaign.store.manifest import MANIFEST, read_manifest

SUFFIX = ".mcap"
METADATA = "metadata.yaml"
_PACKED = (".mcap.zstd", ".mcap.zst", ".mcap.lz4", ".mcap.gz", ".mcap.bz2", ".mcap.xz")
_OTHER_STORAGE = (".db3", ".db3.zstd", ".bag", ".mcap.active", ".mcap.part")
_READ_BESIDE = (METADATA, MANIFEST, "assessment.json")
_PATHS = re.compile(r"^ *relative_file_paths:[ ]*\n((?: *- [^\n]*\S[^\n]*(?:\n|\Z))+)", re.MULTILINE)
_COUNT = re.compile(r"^( *)message_count:[ ]*([0-9]{1,18})[ ]*$", re.MULTILINE)
_MOST = 1_000_000  # entries of all folders together


@dataclass
class _Found:
    """What was found below one path."""

    files: list[Path] = field(default_factory=list)
    packed: list[Path] = field(default_factory=list)
    metadata: list[Path] = field(default_factory=list)
    manifests: list[Path] = field(default_factory=list)
    entries: int = 0


def find_recordings(paths: Sequence[Path], damage: Damage | None = None) -> list[list[Path]]:
    """Return the recordings below `paths`, each as its .mcap files: a bag folder's together, a lone file by itself.

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
        if not path.is_dir():
            if path.suffix.lower() != SUFFIX:
                raise UsageError(f"{path}: is no .mcap file; give a bag folder, an .mcap file, or a folder of them")
            found = _Found(files=[path])
        else:
            found = _Found()
            _look_into(path, found, set(), damage)
            _refuse_nothing(path, found)
            _account(path, found, damage)
        for file in found.files:
            bag = file.parent if (file.parent / METADATA).exists() else file
            if file not in recordings.setdefault(bag, []):
                recordings[bag].append(file)
    return list(recordings.values())


def holds_recordings(folder: Path) -> bool:
    """Return whether there is an .mcap file, packed or not, at or below a folder."""
    found = _Found()
    _look_into(folder, found, set(), Damage(skip=True))
    return bool(found.files or found.packed)


def _look_into(folder: Path, found: _Found, known: set[Path], damage: Damage) -> None:
    """Add what is in a folder, and below it in the order of names."""
    known.add(real_path(folder))
    inside: list[Path] = []
    for path in _entries(folder, found, damage):
        name = path.name.lower()
        if path.is_dir():
            inside.append(path)
        elif path.is_symlink() and not path.exists():
            _leave_out_or_list(path, "is a link that leads nowhere", damage, recording=name.endswith(SUFFIX))
        elif name.endswith(SUFFIX):
            found.files.append(path)
        elif name.endswith(_PACKED):
            found.packed.append(path)
        elif name.endswith(_OTHER_STORAGE):
            damage.leave_out(f"{path}: is of another storage than MCAP, or unfinished; ros2 bag convert makes an .mcap")
        elif name == METADATA:
            found.metadata.append(path)
        elif name == MANIFEST:
            found.manifests.append(path)
        elif name not in _READ_BESIDE:
            damage.unread.append(path)
    for path in inside:
        if real_path(path) in known:
            damage.warn(f"{path}: leads to a folder that is read already")
        else:
            _look_into(path, found, known, damage)


def _entries(folder: Path, found: _Found, damage: Damage) -> Iterator[Path]:
    try:
        with os.scandir(folder) as entries:
            names = sorted(entry.name for entry in entries)
    except OSError as error:
        damage.leave_out(f"{folder}: cannot be looked into ({error.strerror})")
        return
    found.entries += len(names)
    if found.entries > _MOST:
        raise UsageError(f"{folder}: more than {_MOST} files are here and before it; give the folder of the recordings")
    for name in names:
        yield folder / name


def _leave_out_or_list(path: Path, why: str, damage: Damage, *, recording: bool) -> None:
    if recording:
        damage.leave_out(f"{path}: {why}")
    else:
        damage.warn(f"{path}: {why}")


def _refuse_nothing(path: Path, found: _Found) -> None:
    """Refuse a path below which there is nothing to read, and say what to do."""
    if found.files:
        return
    if found.packed:
        raise UsageError(f"{path}: its files are compressed as a whole; unpack them first (zstd -d *.mcap.zstd)")
    raise UsageError(f"{path}: holds no .mcap file; record with the MCAP storage (ros2 bag record -s mcap)")


def _account(path: Path, found: _Found, damage: Damage) -> None:
    """Name files that should be there, or should have been read, and are not."""
    there = set(map(real_path, found.files))
    for file in found.packed:
        unpacked = file.with_name(file.name[: file.name.lower().rindex(SUFFIX) + len(SUFFIX)])
        if real_path(unpacked) in there:
            damage.warn(f"{file}: not read, for {unpacked.name} is beside it")
        else:
            damage.leave_out(f"{file}: is compressed as a whole and is not read; unpack it first (zstd -d)")
    for file in found.metadata:
        _hold_against_metadata(file, damage)
    beside = [path.parent] if real_path(path).name == "bags" and (real_path(path).parent / MANIFEST).exists() else []
    for folder in [*(one.parent for one in found.manifests), *beside]:
        _hold_against_manifest(folder, path, damage)


def _hold_against_metadata(file: Path, damage: Damage) -> None:
    """See that every file that a bag's metadata names is there."""
    try:
        names = _named_in(read_text(file), file)
    except (OSError, UsageError, LookupError, TypeError, AttributeError) as error:
        said = " ".join(str(error).split())[:120]
        damage.warn(f"{file}: cannot be read, so nobody knows which files belong to this bag ({said})")
        return
    for name in names:
        # Recorders of before wrote the folder's own name, too; a file that was unpacked has lost its ending.
        bare = name[: -len(".zstd")] if name.endswith(".zstd") else name
        places = [file.parent / one for one in (name, bare, Path(name).name, Path(bare).name)]
        if not any(map(is_there, places)):
            damage.leave_out(f"{file}: names {name:.200}, which is not there: what it held is missing")


def _named_in(text: str, file: Path) -> list[str]:
    """Return the files that a bag's metadata names; text as recorders write it is read without a slow YAML parser.

    Raises:
        UsageError, LookupError, TypeError: it is no such metadata.
    """
    block = _PATHS.search(text)
    if block is not None:
        return [line.strip()[1:].strip().strip("'\"") for line in block[1].splitlines()]
    content = parse_yaml(text, str(file))
    return [str(name) for name in content.get("rosbag2_bagfile_information", content)["relative_file_paths"]]


def messages_said(files: Sequence[Path]) -> int | None:
    """Return how many messages a bag's metadata counts in its files; None where it does not say, or is not there.

    Args:
        files: those of the bag that are read; where the metadata names others, nothing is known of these alone.
    """
    path = files[0].parent / METADATA
    try:
        text = read_text(path)
        if {Path(name).name for name in _named_in(text, path)} != {file.name for file in files}:
            return None
    except (OSError, UsageError, LookupError, TypeError, AttributeError):
        return None  # which is said where the folder is looked into
    found = [(len(one[1]), int(one[2])) for one in _COUNT.finditer(text)]  # topics and files have counts further in
    return min(found)[1] if found and [one[0] for one in found].count(min(found)[0]) == 1 else None


def _hold_against_manifest(folder: Path, path: Path, damage: Damage) -> None:
    """Check that every recording that SKD has written is there and unchanged."""
    manifest = read_manifest(folder) or {}
    inside = real_path(path)
    for name, digest in manifest.items():
        file = folder / name
        if not name.lower().endswith(SUFFIX) or not (real_path(folder) / name).is_relative_to(inside):
            continue
        if not is_there(file):
            damage.leave_out(f"{file}: is in {MANIFEST}, and is not there")
        elif sha256_of(file) != digest:
            damage.leave_out(f"{file}: is not what was written: its SHA-256 is another than in {MANIFEST}")
