"""The files that say which car is rated: for the kept model, for going on with a campaign, and for results.

They are the code that the car's name, or its command, leads to, the modules that this imports, and whatever lies beside
either, such as the weights of a net. Nothing of them is run: imports are read from the source.
"""

from __future__ import annotations

import hashlib
import os
import shlex
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from importlib.machinery import PathFinder
from pathlib import Path
from typing import Final

from skd_sim.choices.car_under_test import CONTROLLERS, CarUnderTest
from skd_sim.errors import UsageError
from skd_sim.inputs.outside import sha256_of

from skd_evaluator.campaign.plan.imports import imports_of, is_installed
from skd_evaluator.files import MARKERS

MOST_FILES: Final = 2_000
MOST_BYTES: Final = 2**30
LISTED: Final = 100
"""Files that a result names one by one; what is beyond has one digest."""

_LAUNCHERS = ("python", "pypy", "ros2", "bash", "sh", "dash", "zsh", "env", "docker", "podman", "nice", "xvfb-run")
_SCRIPTS = (".py", ".sh", ".bash")
_ENDINGS = (".log", ".pyc", ".pyo")
_NO_PART = ("__pycache__", "skd_results", "nohup.out")
_RACY = 2.0  # s: a file that was changed a moment ago may change once more without that its times say so
_KNOWN: Final[dict[tuple[int, ...], str]] = {}  # digests by device, number, size and times of a file
_LEFT_OUT: Final[set[str]] = set()


@dataclass(frozen=True)
class CarFiles:
    """The files of a car.

    Attributes:
        code: files that its name, or the words of its command, lead to, and what these import; in this order.
        beside: the others; none where there are too many.
        names: names that are the same on another machine, in the order of `all`: from the folder of the package on.
        why_not: why these are not all, in words that follow *because*; empty: they are all that is known of.
    """

    code: tuple[Path, ...]
    beside: tuple[Path, ...]
    names: tuple[str, ...]
    why_not: str

    @property
    def all(self) -> tuple[Path, ...]:
        """All files."""
        return (*self.code, *self.beside)

    @cached_property
    def sha256(self) -> tuple[str, ...]:
        """The SHA-256 of each, in the order of `all`; empty where one cannot be read any more."""
        return tuple(map(digest_of, self.all))

    @cached_property
    def digests(self) -> dict[str, str]:
        """The SHA-256 by path, of the first `LISTED`; of all that are beyond one digest, under their number."""
        pairs = [(in_words(path), digest) for path, digest in zip(self.all, self.sha256, strict=True)]
        found, rest = dict(pairs[:LISTED]), pairs[LISTED:]
        if rest:
            lines = "".join(f"{digest}  {name}\n" for name, digest in rest)
            found[f"{len(rest)} further files"] = hashlib.sha256(lines.encode()).hexdigest()
        return found


def in_words(path: Path) -> str:
    """Return a path as a text that can be written: names of files may have bytes that are no UTF-8."""
    return os.fsencode(path).decode("utf-8", "backslashreplace")


def leave_out(paths: Iterable[Path]) -> None:
    """From now on take some files and folders for no part of any car, such as what a command writes."""
    with suppress(OSError, ValueError):
        _LEFT_OUT.update(os.path.realpath(path) for path in paths)


def controller_files(car: CarUnderTest, command: str = "") -> list[Path]:
    """Return the files that the name of a car leads to, or the words of its command; nothing of them is run.

    Of `package.module:Class`, or of a registered name, that is the module's; of a node's command line, every word that
    names a file.
    """
    if car.is_external:
        return list(_starts(car, command).files)
    target = _target(car)
    if target.startswith("__main__:"):
        return [one for one in _starts(car, command).files if one.is_file()]
    path = module_file(target)
    return [] if path is None else [path]


def module_file(target: str) -> Path | None:
    """Return the file of the module in `package.module:Class`, if one can be read; nothing is imported."""
    module = target.partition(":")[0]
    found = list(_modules(module, sys.path))
    return found[-1].file if found and found[-1].name == module else None


def car_files(car: CarUnderTest, command: str = "", others: Sequence[str] = ()) -> CarFiles:
    """Return the files of a car.

    Args:
        car: the car under test. Of SKD's own, that is the module's file: the rest goes with SKD's version.
        command: command that starts the car's own node, if it has one.
        others: `package.module:Class` of what else drives it, as a simulator of a user's.
    """
    starts = _starts(car, command)
    if car.is_own:
        starts.whole.clear()
    for target in others:
        starts.add_module(target.partition(":")[0])
    if others or not car.is_own:
        starts.follow_imports()
    code = [one for one in starts.files if one.is_file()]
    why_not = "" if code or car.is_own else "no file of it is known"
    if car.is_external and not starts.says_which:
        why_not = "its command names no file of it" if command else "SKD has not started it"
    try:
        beside = sorted({path for folder in starts.whole for path in _files_below(folder)} - set(code))
        _refuse_many(beside, starts.whole)
    except _TooManyError as error:
        beside, why_not = [], str(error)
    names = tuple(starts.name_of(path) for path in (*code, *beside))
    return CarFiles(tuple(code), tuple(beside), names, why_not)


@dataclass(frozen=True)
class _Found:
    """A module: its dotted name, file, and the folder that belongs to it as a whole; None: the file alone does."""

    name: str
    file: Path
    folder: Path | None


class _Starts:
    """Files that names lead to, and the folders that belong to them as a whole.

    Attributes:
        files: the files, in the order in which they were found.
        whole: folders by their path, each with the folder from which names of its files go.
        says_which: whether a file is among them that is not only a program that starts others.
    """

    def __init__(self) -> None:
        """Have none."""
        self.files: dict[Path, None] = {}
        self.whole: dict[Path, Path] = {}
        self.says_which = False
        self._search: dict[Path, tuple[str, ...]] = {}  # where the imports of a file are looked for

    def add_module(self, name: str, search: Sequence[str] | None = None) -> bool:
        """Add a module, those above it and what belongs to them; tell whether there is one."""
        search = tuple(sys.path if search is None else search)
        found = list(_modules(name, search))
        for one in reversed(found):  # the module itself first
            self._add(one.file, one.folder, search)
        return bool(found) and found[-1].name == name

    def add_word(self, word: str) -> None:
        """Add the file or folder that a word of a command names, or what is behind its `=`, if it names one."""
        for name in dict.fromkeys((word, word.rpartition("=")[2])):
            for path in _there([name]):
                if path.is_dir():
                    self.whole.setdefault(path, path)
                    continue
                launcher = path.name.rstrip("0123456789.") in _LAUNCHERS or Path(name).name in _LAUNCHERS
                self.says_which |= not launcher
                alone = launcher or path.parent.name == "bin" or is_installed(path) or not _is_script(path)
                search = (str(path.parent), *sys.path)
                self._add(path, None if alone else _top(path.parent), search)

    def add_program(self, path: Path) -> None:
        """Add a program in Python, and what lies beside it."""
        self._add(path.resolve(), path.resolve().parent, (str(path.parent), *sys.path))

    def _add(self, file: Path, folder: Path | None, search: tuple[str, ...]) -> None:
        self.files.setdefault(file)
        self._search.setdefault(file, search)
        for one in dict.fromkeys(() if folder is None else (folder.resolve(), file.parent)):  # also where a link leads
            if not any(one.is_relative_to(known) for known in self.whole):
                self.whole[one] = one.parent if (one / "__init__.py").exists() else one

    def follow_imports(self) -> None:
        """Add the modules that are imported, and those that these import; what is installed, and SKD, is left out."""
        waiting = list(self.files)
        while waiting:
            file = waiting.pop()
            if not _is_script(file):
                continue
            known, search = set(self.files), self._search[file]
            for name in imports_of(file, digest_of(file)):
                if name.startswith("."):
                    self._add_relative(file, name, search)
                    continue
                for one in _modules(name, search):
                    own = any(one.file.is_relative_to(folder) for folder in self.whole)
                    if own or not is_installed(one.file):
                        self._add(one.file, one.folder, search)
            waiting += [one for one in self.files if one not in known]
            if len(self.files) > MOST_FILES:
                return

    def _add_relative(self, file: Path, name: str, search: tuple[str, ...]) -> None:
        inner = name.lstrip(".")
        base = file.parents[min(len(name) - len(inner), len(file.parents)) - 1].joinpath(*inner.split("."))
        for path in (base.with_name(f"{base.name}.py"), base / "__init__.py"):
            if path.is_file():
                self.files.setdefault(path)
                self._search.setdefault(path, search)

    def name_of(self, path: Path) -> str:
        """Return the name of a file from the folder on in which its package, or module, is."""
        for folder, base in self.whole.items():
            if path.is_relative_to(folder):
                return path.relative_to(base).as_posix()
        return path.name


def _starts(car: CarUnderTest, command: str) -> _Starts:
    """Return what the name of a car, or its command, leads to."""
    found = _Starts()
    if car.is_external:
        with suppress(ValueError):  # a quotation mark too many: it will not start either
            words = shlex.split(command)
            for before, word in zip(["", *words], words, strict=False):
                if before == "-m":
                    found.says_which |= found.add_module(word)
                else:
                    found.add_word(word)
        return found
    module = _target(car).partition(":")[0]
    if module == "__main__":
        program = getattr(sys.modules["__main__"], "__file__", None)
        if program is not None:
            found.add_program(Path(program))
    elif not found.add_module(module):
        return _Starts()
    return found


def _target(car: CarUnderTest) -> str:
    """Return `package.module:Class` of a car; empty where its name leads to none."""
    with suppress(UsageError):
        return CONTROLLERS.target(car.controller) if car.controller in CONTROLLERS else car.controller
    return ""


def _modules(name: str, search: Sequence[str]) -> Iterator[_Found]:
    """Yield a module and the packages that it is in, from above, as far as they are there; nothing is imported."""
    places: Sequence[str] | None = search
    top: Path | None = None
    parts = name.split(".")
    for number, part in enumerate(parts, start=1):
        dotted = ".".join(parts[:number])
        # Asked by the last part: of a whole name it would look for the package above, which nobody has imported.
        spec = None if places is None or not all(parts) else PathFinder.find_spec(part, places)
        if spec is None:
            return
        places = None if spec.submodule_search_locations is None else list(spec.submodule_search_locations)
        origin = Path(spec.origin) if spec.origin else None
        if number == 1 and places is not None:
            top = Path(next(iter(places))) if origin is None else _top(origin.parent)
        for file in () if origin is None else _there([str(origin)]):
            alone = top is None and is_installed(origin or file)
            yield _Found(dotted, file, None if alone else top or _top((origin or file).absolute().parent))


def _top(folder: Path) -> Path:
    """Return the folder of the package that a folder is a part of; the folder itself if it is of none."""
    while (folder / "__init__.py").exists() and (folder.parent / "__init__.py").exists():
        folder = folder.parent
    return folder


def _there(names: Iterable[str]) -> Iterator[Path]:
    """Yield the files and folders of some names, where there are such."""
    for name in names:
        with suppress(OSError, ValueError, RuntimeError):  # the last: of a home that nobody has
            path = Path(name).expanduser().resolve()
            if name and (path.is_file() or path.is_dir()) and os.access(path, os.R_OK):
                yield path


def _is_script(path: Path) -> bool:
    if path.suffix in _SCRIPTS:
        return True
    with suppress(OSError), path.open("rb") as file:
        return file.read(2) == b"#!"
    return False


# --- what lies beside


class _TooManyError(Exception):
    """There are too many files; says so."""


def _refuse_many(files: Sequence[Path], folders: Iterable[Path]) -> None:
    size = 0
    for path in files:
        with suppress(OSError):
            size += path.stat().st_size
    if len(files) > MOST_FILES or size > MOST_BYTES:
        where = in_words(next(iter(folders)))
        limit = f"{MOST_FILES:,} files" if len(files) > MOST_FILES else f"{MOST_BYTES // 2**20:,} MiB"
        raise _TooManyError(f"more than {limit} lie in {where}")


def _files_below(top: Path) -> Iterator[Path]:
    """Yield the regular files in a folder and below it that may be a car's; links are followed, each folder once.

    Raises:
        _TooManyError: there are too many to look at.
    """
    seen: set[tuple[int, int]] = set()
    said = _told_to()
    count = 0
    waiting = [top]
    while waiting:
        folder = waiting.pop()
        with suppress(OSError):
            state = folder.stat()
            if (state.st_dev, state.st_ino) in seen:
                continue
            seen.add((state.st_dev, state.st_ino))
            with os.scandir(folder) as entries:
                inside = sorted(entries, key=lambda one: one.name)
            if folder != top and _is_no_part({one.name for one in inside}):
                continue
            for one in inside:
                if one.name.startswith(".") or one.name in _NO_PART or one.name.endswith(_ENDINGS):
                    continue
                path = Path(one.path)
                if _LEFT_OUT and os.path.realpath(path) in _LEFT_OUT:
                    continue
                if one.is_dir():
                    waiting.append(path)
                elif one.is_file() and os.access(path, os.R_OK) and _numbers(path) not in said:
                    count += 1
                    yield path
                if count > MOST_FILES:
                    break
        if count > MOST_FILES or len(seen) > MOST_FILES:
            raise _TooManyError(f"more than {MOST_FILES:,} files lie in {in_words(top)}")


def _is_no_part(names: set[str]) -> bool:
    """Return whether a folder with files of these names is a result of SKD, or an environment of Python."""
    result = "manifest.sha256" in names and not names.isdisjoint(MARKERS)
    return result or "pyvenv.cfg" in names or {"cells.json", ".lock"} <= names


def _numbers(path: Path) -> tuple[int, int]:
    state = path.stat()
    return state.st_dev, state.st_ino


def _told_to() -> set[tuple[int, int]]:
    """Return the device and number of what this process prints into: it grows meanwhile."""
    found = set()
    for descriptor in (1, 2):
        with suppress(OSError):
            state = os.fstat(descriptor)
            found.add((state.st_dev, state.st_ino))
    return found


def digest_of(path: Path) -> str:
    """Return the SHA-256 of a file, read once as long as it stays as it is; empty where it cannot be read."""
    try:
        state = path.stat()
        key = (state.st_dev, state.st_ino, state.st_size, state.st_mtime_ns, state.st_ctime_ns)
        if key not in _KNOWN:
            digest = sha256_of(path)
            if time.time() - state.st_ctime < _RACY:
                return digest
            _KNOWN[key] = digest
        return _KNOWN[key]
    except (OSError, UsageError):
        return ""
