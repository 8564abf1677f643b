"""The manifest of a result: the SHA-256 of each of its files, written last, so that a changed file is noticed.

It is in the format of `sha256sum`, which checks it as well: `sha256sum -c manifest.sha256` in the folder. It says that
files are what was written, not by whom: who changes a file can change the manifest, too, unless it is signed
(`signature.py`).
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from skd_sim.errors import UsageError
from skd_sim.inputs.outside import read_text, sha256_of

from skd_evaluator.campaign.store.result_file import ASSESSMENT
from skd_evaluator.files import PREFIX

MANIFEST = "manifest.sha256"
SIGNATURE = f"{MANIFEST}.sig"
_LARGEST = 16 * 2**20  # bytes: some 150,000 files
_LINE = re.compile(r"([0-9a-f]{64})  ([^\x00-\x1f\\]+)")


@dataclass(frozen=True)
class Held:
    """A folder held against its manifest; names are relative to the folder, and sorted.

    Attributes:
        same: files that are what was written.
        changed: files that are not.
        missing: files that are not there.
        others: files that the manifest does not know.
    """

    same: tuple[str, ...]
    changed: tuple[str, ...]
    missing: tuple[str, ...]
    others: tuple[str, ...]


def write_manifests(folder: Path) -> None:
    """Write the manifest of a folder, and before that one in each folder below it that holds an assessment.

    Args:
        folder: the folder of a result.

    Raises:
        OSError: it cannot be written.
    """
    for inside in sorted(folder.glob(f"**/{ASSESSMENT}"), reverse=True):
        if inside.parent != folder:
            _write(inside.parent)
    _write(folder)


def _write(folder: Path) -> None:
    lines = [
        f"{sha256_of(folder / name)}  {name}\n" for name in _files(folder) if _LINE.fullmatch(f"{'0' * 64}  {name}")
    ]
    temporary = folder / f"{PREFIX}{MANIFEST}.{os.getpid()}"
    try:
        with temporary.open("w", encoding="utf-8") as file:
            file.writelines(lines)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(folder / MANIFEST)
    finally:
        temporary.unlink(missing_ok=True)


def _files(folder: Path) -> list[str]:
    """Return the names of all regular files below a folder but for its manifest and its signature, sorted, no links."""
    found, own = [], (folder / MANIFEST, folder / SIGNATURE)
    for where, _, names in os.walk(folder):
        for name in names:
            path = Path(where, name)
            if not path.is_symlink() and path.is_file() and path not in own:
                found.append(path.relative_to(folder).as_posix())
    return sorted(found)


def read_manifest(folder: Path) -> dict[str, str] | None:
    """Return the SHA-256 by the name of the file; None where there is no manifest.

    Raises:
        UsageError: it cannot be read, or is none.
    """
    path = folder / MANIFEST
    if not path.is_symlink() and not path.exists():
        return None
    found: dict[str, str] = {}
    for number, line in enumerate(read_text(path, _LARGEST).splitlines(), start=1):
        parts = _LINE.fullmatch(line)
        if parts is None or not _inside(parts[2]) or parts[2] in found:
            raise UsageError(f"{path}, line {number}: must be a SHA-256, two blanks and the name of a file, each once")
        found[parts[2]] = parts[1]
    return found


def _inside(name: str) -> bool:
    path = PurePosixPath(name)
    return not path.is_absolute() and ".." not in path.parts


def hold(folder: Path, manifest: dict[str, str]) -> Held:
    """Hold the files of a folder against a manifest of it."""
    there = set(_files(folder))
    known = sorted(manifest)
    same = [name for name in known if name in there and sha256_of(folder / name) == manifest[name]]
    return Held(
        tuple(same),
        tuple(name for name in known if name in there and name not in set(same)),
        tuple(name for name in known if name not in there),
        tuple(sorted(there - set(known))),
    )


def check_unchanged(folder: Path, names: Iterable[str]) -> bool:
    """See that files of a folder are what was written, and return whether it has a manifest that says so.

    Raises:
        UsageError: one is not, or the manifest does not know it.
    """
    manifest, names = read_manifest(folder), tuple(names)
    if manifest is None:
        return False
    for name in names:
        if name not in manifest:
            raise UsageError(f"{folder / name}: is not in {MANIFEST} beside it: it was not written with this result")
        if sha256_of(folder / name) != manifest[name]:
            raise UsageError(
                f"{folder / name}: is not what was written: {MANIFEST} knows another, and {ASSESSMENT} is of that one"
                if name != ASSESSMENT and ASSESSMENT in names
                else f"{folder / name}: is not what was written: its SHA-256 is another than in {MANIFEST}"
            )
    return True


def check_as_written(path: Path) -> None:
    """See that a file is what was written, if the manifest of its folder knows it; one of a user's own it does not.

    Raises:
        UsageError: it is another, or the manifest cannot be read.
    """
    known = (read_manifest(path.parent) or {}).get(path.name)
    if known is not None and sha256_of(path) != known:
        raise UsageError(
            f"{path}: is not what was written: its SHA-256 is another than in {MANIFEST} beside it; who changes it on "
            "purpose makes a copy in another folder"
        )
