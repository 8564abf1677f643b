"""What the tests of rosless share: domains of their own, and processes that always end."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from common import PATIENCE, wait_for_line

SOURCE = Path(__file__).resolve().parents[2] / "rosless" / "src"
PRELUDE = f"import sys; sys.path.insert(0, {str(SOURCE)!r}); import rosless.activate\n"


class Process:
    """A Python program in a process of its own."""

    def __init__(self, path: Path, arguments: list[str], environment: dict[str, str]) -> None:
        # without the paths of a sourced ROS 2, whose rclpy would come first
        base = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "AMENT_PREFIX_PATH")}
        self._popen = subprocess.Popen(
            [sys.executable, "-u", str(path), *arguments],
            env={**base, **environment},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def signal(self, number: int) -> None:
        """Send a signal."""
        self._popen.send_signal(number)

    def sleeps(self) -> bool:
        """Whether its main thread waits for something instead of running or wanting to run."""
        status = Path(f"/proc/{self._popen.pid}/stat").read_text()
        # the name before the state may hold blanks and brackets
        return status.rpartition(")")[2].split()[0] == "S"

    def kill(self) -> None:
        """End the process without giving it a chance to say goodbye."""
        self._popen.kill()
        self._popen.wait()

    def wait_for_line(self, wanted: str) -> str:
        """The first line of standard output that holds a text."""
        line = wait_for_line(self._popen, wanted)
        assert line, f"no line with {wanted!r}; standard error:\n{self.finish()[2]}"
        return line

    def finish(self, timeout: float = PATIENCE) -> tuple[int, str, str]:
        """Exit code, standard output and standard error; killed if it takes too long."""
        try:
            out, err = self._popen.communicate(timeout=timeout)
        except subprocess.TimeoutExpired:
            self._popen.kill()
            out, err = self._popen.communicate()
            raise AssertionError(f"the process did not end; it said:\n{out}\n{err}") from None
        return self._popen.returncode, out, err

    def stop(self) -> None:
        """End it if it still runs."""
        if self._popen.poll() is None:
            self._popen.kill()
            self._popen.communicate()
