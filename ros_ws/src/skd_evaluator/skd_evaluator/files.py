"""Files that are written elsewhere and then put in their place, and which results a command has put there."""

from __future__ import annotations

import errno
import os
import shutil
import stat
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from skd_sim.errors import UsageError
from skd_sim.inputs.files import real_path

MARKERS: Final = (
    "assessment.json", "sweep.json", "episode.json", "probe.json", "car_model.yaml", "comparison.json", "show.json",
    "fusion.json", "scenarios.json", "behaviour.yaml", "protocol.json",
    "export.json", "import.json", "log.json", "simulator.json",
)  # fmt: skip
"""A folder with one of these holds results of ours."""
PREFIX: Final = ".skd-"
"""Of names of temporary files and folders, which lie beside what they become; one that was killed leaves them."""
UNFINISHED: Final = ".unfinished.sqlite"
"""End of the name of the file beside results in which episodes are kept until these are written."""


def tails(folders: Sequence[Path]) -> list[str]:
    """Return of each folder as little of the end of its path as tells all of them apart."""
    parts = [real_path(folder).parts for folder in folders]
    count = 1
    while count < max(map(len, parts), default=0) and len({one[-count:] for one in parts}) < len(set(parts)):
        count += 1
    return [str(Path(*one[-count:])) for one in parts]


def check_folder(path: Path) -> None:
    """Refuse what is no folder, in which results would be looked for.

    Raises:
        UsageError: it is a file, or is not there.
    """
    if not path.is_dir():
        said = "is a file; give the folder of a result" if path.exists() else "there is no such folder"
        raise UsageError(f"{path}: {said}")


def check_file(path: Path, option: str, *, overwrite: bool = True) -> None:
    """Refuse, before any work, what `write_file` would not replace.

    Args:
        path: where the file is to be, as the user has named it.
        option: the option that names it, for error lines.
        overwrite: whether a file that is there may be replaced.

    Raises:
        UsageError: it is a folder, a device, a pipe or a socket, or leads to one, or it is there already.
    """
    try:
        found = path.stat()
    except FileNotFoundError:
        return
    except OSError as error:  # links in a circle, a file in the place of a folder, a name that is too long
        raise UsageError(f"{option} {path}: cannot be written ({error.strerror}); give another file") from error
    if stat.S_ISDIR(found.st_mode):
        raise UsageError(f"{option} {path}: is a folder; give the name of a file")
    if not stat.S_ISREG(found.st_mode):
        raise UsageError(f"{option} {path}: is a device, a pipe or a socket; give the name of a file")
    if not overwrite:
        raise UsageError(f"{option} {path}: is there already; add --overwrite to replace it")


def write_file(path: Path, text: str, *, overwrite: bool = True) -> None:
    """Write a file that a user has named: elsewhere, and then in its place, so that it is there whole or not at all.

    A link stays, and what it leads to is written.

    Raises:
        OSError: it cannot be written, or is there though it may not be replaced; what is there has not changed.
    """
    target = real_path(path)
    if path.exists() and not (overwrite and path.is_file()):
        raise OSError(errno.EEXIST, "something is there already")
    target.parent.mkdir(parents=True, exist_ok=True)
    replace_file(target, text)
    note_in_place(path)


def replace_file(path: Path, text: str) -> None:
    """Write a file so that after whatever happens it is the old one or the new one.

    Raises:
        OSError: it cannot be written.
    """
    temporary = path.with_name(f"{PREFIX}{os.getpid()}")
    try:
        with temporary.open("w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        if path.exists():
            shutil.copymode(path, temporary)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def keep(file: Path, content: bytes) -> bool:
    """Put a file into the user's cache, whole; return whether that was possible."""
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=file.parent, prefix=PREFIX, delete=False) as stream:
            stream.write(content)
        Path(stream.name).replace(file)
    except OSError:
        return False
    return True


def unfinished(out: Path) -> Path:
    """Return the file beside the results in which episodes are kept until these are written."""
    return out.with_name(f"{out.name}{UNFINISHED}")


def is_unfinished(out: Path) -> bool:
    """Return whether episodes of an interrupted assessment are kept beside a folder."""
    return os.path.isfile(unfinished(out))  # noqa: PTH113 - which is false of a name that no file can have


def umask() -> int:
    """Return the mask of permissions that new files of this process do not get."""
    mask = os.umask(0)
    os.umask(mask)
    return mask


def make_temporary(parent: Path) -> Path:
    """Make a temporary folder of this process.

    Raises:
        OSError: it cannot be made.
    """
    return Path(tempfile.mkdtemp(prefix=f"{PREFIX}{os.getpid()}-", dir=parent))


def remove(folder: Path) -> None:
    """Remove a folder, wholly also where an interrupt comes meanwhile; what cannot be removed stays."""
    try:
        shutil.rmtree(folder, ignore_errors=True)
    except KeyboardInterrupt:
        shutil.rmtree(folder, ignore_errors=True)
        raise


_in_place: Final[list[Path]] = []


def begin_command() -> None:
    """Forget what a command of before has written: this process may run several."""
    _in_place.clear()


def note_in_place(path: Path) -> None:
    """Note that results are in their place, whole: what comes afterwards takes nothing of them back."""
    _in_place.append(path)


def what_is_in_place() -> str:
    """Return what an interrupted command has written, in a few words."""
    return f"results are in {' and '.join(map(str, _in_place))}" if _in_place else "nothing was written"
