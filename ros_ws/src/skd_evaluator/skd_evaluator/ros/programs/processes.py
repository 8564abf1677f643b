"""The processes of a graph: started, watched, restarted, and all ended, whatever happens.

Above each stands a keeper (`skd_evaluator.keeper`): it ends what the process has started when that ends, or `skd` does.
"""

from __future__ import annotations

import contextlib
import json
import mmap
import os
import shutil
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import IO

from skd_sim.episode.aborts import AbortKind, abort_reason
from skd_sim.errors import UsageError
from skd_sim.inputs.printable import pieces, printable
from skd_sim.program.secret import FROM_INPUT
from skd_sim.ros_environment import is_sourced

from skd_evaluator.errors import AssessmentError
from skd_evaluator.keeper import end_now, has_ended, keep
from skd_evaluator.ros.programs.guardian import Guardian
from skd_evaluator.ros.programs.process_tree import MARK, is_stopped, kill_marked, marked

_RESTARTS = 20
"""How often a process may die in one campaign before the campaign is given up."""
END_LIMIT = 2.0
"""Seconds that a process has to end after SIGINT; half of them after SIGTERM, which follows."""
_CANNOT_START = (2, 126, 127)
"""Exit codes of a usage error, and of a shell that cannot run or find a command: another start ends alike."""
_LACKS = ("ModuleNotFoundError: ", "ImportError: ")
_KEEPER_PATIENCE = 3.0  # s for a keeper to kill all that is below it
_STOPPED_LIMIT = 1.0
"""Seconds after which a process that was stopped is replaced."""
_LEAD = "\n  | "
"""What the lines of a process begin with, which are not SKD's."""
_LAST_LINES, _LONGEST_LINE, _LAST_BYTES = 5, 300, 10_000
"""How much is shown of what a process that has ended printed."""


class GraphError(AssessmentError):
    """The graph cannot go on; the message says which process and why."""


def python_node(module: str, *arguments: str) -> list[str]:
    """Return the command of one of our nodes, on this interpreter; `-P`: the working folder cannot shadow modules."""
    return [sys.executable, "-P", "-m", module, *arguments]


def ros_parameters(values: Mapping[str, object]) -> list[str]:
    """Return parameters as `--ros-args -p name:=value …`."""
    arguments = ["--ros-args"]
    for name, value in values.items():
        text = json.dumps(value)  # which is YAML: a text stays one, the empty one, too
        arguments += ["-p", f"{name}:={text}"]
    return arguments


def _below_keeper(told: mmap.mmap) -> None:
    """Have a keeper above this process, tell its id, and answer to SIGINT whatever the one that started it does."""
    keep()
    told[:] = os.getpid().to_bytes(len(told), "little")
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@dataclass(frozen=True)
class Program:
    """What a process of the graph is started with: its command and all of its environment's variables.

    Attributes:
        command: program and arguments.
        environment: all variables.
        secret: handed to it by standard input, see `skd_sim.program.secret`.
    """

    command: Sequence[str]
    environment: Mapping[str, str]
    secret: bytes = field(default=b"", repr=False)


@dataclass
class _Process:
    name: str
    program: Program
    log: Path
    popen: subprocess.Popen[bytes] | None = None  # of the keeper
    told: mmap.mmap = field(default_factory=lambda: mmap.mmap(-1, 8), repr=False)  # id of the process itself
    output: IO[bytes] | None = field(default=None, repr=False)
    restarts: int = 0
    mark: str = ""
    stopped_since: float | None = None
    begin: int = 0  # of what this one has printed, in the log
    said: bool = False

    def exit_code(self) -> int | None:
        """Return how the process has ended; none while it runs."""
        if self.popen is None or (code := self.popen.poll()) is not None:
            return None if self.popen is None else code
        # Its keeper says it a moment later; whoever asks before an episode must not be told in the middle of it.
        if has_ended(int.from_bytes(self.told, "little")):
            with contextlib.suppress(subprocess.TimeoutExpired):
                return self.popen.wait(_KEEPER_PATIENCE)
        return None


class Supervisor:
    """Starts processes in sessions of their own and never leaves one behind."""

    def __init__(
        self,
        programs: Mapping[str, Program],
        log_folder: Path,
        say: Callable[[str], None] = lambda _line: None,
    ) -> None:
        """Prepare; nothing runs yet.

        Args:
            programs: the programs to start, by name.
            log_folder: folder for each process's output, as <name>.log.
            say: called once for each process that ends by itself, with how it ended and what it printed last.
        """
        self._say = say
        self._processes = [_Process(name, program, log_folder / f"{name}.log") for name, program in programs.items()]
        self._mark = uuid.uuid4().hex
        for process in self._processes:
            process.mark = f"{self._mark}:{process.name}"
        self._guardian: Guardian | None = None
        self._looked = 0.0

    def __enter__(self) -> Supervisor:
        try:
            self._guardian = Guardian(self._mark)
            for process in self._processes:
                self._start(process)
        except BaseException:
            self.stop()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def _start(self, process: _Process) -> None:
        process.output = process.log.open("ab")
        process.begin = process.output.tell()
        process.told[:] = bytes(len(process.told))
        secret = process.program.secret
        handed = {FROM_INPUT: str(len(secret))} if secret else {}
        try:
            process.popen = subprocess.Popen(
                process.program.command,
                stdin=subprocess.PIPE if secret else subprocess.DEVNULL,
                stdout=process.output,
                stderr=subprocess.STDOUT,
                env={**process.program.environment, **handed, MARK: process.mark},
                start_new_session=True,
                preexec_fn=partial(_below_keeper, process.told),
            )
        except OSError as error:
            raise UsageError(
                f"{process.name} cannot be started: {error.strerror}: {process.program.command[0]}"
            ) from error
        if process.popen.stdin is not None:
            with contextlib.suppress(BrokenPipeError), process.popen.stdin as pipe:  # it may have ended already
                pipe.write(secret)
        if self._guardian is not None:
            self._guardian.tell("+", process.popen.pid)

    def check(self) -> str | None:
        """Restart every process that has died or is stopped, and return what happened; none where all are well.

        Raises:
            GraphError: one dies again and again.
        """
        problems = []
        stopped = self._stopped()
        for process in self._processes:
            assert process.popen is not None
            code = process.exit_code()
            if code is not None:
                how = f"was killed by signal {-code}" if code < 0 else f"ended with exit code {code}"
                problem = abort_reason(AbortKind.ENDED, f"{process.name} {how}")
            elif process.name in stopped:
                problem = abort_reason(
                    AbortKind.STOPPED,
                    f"{process.name}, or what it has started, was stopped by a signal; it is replaced",
                )
            else:
                continue
            problems.append(problem)
            self._end([process])
            if code is not None and not process.said:
                process.said = True
                self._say(_LEAD.join([f"{problem}; the end of {process.log}:", *_led(_last_lines(process))]))
            process.restarts += 1
            last_words = _last_lines(process)[-1]
            certain = code in _CANNOT_START or last_words.startswith(_LACKS)
            if process.restarts > _RESTARTS or (certain and process.restarts > 1):
                bare = last_words.startswith(_LACKS) and not is_sourced(process.program.environment)
                hint = (
                    "; the ROS 2 that SKD brings has rclpy and messages alone: source one with the rest" if bare else ""
                )
                raise GraphError(f"{problem}, for the {process.restarts}. time; its last words: {last_words}{hint}")
            self._start(process)
        return " and ".join(problems) or None

    def _stopped(self) -> list[str]:
        """Return the names of the processes that are stopped for a while, or have started one that is."""
        now = time.monotonic()
        if now - self._looked < 0.5 * _STOPPED_LIMIT:
            return []
        self._looked = now
        some = any(map(is_stopped, marked(self._mark)))
        found = []
        for process in self._processes:
            if not (some and any(map(is_stopped, marked(process.mark)))):
                process.stopped_since = None
            elif process.stopped_since is None:
                process.stopped_since = now
            elif now - process.stopped_since > _STOPPED_LIMIT:
                found.append(process.name)
        return found

    def restart(self, name: str) -> None:
        """End a process and start it anew."""
        for process in self._processes:
            if process.name == name:
                self._end([process])
                self._start(process)

    def stop(self) -> None:
        """End all processes: politely, then firmly."""
        try:
            self._end(self._processes)
        finally:
            if self._guardian is not None:
                self._guardian.stop()
                self._guardian = None

    def _end(self, processes: Sequence[_Process]) -> None:
        begin = time.monotonic()
        alive = _alive(processes)
        for number, latest in ((signal.SIGINT, begin + 0.5 * END_LIMIT), (signal.SIGTERM, begin + END_LIMIT)):
            for process in alive:
                _signal_group(process, number)
                # One that is stopped answers no signal; killed where it stands, it may leave locks of the middleware's
                # shared memory behind, and who comes in its place is not heard.
                _signal_group(process, signal.SIGCONT)
            while alive and time.monotonic() < latest:
                time.sleep(0.01)
                alive = _alive(alive)
        for process in alive:
            self._say(f"{process.name} did not end within {END_LIMIT:g} s of SIGINT; it is killed, with its group")
            if process.popen is not None:
                end_now(process.popen.pid)
        latest = time.monotonic() + _KEEPER_PATIENCE
        while alive and time.monotonic() < latest:
            time.sleep(0.01)
            alive = _alive(alive)
        for process in processes:
            _signal_group(process, signal.SIGKILL)  # were its keeper itself killed or stopped
            kill_marked(process.mark)
            process.stopped_since = None
            if process.popen is not None:
                process.popen.wait()
                if self._guardian is not None:
                    self._guardian.tell("-", process.popen.pid)
            if process.output is not None:
                process.output.close()
            process.popen = process.output = None


def _alive(processes: Sequence[_Process]) -> list[_Process]:
    return [process for process in processes if process.popen is not None and process.popen.poll() is None]


def _signal_group(process: _Process, number: int) -> None:
    if process.popen is not None:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.popen.pid, number)


def _last_lines(process: _Process) -> list[str]:
    """Return the last lines that a process has printed since it was started, at least one."""
    try:
        with process.log.open("rb") as log:
            size = log.seek(0, os.SEEK_END)
            log.seek(max(process.begin, size - _LAST_BYTES))
            text = log.read().decode(errors="replace")
    except OSError:
        text = ""
    lines = [line.rstrip()[:_LONGEST_LINE] for line in text.splitlines() if line.strip()]
    return lines[-_LAST_LINES:] or ["(it has printed nothing)"]


def _led(lines: Sequence[str]) -> Iterator[str]:
    """Yield lines in pieces that a terminal does not break: it would lead the rest by nothing, as if SKD said it."""
    width = shutil.get_terminal_size().columns if sys.stderr.isatty() else _LONGEST_LINE
    room = max(1, width - len(_LEAD))
    for line in lines:
        yield from pieces(printable(line.expandtabs()), room)
