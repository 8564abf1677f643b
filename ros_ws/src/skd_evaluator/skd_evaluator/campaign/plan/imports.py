"""What a module imports, read from its source: nothing of it is run."""

from __future__ import annotations

import ast
import functools
import sysconfig
import warnings
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

_OWN = ("skd_sim", "skd_adversary", "skd_evaluator", "skd_msgs")  # which go with SKD's version
_LARGEST = 2**20  # bytes of a source that is read for its imports


@lru_cache(maxsize=4096)
def imports_of(file: Path, _digest: str) -> tuple[str, ...]:
    """Return the dotted names that a source in Python imports, wherever in it; a relative one begins with dots.

    Of `from a import b` it names `a.b`, which may be a module, and `a`. SKD's own are left out. What is no Python
    imports nothing, nor do names that are put together while it runs.

    Args:
        file: the source.
        _digest: its SHA-256, by which what was found before is known.
    """
    try:
        if file.stat().st_size > _LARGEST:
            return ()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of odd sources it is their authors who should be warned
            tree = ast.parse(file.read_bytes())
    except (OSError, SyntaxError, ValueError, RecursionError, MemoryError):
        return ()
    names = dict.fromkeys(name for node in ast.walk(tree) for name in _names_in(node))
    return tuple(name for name in names if name.partition(".")[0] not in _OWN)


def _names_in(node: ast.AST) -> Iterator[str]:
    if isinstance(node, ast.Import):
        yield from (one.name for one in node.names)
    elif isinstance(node, ast.ImportFrom):
        base = "." * node.level + (node.module or "")
        if node.module:
            yield base
        yield from (f"{base}{'.' if node.module else ''}{one.name}" for one in node.names if one.name != "*")
        if node.level and not node.module:
            yield f"{base}__init__"


def is_installed(file: Path) -> bool:
    """Return whether a file belongs to Python, to ROS, or to what is installed."""
    return not {"site-packages", "dist-packages"}.isdisjoint(file.parts) or any(
        file.is_relative_to(place) for place in _installed()
    )


@functools.cache
def _installed() -> tuple[Path, ...]:
    paths = sysconfig.get_paths()
    found = [Path(one) for one in (*(paths[name] for name in ("stdlib", "platstdlib", "purelib")), "/opt/ros")]
    return tuple(dict.fromkeys((*found, *(one.resolve() for one in found))))
