"""What a user's controller prints, on its way to who reads it: line by line, each led by the controller's name.

The process of a controller prints into a pipe. A small process of its own reads it and writes to standard error, in
characters that steer no terminal: so nothing that a controller prints clears the screen, or passes for a line of SKD's.
It is no thread, for processes are forked from those that ask controllers; and it outlives the controller's process,
however that ends, until it has written what was printed by then. It waits for nobody else who holds the pipe, such as
children of the controller's.

Imports little, for it begins with each process of a controller.
"""

from __future__ import annotations

import codecs
import fcntl
import io
import os
import select
import signal
import struct
import sys
import termios
from collections.abc import Iterator
from pathlib import Path
from typing import Final, NamedTuple

from skd_sim.inputs.printable import columns, one_line, pieces, printable

_STDERR: Final = 2  # its descriptor
_DEAF: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
_BLOCK: Final = 65536  # bytes read at once: as many as a pipe holds
_WHOLE: Final = 4096  # bytes that a pipe takes whole (PIPE_BUF), so that lines of several pumps do not mix
_LONGEST: Final = 800  # characters of a line; what is longer goes on in the next one
_NARROWEST: Final = 20  # columns beside the name on a terminal; a longer name loses its beginning
_LINE_ANEW: Final = "\r\x1b[K"
"""To a terminal (ECMA-48): go to the begin of the line, and erase it.

SKD's bar ends in the middle of one. What is printed behind it would come to the terminal's edge early, and go on in a
line of its own that is led by no name.
"""
_LONGEST_NAME: Final = 80
_PAUSE: Final = 0.5  # s until a line without an end is shown
_PROGRAM: Final = "import sys; sys.path.insert(0, sys.argv.pop(1)); from skd_sim.apart.pump import main; main()"


class Pump:
    """The process that passes on what the process of a controller prints.

    Attributes:
        pid: of it.
    """

    def __init__(self, name: str, printed: int, car: int) -> None:
        """Start it.

        Args:
            name: of the controller.
            printed: descriptor that it is to read.
            car: descriptor of the controller's process (pidfd_open(2)), by whose end it ends; -1 where there is none.
        """
        import subprocess  # only now: the process itself begins with this module

        here = str(Path(__file__).parents[2])
        files = [file for file in (printed, car) if file >= 0]
        # Ctrl-C reaches all processes of a terminal; this one ends with the controller's.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, _DEAF)
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-I", "-S", "-c", _PROGRAM, here, str(printed), str(car), str(os.getpid()), name],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                pass_fds=files,
            )
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        self.pid = self._process.pid

    def finish(self, patience: float) -> None:
        """Wait until all is written that a process printed which has ended, but no longer than `patience` (s)."""
        import subprocess

        try:
            self._process.wait(patience)
        except subprocess.TimeoutExpired:  # nobody reads what it writes
            self._process.kill()
            self._process.wait()


class _Place(NamedTuple):
    """Where lines are written to.

    Attributes:
        begin: with what each write begins.
        lead: with what each line begins.
        room: for so many columns behind that.
    """

    begin: str
    lead: str
    room: int


class _Lines:
    """Makes lines of what comes in pieces."""

    def __init__(self, name: str, encoding: str) -> None:
        """Lead each with a name."""
        self._name = one_line(name)[-_LONGEST_NAME:]
        self._encoding = encoding
        decoder = codecs.getincrementaldecoder(encoding)("backslashreplace")
        self._decoder = io.IncrementalNewlineDecoder(decoder, translate=True)
        self._begun = ""
        self.begun = False

    def take(self, data: bytes) -> Iterator[bytes]:
        """Take bytes that were printed; yield what is to be written, a line or several."""
        *lines, self._begun = (self._begun + self._decoder.decode(data)).split("\n")
        place = self._place()
        while len(self._begun) > place.room:
            lines.append(self._begun[: place.room])
            self._begun = self._begun[place.room :]
        self.begun = bool(self._begun)
        yield from self._shown(lines, place)

    def rest(self, *, last: bool = False) -> Iterator[bytes]:
        """Yield the line that has no end yet; with `last` also the bytes that are no whole character."""
        begun, self._begun, self.begun = self._begun, "", False
        if last:
            begun += self._decoder.decode(b"", final=True).rstrip("\n")
        if begun:
            yield from self._shown(begun.split("\n"), self._place())

    def _place(self) -> _Place:
        """Return where lines are written to: a terminal would break a longer one, and lead its rest by no name."""
        try:
            width = os.get_terminal_size(_STDERR).columns if os.isatty(_STDERR) else 0
        except OSError:
            width = 0
        name = self._name
        if width:
            while len(name) > 1 and columns(name) > width - len(" | ") - _NARROWEST:
                name = name[1:]
        lead = f"{name} | "
        draws = width and os.environ.get("TERM", "dumb") != "dumb"
        room = min(_LONGEST, max(1, width - columns(lead))) if width else _LONGEST
        return _Place(_LINE_ANEW if draws else "", lead, room)

    def _shown(self, lines: list[str], place: _Place) -> Iterator[bytes]:
        begin = place.begin.encode()
        whole = b""
        for line in lines:
            for piece in pieces(printable(line.expandtabs()), place.room):
                shown = f"{place.lead}{piece}".rstrip() + "\n"
                data = shown.encode(self._encoding, "backslashreplace")
                if whole and len(begin) + len(whole) + len(data) > _WHOLE:
                    yield begin + whole
                    whole = b""
                whole += data
        if whole:
            yield begin + whole


class _Output:
    """Standard error, whose reader may be slow, or gone."""

    def __init__(self, owner: int) -> None:
        self._owner = owner
        self._ready = select.poll()
        self._ready.register(_STDERR, select.POLLOUT)

    def write(self, data: bytes) -> None:
        """Write, or drop what cannot be: the controller is not to fail because nobody reads what it prints."""
        try:
            while data:
                while not self._ready.poll(1000.0 * _PAUSE):
                    if os.getppid() != self._owner:
                        os._exit(1)  # nobody waits for this process, and nobody reads what it writes
                try:
                    data = data[os.write(_STDERR, data) :]
                except BlockingIOError:
                    continue
        except OSError:
            return


def main() -> None:
    """Pass on what is printed until the process of the controller has ended; the arguments are those that it has."""
    (printed, car, owner), name = map(int, sys.argv[1:4]), sys.argv[4]
    lines = _Lines(name, getattr(sys.stderr, "encoding", None) or "utf-8")
    output = _Output(owner)
    coming = select.poll()
    for file in (printed, car):
        if file >= 0:
            coming.register(file, select.POLLIN)
    left: int | None = None  # bytes, once the process has ended: what others print afterwards is not waited for
    while left is None or left > 0:
        ready = [file for file, _ in coming.poll(1000.0 * _PAUSE if lines.begun else None)]
        if left is None and car in ready:
            coming.unregister(car)
            (left,) = struct.unpack("i", fcntl.ioctl(printed, termios.FIONREAD, bytes(4)))
        elif printed in ready:
            data = os.read(printed, _BLOCK if left is None else min(_BLOCK, left))
            if not data:
                break
            left = None if left is None else left - len(data)
            for some in lines.take(data):
                output.write(some)
        else:
            for some in lines.rest():
                output.write(some)
    for some in lines.rest(last=True):
        output.write(some)
    os._exit(0)
