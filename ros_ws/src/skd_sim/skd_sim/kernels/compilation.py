"""Compilation of numeric kernels, with an on-disk cache that no change can ever leave stale.

Numba's own cache looks only at the file of the compiled function. A kernel that calls a kernel of another file, or
reads a number from one, would keep the old code after an update, and two runs of the same version would then give
different trajectories. Here code is kept under a digest of all that it depends on (`fingerprint`, `kernel_cache`).
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar, overload

from skd_sim.kernels import waiting
from skd_sim.program.lasting import import_lasting

_Function = TypeVar("_Function", bound=Callable[..., Any])


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
    options = {"inline": inline, "allocates": counts, "nogil": nogil}
    if waiting.is_put_off():
        return waiting.Waiting(function, options)
    return import_lasting("skd_sim.kernels.compiler.machine_code").compiled(function, **options)
