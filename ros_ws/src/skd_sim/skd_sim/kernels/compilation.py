"""Compilation of numeric kernels, with an on-disk cache that no change can ever leave stale.

Numba's own cache looks only at the file of the compiled function. A kernel that calls a kernel of another file, or
reads a number from one, would keep the old code after an update, and two runs of the same version would then give
different trajectories. Here code is kept under a digest of all that it depends on (`fingerprint`, `kernel_cache`).
"""

from __future__ import annotations

import functools
import importlib
import sys
import types
from collections.abc import Callable, Mapping
from typing import Any, TypeVar, overload

import numba
from numba.core.dispatcher import Dispatcher
from numba.core.errors import NumbaError
from numba.np import linalg

from skd_sim.errors import UsageError
from skd_sim.kernels.fingerprint import UnfathomableError, fingerprint
from skd_sim.kernels.kernel_cache import KernelCache
from skd_sim.program.requirements import environment

CompilationError = NumbaError
"""What a kernel raises whose code or arguments cannot be compiled."""

_Function = TypeVar("_Function", bound=Callable[..., Any])

_specialised: dict[tuple[str, str, str], str] = {}
"""(module and name of the template, name of the specialisation) → fingerprint."""
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
    # `_nrt` is one of numba's own options, of which its types do not know.
    options: Any = {"forceinline": inline, "_nrt": counts, "nogil": nogil}
    compiled: Any = numba.njit(error_model="numpy", **options)(function)
    if isinstance(compiled, Dispatcher):  # not where numba is told to leave Python as it is
        vars(compiled)["_cache"] = KernelCache(compiled)
    return compiled


def unbound(*_arguments: Any) -> Any:
    """Stand, in a template, for a kernel that `specialise` binds."""
    raise NotImplementedError("bound to the model's kernel by `specialise`")


def specialise(
    template: Callable[..., Any],
    name: str,
    bindings: Mapping[str, Any],
    *,
    allocates: bool = True,
    inline: bool = False,
) -> Callable[..., Any]:
    """Compile a copy of `template` in which the global names of `bindings` stand for other kernels.

    This is how one planner serves many models at full speed: the model's kernels are inlined as if the
    planner had been written for it, and, unlike a closure over kernels, the result can be cached on disk.

    Args:
        template: plain (uncompiled) function that calls the bound names as globals.
        name: name of this specialisation, unique for each (template, bindings).
        bindings: global name → kernel.
        allocates: whether it allocates memory, as in `kernel`.
        inline: whether it is inlined, as in `kernel`; an inlined kernel allocates nothing.

    Raises:
        ValueError: the same template was specialised under this name with other code.
    """
    namespace = {**template.__globals__, **bindings}
    copy = types.FunctionType(template.__code__, namespace, template.__name__, template.__defaults__)
    copy.__module__ = template.__module__
    copy.__qualname__ = template.__qualname__
    try:
        digest = fingerprint(copy)
    except UnfathomableError:  # what cannot be kept on disk need only be told apart within this process
        digest = f"{id(copy):x}"
    if _specialised.setdefault((copy.__module__, copy.__qualname__, name), digest) != digest:
        raise ValueError(
            f"two different models are called {name!r}: give each a name of its own (one that was changed in a running "
            "session, too, or begin a new session)"
        )
    # Names of machine code come from here: no two specialisations may share one.
    copy.__qualname__ += f"__{name}_{digest[:16]}"
    return kernel(inline=True)(copy) if inline else kernel(allocates=allocates)(copy)
