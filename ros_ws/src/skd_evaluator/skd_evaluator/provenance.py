"""Where results come from: what ran, of which code, when and on which machine. None of it is a figure."""

from __future__ import annotations

import datetime
import hashlib
import os
import platform
import shlex
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from skd_sim.options.car_under_test import CarUnderTest

from skd_evaluator.fingerprint import code_files, code_paths, in_words

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
    return {
        "date": now.isoformat(timespec="seconds").replace("+00:00", "Z"),
        **around,
        "controller_files": [
            {"path": path, "sha256": digest}
            for path, digest in code_files(car, controller_command).digests.items()
            if digest  # whoever has removed it meanwhile
        ],
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
        "folder": in_words(Path.cwd()),
        "git": git_revision(),
    }


def controller_revision(car: CarUnderTest, command: str, own: dict[str, Any] | None) -> dict[str, Any] | None:
    """Return the commit of the checkout that the last of a car's files is in; None: in none. This starts programs.

    Args:
        car: the car under test.
        command: command that starts the car's own node, if it has one.
        own: commit of the checkout that SKD's code is in, for its own cars.
    """
    if car.is_own:
        return own
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
