"""SIGINT and SIGTERM as KeyboardInterrupt, and remembered: code that is not ours may swallow the exception."""

from __future__ import annotations

import os
import signal
import threading
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Interruption:
    """Listens to both signals.

    Attributes:
        came: whether one has come.
        held: set it to have further ones remembered only, while there is something to clean up.
    """

    def __init__(self) -> None:
        """Begin to listen with `listen` or a `with` statement."""
        self.came = False
        self.held = False
        self._before: dict[int, Any] = {}

    def listen(self) -> None:
        """Begin to listen; a signal that whoever started this process has it ignore stays ignored."""
        if threading.current_thread() is threading.main_thread():  # Python allows it nowhere else
            for number in SIGNALS:
                if signal.getsignal(number) is not signal.SIG_IGN:
                    self._before[number] = signal.signal(number, self._on_signal)

    def _on_signal(self, _number: int, _frame: object) -> None:
        self.came = True
        if not self.held:
            raise KeyboardInterrupt

    def exit_at_next(self, code: int) -> None:
        """From now on a signal ends the process at once: nothing is left to do but Python's own end."""
        self.held = True
        for number in self._before:
            signal.signal(number, lambda _number, _frame: os._exit(code))

    def __enter__(self) -> Interruption:
        self.listen()
        return self

    def __exit__(self, *_error: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
