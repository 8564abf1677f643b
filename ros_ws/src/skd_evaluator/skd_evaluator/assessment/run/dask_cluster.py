"""Episodes on a Dask cluster: the runner, and what its workers do."""

from __future__ import annotations

import functools
import importlib
import logging
import pickle
import platform
import re
import sys
import tempfile
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, wait
from dataclasses import dataclass
from importlib.metadata import version as version_of
from pathlib import Path
from typing import Any, Final

from skd_sim.controllers.isolated import CALL_LIMIT, end_children, set_call_limit
from skd_sim.errors import AssessmentError, OutOfReachError, UsageError
from skd_sim.options.car_and_adversary import CONTROLLERS, CarUnderTest
from skd_sim.start import installing
from skd_sim.world.episode import AbortKind, EpisodeSpec, abort_reason

from skd_evaluator.assessment.run.workers import Done, Pace, Workers, do, warm_up_with
from skd_evaluator.provenance import code_paths, digest_of, environment, files_of

_PROTOCOL = 4
"""Of pickled answers. From 5 on a small array comes back as a view of a view of bytes, which takes twice the memory."""
_alone = threading.Lock()  # a process runs one chunk at a time, however many threads its worker has


_sent: Final[dict[str, tuple[bytes, str]]] = {}  # by module, its source and the folder that it was put into


def _put(module: str, name: str, source: bytes) -> None:
    """Have children find a sent module before any other of its name; those that had another one begin anew."""
    known, old = _sent.get(module, (b"", ""))
    if known == source and old:
        return
    folder = tempfile.mkdtemp(prefix="skd-")
    Path(folder, name).write_bytes(source)
    sys.path[:] = [folder, *(one for one in sys.path if one != old)]
    _sent[module] = source, folder
    importlib.invalidate_caches()
    end_children()


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
        why = f"{what} the controller {controller.name}, which are in {controller.path}"
        raise UsageError(f"worker on {platform.node()} {why}: only a module alone in its folder is sent to workers")
    if controller.source is not None:
        _put(controller.module, Path(controller.path).name, controller.source)


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


CONNECT_LIMIT = 10.0
"""s in which the scheduler has to answer, at first and ever after."""
WORKER_LIMIT = 60.0
"""s for which there may be no worker."""
COMPILE_LIMIT = 900.0
"""s in which workers have to have compiled."""
_LOOK = 3.0  # s between two looks at who is there
_ADDRESS = re.compile(r"(tcp|tls)://[^\s/]+:\d+")


class DaskRunner(Workers):
    """Runs episodes on the workers of a Dask cluster; see `Workers`.

    Every worker is checked to be like this process: version and sources of SKD, Python, libraries, and what its
    arithmetic gives. A process runs one chunk at a time; users' controllers run in a child of it.
    """

    pace = Pace(target=1.0, least=0.2)

    def __init__(self, address: str, *, answer_limit: float = CALL_LIMIT) -> None:
        """Prepare to run.

        Args:
            address: address of the scheduler, for example tcp://host:8786.
            answer_limit: time that a call of a user's controller may take, s.

        Raises:
            UsageError: the address is none.
        """
        super().__init__()
        if not _ADDRESS.fullmatch(address):
            raise UsageError(f"--scheduler {address}: give the address of a Dask scheduler, as tcp://host:8786")
        self._address = address
        self._answer_limit = answer_limit
        self._description = description()
        self._controllers: dict[str, SentController] = {}
        self._client: Any = None
        self._executor: Any = None
        self._lock = threading.RLock()  # of all of these, and of what follows
        self._addresses: list[str] = []
        self._looked = self._seen = 0.0

    def start(self, warm_up: Sequence[EpisodeSpec] = (), *, inherited: Callable[[], None] = lambda: None) -> None:
        """Connect, compare the workers with this process, and have them compile what `warm_up` needs.

        Raises:
            UsageError: Dask is not installed, or workers are unlike this process.
            AssessmentError: scheduler or workers cannot be reached.
        """
        with self._lock:
            if self._client is None:
                self._connect()
                self._compare()
            if warm_up:
                for address, found in self._everywhere(compile_for, pickle.dumps(list(warm_up))).items():
                    if isinstance(found, Exception):
                        raise AssessmentError(f"worker {address} cannot compile: {_shortened(found)}")
        inherited()

    def _connect(self) -> None:
        try:
            distributed = importlib.import_module("distributed")  # slow to import, and an extra
        except ModuleNotFoundError as error:
            raise UsageError(f"--scheduler needs Dask, and there is no {error.name}: {installing('dask')}") from None
        for name in list(logging.root.manager.loggerDict):
            if name.partition(".")[0] == "distributed":
                logging.getLogger(name).setLevel(logging.CRITICAL + 1)  # what fails is said by us, once
        warnings.simplefilter("ignore", distributed.versions.VersionMismatchWarning)  # as what differs
        try:
            self._client = distributed.Client(self._address, timeout=CONNECT_LIMIT, set_as_default=False)
        except Exception as error:
            raise OutOfReachError(f"no Dask scheduler answers at {self._address}: {_shortened(error)}") from None
        self._executor = self._client.get_executor()
        self._seen = time.monotonic()
        self._look()
        while not self._addresses:
            time.sleep(0.25)
            self._check()

    def _compare(self) -> None:
        for address, theirs in self._everywhere(description).items():
            if isinstance(theirs, Exception):
                raise UsageError(
                    f"worker {address} cannot run SKD: {_shortened(theirs)}; all need the same environment"
                )
            if different := difference(theirs, self._description):
                raise UsageError(f"worker {address} has {different}: all need the same")

    def _everywhere(self, work: Callable[..., Any], *arguments: Any) -> dict[str, Any]:
        """Return what a call gives on each worker, by its address: its result or an exception; without those that went.

        Raises:
            AssessmentError: the cluster went, or does not come to an end.
        """
        deadline = time.monotonic() + COMPILE_LIMIT
        calls: dict[str, Future[Any]] = {
            address: self._client.get_executor(workers=[address]).submit(work, *arguments)
            for address in self._addresses
        }
        while wait(calls.values(), 0.25).not_done:
            self._check()
            calls = {address: call for address, call in calls.items() if call.done() or address in self._addresses}
            if time.monotonic() > deadline:
                raise AssessmentError(f"workers of {self._address} gave no answer within {COMPILE_LIMIT:g} s")
        self._check()
        return {address: call.exception() or call.result() for address, call in calls.items() if not call.cancelled()}

    def _expect(self, episodes: Sequence[EpisodeSpec]) -> None:
        names = {episode.controller for episode in episodes if not episode.car.is_own}
        with self._lock:
            for name in names - self._controllers.keys():
                self._controllers[name] = sent(CarUnderTest(name))

    def _submit(self, work: Callable[[Any], Any], items: Sequence[Any]) -> Future[Any]:
        task = pickle.dumps((work, items), protocol=pickle.HIGHEST_PROTOCOL)
        setting = Setting(self._description, tuple(self._controllers.values()), self._answer_limit)
        try:
            call: Future[bytes] = self._executor.submit(work_on, setting, task)
        except Exception as error:
            self._check()
            raise OutOfReachError(f"the Dask scheduler {self._address} takes no work: {_shortened(error)}") from error
        return call

    def _unpacked(self, found: bytes) -> Done:
        return Done(*pickle.loads(found))

    def _workers(self) -> int:
        self._look_now_and_then()
        return max(1, len(self._addresses))

    def _check(self) -> None:
        client = self._client
        if client is None or client.status != "running":
            raise OutOfReachError(f"the Dask scheduler {self._address} is gone")
        self._look_now_and_then()
        if time.monotonic() - self._seen > WORKER_LIMIT:
            raise OutOfReachError(f"the Dask scheduler {self._address} has had no worker for {WORKER_LIMIT:g} s")

    def _look_now_and_then(self) -> None:
        if time.monotonic() - self._looked > _LOOK:
            self._look()

    def _look(self) -> None:
        """Look which workers there are.

        Raises:
            AssessmentError: the scheduler does not answer.
        """
        with self._lock:
            self._looked = time.monotonic()
            try:
                self._addresses = list(self._client.nthreads(callback_timeout=CONNECT_LIMIT))
            except Exception as error:
                raise OutOfReachError(f"the Dask scheduler {self._address} is gone: {_shortened(error)}") from None
            if self._addresses:
                self._seen = time.monotonic()

    def _is_loss(self, error: Exception) -> bool:
        return isinstance(error, importlib.import_module("distributed").KilledWorker)

    def _again(
        self, work: Callable[[Any], Any], items: Sequence[Any], lost: Callable[[Any, str], Any], error: Any
    ) -> Iterator[Any]:
        if len(items) > 1:
            for item in items:
                yield from self._results(work, [item], self._submit(work, [item]), lost)
            return
        often = error.allowed_failures + 1
        what = f"{often} workers of the cluster died at it, the last one {error.last_worker.address}"
        yield lost(items[0], abort_reason(AbortKind.ENDED, what))

    def close(self, *, wait: bool = True) -> None:
        """Leave the cluster; what has not begun is dropped."""
        with self._lock:
            client, self._client = self._client, None
        if client is not None:
            client.close(timeout=_LOOK)


def _shortened(error: BaseException) -> str:
    """Return what an exception says, in one line that is not too long."""
    return f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
