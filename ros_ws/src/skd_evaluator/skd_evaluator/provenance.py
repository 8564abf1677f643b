"""Where results come from: what ran, of which code, when and on which machine. None of it is a figure."""

from __future__ import annotations

import datetime
import hashlib
import os
import platform
import shlex
import shutil
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from importlib.machinery import PathFinder
from pathlib import Path
from typing import Any

from skd_sim.choices.car_under_test import CONTROLLERS, CarUnderTest
from skd_sim.errors import UsageError
from skd_sim.inputs.outside import sha256_of
from skd_sim.program.places import users_first

_GIT_PATIENCE = 10.0  # s


def provenance(
    command: Sequence[str],
    car: CarUnderTest,
    *,
    controller_command: str = "",
    car_model: str = "",
    surroundings: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Return the entry `provenance` of results, as JSON; its date is now.

    Args:
        command: words of the command line.
        car: the car under test.
        controller_command: command that starts the car's own node, if it has one.
        car_model: text of the model with which the adversary plans; empty: none was given.
        surroundings: what `surroundings_of` gave, and as `controller_git` what `controller_revision` gave; found out by
            default.
    """
    now = datetime.datetime.now(datetime.UTC)
    around = surroundings_of(command) if surroundings is None else surroundings
    files = controller_files(car, controller_command)
    return {
        "date": now.isoformat(timespec="seconds").replace("+00:00", "Z"),
        **around,
        "controller_files": [{"path": _in_words(path), "sha256": sha256_of(path)} for path in files],
        "controller_git": around["controller_git"]
        if "controller_git" in around
        else controller_revision(car, controller_command, around["git"]),
        "car_model_sha256": hashlib.sha256(car_model.encode()).hexdigest() if car_model else None,
    }


def surroundings_of(command: Sequence[str]) -> dict[str, Any]:
    """Return the part of the entry that is the same for all results of a command; this starts programs."""
    return {
        "host": platform.node(),
        "platform": platform.platform(),
        "python": platform.python_version(),
        "command": shlex.join(command),
        "folder": _in_words(Path.cwd()),
        "git": git_revision(),
    }


def _in_words(path: Path) -> str:
    """Return a path as a text that can be written: names of files may have bytes that are no UTF-8."""
    return os.fsencode(path).decode("utf-8", "backslashreplace")


def controller_revision(car: CarUnderTest, command: str, own: dict[str, Any] | None) -> dict[str, Any] | None:
    """Return the commit of the checkout that the last of a car's files is in; None: in none. This starts programs.

    Args:
        car: the car under test.
        command: command that starts the car's own node, if it has one.
        own: commit of the checkout that SKD's code is in, for its own cars.
    """
    if car.is_own:
        return own
    files = controller_files(car, command)
    return next(filter(None, map(git_revision, reversed(files))), None)


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
    # An environment inside somebody else's checkout is not part of it: the file has to be tracked there.
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


def controller_files(car: CarUnderTest, command: str = "") -> list[Path]:
    """Return the files that say how a car drives, as far as names lead to them; nothing of them is run.

    Of `package.module:Class`, or of a registered name, that is the module's; of a node's command line, every word that
    names a file.
    """
    if car.is_external:
        with suppress(ValueError):  # a quotation mark too many: it will not start either
            return list(dict.fromkeys(_regular(shlex.split(command))))
        return []
    try:
        target = CONTROLLERS.target(car.controller) if car.controller in CONTROLLERS else car.controller
    except UsageError:
        return []
    path = module_file(target)
    return [] if path is None else [path]


def _regular(names: Sequence[str]) -> Iterator[Path]:
    for name in names:
        with suppress(OSError, ValueError, RuntimeError):  # the last: of a home that nobody has
            path = Path(name).expanduser().resolve()
            if path.is_file() and os.access(path, os.R_OK):
                yield path


def module_file(target: str) -> Path | None:
    """Return the file of the module in `package.module:Class`, if one can be read; nothing is imported."""
    module = target.partition(":")[0]
    search: Sequence[str] | None = users_first()
    found = None
    parts = module.split(".")
    for number in range(1, len(parts) + 1):
        found = None if search is None else PathFinder.find_spec(".".join(parts[:number]), list(search))
        if found is None:
            return None
        search = found.submodule_search_locations
    if found is None or found.origin is None:
        return None
    return next(_regular([found.origin]), None)
