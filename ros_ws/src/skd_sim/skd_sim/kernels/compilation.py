"""Kernels: functions of numbers and arrays that numba compiles, and templates of kernels for many models."""

from __future__ import annotations

import functools
import itertools
import sys
import types
from collections.abc import Callable, Mapping
from typing import Any, Final, TypeVar, overload

import numba
from numba.core.dispatcher import Dispatcher
from numba.core.errors import NumbaError

from skd_sim.errors import UsageError
from skd_sim.kernels import stream_type as stream_type  # tells numba of it
from skd_sim.kernels.code_cache import KernelCache, digest_of
from skd_sim.start import environment

if tuple(map(int, numba.__version__.split(".")[:2])) < (0, 61):  # as Ubuntu's python3-numba may be
    raise UsageError(f"skd needs numba 0.61 or newer, and {sys.executable} has {numba.__version__}: {environment()}")

CompilationError = NumbaError
"""What a kernel raises whose code or arguments cannot be compiled."""
_Function = TypeVar("_Function", bound=Callable[..., Any])
_NUMBERS: Final = itertools.count()


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
        allocates: whether it makes arrays; not, by default, where it is inlined. A slice is none as long as only
            kernels that it calls see it. One that does not allocate keeps no count of references to the arrays it was
            given, which would cost several times as much as a step of a model. That it does not is checked when it is
            compiled.
        nogil: let other Python threads run during a call from Python; the arrays must then be theirs to share.
    """
    if function is None:
        return functools.partial(kernel, inline=inline, allocates=allocates, nogil=nogil)
    counts = not inline if allocates is None else allocates
    # `_nrt` is one of numba's own options, of which its types do not know.
    options: Any = {"forceinline": inline, "_nrt": counts, "nogil": nogil}
    made: Any = numba.njit(error_model="numpy", **options)(function)
    if isinstance(made, Dispatcher):  # not where numba is told to leave Python as it is
        vars(made)["_cache"] = KernelCache(made)
    return made


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
        name: name of this specialisation, by which a reader of profiles and of the cache knows it.
        bindings: global name → kernel.
        allocates: whether it allocates memory, as in `kernel`.
        inline: whether it is inlined, as in `kernel`; an inlined kernel allocates nothing.
    """
    namespace = {**template.__globals__, **bindings}
    copy = types.FunctionType(template.__code__, namespace, template.__name__, template.__defaults__)
    copy.__module__ = template.__module__
    copy.__qualname__ = template.__qualname__
    # Names of machine code come from here: no two specialisations may share one.
    copy.__qualname__ += f"__{name}_{(digest_of(copy) or f'{next(_NUMBERS)}')[:16]}"
    return kernel(inline=True)(copy) if inline else kernel(allocates=allocates)(copy)
