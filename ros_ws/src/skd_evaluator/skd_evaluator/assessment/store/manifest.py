"""manifest.sha256: the SHA-256 of every file of a result, in the format that `sha256sum -c` reads.

Written last into a folder of results, so it says that a file is what was written: not cut short, not edited, not that
of another run. Who wrote it is said by a signature: `ssh-keygen -Y sign -n skd`.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from skd_sim.errors import UsageError
from skd_sim.inputs.outside import read_text, sha256_of

from skd_evaluator.assessment.store.result_file import ASSESSMENT
from skd_evaluator.files import PREFIX

MANIFEST = "manifest.sha256"
_OWN = (MANIFEST, f"{MANIFEST}.sig")
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

    Raises:
        OSError: it cannot be written.
    """
    for inside in sorted(folder.glob(f"**/{ASSESSMENT}"), reverse=True):
        if inside.parent != folder:
            _write(inside.parent)
    _write(folder)


def _write(folder: Path) -> None:
    lines = [f"{sha256_of(folder / name)}  {name}\n" for name in _files(folder)]
    temporary = folder / f"{PREFIX}{MANIFEST}.{os.getpid()}"
    try:
        with temporary.open("w", encoding="utf-8") as file:
            file.writelines(line for line in lines if _LINE.fullmatch(line[:-1]))
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(folder / MANIFEST)
    finally:
        temporary.unlink(missing_ok=True)


def _files(folder: Path) -> list[str]:
    """Return the names of all regular files below a folder but for its manifest and its signature, sorted, no links."""
    found = (path for path in folder.rglob("*") if path.is_file() and not path.is_symlink())
    return sorted({path.relative_to(folder).as_posix() for path in found} - {*_OWN})


def read_manifest(folder: Path) -> dict[str, str] | None:
    """Return the SHA-256 by the name of the file; None where there is no manifest.

    Raises:
        UsageError: it cannot be read, or is none.
    """
    path = folder / MANIFEST
    if not path.exists():
        return None
    found: dict[str, str] = {}
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        parts = _LINE.fullmatch(line)
        name = PurePosixPath(parts[2]) if parts else PurePosixPath("..")
        if parts is None or name.is_absolute() or ".." in name.parts:
            raise UsageError(f"{path}, line {number}: must be a SHA-256, two blanks and the name of a file")
        found[parts[2]] = parts[1]
    return found


def hold(folder: Path, manifest: dict[str, str]) -> Held:
    """Hold the files of a folder against a manifest of it."""
    there, known = set(_files(folder)), sorted(manifest)
    same = [name for name in known if name in there and sha256_of(folder / name) == manifest[name]]
    return Held(
        tuple(same),
        tuple(name for name in known if name in there and name not in same),
        tuple(name for name in known if name not in there),
        tuple(sorted(there - set(known))),
    )


def check_unchanged(folder: Path, names: Iterable[str]) -> bool:
    """See that files of a folder are what was written, as far as its manifest knows them; return whether there is one.

    Raises:
        UsageError: a file is another one, or the manifest cannot be read.
    """
    manifest = read_manifest(folder)
    for name in names:
        known = (manifest or {}).get(name)
        if known is not None and sha256_of(folder / name) != known:
            raise UsageError(
                f"{folder / name}: is not what was written: its SHA-256 is another than in {MANIFEST} beside it; to "
                "change a file on purpose, copy it to another folder"
            )
    return manifest is not None
