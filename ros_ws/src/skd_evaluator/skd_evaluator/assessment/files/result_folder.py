"""Results on disk: a folder that is taken before the work and filled after it, wholly or not at all; its manifest.

manifest.sha256 holds the SHA-256 of every file, as `sha256sum -c` reads it, and is written last: a file that differs
from it was cut short, edited, or is of another run.
"""

from __future__ import annotations

import csv
import errno
import fcntl
import io
import itertools
import json
import os
import re
import shutil
import weakref
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

from skd_sim.errors import UsageError
from skd_sim.inputs.files import read_text, real_path, sha256_of

from skd_evaluator.assessment.files.assessment_json import ASSESSMENT
from skd_evaluator.files import MARKERS, PREFIX, make_temporary, note_in_place, remove, umask

LOGS = "logs"
_FAILED = ".failed"
"""A file in logs of work that has failed: they may be replaced."""


class ElsewhereError(OSError):
    """The results are whole, but not where they were asked for; the message says where they are."""


class Scratch(NamedTuple):
    """A temporary folder for what grows during work.

    Attributes:
        folder: the folder, with a folder `logs` in it.
        logs: by which name these logs are found now and later.
    """

    folder: Path
    logs: Path


class ResultFolder:
    """An output folder: taken before the work, exclusively, and filled after it, by one rename of what is complete.

    While it is taken it exists, locked, and empty unless it holds results that are to be replaced. It is given back,
    and removed where it was made, when this object is let go without having been written; the lock ends with the
    process, however that ends. What the processes of a graph print is there from the beginning, under `logs`, and stays
    after work that has failed: a folder with nothing else is taken like an empty one.

    Attributes:
        path: where the results are.
    """

    def __init__(self, path: Path, *, overwrite: bool = False) -> None:
        """Take the folder.

        Raises:
            UsageError: it cannot be written, holds something already, or another run has taken it.
        """
        self.path = path
        try:
            self._target = real_path(path)  # of a link, the folder behind it is replaced
            _check(self._target, f"--out {path}", overwrite=overwrite)
            made = _make(self._target)
            try:
                self._descriptor = _lock(self._target, f"--out {path}")
                _check(self._target, f"--out {path}", overwrite=overwrite)  # another run may have ended just now
            except BaseException:
                _remove_empty(made)
                raise
        except OSError as error:
            raise UsageError(f"--out {path}: cannot be written ({error.strerror}); give another") from error
        self._replaces = _holds_something(self._target)
        self._give_back = weakref.finalize(self, _give_back, self._descriptor, made, os.getpid())

    def close(self) -> None:
        """Let go of the folder, and remove it if nothing was written."""
        self._give_back()

    @contextmanager
    def scratch(self) -> Iterator[Scratch]:
        """Yield a temporary folder on the same file system for what grows during the work; gone afterwards.

        The logs of work that has failed stay where `Scratch.logs` says.
        """
        temporary = self._temporary()
        logs = temporary / LOGS
        # Results that are there stay as they are until they are replaced.
        shown = _free(self.path.with_name(f"{self.path.name}.{LOGS}")) if self._replaces else self.path / LOGS
        try:
            logs.mkdir()
            if not self._replaces:
                _remove_left(self._target)
            shown.symlink_to(real_path(logs))
            yield Scratch(temporary, shown)
        except Exception:
            if logs.is_dir() and any(logs.iterdir()):
                shown.unlink(missing_ok=True)
                logs.rename(shown)
                shown.joinpath(_FAILED).touch()
            raise
        finally:
            if shown.is_symlink():
                shown.unlink()
            remove(temporary)

    def write(self, fill: Callable[[Path], None]) -> None:
        """Let `fill` write into a temporary folder beside the target and put it in the target's place.

        Raises:
            ElsewhereError: something was put there meanwhile, which stays; the results are in a folder beside it.
            OSError: it cannot be written; nothing has changed.
        """
        temporary = self._temporary()
        try:
            temporary.chmod(0o777 & ~umask())
            fill(temporary)
            write_manifests(temporary)
            self._put_in_place(temporary)
        finally:
            remove(temporary)

    def _put_in_place(self, temporary: Path) -> None:
        replaced = temporary.with_name(temporary.name + ".old")
        if self._replaces:
            self._target.rename(replaced)
        else:
            _remove_left(self._target)
        try:
            temporary.rename(self._target)  # over an empty folder at most
        except OSError as error:
            if replaced.exists():
                replaced.rename(self._target)
            if error.errno not in (errno.ENOTEMPTY, errno.EEXIST, errno.ENOTDIR):
                raise
            requested, self.path = self.path, _free(self._target)
            temporary.rename(self.path)
            note_in_place(self.path)
            text = f"--out {requested}: something was put there meanwhile; the results are in {self.path}"
            raise ElsewhereError(text) from error
        note_in_place(self.path)
        remove(replaced)

    def save(self, fill: Callable[[Path], None]) -> str | None:
        """Write, and return why it failed, in one line; none where all is well.

        For what is still to be printed: a full disk must not take it along.
        """
        try:
            self.write(fill)
        except ElsewhereError as error:
            return str(error)
        except OSError as error:
            return f"nothing was written: {error}"
        return None

    def _temporary(self) -> Path:
        self._target.parent.mkdir(parents=True, exist_ok=True)
        return make_temporary(self._target.parent)


def _make(target: Path) -> list[Path]:
    """Make a folder with its parents, and return which of them are new, innermost first."""
    made: list[Path] = []
    try:
        for folder in [*reversed(target.parents), target]:
            with suppress(FileExistsError):
                folder.mkdir()
                made.insert(0, folder)
    except BaseException:
        _remove_empty(made)
        raise
    return made


def _remove_empty(folders: Iterable[Path]) -> None:
    with suppress(OSError):  # something is in it: nor will those around it be empty
        for folder in folders:
            folder.rmdir()


def _lock(target: Path, option: str) -> int:
    """Return a descriptor of a folder, locked as long as it is open."""
    descriptor = os.open(target, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if not os.path.samestat(target.stat(), os.fstat(descriptor)):
            raise BlockingIOError(errno.EAGAIN, "it has just been exchanged")
    except OSError as error:
        if error.errno in (errno.ENOLCK, errno.ENOTSUP, errno.EBADF, errno.ENOSYS):
            return descriptor  # a file system without locks, as some networks have
        os.close(descriptor)
        if isinstance(error, BlockingIOError):
            raise UsageError(f"{option}: another run is about to write there; give another folder") from error
        raise
    return descriptor


def _give_back(descriptor: int, made: Sequence[Path], process: int) -> None:
    """Remove the folders that were made and are empty, and let go of the lock; not in a worker forked meanwhile."""
    if os.getpid() != process:
        return
    with suppress(OSError):
        if made and os.path.samestat(made[0].lstat(), os.fstat(descriptor)):
            _remove_empty(made)
    os.close(descriptor)


def _check(target: Path, option: str, *, overwrite: bool) -> None:
    """Refuse a target that is no folder, holds something, or cannot be replaced or made (OSError)."""
    if target.exists():
        if not target.is_dir():
            raise UsageError(f"{option}: is a file; give a folder")
        if _holds_something(target):
            if not any((target / marker).exists() for marker in MARKERS):
                raise UsageError(f"{option}: is not empty and holds no SKD results; give a new folder")
            if not overwrite:
                raise UsageError(f"{option}: already holds results; add --overwrite to replace them")
        if target.is_mount() or Path.cwd().is_relative_to(target):
            raise UsageError(f"{option}: is a mount point or the current folder; give a new folder inside it")
        if not os.access(target, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    elif len(target.name.encode()) > os.pathconf("/", "PC_NAME_MAX"):
        raise OSError(errno.ENAMETOOLONG, os.strerror(errno.ENAMETOOLONG))
    ancestor = next(folder for folder in target.parents if folder.exists())
    make_temporary(ancestor).rmdir()


def _holds_something(target: Path) -> bool:
    """Return whether something is in a folder but the logs of work of ours that has failed, or was killed."""
    return any(not _is_left(one) for one in target.iterdir())


def _is_left(path: Path) -> bool:
    if path.name != LOGS:
        return False
    return path.readlink().parent.name.startswith(PREFIX) if path.is_symlink() else (path / _FAILED).is_file()


def _remove_left(target: Path) -> None:
    """Remove what work of ours that has failed has left in a folder."""
    logs = target / LOGS
    if logs.is_symlink():
        logs.unlink()
    elif logs.is_dir() and _is_left(logs):
        shutil.rmtree(logs)


def _free(path: Path) -> Path:
    """Return a path where nothing is: this one, or with a number behind it."""
    names = itertools.chain([path.name], (f"{path.name}-{number}" for number in itertools.count(2)))
    return next(one for one in map(path.with_name, names) if not (one.exists() or one.is_symlink()))


def csv_text(rows: Iterable[Mapping[str, Any]], columns: Sequence[str]) -> str:
    """Return rows as CSV, those of their keys that are columns; of an interval both ends in one cell."""
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    for row in rows:
        writer.writerow(
            {key: " ".join(map(str, cell)) if isinstance(cell, (list, tuple)) else cell for key, cell in row.items()}
        )
    return text.getvalue()


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write JSON; NaN and infinity are refused, for JSON has none."""
    path.write_text(json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8")


MANIFEST = "manifest.sha256"
_OWN = (MANIFEST, f"{MANIFEST}.sig")
_LINE = re.compile(r"([0-9a-f]{64})  ([^\x00-\x1f\\]+)")


def write_manifests(folder: Path) -> None:
    """Write the manifest of a folder, and before that one in each folder below it that holds an assessment.

    Raises:
        OSError: it cannot be written.
    """
    below = {inside.parent for inside in folder.glob(f"**/{ASSESSMENT}")} - {folder}
    for one in (*sorted(below, reverse=True), folder):
        lines = [f"{sha256_of(one / name)}  {name}" for name in _files(one)]
        text = "".join(f"{line}\n" for line in lines if _LINE.fullmatch(line))
        (one / MANIFEST).write_text(text, encoding="utf-8")


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


CHANGED, GONE, FOREIGN = "changed since it was written", "gone", "not of this result"


def compared(folder: Path, manifest: Mapping[str, str]) -> dict[str, str]:
    """Return which files of a folder are not as its manifest has them: what is wrong, by their names."""
    there = set(_files(folder))
    found = {name: GONE for name in manifest if name not in there}
    found |= {name: CHANGED for name in there & manifest.keys() if sha256_of(folder / name) != manifest[name]}
    found |= dict.fromkeys(there - manifest.keys(), FOREIGN)
    return dict(sorted(found.items()))


def check_unchanged(folder: Path, names: Iterable[str]) -> bool:
    """See that files of a folder are what was written, as far as its manifest knows them; return whether there is one.

    Raises:
        UsageError: a file is another one, or the manifest cannot be read.
    """
    manifest = read_manifest(folder)
    for name in names:
        known = (manifest or {}).get(name)
        if known is not None and sha256_of(folder / name) != known:
            raise UsageError(f"{folder / name}: is not what was written: its SHA-256 is another than in {MANIFEST}")
    return manifest is not None
