"""What becomes of a terminal that is drawn on when its program is stopped by Ctrl-Z, hung up or ended by SIGQUIT."""

from __future__ import annotations

import os
import signal
import sys
import termios
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from skd_sim.inputs.printable import own

_LEAVE, _RETURN = "\x1b[?25h\x1b[?1049l", "\x1b[?1049h\x1b[?25l"
"""The cursor shown and the other screen left, and the reverse (xterm's control sequences)."""
_END = (signal.SIGHUP, signal.SIGQUIT)


@contextmanager
def leaving_in_order(descriptor: int, usual: list[object]) -> Iterator[None]:
    """Give a terminal back whenever the program leaves it, as long as this lasts.

    At Ctrl-Z the terminal is as it was before until the program goes on; SIGHUP and SIGQUIT, by which a program ends
    without a word to its terminal, end it as SIGTERM does. Signals that are ignored stay so.

    Args:
        descriptor: of the terminal.
        usual: its attributes before anything was drawn, as `termios.tcgetattr` gives them.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(_number: int, _frame: FrameType | None) -> None:
        drawn = termios.tcgetattr(descriptor)
        termios.tcsetattr(descriptor, termios.TCSADRAIN, usual)  # type: ignore[arg-type]
        _write(_LEAVE)
        os.kill(os.getpid(), signal.SIGSTOP)
        termios.tcsetattr(descriptor, termios.TCSADRAIN, drawn)
        _write(_RETURN)

    def end(_number: int, _frame: FrameType | None) -> None:
        os.kill(os.getpid(), signal.SIGTERM)

    handlers = {signal.SIGTSTP: stop, **dict.fromkeys(_END, end)}
    before = {
        number: signal.signal(number, handler)
        for number, handler in handlers.items()
        if signal.getsignal(number) is not signal.SIG_IGN
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _write(text: str) -> None:
    os.write(own(sys.stdout).fileno(), text.encode())
