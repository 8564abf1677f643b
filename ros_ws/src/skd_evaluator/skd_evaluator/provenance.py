"""What results follow from beside their options: versions, the files of a user's code, when and where it ran.

A model that is kept, a campaign that goes on, and workers on other machines must have the same code. A user's code is
the folder of its package, with everything in it; of a module in no package it is the module and what lies beside it; of
a node it is what the words of its command name. Nothing of it is run.
"""

from __future__ import annotations

import datetime
import functools
import hashlib
import os
import platform
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from importlib.machinery import PathFinder
from importlib.metadata import version as version_of
from itertools import islice
from pathlib import Path
from typing import Any, Final

import skd_adversary
import skd_sim
from skd_sim.errors import UsageError
from skd_sim.inputs.files import sha256_of
from skd_sim.kernels.compilation import arithmetic_digest
from skd_sim.options.car_and_adversary import CONTROLLERS, CarUnderTest

from skd_evaluator.files import MARKERS, UNFINISHED
from skd_evaluator.version import version

MOST_FILES: Final = 2_000
"""Of a user's code; a folder with more is not looked through."""
_NOT_CODE = (".log", ".out", ".txt", ".md", ".html", ".xml", ".csv", ".yaml", ".yml")
"""Endings of files beside a module that are taken for what a command reads or writes."""


@functools.cache
def environment() -> Mapping[str, str]:
    """Return versions and digests, by the name of what they are of, which results to the bit depend on."""
    digest = hashlib.sha256()
    for folder in (Path(__file__).parent, *(Path(str(one.__file__)).parent for one in (skd_sim, skd_adversary))):
        for file in sorted(folder.rglob("*")):
            if file.is_file() and "__pycache__" not in file.parts:
                digest.update(f"{file.relative_to(folder.parent)}\0".encode())
                digest.update(file.read_bytes())
    return {
        "SKD": f"{version()} with sources {digest.hexdigest()[:12]}",
        "Python": platform.python_version(),
        **{name: version_of(name) for name in ("numpy", "scipy", "numba")},
        "platform": f"{platform.system()} on {platform.machine()}",
        "arithmetic": arithmetic_digest()[:12],
    }


def code_digests(car: CarUnderTest, command: str = "", others: Iterable[str] = ()) -> dict[str, str] | None:
    """Return the SHA-256 of each package folder, module or named file of a user's code, by its path.

    SKD's own cars have none, they go with its version.

    Args:
        car: the car under test.
        command: command that starts the car's own node, if it has one.
        others: `package.module:Class` of what else belongs to it, as a simulator.

    Returns:
        None where it is not known which files these are, or they are too many.
    """
    found = _files_of_code(car, command, others)
    return None if found is None else {path: digest_of(files) for path, files in found.items()}


def code_files(car: CarUnderTest, command: str = "") -> dict[str, str] | None:
    """Return the SHA-256 of each single file of a user's code, by its path; arguments and None as `code_digests`."""
    found = _files_of_code(car, command)
    return None if found is None else sums_of(found)


def sums_of(paths: Iterable[str]) -> dict[str, str]:
    """Return the SHA-256 of each file of packages and modules, by its path; nothing of what cannot be read."""
    found = {}
    for file in (file for path in paths for file in files_of(Path(path))):
        with suppress(OSError, UsageError):  # it was removed meanwhile
            found[str(file)] = sha256_of(file)
    return found


def _files_of_code(car: CarUnderTest, command: str, others: Iterable[str] = ()) -> dict[str, list[Path]] | None:
    """Return the files of a user's code by package folder, module or named file; None as `code_digests`."""
    paths = code_paths(car, command)
    if not paths and not car.is_own:
        return None
    paths += [path for target in others if (path := _path_of_target(target)) is not None]
    files = {str(path): files_of(path) for path in dict.fromkeys(paths)}
    return None if any(len(found) > MOST_FILES for found in files.values()) else files


def code_paths(car: CarUnderTest, command: str = "") -> list[Path]:
    """Return the package folder or the module that a car's name leads to, or what the words of its command name."""
    if car.is_own:
        return []
    if not car.is_external:
        with suppress(UsageError):
            target = CONTROLLERS.target(car.controller) if car.controller in CONTROLLERS else car.controller
            path = _path_of_target(target)
            return [] if path is None else [path]
        return []
    found: list[Path] = []
    with suppress(ValueError):  # a quotation mark too many: it will not start either
        words = shlex.split(command)
        for before, word in zip(["", *words], words, strict=False):
            path = _path_of_module(word) if before == "-m" else _path_named(word)
            found += [] if path is None else [path]
    return list(dict.fromkeys(found))


def files_of(path: Path) -> list[Path]:
    """Return the files in a package folder; or a module with what lies beside it, in no particular order.

    There are one more than `MOST_FILES` where there are too many.
    """
    if path.is_dir():
        return list(islice(_below(path), MOST_FILES + 1))
    found = [path] if path.is_file() else []
    if path.suffix == ".py" and "site-packages" not in path.parts:
        beside = (file for file in _below(path.parent) if file.suffix not in _NOT_CODE and file != path)
        found += islice(beside, MOST_FILES)
    return found


def digest_of(files: Sequence[Path]) -> str:
    """Return the SHA-256 of files with their names, from the folder on that they are in; empty for none."""
    if not files:
        return ""
    top = os.path.commonpath([file.parent for file in files])
    digest = hashlib.sha256()
    for file in files:
        with suppress(OSError, UsageError):  # it was removed meanwhile
            digest.update(os.fsencode(os.path.relpath(file, top)) + b"\0")
            digest.update(sha256_of(file).encode())
    return digest.hexdigest()


def _path_of_target(target: str) -> Path | None:
    """Return the file, or the folder of the package, that `file.py:Class` or `package.module:Class` leads to."""
    module = target.rpartition(":")[0]
    if not module.endswith(".py"):
        return _path_of_module(module)
    path = Path(module)
    inside = [folder for folder in path.parents if (folder / "__init__.py").is_file()]
    return inside[-1] if inside else path if path.is_file() else None


def _path_of_module(module: str) -> Path | None:
    """Return the folder of the package that a module is in, or the module's file; nothing is imported."""
    if module == "__main__":
        program = getattr(sys.modules["__main__"], "__file__", None)
        return None if program is None else Path(program).resolve()
    spec = PathFinder.find_spec(module.partition(".")[0], sys.path)
    if spec is None:
        return None
    folders = list(spec.submodule_search_locations or ())
    origin = folders[0] if folders else spec.origin
    return Path(origin).absolute() if origin is not None and Path(origin).exists() else None


def _path_named(word: str) -> Path | None:
    """Return the file or folder that a word of a command names, or what is behind its `=`; no program of the system."""
    for name in (word, word.rpartition("=")[2]):
        with suppress(OSError, ValueError, RuntimeError):  # the last: of a home that is not there
            path = Path(name).expanduser().absolute()
            if name and (path.is_dir() or path.is_file()) and path.parent.name != "bin":
                return path
    return None


def _below(folder: Path) -> Iterator[Path]:
    """Yield the files in a folder and below it, in the order of their names, but for results and environments."""
    for top, folders, names in os.walk(folder, followlinks=True):
        folders[:] = sorted(one for one in folders if not one.startswith((".", "__pycache__")))
        written = "manifest.sha256" in names and not set(MARKERS).isdisjoint(names)
        if written or not {"cells.json", "pyvenv.cfg"}.isdisjoint(names):
            folders.clear()
            continue
        for name in sorted(names):
            file = Path(top, name)
            written = name.endswith((".pyc", ".pyo")) or UNFINISHED in name
            if not (name.startswith(".") or written) and file.is_file():
                yield file


_GIT_PATIENCE = 10.0  # s


def provenance(command: Sequence[str], car: CarUnderTest, *, controller_command: str = "") -> dict[str, Any]:
    """Return the entry `provenance` of results, as JSON; its date is now. This starts programs.

    Args:
        command: words of the command line.
        car: the car under test.
        controller_command: command that starts the car's own node, if it has one.
    """
    digests = code_digests(car, controller_command) or {}
    return {
        "date": date_now(),
        "host": platform.node(),
        "platform": platform.platform(),
        "python": platform.python_version(),
        "command": shlex.join(command),
        "folder": str(Path.cwd()),
        "git": git_revision(),
        # Without a digest: it was removed meanwhile.
        "controller_files": [{"path": path, "sha256": digest} for path, digest in digests.items() if digest],
        "controller_git": controller_revision(car, controller_command),
        "car_model_sha256": None,  # until it is known
        "inputs_sha256": None,  # only `skd assess` knows it
    }


def date_now() -> str:
    """Return the date and time, as `provenance` says it."""
    now = datetime.datetime.now(datetime.UTC)
    return now.isoformat(timespec="seconds").replace("+00:00", "Z")


def controller_revision(car: CarUnderTest, command: str = "") -> dict[str, Any] | None:
    """Return the commit of the checkout that the last of a car's files is in; None: in none. This starts programs.

    Args:
        car: the car under test.
        command: command that starts the car's own node, if it has one.
    """
    if car.is_own:
        return git_revision()
    return next(filter(None, map(git_revision, reversed(code_paths(car, command)))), None)


def code_of_car(figures: Mapping[str, Any]) -> dict[str, Any] | None:
    """Return the commit of a car's code, as `git_revision` does; None: it is not known.

    Of SKD's own cars alone it is that of SKD: what drives a user's car, SKD's commit says nothing of.

    Args:
        figures: content of an assessment.json.
    """
    origin = figures.get("provenance") or {}
    own = CarUnderTest(str(figures.get("controller"))).is_own
    found: dict[str, Any] | None = origin.get("controller_git") or (origin.get("git") if own else None)
    return found


def git_revision(file: Path = Path(__file__)) -> dict[str, Any] | None:
    """Return the commit of the checkout that code is in, and whether files of it differ from that; None: in none.

    Args:
        file: a file of the code; by default SKD's own.
    """
    here, git = file.resolve().parent, shutil.which("git")
    # An environment inside another checkout is not part of it: the file has to be tracked there.
    if git is None or _git(git, here, "ls-files", "--error-unmatch", "--", file.name) is None:
        return None
    revision = _git(git, here, "rev-parse", "HEAD")
    changed = _git(git, here, "status", "--porcelain", "--untracked-files=no")
    return None if revision is None else {"revision": revision.strip(), "modified": bool(changed and changed.strip())}


def _git(git: str, folder: Path, *words: str) -> str | None:
    """Return what git says in a folder; None where it fails. A hook's variables would lead it elsewhere."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}
    with suppress(OSError, subprocess.SubprocessError, UnicodeDecodeError):
        done = subprocess.run(
            [git, "-C", str(folder), *words], env=environment, capture_output=True, text=True, timeout=_GIT_PATIENCE
        )
        return done.stdout if done.returncode == 0 else None
    return None
