"""Kernels: functions of numbers and arrays that numba compiles, templates of them, and the cache of their code.

Numba's own cache looks at the file of the compiled function alone, while numba puts the code of callees and the values
of globals, from whichever file, into their callers; and two processes that compile one function for other arguments may
mix up its index. Here each function and tuple of argument types has a file of its own, under a digest of all that it
depends on, which is replaced as a whole.
"""

from __future__ import annotations

import atexit
import contextlib
import enum
import functools
import hashlib
import io
import itertools
import math
import os
import pickle
import re
import shutil
import sys
import tempfile
import types
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeVar, overload

import numba
import numpy as np
from numba.core.caching import NullCache
from numba.core.compiler import CompileResult
from numba.core.dispatcher import Dispatcher
from numba.core.errors import NumbaError
from numba.core.serialize import NumbaPickler

from skd_sim.errors import UsageError
from skd_sim.start import environment

VARIABLE: Final = "SKD_CACHE_DIR"
_PLAIN: Final = (type(None), bool, int, float, complex, str, bytes)
_LIBRARIES: Final = frozenset({"numba", "numpy", "llvmlite"}) | sys.stdlib_module_names
"""Whose functions are distinguished by their names: their versions are in each digest."""
_VERSIONS: Final = f"{sys.version_info[:3]} {numba.__version__} {np.__version__}"
_NumbaCache: Any = NullCache  # numba has no types for these
_NumbaPickler: Any = NumbaPickler
_rebuild: Any = CompileResult._rebuild
_unliteral: Any = numba.types.unliteral


@functools.cache
def cache_folder() -> Path:
    """Return the folder of compiled kernels: in $SKD_CACHE_DIR, else in the user's cache.

    Where that cannot be written, a temporary one takes its place, which the programs that this one starts share.
    """
    try:
        root = os.environ.get(VARIABLE)
        base = Path(root) if root else Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "skd"
        folder = base / "kernels"
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if os.access(folder, os.W_OK | os.X_OK):
            return folder
        reason = f"{folder} cannot be written to"
    except (OSError, RuntimeError) as error:  # the latter where there is no home
        reason = str(error)
    print(
        f"skd: warning: {reason}; so kernels are compiled anew at each start, which takes about a minute: set "
        f"{VARIABLE} to a folder of your own",
        file=sys.stderr,
    )
    base = Path(tempfile.mkdtemp(prefix="skd-"))
    atexit.register(_remove, base, os.getpid())
    os.environ[VARIABLE] = str(base)
    (base / "kernels").mkdir()
    return base / "kernels"


def _remove(folder: Path, process: int) -> None:
    if os.getpid() == process:  # not at the end of a worker forked from it
        shutil.rmtree(folder, ignore_errors=True)


def is_kept(kernel: Any) -> bool:
    """Return whether code of a kernel is kept, for some types of arguments, of this version or another."""
    return any(cache_folder().glob(f"{_readable(kernel.py_func)}-*"))


class _Pickler(_NumbaPickler):  # type: ignore[misc]
    """Names the classes of the program that is run; numba would copy them, and a copy is no other kernel's argument."""

    def reducer_override(self, value: Any) -> Any:
        name = getattr(value, "__qualname__", "")
        if isinstance(value, type) and getattr(sys.modules["__main__"], name, None) is value:
            return name
        return super().reducer_override(value)


on_compiling: Final[list[Callable[[], None]]] = []
"""Called, once each, before the first kernel that has to be compiled."""


class KernelCache(_NumbaCache):  # type: ignore[misc]
    """Code of one kernel, as numba asks for it by the types of its arguments.

    A file that is missing or damaged means compiling; one that cannot be written, compiling again next time.
    """

    def __init__(self, kernel: Dispatcher) -> None:
        """Serve a kernel, whose digest is made when it is first called: then all that it calls is defined."""
        self._kernel = kernel

    @functools.cached_property
    def _digest(self) -> str | None:
        return digest_of(self._kernel)

    def load_overload(self, signature: Any, target: Any) -> Any:
        """Return what was compiled for a signature; None where there is nothing."""
        target.refresh()
        path = self._path(signature, target.codegen())
        if path is None:
            return None
        try:
            parts = pickle.loads(path.read_bytes())
        except (OSError, pickle.UnpicklingError, EOFError, AttributeError):
            while on_compiling:
                on_compiling.pop()()
            return None  # the last where it names a class of a program, and this is another program
        return _rebuild(target, *parts)

    def save_overload(self, signature: Any, compiled: Any) -> None:
        """Keep what was compiled for a signature."""
        path = self._path(signature, compiled.codegen)
        if path is None or compiled.library.has_dynamic_globals or any(not one.can_cache for one in compiled.lifted):
            return  # the latter two hold addresses of this process
        content, pickler = io.BytesIO(), _Pickler
        pickler(content, protocol=4).dump(compiled._reduce())
        temporary = path.with_name(f".{os.getpid()}-{path.name}")
        with contextlib.suppress(OSError):
            try:
                temporary.write_bytes(content.getvalue())
                temporary.replace(path)
            finally:
                temporary.unlink(missing_ok=True)

    def _path(self, signature: Any, codegen: Any) -> Path | None:
        """Return the file for a signature; None where the kernel's code cannot be kept."""
        shapes = [_shape(one) for one in getattr(signature, "args", signature)]
        if self._digest is None or None in shapes:
            return None
        key = hashlib.sha256(f"{self._digest} {shapes} {codegen.magic_tuple()}".encode()).hexdigest()[:40]
        return cache_folder() / f"{_readable(self._kernel.py_func)}-{key}.kernel"


def _readable(function: Any) -> str:
    """Return what names of files say of a function."""
    return re.sub(r"[^\w.]", "", f"{function.__module__}.{function.__qualname__}", flags=re.ASCII)[:100]


def _shape(kind: Any) -> str | None:
    """Return a numba type as text, with the fields of named tuples: code reads them by their place.

    None for a function, whose code may change.
    """
    named = getattr(kind, "instance_class", None)
    if isinstance(kind, numba.types.Dispatcher):
        return None
    inner = [_shape(one) for one in getattr(kind, "types", ())] if isinstance(kind, numba.types.BaseTuple) else []
    return None if None in inner else f"{kind} {_name(named)} {getattr(named, '_fields', '')} {inner}"


class _UnknownError(Exception):
    """A function reads something whose states cannot be distinguished."""


def digest_of(kernel: Callable[..., Any]) -> str | None:
    """Return a digest (hexadecimal) of all that the machine code of a function depends on but its argument types.

    That is bytecode, constants, options, and every global value that it reads, and so for each function that it calls.

    Args:
        kernel: plain, or compiled by numba.

    Returns:
        None where it reads a value whose states cannot be distinguished: then its code must not be kept.
    """
    digest = hashlib.sha256(_VERSIONS.encode())
    met: dict[int, int] = {}
    todo: list[Any] = [kernel]
    try:
        while todo:
            value = todo.pop()
            number = met.setdefault(id(value), len(met)) if callable(value) else len(met)
            words, inner = ((number,), ()) if number < len(met) - 1 else _parts(value)
            digest.update(repr((type(value).__qualname__, *words)).encode())
            todo += inner
    except _UnknownError:
        return None
    return digest.hexdigest()


def _parts(value: Any) -> tuple[tuple[Any, ...], list[Any]]:
    """Return what tells a value from others of its type, and the values below it."""
    kind = type(value)
    if isinstance(value, Dispatcher):
        return (sorted((name, repr(option)) for name, option in value.targetoptions.items()),), [value.py_func]
    if isinstance(value, types.FunctionType) and not _is_of_library(value):
        inner = [cell.cell_contents for cell in value.__closure__ or ()]
        inner += [value.__defaults__, value.__kwdefaults__ and sorted(value.__kwdefaults__.items())]
        words: list[Any] = [_name(value)]
        for code in _codes(value.__code__):
            consts = [one for one in code.co_consts if not isinstance(one, (types.CodeType, frozenset))]
            sets = [sorted(map(repr, one)) for one in code.co_consts if isinstance(one, frozenset)]
            words += [code.co_code, code.co_flags, code.co_argcount, code.co_names, code.co_varnames, consts, sets]
            inner += _globals_read(code.co_names, value.__globals__)
        return tuple(words), inner
    if kind in _PLAIN:
        return (value,), []
    if isinstance(value, enum.Enum):
        return (_name(kind), value.name, value.value), []
    if isinstance(value, (np.ndarray, np.generic)) and not value.dtype.hasobject:
        return (value.dtype.descr, value.shape, value.flags.c_contiguous, value.tobytes()), []
    if isinstance(value, (tuple, list)):
        return (_name(kind), getattr(kind, "_fields", ""), len(value)), list(value)
    if isinstance(value, type) and issubclass(value, enum.Enum):
        return (_name(value),), list(value)
    if isinstance(value, type) and issubclass(value, tuple) and hasattr(value, "_fields"):
        return (_name(value), value._fields), list(getattr(value, "_field_defaults", {}).items())
    if isinstance(value, numba.types.Type) or _is_of_library(value):
        return (_name(value), str(value) if isinstance(value, numba.types.Type) else ""), []
    raise _UnknownError


def _codes(code: types.CodeType) -> Iterator[types.CodeType]:
    """Yield the code of a function and that of its comprehensions."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _codes(constant)


def _globals_read(names: tuple[str, ...], namespace: dict[str, Any]) -> Iterator[Any]:
    """Yield the values that code may read by these names: globals, and attributes of the modules among them."""
    for name in names:
        value = namespace.get(name)
        if not isinstance(value, types.ModuleType):
            yield value
        elif value.__name__.partition(".")[0] not in _LIBRARIES:
            yield from _globals_read(tuple(one for one in names if one != name), vars(value))


def _is_of_library(value: Any) -> bool:
    owner = getattr(value, "__module__", None) or type(value).__module__
    return owner.partition(".")[0] in _LIBRARIES and _name(value) is not None


def _name(value: Any) -> str | None:
    """Return module and qualified name of a class or a function; none of what has no name."""
    name = getattr(value, "__qualname__", None) or getattr(value, "__name__", None)
    return f"{getattr(value, '__module__', None) or type(value).__module__}.{name}" if name else None


if tuple(map(int, numba.__version__.split(".")[:2])) < (0, 61):  # as Ubuntu's python3-numba may be
    raise UsageError(
        f"skd needs numba 0.61 or newer, and {sys.executable} has {numba.__version__}: {environment(['numba'])}"
    )

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
    # Some of these are numba's own options, of which its types do not know.
    options: Any = {"forceinline": inline, "_nrt": counts, "nogil": nogil}
    options |= {"no_cpython_wrapper": inline, "no_cfunc_wrapper": inline}
    made: Any = numba.njit(error_model="numpy", **options)(function)
    if isinstance(made, Dispatcher):  # not where numba is disabled
        vars(made)["_cache"] = KernelCache(made)
        made.__class__ = _InlinedKernel if inline else _Kernel
    return made


class _Kernel(type(numba.njit(lambda: None))):  # type: ignore[misc]
    """A kernel that is compiled once for each type of its arguments; numba would do so for each literal, too."""

    def get_call_template(self, args: Any, kws: Any) -> Any:
        return super().get_call_template(
            tuple(map(_unliteral, args)), {name: _unliteral(kind) for name, kind in kws.items()}
        )


class _InlinedKernel(_Kernel):
    """A kernel that other kernels contain: it is compiled without what Python calls it by.

    That takes half of the time. Called from Python it is compiled once more.
    """

    @functools.cached_property
    def _from_python(self) -> Any:
        return kernel(self.py_func)

    def __call__(self, *arguments: Any) -> Any:
        return self._from_python(*arguments)


def unbound(*_arguments: Any) -> Any:
    """Stand, in a template, for a kernel that `bound` puts in its place."""
    raise NotImplementedError("`bound` puts the model's kernel in its place")


@dataclass(frozen=True)
class Template:
    """A kernel to be, which calls other kernels, or other templates of its module, by name; see `template`."""

    function: Callable[..., Any]
    inline: bool
    allocates: bool


@overload
def template(function: _Function, /) -> _Function: ...


@overload
def template(*, inline: bool = ..., allocates: bool = ...) -> Callable[[_Function], _Function]: ...


def template(function: Any = None, /, *, inline: bool = True, allocates: bool = True) -> Any:
    """Make a function a template.

    Args:
        function: plain function that calls kernels by name.
        inline: whether callers contain its code; see `kernel`.
        allocates: whether it makes arrays; see `kernel`.
    """
    if function is None:
        return functools.partial(template, inline=inline, allocates=allocates)
    return Template(function, inline, allocates)


def bound(part: Any, name: str, parts: Mapping[str, Any]) -> Any:
    """Compile a template with the parts that it names, and so each template that it calls; return others as they are.

    This is how one planner serves many models at full speed: the model's kernels are inlined as if the planner had been
    written for it, and, unlike a closure over kernels, the result can be cached on disk.

    Args:
        part: template, compiled kernel or None.
        name: name of the composition, by which a reader of profiles and of the cache knows it.
        parts: kernel or number of each part, by name.
    """
    if not isinstance(part, Template):
        return part
    function, namespace = part.function, dict(part.function.__globals__)
    for use in function.__code__.co_names:
        if use in parts:
            namespace[use] = parts[use]
        elif isinstance(namespace.get(use), Template):
            namespace[use] = bound(namespace[use], name, parts)
    copy = types.FunctionType(function.__code__, namespace, function.__name__, function.__defaults__)
    copy.__module__, copy.__qualname__ = function.__module__, function.__qualname__
    # Names of machine code come from here: no two compositions may share one.
    copy.__qualname__ += f"__{name}_{(digest_of(copy) or f'{next(_NUMBERS)}')[:16]}"
    return kernel(inline=True)(copy) if part.inline else kernel(allocates=part.allocates)(copy)


_POINTS = np.linspace(-9.7, 9.3, 1021)


def arithmetic_digest() -> str:
    """Return a digest of functions whose last bit hangs on the processor and on libraries that pick code for it.

    numpy, BLAS and libm have several versions of each, by the processor's instructions. What numba compiles keeps to
    the order of operations, unless it has Intel's vector functions.
    """
    x, positive = _POINTS, np.abs(_POINTS) + 1e-3
    square = np.sin(np.arange(4096.0)).reshape(64, 64)
    with np.errstate(all="ignore"):
        vectors = [
            *(function(x) for function in (np.sin, np.cos, np.tan, np.exp, np.arctan, np.tanh, np.expm1)),
            *(function(positive) for function in (np.log, np.log1p, np.sqrt, np.cbrt)),
            *(function(x, x[::-1]) for function in (np.hypot, np.arctan2)),
            np.power(positive, x),
            square @ square.T,
            np.array([x.sum(), x.dot(x), x.std(), np.linalg.norm(x)]),
        ]
    scalars = [
        *(function(one) for function in (math.sin, math.cos, math.tan, math.exp, math.erf) for one in x),
        *(function(one) for function in (math.log, math.lgamma, math.gamma) for one in positive),
        *(function(one, 0.7) for function in (math.hypot, math.atan2, math.fmod) for one in x),
        *(math.pow(one, 1.3) for one in positive),
    ]
    digest = hashlib.sha256(f"vector functions {vars(numba.config)['USING_SVML']}".encode())
    for array in (*vectors, np.array(scalars)):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
