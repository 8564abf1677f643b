"""Imports of a program's own modules, which stay until it ends."""

from __future__ import annotations

import gc
import importlib
import sys
from types import ModuleType


def import_lasting(name: str) -> ModuleType:
    """Import a module and return it; where it is new, nothing that is there by then is looked through for garbage.

    Python would do so again and again while modules are imported: a sixth of the start of a node. A process that is
    forked later copies less memory, as well.
    """
    if name in sys.modules or not gc.isenabled():
        return importlib.import_module(name)
    gc.disable()
    try:
        return importlib.import_module(name)
    finally:
        gc.freeze()
        gc.enable()
