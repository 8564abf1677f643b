"""Compilation of numeric kernels, with an on-disk cache that a source change can never leave stale.

Numba's own cache looks only at the file of the compiled function. A kernel that calls a kernel of another
file would keep the old code of its callee after an update, and two runs of the same version would then give
different trajectories. Here the cache folder carries a fingerprint of every kernel source instead.
"""

from __future__ import annotations

import functools
import hashlib
import importlib.util
import inspect
import os
import sys
import tempfile
import types
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar, overload

import numba
from numba.core import config

from skd_sim.errors import UsageError
from skd_sim.requirements import environment

_Function = TypeVar("_Function", bound=Callable[..., Any])
_MARK = "@kernel"

if tuple(map(int, numba.__version__.split(".")[:2])) < (0, 61):  # as Ubuntu's python3-numba may be
    raise UsageError(f"skd needs numba 0.61 or newer, and {sys.executable} has {numba.__version__}: {environment()}")


@functools.cache
def _fingerprint() -> str:
    """Return a digest of every source file of the SKD packages that defines a kernel."""
    digest = hashlib.sha256(numba.__version__.encode())
    here = Path(__file__).resolve().parent
    roots = {here}
    for name in ("skd_adversary", "skd_evaluator"):
        beside = [p for p in (here.parent.parent / name / name, here.parent / name) if p.is_dir()]
        spec = None if beside else importlib.util.find_spec(name)  # colcon installs each package in a place of its own
        roots.update(beside or map(Path, (spec and spec.submodule_search_locations) or ()))
    for root in sorted(roots, key=lambda path: path.name):
        for source in sorted(root.rglob("*.py")):
            text = source.read_text(encoding="utf-8")
            if _MARK in text:
                digest.update(text.encode())
    return digest.hexdigest()[:16]


@functools.cache
def cache_directory() -> Path:
    """Return the folder for compiled kernels: $SKD_CACHE_DIR, else the user's cache, else a temporary one."""
    root = os.environ.get("SKD_CACHE_DIR")
    base = Path(root) if root else Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "skd"
    folder = base / f"kernels-{_fingerprint()}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK):
            raise PermissionError(folder)
    except OSError:
        folder = Path(tempfile.gettempdir()) / f"skd-{os.getuid()}" / folder.name
        folder.mkdir(parents=True, exist_ok=True)
    return folder


@overload
def kernel(function: _Function, /) -> _Function: ...


@overload
def kernel(*, inline: bool = ..., allocates: bool = ..., nogil: bool = ...) -> Callable[[_Function], _Function]: ...


def kernel(function: Any = None, /, *, inline: bool = False, allocates: bool | None = None, nogil: bool = False) -> Any:
    """Compile a function with numba in nopython mode at its first call; no fast-math, so bits are stable.

    Args:
        function: plain function of numbers and arrays.
        inline: compile it into every kernel that calls it. A call hands over each number of a NamedTuple on its own,
            which for a model's parameters takes longer than a step of the model.
        allocates: whether it makes arrays, slices included; not, by default, where it is inlined. One that does not
            keeps no count of references to those it was given, which would cost several times as much as a step of a
            model. That it does not is checked when it is compiled.
        nogil: let other Python threads run during a call from Python; the arrays must then be theirs to share.
    """
    if function is None:
        return functools.partial(kernel, inline=inline, allocates=allocates, nogil=nogil)
    counts = not inline if allocates is None else allocates
    settings: Any = config  # numba fills this module at run time
    before = settings.CACHE_DIR
    settings.CACHE_DIR = str(cache_directory())
    try:
        # `_nrt` is one of numba's own options, of which its types do not know.
        options: Any = {"forceinline": inline, "_nrt": counts, "nogil": nogil}
        return numba.njit(cache=True, error_model="numpy", **options)(function)
    finally:
        settings.CACHE_DIR = before


def specialise(
    template: Callable[..., Any], name: str, bindings: Mapping[str, Any], *, allocates: bool = True
) -> Callable[..., Any]:
    """Compile a copy of `template` in which the global names of `bindings` stand for other kernels.

    This is how one planner serves many models at full speed: the model's kernels are inlined as if the
    planner had been written for it, and, unlike a closure over kernels, the result can be cached on disk.

    Args:
        template: plain (uncompiled) function that calls the bound names as globals.
        name: identifies this specialisation in the cache; unique per (template, bindings).
        bindings: global name → kernel.
        allocates: as in `kernel`.
    """
    namespace = {**template.__globals__, **bindings}
    copy = types.FunctionType(template.__code__, namespace, template.__name__, template.__defaults__)
    # A model may come from outside of the fingerprinted packages: its sources are part of the name.
    digest = hashlib.sha256()
    for function in filter(callable, bindings.values()):
        digest.update(Path(inspect.getfile(getattr(function, "py_func", function))).read_bytes())
    copy.__qualname__ = f"{template.__qualname__}__{name}_{digest.hexdigest()[:8]}"
    copy.__module__ = template.__module__
    return kernel(allocates=allocates)(copy)
