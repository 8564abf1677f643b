"""Text of others for a terminal: what would steer it, as colours in a log or a new line in a name, is an escape."""

from __future__ import annotations

import unicodedata


def printable(text: str) -> str:
    """Return text in which control and format characters are written as escapes, but for tabs and ends of lines."""
    if text.isprintable():
        return text
    return "".join(
        one.encode("unicode_escape").decode() if unicodedata.category(one)[0] == "C" and one not in "\n\t" else one
        for one in text
    )


def one_line(text: str) -> str:
    """Return the same in one line: what begins a new one is a blank."""
    return printable(" ".join(text.splitlines()))
