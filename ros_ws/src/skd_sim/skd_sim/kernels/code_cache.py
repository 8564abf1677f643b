"""Machine code of kernels on disk, each under a digest of all that it depends on, so that no change leaves it stale.

Numba's own cache looks at the file of the compiled function alone, while numba puts the code of callees and the values
of globals, from whichever file, into their callers; and two processes that compile one function for other arguments may
mix up its index. Here each function and tuple of argument types has a file of its own, which is replaced as a whole.
"""

from __future__ import annotations

import atexit
import contextlib
import enum
import functools
import hashlib
import io
import os
import pickle
import re
import shutil
import sys
import tempfile
import types
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

import numba
import numpy as np
from numba.core.caching import NullCache
from numba.core.compiler import CompileResult
from numba.core.dispatcher import Dispatcher
from numba.core.serialize import NumbaPickler

VARIABLE: Final = "SKD_CACHE_DIR"
_PLAIN: Final = (type(None), bool, int, float, complex, str, bytes)
_LIBRARIES: Final = frozenset({"numba", "numpy", "llvmlite"}) | sys.stdlib_module_names
"""Whose functions are told apart by their names: their versions are in each digest."""
_VERSIONS: Final = f"{sys.version_info[:3]} {numba.__version__} {np.__version__}"
_NumbaCache: Any = NullCache  # numba has no types for these
_NumbaPickler: Any = NumbaPickler
_rebuild: Any = CompileResult._rebuild


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
    except (OSError, RuntimeError) as error:  # the latter where nobody knows a home
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
    """A function reads something of which no two states can be told apart."""


def digest_of(kernel: Callable[..., Any]) -> str | None:
    """Return a digest (hexadecimal) of all that the machine code of a function depends on but its argument types.

    That is bytecode, constants, options, and every global value that it reads, and so for each function that it calls.

    Args:
        kernel: plain, or compiled by numba.

    Returns:
        None where it reads a value of which no two states can be told apart: then its code must not be kept.
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
