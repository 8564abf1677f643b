"""What becomes of a terminal that is drawn on when its program is stopped by Ctrl-Z, hung up or ended by SIGQUIT."""

from __future__ import annotations

import contextlib
import os
import signal
import termios
import threading
from collections.abc import Iterator
from types import FrameType
from typing import Final, NamedTuple


class Sequences(NamedTuple):
    """What a terminal is sent (xterm's control sequences).

    Attributes:
        leave: before others have the terminal.
        back: when the program has it again.
    """

    leave: str
    back: str


CURSOR: Final = Sequences("\x1b[?25h", "\x1b[?25l")
"""The cursor is shown and hidden."""
OTHER_SCREEN: Final = Sequences("\x1b[?25h\x1b[?1049l", "\x1b[?1049h\x1b[?25l")
"""The cursor is shown and the other screen left, and the reverse."""
_END: Final = (signal.SIGHUP, signal.SIGQUIT)


@contextlib.contextmanager
def leaving_in_order(
    drawn_on: int, sequences: Sequences, keys: int | None = None, usual: list[object] | None = None
) -> Iterator[None]:
    """Give a terminal back whenever the program leaves it, as long as this lasts.

    At Ctrl-Z the terminal is as it was before until the program goes on; SIGHUP and SIGQUIT, by which a program ends
    without a word to its terminal, end it as SIGTERM does. Signals that are ignored stay so.

    Args:
        drawn_on: descriptor of the terminal that is drawn on.
        sequences: what it is sent when it is left, and afterwards.
        keys: descriptor of the terminal whose keys are read one by one, if they are.
        usual: its attributes before that, as `termios.tcgetattr` gives them.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    owner = os.getpid()

    def is_forked(number: int) -> bool:
        """Do in a process that was forked meanwhile, and draws nothing, what is usual; return whether this is one."""
        if os.getpid() == owner:
            return False
        signal.signal(number, signal.SIG_DFL)
        os.kill(os.getpid(), number)
        return True

    def stop(number: int, _frame: FrameType | None) -> None:
        if is_forked(number):
            return
        drawn = None if keys is None else termios.tcgetattr(keys)
        if keys is not None and usual is not None:
            termios.tcsetattr(keys, termios.TCSADRAIN, usual)  # type: ignore[arg-type]
        _write(drawn_on, sequences.leave)
        os.kill(os.getpid(), signal.SIGSTOP)
        if keys is not None and drawn is not None:
            termios.tcsetattr(keys, termios.TCSADRAIN, drawn)
        _write(drawn_on, sequences.back)

    ending = False

    def end(number: int, _frame: FrameType | None) -> None:
        nonlocal ending
        if not is_forked(number):
            ending = True
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
            # A shell that is hung up sends the signal once more, while there is something to clean up.
            signal.signal(number, signal.SIG_IGN if ending and number in _END else handler)


def _write(descriptor: int, text: str) -> None:
    with contextlib.suppress(OSError):  # of a terminal that is gone
        os.write(descriptor, text.encode())
