"""What the workers of a Dask cluster do for a campaign: see that they are like its own process, and run chunks."""

from __future__ import annotations

import functools
import importlib.util
import pickle
import platform
import sys
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.abc import ExecutionLoader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.metadata import version as version_of
from pathlib import Path
from typing import Final, NamedTuple

from skd_sim.controllers.isolated import end_children, set_call_limit
from skd_sim.errors import UsageError
from skd_sim.options.car_under_test import CONTROLLERS, CarUnderTest

from skd_evaluator.assessment.run.workers import do, warm_up_with
from skd_evaluator.provenance import code_paths, digest_of, environment, files_of

_PROTOCOL = 4
"""Of pickled answers. From 5 on a small array comes back as a view of a view of bytes, which takes twice the memory."""
_alone = threading.Lock()  # a process runs one chunk at a time, however many threads its worker has


class SentModule(NamedTuple):
    """A module that is not on this machine: the path it has elsewhere, and what stands there."""

    path: str
    source: bytes


class _SentModules(ExecutionLoader, MetaPathFinder):
    """Imports modules from memory: for the children in which users' controllers run."""

    def __init__(self) -> None:
        self.known: dict[str, SentModule] = {}

    def add(self, name: str, module: SentModule) -> None:
        """Have children find a module before any other of its name; those that had another one begin anew."""
        if self not in sys.meta_path:
            sys.meta_path.insert(0, self)
        if self.known.get(name) != module:
            self.known[name] = module
            end_children()

    def find_spec(self, fullname: str, path: object = None, target: object = None) -> ModuleSpec | None:
        """Find a module that was sent."""
        return importlib.util.spec_from_loader(fullname, self) if fullname in self.known else None

    def get_source(self, fullname: str) -> str:
        """Return its text."""
        return importlib.util.decode_source(self.known[fullname].source)

    def get_filename(self, fullname: str) -> str:
        """Return its path where it came from."""
        return self.known[fullname].path


_sent_modules: Final = _SentModules()


@functools.cache
def description() -> Mapping[str, str]:
    """Return what must be the same in all processes that share a campaign, as their results are the same to the bit."""
    return {**environment(), "distributed": version_of("distributed")}


def difference(theirs: Mapping[str, str], ours: Mapping[str, str]) -> str | None:
    """Return in what two descriptions differ, in a few words; none where they do not."""
    for name in ours:
        if theirs.get(name) != ours[name]:
            return f"{name} {theirs.get(name, 'unknown')} instead of {ours[name]}"
    return None


@dataclass(frozen=True)
class SentController:
    """A controller of a user's own, for workers on other machines.

    Attributes:
        name: name of the controller.
        module: name of the module that holds its class.
        path: path of the module's file, or of its package's folder, on the machine where the campaign runs.
        sha256: digest of the package, or of what lies beside the module; empty: nothing does, or no file was found.
        source: content of the file if the module is no part of a package; None: workers have to have it installed.
    """

    name: str
    module: str
    path: str
    sha256: str
    source: bytes | None


def sent(car: CarUnderTest) -> SentController:
    """Return the controller of a car, ready to be sent; nothing of it is run."""
    target = CONTROLLERS.target(car.controller) if car.controller in CONTROLLERS else car.controller
    module = target.partition(":")[0]
    for path in code_paths(car):
        source = path.read_bytes() if path.is_file() else None
        return SentController(car.controller, module, str(path), _digest_beside(path), source)
    return SentController(car.controller, module, "", "", None)


def _digest_beside(path: Path) -> str:
    """Return the digest of a package's folder, or of all that lies beside a module."""
    return digest_of([file for file in files_of(path) if file != path])


def _have(controller: SentController) -> None:
    """See that a controller here is that of the campaign.

    Raises:
        UsageError: its package is another, or not there, or what lies beside its module.
    """
    here = sent(CarUnderTest(controller.name)).sha256 if controller.source is None else controller.sha256
    if controller.source is not None and controller.sha256:
        here = _digest_beside(Path(controller.path))
    if here != controller.sha256:
        what = "has other files of" if here else "does not have"
        raise UsageError(
            f"worker on {platform.node()} {what} the controller {controller.name}, which are in {controller.path}: "
            "only a module that stands alone in its folder is sent to the workers, all else has to be there, the same"
        )
    if controller.source is not None:
        _sent_modules.add(controller.module, SentModule(controller.path, controller.source))


@dataclass(frozen=True)
class Setting:
    """What a worker has to know of a campaign.

    Attributes:
        description: description of the campaign's own process; see `description`.
        controllers: users' own controllers.
        answer_limit: time that a call of a controller may take, s.
    """

    description: Mapping[str, str]
    controllers: tuple[SentController, ...]
    answer_limit: float


def work_on(setting: Setting, task: bytes) -> bytes:
    """Return what became of a pickled task, `(work, items)`, pickled: in a worker.

    Raises:
        UsageError: this worker is unlike the campaign's own process, or a controller here is another.
    """
    if different := difference(description(), setting.description):
        raise UsageError(f"worker on {platform.node()} has {different}: all need the same")
    with _alone:
        set_call_limit(setting.answer_limit)
        for controller in setting.controllers:
            _have(controller)
        return pickle.dumps(tuple(do(*pickle.loads(task))), protocol=_PROTOCOL)


def compile_for(episodes: bytes) -> None:
    """Have this worker compile what some pickled episodes need."""
    with _alone:
        warm_up_with(pickle.loads(episodes))
