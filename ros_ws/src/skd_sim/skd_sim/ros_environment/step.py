"""A step of the set-up: it runs commands, keeps what they say in a log, and shows how far it is."""

from __future__ import annotations

import re
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from skd_sim.errors import UsageError
from skd_sim.inputs.printable import own

_COUNTED = re.compile(r"\[(\d+)/(\d+)\]")  # ninja's way
_ERROR = re.compile(r"\berror\b", re.IGNORECASE)


class Step:
    """What is done, and how far it is; to be used in a `with` statement."""

    def __init__(
        self, label: str, log: Path, *, parts: int = 0, sign: str = "$^", failure: str = "ROS 2 could not be added"
    ) -> None:
        """Say what is done.

        Args:
            label: name of the step on the terminal.
            log: file for everything that the commands print.
            parts: number of parts; 0: the commands print it, as `[3/17]`.
            sign: regular expression of a line that begins a part.
            failure: beginning of the error line.
        """
        self._label, self._log = label, log
        self._done, self._parts, self._sign = 0, parts, re.compile(sign)
        self._failure = failure
        self._begin = time.monotonic()

    def __enter__(self) -> Step:
        return self

    def __exit__(self, kind: object, _error: object, _trace: object) -> None:
        if sys.stderr.isatty():
            print("\r\x1b[K", end="", file=own(sys.stderr))
        if kind is None:
            print(f"skd:   {self._label}: {time.monotonic() - self._begin:.0f} s", file=sys.stderr)

    def run(self, command: Sequence[str], environment: Mapping[str, str] | None = None) -> None:
        """Run a command to its end.

        Raises:
            UsageError: it cannot be started, or fails.
        """
        last = problem = ""
        with self._log.open("a", encoding="utf-8") as log:
            log.write(f"$ {' '.join(command)}\n")
            log.flush()
            try:
                process = subprocess.Popen(
                    command,
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.PIPE,
                    stderr=subprocess.STDOUT,
                    text=True,
                    errors="replace",
                    env=environment,
                )
            except OSError as error:
                raise UsageError(f"{self._failure}: {command[0]}: {error.strerror}") from error
            assert process.stdout is not None
            try:
                for line in process.stdout:
                    log.write(line)
                    last = line.strip() or last
                    problem = problem or (last if _ERROR.search(line) else "")
                    self._show(line)
                code = process.wait()
            except BaseException:
                process.terminate()
                process.wait()
                raise
        if code:
            said = (problem or last or f"exit code {code}")[:200]
            raise UsageError(f"{self._failure} ({self._label}): {said}; the whole log is {self._log}")

    def _show(self, line: str) -> None:
        counted = _COUNTED.match(line)
        if counted:
            self._done, self._parts = int(counted[1]), int(counted[2])
        elif self._sign.search(line):
            self._done += 1
        else:
            return
        if sys.stderr.isatty():
            text = f"skd:   {self._label}: {min(self._done, self._parts)} of {self._parts}"
            print(f"\r\x1b[K{text}", end="", file=own(sys.stderr), flush=True)
