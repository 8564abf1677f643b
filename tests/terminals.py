"""A program on a terminal of 80 columns: what it draws there, and keys that are pressed."""

import contextlib
import fcntl
import os
import pty
import re
import select
import signal
import struct
import termios
import time
from collections.abc import Mapping, Sequence

from common import PATIENCE

_SEQUENCE = re.compile(r"\x1b(\[[0-?]*[ -/]*[@-~]|[@-Z\\-_])")
_WAIT = 0.2  # s


class Terminal:
    """A program with a terminal for input and output, as a user has it."""

    def __init__(self, words: Sequence[str], *, columns: int = 80, lines: int = 24, **environment: str) -> None:
        variables: Mapping[str, str] = {**os.environ, "TERM": "xterm-256color", **environment}
        self.pid, self._descriptor = pty.fork()
        if self.pid == 0:
            for number in (signal.SIGINT, signal.SIGQUIT, signal.SIGTSTP, signal.SIGHUP):
                signal.signal(number, signal.SIG_DFL)  # ignored in what a shell starts in the background
            os.execve(words[0], list(words), dict(variables))
        fcntl.ioctl(self._descriptor, termios.TIOCSWINSZ, struct.pack("HHHH", lines, columns, 0, 0))
        self._output = b""
        self._read = 0  # what was waited for has been seen up to here
        self._open = True

    @property
    def text(self) -> str:
        """All that it has drawn, without sequences that move or colour."""
        return _SEQUENCE.sub("", self._output.decode("utf-8", errors="replace"))

    def count(self, sequence: str) -> int:
        return self._output.count(sequence.encode())

    def press(self, keys: str) -> None:
        os.write(self._descriptor, keys.encode())

    def wait_for(self, pattern: str) -> re.Match[str]:
        """Wait until something is drawn that was not there when something was waited for last."""
        latest = time.monotonic() + PATIENCE
        while (found := re.search(pattern, self.text[self._read :])) is None:
            if time.monotonic() > latest or not self._take():
                self.kill()
                raise AssertionError(f"{pattern!r} is not drawn; there is:\n{self.text[-4000:]}")
        self._read = len(self.text)
        return found

    def finish(self) -> int:
        latest = time.monotonic() + PATIENCE
        while self._take():
            if time.monotonic() > latest:
                self.kill()
                raise AssertionError(f"it does not end; there is:\n{self.text[-4000:]}")
        os.close(self._descriptor)
        return os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])

    def kill(self) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.kill(self.pid, signal.SIGKILL)

    def _take(self) -> bool:
        """Take what has been drawn; False if nothing can be drawn any more."""
        if self._open and select.select([self._descriptor], [], [], _WAIT)[0]:
            try:
                data = os.read(self._descriptor, 65_536)
            except OSError:  # Linux's answer where nobody has the other end any more
                data = b""
            self._output += data
            self._open = bool(data)
        return self._open
