"""The processes of a graph: started, watched, restarted, and all ended, whatever happens.

Each is the first of a process group, which ends with it. A shell beside it waits for the end of this process, by
whatever death, and kills the group then. Aborted episodes are said once of each kind, and too many in a row end the
campaign (`AbortedEpisodes`).
"""

from __future__ import annotations

import contextlib
import json
import os
import shlex
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from skd_sim.controllers.isolated import FAILED_STARTS
from skd_sim.errors import AssessmentError, UsageError
from skd_sim.inputs.files import printable
from skd_sim.options.car_and_adversary import WORLD, CarUnderTest
from skd_sim.ros_environment.installation import foreign_variables, is_sourced, node_variables
from skd_sim.world.episode import AbortKind, EpisodeLog, Outcome, abort_reason, kind_of

from skd_evaluator.assessment.options import GraphOptions

CONTROLLER, ADVERSARY, SIMULATOR = "car_controller", "adversary", "vehicle_simulator"
_CALLED = {
    CONTROLLER: ("the car controller", CONTROLLER),
    ADVERSARY: ("the adversary", ADVERSARY),
    SIMULATOR: ("the vehicle simulator", SIMULATOR),
}
_RESTARTS = 20
"""How often a process may die in one campaign before the campaign is given up."""
_UNANSWERED = 10
"""After so many episodes in a row in which a node hangs, or is too slow, the campaign is given up."""
END_LIMIT = 2.0
"""Seconds that a process has to end after SIGINT; half of them after SIGTERM, which follows."""
_CANNOT_START = (2, 126, 127)
"""Exit codes of a usage error, and of a shell that cannot run or find a command: another start ends alike."""
_LACKS = ("ModuleNotFoundError: ", "ImportError: ")
_WATCH = 'read -r _ || kill -KILL "-$1"'
"""For a shell whose standard input ends when this process does: it kills a process group then."""
_LAST_LINES, _LONGEST_LINE, _LAST_BYTES = 5, 300, 10_000
"""How much is shown of what a process that has ended printed."""


def say_to_user(line: str) -> None:
    """Print a line for the user."""
    print(f"skd: {line}", file=sys.stderr, flush=True)


@dataclass(frozen=True, kw_only=True)
class GraphSetting:
    """What a graph, or a pool of them, runs.

    Attributes:
        options: how to run it.
        car: the car under test.
        log_folder: folder for the processes' output.
        simulator: name of the simulator.
        record_to: folder for one bag per episode; none: do not record.
        say: called with each line for the user.
        campaign: name of the campaign; empty: one that no other has, and that does not tell the seed.
    """

    options: GraphOptions
    car: CarUnderTest
    log_folder: Path
    simulator: str = WORLD
    record_to: Path | None = None
    say: Callable[[str], None] = say_to_user
    campaign: str = ""

    @property
    def awaits_car(self) -> bool:
        """Whether the user starts the car under test."""
        return self.car.is_external and not self.options.controller_command


def campaign_name(car: CarUnderTest) -> str:
    """Return a name for a campaign that no other has."""
    return f"{car.file_name}-{uuid.uuid4().hex[:8]}"


class GraphError(AssessmentError):
    """The graph cannot go on; the message says which process and why."""


@dataclass(frozen=True)
class Program:
    """What a process of the graph is started with: its command and all of its environment's variables."""

    command: Sequence[str]
    environment: Mapping[str, str]


def graph_programs(
    options: GraphOptions, car: CarUnderTest, environment: Mapping[str, str], *, composed: bool
) -> dict[str, Program]:
    """Return the graph's processes, beside the evaluator's own.

    Args:
        options: how to run the graph.
        car: the car under test.
        environment: variables that they inherit.
        composed: whether simulator and adversary are none of these processes.

    Raises:
        UsageError: the controller's command is no command line.
    """
    ours = node_variables(environment)
    programs = {}
    if not composed:
        programs[SIMULATOR] = Program(_node(SIMULATOR, options.simulator_parameters()), ours)
        programs[ADVERSARY] = Program(_node(ADVERSARY), ours)
    if not car.is_external:
        programs[CONTROLLER] = Program(_node(CONTROLLER), ours)
    elif options.controller_command:
        try:
            command = shlex.split(options.controller_command)
        except ValueError as error:
            raise UsageError(f"--controller-command {options.controller_command!r}: {error}") from error
        if not command:
            raise UsageError("--controller-command is empty")
        programs[CONTROLLER] = Program(command, _controller_environment(environment))
    return programs


def _node(name: str, parameters: Mapping[str, object] | None = None) -> list[str]:
    """Return the command of one of our nodes, on this interpreter; `-P`: the working folder cannot shadow modules."""
    # JSON is YAML: a text stays one, the empty one, too.
    given = [word for key, value in (parameters or {}).items() for word in ("-p", f"{key}:={json.dumps(value)}")]
    return [sys.executable, "-P", "-m", "skd_sim.start", name, "--ros-args", *given]


def _controller_environment(environment: Mapping[str, str]) -> dict[str, str]:
    """Return the environment of a controller that is not ours.

    Where no ROS 2 is sourced, its `python3` is the one of this environment, in which `import rclpy` works. With ROS 2
    the PATH stays as it is: `python3` is then the one that the user's own stack runs on. Where our libraries lie is
    none of its business: it may be built against others.
    """
    if is_sourced(environment):
        return dict(environment)
    folders = [str(Path(sys.executable).parent), environment.get("PATH") or os.defpath]
    return {**foreign_variables(environment), "PATH": os.pathsep.join(folders)}


_LAST_LINE = "; the last line of its log: "


def concerned(reason: str) -> list[str]:
    """Return which processes the reason of an abort speaks of."""
    said = reason.partition(_LAST_LINE)[0]
    return [name for name, words in _CALLED.items() if any(word in said for word in words)]


def log_of(folder: Path, reason: str) -> Path:
    """Return the log of the process that a reason speaks of first, where it has one, else the simulator's."""
    logs = [folder / f"{name}.log" for name in (*concerned(reason), SIMULATOR)]
    return next((log for log in logs if log.exists()), folder)


_LIMITED = "; the ROS 2 that SKD brings has rclpy and messages alone: source one with the rest"


class _Process:
    """A program that runs, or can be started; a shell beside it kills its group when this process has died."""

    def __init__(self, name: str, program: Program, log: Path) -> None:
        self.name, self.program, self.log = name, program, log
        self.restarts = 0
        self.said = False
        self.given_up = ""
        self._popen: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start it, in a process group of its own.

        Raises:
            UsageError: it cannot be started.
        """
        command = self.program.command
        with self.log.open("ab") as output:
            self._begin = output.tell()  # of what this one prints, in the log
            try:
                self._popen = subprocess.Popen(
                    command,
                    stdin=subprocess.DEVNULL,
                    stdout=output,
                    stderr=subprocess.STDOUT,
                    env=self.program.environment,
                    start_new_session=True,
                    preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),  # whatever this process does
                )
            except OSError as error:
                more = _LIMITED if command[0] == "ros2" else ""
                raise UsageError(f"{self.name} cannot be started: {error.strerror}: {command[0]}{more}") from error
        self._watch = subprocess.Popen(
            ["/bin/sh", "-c", _WATCH, "sh", str(self._popen.pid)],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )

    @property
    def code(self) -> int | None:
        """Its exit code; none where it runs, or has been ended."""
        return None if self._popen is None else self._popen.poll()

    @property
    def lives(self) -> bool:
        """Whether it runs."""
        return self._popen is not None and self._popen.poll() is None

    def signal(self, number: int) -> None:
        """Send a signal to its group."""
        if self._popen is not None:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(self._popen.pid, number)

    def clear_away(self) -> None:
        """Kill it where it still runs, and what it has left behind."""
        self.signal(signal.SIGKILL)
        if self._popen is not None:
            self._popen.wait()
            self._watch.communicate(b"\n")
        self._popen = None

    def last_lines(self) -> list[str]:
        """Return the last lines that it has printed since it was started, at least one."""
        with self.log.open("rb") as log:
            log.seek(max(self._begin, log.seek(0, os.SEEK_END) - _LAST_BYTES))
            text = log.read().decode(errors="replace")
        lines = [printable(line.rstrip().expandtabs())[:_LONGEST_LINE] for line in text.splitlines() if line.strip()]
        return lines[-_LAST_LINES:] or ["(it has printed nothing)"]


class Supervisor:
    """Starts processes in groups of their own and never leaves one behind."""

    def __init__(
        self, programs: Mapping[str, Program], log_folder: Path, say: Callable[[str], None] = lambda _line: None
    ) -> None:
        """Prepare; nothing runs yet.

        Args:
            programs: the programs to start, by name.
            log_folder: folder for each process's output, as <name>.log.
            say: called once for each process that ends by itself, with how it ended and what it printed last.
        """
        self._say = say
        self._processes = [_Process(name, program, log_folder / f"{name}.log") for name, program in programs.items()]

    def __enter__(self) -> Supervisor:
        try:
            for process in self._processes:
                process.start()
        except BaseException:
            self._end(self._processes)
            raise
        return self

    def __exit__(self, *_error: object) -> None:
        self._end(self._processes)

    def check(self) -> str | None:
        """Restart every process that has died, and return what happened; none where all are well.

        Raises:
            GraphError: one dies again and again.
        """
        problems = []
        for process in self._processes:
            code = process.code
            if process.given_up:
                raise GraphError(process.given_up)
            if code is None:
                continue
            how = f"was killed by signal {-code}" if code < 0 else f"ended with exit code {code}"
            problem = abort_reason(AbortKind.ENDED, f"{process.name} {how}")
            self._end([process])
            last = process.last_lines()
            problems.append(f"{problem}{_LAST_LINE}{last[-1]}")
            if not process.said:
                process.said = True
                self._say("\n  | ".join([f"{problem}; the end of {process.log}:", *last]))
            process.restarts += 1
            lacks = last[-1].startswith(_LACKS)
            if process.restarts > _RESTARTS or ((lacks or code in _CANNOT_START) and process.restarts > 1):
                hint = ""
                if lacks and not is_sourced(process.program.environment):
                    hint = "; write python3, not a path: SKD's Python has it" if "'rclpy'" in last[-1] else _LIMITED
                process.given_up = f"{problem}, {process.restarts} times{_LAST_LINE}{last[-1]}{hint}"
                raise GraphError(process.given_up)
            process.start()
        return " and ".join(problems) or None

    def restart(self, names: Collection[str]) -> None:
        """End processes, by their names, and start them anew."""
        for process in self._processes:
            if process.name in names:
                self._end([process])
                process.start()

    def _end(self, processes: Sequence[_Process]) -> None:
        """End processes: politely, then firmly."""
        begin = time.monotonic()
        alive = [process for process in processes if process.lives]
        for number, latest in ((signal.SIGINT, begin + 0.5 * END_LIMIT), (signal.SIGTERM, begin + END_LIMIT)):
            for process in alive:
                process.signal(number)
                # One that is stopped answers no signal; killed where it stands, it may leave locks of the middleware's
                # shared memory behind, and its successor is not heard.
                process.signal(signal.SIGCONT)
            while alive and time.monotonic() < latest:
                time.sleep(0.01)
                alive = [process for process in alive if process.lives]
        for process in alive:
            self._say(f"{process.name} did not end within {END_LIMIT:g} s of SIGINT; it is killed, with its group")
        for process in processes:
            process.clear_away()


class AbortedEpisodes:
    """Takes note of every episode of a campaign, in their order.

    Attributes:
        reasons: why episodes were aborted, one reason for each.
    """

    def __init__(self, say: Callable[[str], None], log_folder: Path | None = None) -> None:
        """Know of none yet.

        Args:
            say: called with a line for the user.
            log_folder: folder with the output of the graph's processes, if they print there.
        """
        self.reasons: list[str] = []
        self._say = say
        self._log_folder = log_folder
        self._said: set[AbortKind] = set()
        self._failed_starts = self._unanswered = 0

    def note(self, log: EpisodeLog) -> None:
        """Take note of an episode.

        Raises:
            AssessmentError: it is the last of several in a row that were not answered, or twice, or never began.
        """
        if log.outcome != Outcome.ABORTED:
            self._failed_starts = self._unanswered = 0
            return
        self.reasons.append(log.reason)
        kind = kind_of(log.reason)
        fails_always = len(log.adversary) <= 1 or kind == AbortKind.ANSWERED_TWICE
        self._failed_starts = self._failed_starts + 1 if fails_always else 0
        self._unanswered = self._unanswered + 1 if kind == AbortKind.NO_ANSWER else 0
        if kind not in self._said:
            self._said.add(kind)
            where = f"; log: {log_of(self._log_folder, log.reason)}" if self._log_folder else ""
            self._say(f"an episode was aborted, the first one so: {log.reason}{where}")
        if self._failed_starts >= FAILED_STARTS:
            raise AssessmentError(f"{FAILED_STARTS} episodes in a row failed, the last one so: {log.reason}")
        if self._unanswered >= _UNANSWERED:
            raise AssessmentError(f"{_UNANSWERED} episodes in a row were not answered, the last one so: {log.reason}")
