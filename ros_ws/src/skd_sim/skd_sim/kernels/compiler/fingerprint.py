"""What compiled code depends on, as a digest: its own source, every global value that it reads, and so for its callees.

Numba freezes globals when it compiles, and puts the code of callees into their callers. So compiled code is right
exactly as long as the whole closure is the same: bytecode, constants, values and shapes of what is read, qualified
names and options of compilation, from whichever file.
"""

from __future__ import annotations

import dis
import enum
import functools
import hashlib
import sys
import types
from collections.abc import Callable, Iterator
from typing import Any

import numba
import numpy as np
from numba.core.dispatcher import Dispatcher

_PLAIN = (type(None), type(...), bool, int, float, complex, str, bytes)
_COMPILED = frozenset({"numba", "numpy", "llvmlite"})  # whose functions numba knows by name
_LIBRARIES = _COMPILED | sys.stdlib_module_names  # versions are in the digest
_VERSIONS = f"{sys.version_info[:3]} {numba.__version__} {np.__version__}"


class UnfathomableError(Exception):
    """A function reads something whose value cannot be told, so that its code must not be kept."""


def fingerprint(function: Callable[..., Any]) -> str:
    """Return a digest (hexadecimal) of all that the compiled code of a function depends on but its argument types.

    Args:
        function: plain, or compiled by numba.

    Raises:
        UnfathomableError: it, or what it calls, reads a value of which no two states can be told apart.
    """
    walk = _Walk()
    walk.value(function)
    return walk.digest.hexdigest()


def argument_shapes(kind: Any) -> str:
    """Return a numba type as text, with the fields of named tuples: code reads them by their place.

    Raises:
        UnfathomableError: it is that of a function.
    """
    if isinstance(kind, numba.types.Dispatcher):
        raise UnfathomableError("a function as an argument")
    text = f"{kind}"
    tuple_class = getattr(kind, "instance_class", None)
    if tuple_class is not None:
        text += f" {_name_of(tuple_class)}{getattr(tuple_class, '_fields', ())}"
    inner = getattr(kind, "types", ()) if isinstance(kind, numba.types.BaseTuple) else ()
    return " ".join([text, *map(argument_shapes, inner)])


class _Walk:
    """Feeds a digest with everything below a value; what has been met already is named by its number."""

    def __init__(self) -> None:
        self.digest = hashlib.sha256(_VERSIONS.encode())
        self._met: dict[int, int] = {}

    def _say(self, *words: object) -> None:
        self.digest.update((" ".join(map(str, words)) + "\0").encode())

    def _is_new(self, thing: object) -> bool:
        number = self._met.setdefault(id(thing), len(self._met))
        if number == len(self._met) - 1:
            return True
        self._say("again", number)
        return False

    def value(self, value: Any) -> None:
        """Take in a value that a kernel can read.

        Raises:
            UnfathomableError: no two states of it can be told apart.
        """
        kind = type(value)
        if kind in _PLAIN:
            self._say(kind.__name__, repr(value))
        elif isinstance(value, Dispatcher):
            if self._is_new(value):
                self._say("options", sorted((name, repr(option)) for name, option in value.targetoptions.items()))
                self.value(value.py_func)
        elif isinstance(value, types.FunctionType):
            self._function(value)
        elif isinstance(value, enum.Enum):
            self._say("member", _name_of(kind), value.name, repr(value.value))
        elif isinstance(value, (np.ndarray, np.generic)):
            array = np.asarray(value)
            if array.dtype.hasobject:
                raise UnfathomableError(f"an array of {array.dtype}")
            self._say(kind.__name__, array.dtype.descr, array.shape, array.flags.c_contiguous)
            self.digest.update(array.tobytes())
        elif isinstance(value, (tuple, list)):
            self._say(_name_of(kind), getattr(kind, "_fields", ""), len(value))
            for item in value:
                self.value(item)
        elif isinstance(value, type):
            self._class(value)
        elif isinstance(value, numba.types.Type) or _is_of_library(value):
            self._say(kind.__name__, _name_of(value), value if isinstance(value, numba.types.Type) else "")
        else:
            raise UnfathomableError(f"a {_name_of(kind)}")

    def _class(self, value: type) -> None:
        if issubclass(value, enum.Enum):
            self._say("class", _name_of(value), [(name, repr(one.value)) for name, one in value.__members__.items()])
        elif issubclass(value, tuple) and hasattr(value, "_fields"):
            self._say(
                "class", _name_of(value), value._fields, sorted(map(repr, vars(value)["_field_defaults"].items()))
            )
        elif _is_of_library(value):
            self._say("class", _name_of(value))
        else:
            raise UnfathomableError(f"class {_name_of(value)}")

    def _function(self, function: types.FunctionType) -> None:
        if not self._is_new(function):
            return
        self._say("function", _name_of(function))
        if function.__module__.partition(".")[0] in _COMPILED:
            return
        self._code(function.__code__, function.__globals__)
        self.value(function.__defaults__)
        self.value(tuple(sorted((function.__kwdefaults__ or {}).items())))
        for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
            self._say("cell", name)
            self.value(cell.cell_contents)

    def _code(self, code: types.CodeType, namespace: dict[str, Any]) -> None:
        self._say(
            code.co_flags, code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount, code.co_names,
            code.co_varnames, code.co_freevars, code.co_cellvars,
        )  # fmt: skip
        self.digest.update(code.co_code)
        for constant in code.co_consts:
            if isinstance(constant, types.CodeType):  # of a comprehension
                self._code(constant, namespace)
            elif isinstance(constant, frozenset):
                self._say("set", sorted(map(repr, constant)))
            else:
                self.value(constant)
        builtins = namespace.get("__builtins__", {})
        builtins = vars(builtins) if isinstance(builtins, types.ModuleType) else builtins
        for name, *attributes in _global_reads(code):
            self._say("reads", name, *attributes)
            value = namespace.get(name, builtins.get(name))
            while isinstance(value, types.ModuleType) and attributes:
                value = getattr(value, attributes.pop(0), None)
            if isinstance(value, types.ModuleType):
                raise UnfathomableError(f"module {value.__name__} as a whole")
            self.value(value)


@functools.lru_cache(maxsize=4096)
def _global_reads(code: types.CodeType) -> tuple[tuple[str, ...], ...]:
    """Return every global name that bytecode reads, once each, with the attributes that it then takes of it."""
    return tuple(dict.fromkeys(_chains(code)))


def _chains(code: types.CodeType) -> Iterator[tuple[str, ...]]:
    chain: list[str] = []
    for instruction in dis.get_instructions(code):
        if chain and instruction.opname in ("LOAD_ATTR", "LOAD_METHOD"):
            chain.append(instruction.argval)
            continue
        if chain:
            yield tuple(chain)
            chain = []
        if instruction.opname in ("LOAD_GLOBAL", "LOAD_NAME"):
            chain = [instruction.argval]
    if chain:
        yield tuple(chain)


def _is_of_library(value: Any) -> bool:
    """Return whether a class, a function or another object belongs to a library whose version is in the digest."""
    owner = getattr(value, "__module__", None) or type(value).__module__
    return isinstance(owner, str) and owner.partition(".")[0] in _LIBRARIES and _name_of(value) is not None


def _name_of(value: Any) -> str | None:
    """Return module and qualified name of a class or a function; none of what has no name."""
    name = getattr(value, "__qualname__", None) or getattr(value, "__name__", None)
    return f"{getattr(value, '__module__', None) or type(value).__module__}.{name}" if name else None
