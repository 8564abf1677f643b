"""The process of a user's controller, as whoever asks it has it: started, asked, closed, and lost.

It is a new Python, not a fork: it has nothing of this one but its environment and its working folder. What it
is told is the controller's name, and what `reset`, `sense` and `command` are given. A call takes some ten microseconds
more than in this process. What it prints comes to standard error through another one, see `skd_sim.apart.pump`.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import pickle
import select
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from skd_sim.apart.beginning import Beginning, SentModules
from skd_sim.apart.pump import Pump
from skd_sim.apart.wire import COPY, HEADER, LOADED, ClosedError, Op, read_answer, write_all
from skd_sim.choices.car_under_test import CarUnderTest
from skd_sim.errors import AssessmentError
from skd_sim.program.places import PUT_OFF, users_first

_PATIENCE: Final = 2.0  # s for a process whose pipe is closed to end
_COPY: Final = Op.COPY.value
_HERE: Final = str(Path(__file__).parents[2])
_PROGRAM: Final = "import sys; sys.path.insert(0, sys.argv.pop(1)); from skd_sim.apart.car import main; main()"


class Call:
    """The call of a controller that has not come back yet.

    Attributes:
        since: when it began (time.monotonic); None outside of calls.
    """

    since: float | None = None


class ApartCar:
    """The process of a user's controller.

    Attributes:
        pid: of it.
    """

    def __init__(self, car: CarUnderTest, modules: SentModules | None = None) -> None:
        """Start it.

        Args:
            car: whose controller it is to load, when one is made.
            modules: that it finds in memory.
        """
        self.name = car.controller
        theirs, self._out = os.pipe()
        self._in, their_answers = os.pipe()
        printed, their_prints = os.pipe()
        command = [sys.executable, "-P", "-c", _PROGRAM, _HERE, str(theirs), str(their_answers)]
        # Who goes by the order of a set of names is the same car in each process.
        variables = {"PYTHONHASHSEED": "0", **os.environ}
        # Nothing of a controller's folder, as a sitecustomize.py, is to run before the process is secluded.
        variables[PUT_OFF] = variables.pop("PYTHONPATH", "")
        self._pid_file = -1
        try:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=their_prints,
                stderr=their_prints,
                pass_fds=(theirs, their_answers),
                env=variables,
            )
            self.pid = self._process.pid
            try:
                if hasattr(os, "pidfd_open"):  # Linux
                    self._pid_file = os.pidfd_open(self.pid)
                self._pump = Pump(car.controller, printed, self._pid_file)
            except BaseException:  # no process or descriptor is left for it
                self._process.kill()
                self._process.wait()
                raise
        finally:
            for file in (theirs, their_answers, printed, their_prints):
                os.close(file)
        self._ending: select.poll | None = None
        if self._pid_file >= 0:
            self._ending = select.poll()
            self._ending.register(self._in, select.POLLIN)
            self._ending.register(self._pid_file, select.POLLIN)
        self._numbers = itertools.count()
        self._later = bytearray()
        self._can_copy = False
        main = getattr(sys.modules["__main__"], "__file__", "") if car.controller.startswith("__main__:") else ""
        self.add(loaded(Op.BEGIN, 0, Beginning(users_first(), car.controller, car.multiplier, modules, main)))

    @property
    def pids(self) -> tuple[int, int]:
        """Ids of its two processes."""
        return self.pid, self._pump.pid

    def new_number(self) -> int:
        """Return a number that no controller in it has."""
        return next(self._numbers)

    def ask(self, operation: bytes, *, timed: bool = True) -> Any:
        """Send an operation, and what was put off until now; return the answer.

        Args:
            operation: see `skd_sim.apart.wire`.
            timed: whether it is a call of the controller, which may take only so long.

        Raises:
            AssessmentError: the controller fails, or its process has ended.
        """
        later = self._later
        Call.since = time.monotonic() if timed else None
        try:
            if later:
                operation = bytes(later) + operation
                later.clear()
            write_all(self._out, HEADER.pack(len(operation)) + operation)
            self._wait_for_answer()
            return read_answer(self._in)
        except ClosedError:
            when_lost(self._ended(), self.name)
            raise
        finally:
            Call.since = None

    def _wait_for_answer(self) -> None:
        """Wait until something comes, or the process has ended: children of its own may hold its end of the pipe.

        Raises:
            ClosedError: it has ended, and said nothing.
        """
        if self._ending is not None and not any(file == self._in for file, _ in self._ending.poll()):
            raise ClosedError

    def add(self, operation: bytes) -> None:
        """Put off an operation that has no answer of its own until the next question."""
        self._later += operation

    def copy(self, number: int) -> int:
        """Copy a controller; return the number of the copy.

        Raises:
            AssessmentError: it cannot be copied. Once one could be, the next question says so.
        """
        again = self.new_number()
        operation = COPY.pack(_COPY, again, number)
        if self._can_copy:
            self.add(operation)
        else:
            self.ask(operation)
            self._can_copy = True
        return again

    def close(self) -> None:
        """End it; what it has printed comes out before this returns, if it does not take long."""
        for file in (self._out, self._in, self._pid_file):
            with contextlib.suppress(OSError):
                os.close(file)
        self._out = self._in = self._pid_file = -1
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(_PATIENCE)
        self._end()

    def _end(self) -> int:
        self._process.kill()
        code = self._process.wait()
        self._pump.finish(_PATIENCE)
        return code

    def _ended(self) -> int:
        """Return with what exit code it has ended, whose pipe is closed; negative: by which signal."""
        try:
            code = self._process.wait(_PATIENCE)
        except subprocess.TimeoutExpired:
            code = 1
        self._end()  # what it has printed comes before what is said of it
        return code


def _say_lost(code: int, name: str) -> None:
    how = f"was killed by signal {-code}" if code < 0 else f"ended with exit code {code}"
    raise AssessmentError(f"controller {name}: its process {how}")


when_lost: Callable[[int, str], None] = _say_lost
"""What happens when the process of a controller has ended by itself, with an exit code as subprocess has it."""


def loaded(operation: Op, number: int, content: object) -> bytes:
    """Return an operation that carries anything that can be pickled."""
    pickled = pickle.dumps(content, protocol=pickle.HIGHEST_PROTOCOL)
    return LOADED.pack(operation, number, len(pickled)) + pickled
