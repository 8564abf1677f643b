"""Keys of a terminal, as they are pressed."""

from __future__ import annotations

import os
import select
import sys
import termios
import threading
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

_ARROWS: Final = {"A": "up", "B": "down", "C": "right", "D": "left"}
_ESCAPE: Final = "\x1b"
_WAIT = 0.1  # s


def key_names(text: str) -> Iterator[str]:
    """Yield the names of the keys that a terminal sent: arrows by their names, letters in small.

    A terminal sends an arrow as ESC [ A or ESC O A, with digits and a semicolon in between where another key was held
    (ECMA-48; xterm's control sequences). Other sequences mean nothing here; ESC alone is the key itself.
    """
    place = 0
    while place < len(text):
        one = text[place]
        place += 1
        if one != _ESCAPE:
            yield one.lower()
            continue
        if text[place : place + 1] not in ("[", "O"):
            yield "escape"
            continue
        place += 1
        while place < len(text) and not text[place].isalpha() and text[place] != "~":
            place += 1
        if (name := _ARROWS.get(text[place : place + 1])) is not None:
            yield name
        place += 1


@contextmanager
def reading_keys(press: Callable[[str], None]) -> Iterator[None]:
    """Call a function with the name of each key that is pressed, as long as this lasts; the terminal shows none.

    Standard input has to be a terminal. The function is called in a thread of its own, which ends where the terminal is
    closed.
    """
    descriptor = sys.stdin.fileno()
    before = termios.tcgetattr(descriptor)
    over = threading.Event()

    def read() -> None:
        while not over.is_set():
            if select.select([descriptor], [], [], _WAIT)[0]:
                try:
                    data = os.read(descriptor, 256)
                except OSError:  # it was closed
                    return
                if not data:
                    return
                for name in key_names(data.decode("utf-8", errors="ignore")):
                    press(name)

    reader = threading.Thread(target=read, name="skd-keys", daemon=True)
    try:
        tty.setcbreak(descriptor)
        attributes = termios.tcgetattr(descriptor)
        for key in (termios.VSUSP, termios.VQUIT):  # Ctrl-C is still a signal; these would leave the terminal drawn on
            attributes[6][key] = b"\0"
        termios.tcsetattr(descriptor, termios.TCSADRAIN, attributes)
        reader.start()
        yield
    finally:
        over.set()
        reader.join(2.0 * _WAIT)
        termios.tcsetattr(descriptor, termios.TCSADRAIN, before)
