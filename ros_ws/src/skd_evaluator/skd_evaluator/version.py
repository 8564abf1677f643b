"""Which SKD this is."""

from __future__ import annotations

import importlib.metadata


def version() -> str:
    """Return the version of SKD, as installed by pip or built by colcon."""
    for name in ("skd", "skd_evaluator"):
        try:
            return importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return "unknown"
