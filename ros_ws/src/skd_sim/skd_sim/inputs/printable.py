"""Text of others on the terminal: characters that would steer it, or reverse letters, are shown and not obeyed.

Names of controllers, of φ and of files are anybody's. An escape sequence in them clears the screen or hides a line, a
mark of writing direction turns "unsafe" around. So all that the program prints goes through one stream, `guarded`, that
writes such a character as the escape that Python has for it. What the program itself draws with goes around it: `own`.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import IO, Any

_BLANKS = frozenset("\n\t\u00a0\u1680\u202f\u205f\u3000") | {chr(code) for code in range(0x2000, 0x200B)}
"""Blanks of several widths, which steer nothing: Python calls them not printable."""
_RESET = "\x1b[0m"
"""Ends colours and does nothing else: colorama, which numba uses where it is installed, writes it at the end."""


def printable(text: str) -> str:
    """Return text in which no character steers a terminal: control and format characters are written as escapes."""
    if text.isprintable():
        return text
    return "".join(one if one.isprintable() or one in _BLANKS else _escape(one) for one in text)


def one_line(text: str) -> str:
    """Return the same in one line: what begins a new one is a blank."""
    return printable(" ".join(text.splitlines()))


def printable_json(text: str) -> str:
    """Return JSON text that says the same and in which no character steers a terminal."""
    if text.isprintable():
        return text
    # Outside of its texts JSON has no such character, and within them \\u stands for one.
    return "".join(one if one.isprintable() or one in _BLANKS else _in_json(one) for one in text)


def columns(text: str) -> int:
    """Return how many columns of a terminal a text takes at most."""
    return len(text) if text.isascii() else sum(1 if one.isascii() else 2 for one in text)


def pieces(text: str, room: int) -> Iterator[str]:
    """Divide a text into pieces that take no more than so many columns of a terminal."""
    if text.isascii():
        yield text[:room]
        for begin in range(room, len(text), room):
            yield text[begin : begin + room]
        return
    begin, width = 0, 0
    for place, one in enumerate(text):
        wide = columns(one)
        if width + wide > room:
            yield text[begin:place]
            begin, width = place, 0
        width += wide
    yield text[begin:]


def _escape(one: str) -> str:
    return one.encode("unicode_escape").decode("ascii")


def _in_json(one: str) -> str:
    pairs = one.encode("utf-16-be", "surrogatepass")
    return "".join(f"\\u{pairs[at]:02x}{pairs[at + 1]:02x}" for at in range(0, len(pairs), 2))


class PrintableStream:
    """A text stream through which nothing steers a terminal; all else is what the stream behind it does."""

    def __init__(self, stream: Any) -> None:
        """Guard a stream."""
        self._stream = stream

    def write(self, text: str) -> int:
        """Write text as `printable` has it, but for an end of colours that stands alone."""
        self._stream.write(text if text == _RESET else printable(text))
        return len(text)

    def writelines(self, lines: Any) -> None:
        """Write each of some texts."""
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def __iter__(self) -> Iterator[str]:
        return iter(self._stream)


def own(stream: Any) -> IO[str]:
    """Return what is behind a guarded stream, for colours and bars of the program's own; else the stream itself."""
    while isinstance(stream, PrintableStream):
        stream = stream._stream
    found: IO[str] = stream
    return found


@contextmanager
def guarded() -> Iterator[None]:
    """Let standard output and standard error be guarded, as long as this lasts."""
    before = sys.stdout, sys.stderr
    mine: tuple[Any, Any] = (PrintableStream(sys.stdout), PrintableStream(sys.stderr))
    sys.stdout, sys.stderr = mine
    try:
        yield
    finally:
        if sys.stdout is mine[0]:
            sys.stdout = before[0]
        if sys.stderr is mine[1]:
            sys.stderr = before[1]
