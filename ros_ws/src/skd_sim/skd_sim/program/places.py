"""Where modules are looked for: a user's folders come behind all that SKD brings, but first for the user's own class.

A folder on PYTHONPATH comes before Python's own modules otherwise, and Python begins with a sitecustomize.py there: a
stranger's `json.py` beside the stranger's car would run in the process that judges the car.
"""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from pathlib import Path
from typing import Final

PUT_OFF: Final = "SKD_PYTHONPATH"
"""Variable in which PYTHONPATH waits until a process has begun: of `scripts/skd`, and of a controller's process."""
_added: Final[list[str]] = []


def places_put_off() -> None:
    """Look into the working folder and those of PYTHONPATH from now on, after all others, if they were put off."""
    path = os.environ.pop(PUT_OFF, None)
    if path is None:
        return
    if path:
        os.environ["PYTHONPATH"] = path  # of what this process starts
    for place in (".", *filter(None, path.split(os.pathsep))):
        with suppress(OSError):  # the working folder is gone
            _added.append(str(Path(place).absolute()))
    sys.path += _added


def users_first() -> tuple[str, ...]:
    """Return `sys.path` as a user's class is to find its modules: what was put off comes first."""
    return tuple(dict.fromkeys([*(place for place in _added if place in sys.path), *sys.path]))
