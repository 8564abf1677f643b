"""Bags written behind the episodes, by a process that does nothing else: nobody waits for the disk.

It gets recordings by its standard input and says by its standard output what has become of each. A recording that it
has not confirmed is kept here: should it die, they are written here, and no bag is lost. It ends when its input does.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import select
import shutil
import subprocess
import sys
from collections import deque
from typing import IO

from skd_sim.ros_environment import node_variables

from skd_evaluator.ros.recording.recording import Recording, write_recording

_FROM = 8
"""Bags after which a process is worth its start."""
_MOST = 16
"""Recordings that may wait for it; then the episodes wait."""
_PATIENCE = 10.0
"""s in which it has to take or say something; else it is stopped, or stuck, and is ended."""
_READY = pickle.dumps(None)
_SIZE = 4  # bytes of a length


class BagsBehind:
    """Takes recordings, and writes them: the first here, those that follow in a process."""

    def __init__(self) -> None:
        """Start nothing yet."""
        self._count = 0
        self._popen: subprocess.Popen[bytes] | None = None
        self._ready = False
        self._unconfirmed: deque[Recording] = deque()

    def write(self, recording: Recording) -> None:
        """Write a recording, now or soon.

        Raises:
            OSError: it, or one before it, cannot be written.
        """
        self._count += 1
        if self._count == _FROM:
            self._popen = _started()
        self._take_answers(wait_until=_MOST - 1)
        if not self._ready:
            write_recording(recording)
            return
        self._unconfirmed.append(recording)
        assert self._popen is not None
        assert self._popen.stdin is not None
        try:
            _send(self._popen.stdin, pickle.dumps(recording, pickle.HIGHEST_PROTOCOL))
        except (BrokenPipeError, TimeoutError):
            self._go_on_here()

    def finish(self) -> None:
        """See that all recordings are written.

        Raises:
            OSError: one cannot be.
        """
        try:
            self._take_answers(wait_until=0)
        finally:
            self.close()

    def close(self) -> None:
        """Let the process end; what it has not begun is not written."""
        if self._popen is not None:
            self._popen.kill()
            self._popen.communicate()
        self._popen, self._ready = None, False
        self._unconfirmed.clear()

    def _take_answers(self, wait_until: int) -> None:
        """Take note of what is written, and wait until so few recordings are not."""
        while (popen := self._popen) is not None:
            assert popen.stdout is not None
            waits = len(self._unconfirmed) > wait_until
            there = select.select([popen.stdout], [], [], _PATIENCE if waits else 0.0)[0]
            if not there and not waits:
                return
            answer = _receive(popen.stdout) if there else None
            if answer is None:
                self._go_on_here()
                return
            error = pickle.loads(answer)
            if not self._ready:
                self._ready = True
                continue
            self._unconfirmed.popleft()
            if error is not None:
                raise error

    def _go_on_here(self) -> None:
        """The process is gone: write what it has not, and all that follows, without it."""
        left = list(self._unconfirmed)
        self.close()
        for recording in left:
            for begun in recording.path.parent.glob(".bag.*"):
                shutil.rmtree(begun)
            if not recording.path.exists():  # else it could not say so any more
                write_recording(recording)


def _started() -> subprocess.Popen[bytes]:
    popen = subprocess.Popen(
        [sys.executable, "-P", "-m", "skd_evaluator.ros.recording.bags_behind"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=node_variables(os.environ),
        start_new_session=True,  # an interrupt from the terminal is not for it
        bufsize=0,
    )
    assert popen.stdin is not None
    os.set_blocking(popen.stdin.fileno(), False)
    return popen


def _send(stream: IO[bytes], data: bytes) -> None:
    """Send a piece of data to a process.

    Raises:
        BrokenPipeError: it has ended.
        TimeoutError: it does not take it.
    """
    left = memoryview(len(data).to_bytes(_SIZE, "little") + data)
    while left:
        if not select.select([], [stream], [], _PATIENCE)[1]:
            raise TimeoutError
        left = left[stream.write(left) or 0 :]  # None: what was free was not enough


def _receive(stream: IO[bytes]) -> bytes | None:
    """Return the next piece of data; none at the stream's end."""

    def exactly(count: int) -> bytes:
        data = b""
        while len(data) < count and (more := stream.read(count - len(data))):
            data += more
        return data

    head = exactly(_SIZE)
    data = exactly(int.from_bytes(head, "little")) if len(head) == _SIZE else b""
    return data or None


def main() -> None:
    """Write what comes until nothing does."""
    answers = os.fdopen(os.dup(1), "wb", buffering=0)
    os.dup2(2, 1)  # what libraries print is no answer
    _send(answers, _READY)
    with contextlib.suppress(BrokenPipeError):  # nobody wants to know any more
        while (data := _receive(sys.stdin.buffer)) is not None:
            error: OSError | None = None
            try:
                write_recording(pickle.loads(data))
            except OSError as failure:
                error = failure
            _send(answers, pickle.dumps(error))


if __name__ == "__main__":
    main()
