"""What a user's code prints that runs in a worker itself, as a simulator does: led by its name, and not among results.

A worker prints where the command does, whose standard output may be read by a program.
"""

from __future__ import annotations

import contextlib
import io
import os
import sys

from skd_sim.apart.pump import Pump

_STDOUT = 1  # its descriptor


class _Here:
    """What this process prints to.

    Attributes:
        name: by which its lines are led; empty: they are not.
    """

    name = ""


def lead_prints(name: str) -> None:
    """Have all that this process prints from now on go to standard error, each line led by a name.

    Meant for a process that prints nothing of its own. One for which no pump can be started prints as before.
    """
    if name == _Here.name:
        return
    _Here.name = name
    files = [-1, -1, -1]
    with contextlib.suppress(OSError):
        try:
            sys.stdout.flush()
            files[:2] = os.pipe()
            if hasattr(os, "pidfd_open"):  # Linux
                files[2] = os.pidfd_open(os.getpid())
            Pump(name, files[0], files[2])
            os.dup2(files[1], _STDOUT)
        finally:
            for file in files:
                if file >= 0:
                    os.close(file)
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(line_buffering=True)  # who prints seldom is heard all the same
