"""Templates of kernels, compiled anew for each model that they serve."""

from __future__ import annotations

import types
from collections.abc import Callable, Mapping
from typing import Any

from skd_sim.kernels.compilation import kernel
from skd_sim.kernels.compiler.fingerprint import UnfathomableError, fingerprint

_specialised: dict[tuple[str, str, str], str] = {}
"""(module and name of the template, name of the specialisation) → fingerprint."""


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
