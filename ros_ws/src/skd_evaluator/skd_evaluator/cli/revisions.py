"""Revisions of a user's controller in git: each is checked out into a folder of its own, never the user's tree."""

from __future__ import annotations

import argparse
import hashlib
import itertools
import os
import re
import shutil
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from importlib.machinery import PathFinder
from pathlib import Path

from skd_sim.errors import UsageError
from skd_sim.options.car_and_adversary import CONTROLLERS, CarUnderTest, is_own_world
from skd_sim.options.options import options_of
from skd_sim.options.registry import CHECKOUTS

from skd_evaluator.assessment.context import Progress
from skd_evaluator.assessment.options import AssessmentOptions, CampaignOptions
from skd_evaluator.cli.main import make_parser, parse

_NOT_CODE = (".md", ".rst")


class Repository:
    """The git repository that a user's controller is in.

    Attributes:
        top: its folder.
        file: file of the controller, from there on.
        name: class of the controller in it.
        storage: folder in which git keeps what is its own.
    """

    def __init__(self, controller: str) -> None:
        """Find it. What is imported from its files is imported from checkouts from now on.

        Args:
            controller: `file.py:Class` or `package.module:Class`, as the command line has it.

        Raises:
            UsageError: the controller is in none, or there is no git.
        """
        car = CarUnderTest(controller)
        if car.is_own or car.is_external:
            raise UsageError(f"--controller {controller}: give one of your own, file.py:Class or package.module:Class")
        target = CONTROLLERS.target(car.controller) if car.controller in CONTROLLERS else car.controller
        module, _, self.name = target.rpartition(":")
        file = Path(module) if module.endswith(".py") else _file_of(module)
        if file is None or not file.is_file():
            raise UsageError(f"--controller {controller}: its file is not found")
        self.top = file.parent
        self.top = Path(self.git("rev-parse", "--show-toplevel"))
        self.file = file.resolve().relative_to(self.top.resolve())
        if not self.git("ls-files", "--", str(self.file)):
            raise UsageError(f"--controller {controller}: {self.file} is not in git; add and commit it")
        self.storage = (self.top / self.git("rev-parse", "--git-common-dir")).resolve()
        inside = [one for one in sys.path if Path(one).resolve().is_relative_to(self.top.resolve())]
        tracked = [one for one in inside if self.git("ls-files", "--", str(Path(one).resolve()))]
        self._folders = tuple(str(Path(one).resolve().relative_to(self.top.resolve())) for one in tracked)
        sys.path[:] = [one for one in sys.path if one not in tracked]

    def git(self, *words: str, folder: Path | None = None, fine: Collection[int] = (0,)) -> str:
        """Return what git says, without the variables that a hook sets, where its exit code is fine.

        Raises:
            UsageError: it fails.
        """
        git = shutil.which("git")
        if git is None:
            raise UsageError("git is not installed")
        variables = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}
        command = [git, "-c", f"core.hooksPath={os.devnull}", "-C", str(folder or self.top), *words]
        done = subprocess.run(command, env={**variables, "LC_ALL": "C"}, capture_output=True, text=True)
        if done.returncode not in fine:
            said = done.stderr.strip() or done.stdout.strip()
            raise UsageError(f"git {' '.join(words)}: {said.splitlines()[-1] if said else done.returncode}")
        return done.stdout.strip()

    def commit(self, revision: str) -> str:
        """Return the hash of a revision's commit.

        Raises:
            UsageError: there is none.
        """
        words = ("rev-parse", "--verify", "--quiet", "--end-of-options", f"{revision}^{{commit}}")
        found = self.git(*words, fine=(0, 1))
        if not found:
            raise UsageError(f"{revision}: no such commit in {self.top}")
        return found

    def subject(self, commit: str) -> str:
        """Return a commit's short hash, and what it says in its first line."""
        return self.git("log", "-1", "--format=%h %s", commit)

    def content(self, commit: str) -> str:
        """Return a digest of all files of a commit but its documentation."""
        lines = self.git("ls-tree", "-r", "-z", commit).split("\0")
        code = "\0".join(line for line in lines if not line.endswith(_NOT_CODE))
        return hashlib.sha256(code.encode()).hexdigest()[:16]

    @contextmanager
    def checkouts(self) -> Iterator[Path]:
        """Yield a folder for checkouts, which git forgets afterwards; enter it before workers are started."""
        with tempfile.TemporaryDirectory(prefix="skd-revisions-") as folder:
            CHECKOUTS[str(Path(folder).resolve())] = self._folders
            try:
                yield Path(folder).resolve()
            finally:
                shutil.rmtree(folder, ignore_errors=True)
                self.git("worktree", "prune")

    def controller_at(self, commit: str, folder: Path) -> str:
        """Check a commit out below a folder, unless it is there, and return its controller, as `file.py:Class`.

        Raises:
            UsageError: git fails, or the commit has no such file.
        """
        place = folder / commit
        if not place.is_dir():
            self.git("worktree", "add", "--quiet", "--detach", str(place), commit)
        if not (place / self.file).is_file():
            raise UsageError(f"{commit[:10]} has no {self.file}")
        return f"{place / self.file}:{self.name}"

    def bisect(self, good: str, bad: str, folder: Path, judge: Callable[[str], str]) -> list[str]:
        """Return the first bad commit; or all that may be it, where revisions between them were skipped.

        Args:
            good: a commit.
            bad: a later one.
            folder: for worktrees.
            judge: returns `good`, `bad` or `skip` for a commit.

        Raises:
            UsageError: git fails, as where good is no ancestor of bad.
        """
        place = folder / "bisect"
        self.git("worktree", "add", "--quiet", "--detach", "--no-checkout", str(place), bad)
        said = self.git("bisect", "start", "--no-checkout", bad, good, folder=place)
        while True:
            if found := re.search(r"^([0-9a-f]{40,}) is the first bad commit", said, re.MULTILINE):
                return [found[1]]
            if "could be any of" in said:
                return re.findall(r"^[0-9a-f]{40,}$", said, re.MULTILINE)
            word = judge(self.git("rev-parse", "BISECT_HEAD", folder=place))
            said = self.git("bisect", word, folder=place, fine=(0, 2))

    @contextmanager
    def assessed(
        self, revisions: Sequence[str], request: argparse.Namespace, progress: Progress
    ) -> Iterator[list[Path]]:
        """Rate the car of some revisions, and yield the folders of the results, which can be run until this ends.

        Args:
            revisions: in git's words.
            request: options of `skd assess`.
            progress: called with how far the work is.

        Raises:
            UsageError: there is no such revision, or its car cannot be loaded.
            AssessmentError: it fails.
        """
        from skd_evaluator.library import assess

        options = {one.name for table in (CampaignOptions, AssessmentOptions) for one in options_of(table)}
        given = {name: value for name, value in vars(request).items() if name in options and value is not None}
        with self.checkouts() as folder, warnings.catch_warnings(action="ignore"):  # they are part of the results
            found = []
            for revision in revisions:
                given["controller"] = self.controller_at(self.commit(revision), folder)
                given["name"] = re.sub(r"\W+", "-", f"{self.name}-{revision}")
                found.append(folder / "results" / given["name"])
                assess(scenario=request.scenario, out=found[-1], workers=request.workers, progress=progress, **given)
            yield found


def assess_request(words: Sequence[str], defaults: Sequence[str] = ()) -> argparse.Namespace:
    """Return the options of `skd assess` that some words give, which may begin with its name, and others by default.

    Raises:
        UsageError: one of them does not go with revisions.
    """
    given = itertools.dropwhile(lambda word: not word.startswith("-"), words)
    request = parse(make_parser(["assess"]), ["assess", *defaults, *given])
    if request.graph or not is_own_world(request.simulator):
        raise UsageError("cars of revisions run in process and in SKD's own world: leave out --graph and --simulator")
    return request


def _file_of(module: str) -> Path | None:
    """Return the file of a module, without importing anything; None: it is not found."""
    names, folders = module.split("."), sys.path
    for name in names[:-1]:
        spec = PathFinder.find_spec(name, folders)
        folders = list((spec and spec.submodule_search_locations) or ())
    spec = PathFinder.find_spec(names[-1], folders)
    return None if spec is None or spec.origin is None else Path(spec.origin)
