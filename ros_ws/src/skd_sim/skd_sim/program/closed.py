"""Standard streams that whoever started the program has closed, as `2>&-` does.

The next file that is opened would get the number of one: what a controller prints, or SKD, would go into that file.
"""

from __future__ import annotations

import os
import sys


def open_closed() -> None:
    """Have each of the three standard streams that is closed lead nowhere, before anything else is opened."""
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(number, True)
    os.close(number)
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:  # Python's own sign of a closed one
            stream = open(number, "w" if number else "r", encoding="utf-8", errors="replace", closefd=False)  # noqa: SIM115
            setattr(sys, name, stream)
            setattr(sys, f"__{name}__", stream)
