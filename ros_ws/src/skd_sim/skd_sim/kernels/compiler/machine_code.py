"""How numba is told to compile a kernel, and where it keeps what it has compiled."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable
from typing import Any

import numba
from numba.core.dispatcher import Dispatcher
from numba.core.errors import NumbaError
from numba.np import linalg

from skd_sim.errors import UsageError
from skd_sim.kernels.compiler.kernel_cache import KernelCache
from skd_sim.program.requirements import environment

CompilationError = NumbaError
"""What a kernel raises whose code or arguments cannot be compiled."""

if tuple(map(int, numba.__version__.split(".")[:2])) < (0, 61):  # as Ubuntu's python3-numba may be
    raise UsageError(f"skd needs numba 0.61 or newer, and {sys.executable} has {numba.__version__}: {environment()}")


def _import_array_functions() -> None:
    """Import what numba itself imports before the first kernel, but for scipy.linalg, a fifth of a node's start.

    Numba imports that only to see whether scipy has it, which it has. A kernel that multiplies matrices is told of it
    when it is compiled.
    """
    ensure, linalg.ensure_blas = linalg.ensure_blas, lambda: None
    try:
        importlib.import_module("numba.np.arraymath")
    finally:
        linalg.ensure_blas = ensure


_import_array_functions()
importlib.import_module("skd_sim.kernels.compiler.stream_type")  # tells numba of it


def compiled(function: Callable[..., Any], *, inline: bool, allocates: bool, nogil: bool) -> Any:
    """Return a function that numba compiles at its first call; see `skd_sim.kernels.compilation.kernel`."""
    # `_nrt` is one of numba's own options, of which its types do not know.
    options: Any = {"forceinline": inline, "_nrt": allocates, "nogil": nogil}
    made: Any = numba.njit(error_model="numpy", **options)(function)
    if isinstance(made, Dispatcher):  # not where numba is told to leave Python as it is
        vars(made)["_cache"] = KernelCache(made)
    return made
