"""What the workers of a Dask cluster do for a campaign: see that they are like its own process, and run chunks."""

from __future__ import annotations

import functools
import hashlib
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

from skd_sim.choices.car_under_test import CONTROLLERS, CarUnderTest
from skd_sim.controllers.isolated import end_children, set_call_limit
from skd_sim.errors import UsageError

from skd_evaluator.campaign.plan.car_files import car_files, controller_files, digest_of
from skd_evaluator.campaign.run.executor_runner import answers
from skd_evaluator.campaign.run.workers import warm_up_with
from skd_evaluator.likeness import likeness

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
    return {**likeness(), "distributed": version_of("distributed")}


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
        path: path of the module's file on the machine where the campaign runs.
        sha256: digest of that file; empty if no file was found.
        source: content of the file if the module is no part of a package; None: workers have to have it installed.
        files: the other files of the car: path on that machine, name from the folder of the package on, digest.
    """

    name: str
    module: str
    path: str
    sha256: str
    source: bytes | None
    files: tuple[tuple[str, str, str], ...] = ()


def sent(car: CarUnderTest) -> SentController:
    """Return the controller of a car, ready to be sent; nothing of it is run."""
    target = CONTROLLERS.target(car.controller) if car.controller in CONTROLLERS else car.controller
    module = target.partition(":")[0]
    for path in controller_files(car):
        content = path.read_bytes()
        alone = path.name == f"{module}.py"
        digest = hashlib.sha256(content).hexdigest()
        files = car_files(car)
        others = zip(map(str, files.all), files.names, files.sha256, strict=True)
        further = tuple(one for one in others if one[0] != str(path))
        return SentController(car.controller, module, str(path), digest, content if alone else None, further)
    return SentController(car.controller, module, "", "", None)


def _have(controller: SentController) -> None:
    """See that a controller here is that of the campaign.

    Raises:
        UsageError: its module, of a package, is another, or not there, or another of its files.
    """
    if controller.source is not None:
        _compare(controller, {path: digest_of(Path(path)) for path, _, _ in controller.files})
        _sent_modules.add(controller.module, SentModule(controller.path, controller.source))
        return
    here = sent(CarUnderTest(controller.name))
    if here.sha256 != controller.sha256:
        what = "has another file of" if here.sha256 else "does not have"
        raise UsageError(
            f"worker on {platform.node()} {what} the controller {controller.name}: a module of a package has to be "
            "installed, the same, on all workers; a single file is sent to them"
        )
    found = {name: digest for _, name, digest in here.files}
    _compare(controller, {path: found.get(name) for path, name, _ in controller.files})


def _compare(controller: SentController, here: Mapping[str, str | None]) -> None:
    """See that the other files of a controller are here what they are on the campaign's machine.

    Raises:
        UsageError: one is not.
    """
    for path, _, digest in controller.files:
        if here[path] != digest:
            what = "has another" if here[path] else "does not have"
            raise UsageError(
                f"worker on {platform.node()} {what} {path}, one of the files of the controller {controller.name}: "
                "only a module that stands alone in its folder is sent to the workers, all else has to be there, the "
                "same"
            )


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
    """Return the pickled answers to a pickled task, `(work, items)`: in a worker.

    Raises:
        UsageError: this worker is unlike the campaign's own process, or a controller here is another.
    """
    if different := difference(description(), setting.description):
        raise UsageError(f"worker on {platform.node()} has {different}: all need the same")
    with _alone:
        set_call_limit(setting.answer_limit)
        for controller in setting.controllers:
            _have(controller)
        return pickle.dumps(answers(*pickle.loads(task)), protocol=_PROTOCOL)


def compile_for(episodes: bytes) -> None:
    """Have this worker compile what some pickled episodes need."""
    with _alone:
        warm_up_with(pickle.loads(episodes))
