"""What a member of a message may hold, and which member holds something else."""

from __future__ import annotations

from array import array
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype

from rosless.interfaces.classes import NUMERIC, Message, attribute_name, message_class
from rosless.interfaces.definitions import Field

_FLOAT32_MAX = float(np.finfo(np.float32).max)


class Mismatch(Exception):  # noqa: N818
    """Some member does not fit its type; :func:`explain` finds out which."""


def check_exact(values: tuple[Any, ...], classes: tuple[type, ...]) -> None:
    """Accept subclasses (numpy.float64 is a float) where the quick test asked for the class itself."""
    for value, cls in zip(values, classes, strict=True):
        if not isinstance(value, cls) and not (cls is bool and isinstance(value, np.bool_)):
            raise Mismatch


def checked_end(buffer: bytes | bytearray, position: int, length: int) -> int:
    """End of ``length`` bytes at a position, if the buffer has that many."""
    end = position + length
    if end > len(buffer):
        raise ValueError(f"length {length} at byte {position} exceeds the data")
    return end


def numeric_bytes(values: Any, dtype: np.dtype[Any]) -> bytes:
    """Little-endian bytes of a sequence of numbers of the right kind."""
    if isinstance(values, (bytes, bytearray, memoryview)) and dtype == np.uint8:
        return bytes(values)
    if isinstance(values, (np.ndarray, array)):
        source = np.asarray(values)
        if source.ndim != 1:
            raise Mismatch
        right_kind = source.dtype.kind in ("f" if dtype.kind == "f" else "iu")
        if len(source) and not right_kind:
            raise Mismatch
        if dtype.kind in "iu" and len(source):
            limits = np.iinfo(dtype)
            if int(source.min()) < limits.min or int(source.max()) > limits.max:
                raise Mismatch
        return source.astype(dtype).tobytes()
    if isinstance(values, str):
        raise Mismatch
    wanted: Any = float if dtype.kind == "f" else (int, np.integer)
    for value in values:
        if not isinstance(value, wanted):
            raise Mismatch
    return np.array(list(values), dtype).tobytes()


def bool_bytes(values: Any) -> bytes:
    """One byte per truth value."""
    for value in values:
        if not isinstance(value, (bool, np.bool_)):
            raise Mismatch
    return bytes(1 if value else 0 for value in values)


def byte_bytes(values: Any) -> bytes:
    """The bytes of a sequence of one-byte ``bytes`` objects (rclpy's form of ``byte[]``), or of ``bytes``."""
    if isinstance(values, (bytes, bytearray)):
        return bytes(values)
    for value in values:
        if not (isinstance(value, bytes) and len(value) == 1):
            raise Mismatch
    return b"".join(values)


def explain(message: Message) -> None:
    """Raise a TypeError that names the first member of a message with an unfitting value."""
    _explain(message, "", message.__msgtype__)


def _explain(message: Message, path: str, root: str) -> None:
    definition = message._definition
    if definition.is_empty:
        return
    for field in definition.fields:
        name = attribute_name(field.name)
        where = f"{path}{name}"
        try:
            value = getattr(message, name)
        except AttributeError:
            raise _error(root, where, "has no value") from None
        problem = _problem(field, value)
        if problem:
            raise _error(root, where, problem)
        if field.kind == Nodetype.NAME:
            _explain(value, f"{where}.", root)
        elif field.nested:
            for index, item in enumerate(value):
                _explain(item, f"{where}[{index}].", root)


def _error(root: str, where: str, problem: str) -> TypeError:
    return TypeError(f"{root}: member '{where}' {problem}")


def _problem(field: Field, value: Any) -> str:
    if not field.is_collection:
        return _item_problem(field, value)
    try:
        length = len(value)
    except TypeError:
        return f"must be a sequence, got {_described(value)}"
    if field.kind == Nodetype.ARRAY and length != field.size:
        return f"must have exactly {field.size} elements, got {length}"
    if field.kind == Nodetype.SEQUENCE and field.size and length > field.size:
        return f"may have at most {field.size} elements, got {length}"
    if isinstance(value, str):
        return f"must be a sequence, got {_described(value)}"
    if isinstance(value, (np.ndarray, array)) and field.base in NUMERIC:
        try:
            numeric_bytes(value, np.dtype(NUMERIC[field.base][1]))
        except Mismatch:
            source = np.asarray(value)
            return f"must hold {field.base} in one dimension, got {source.dtype} with shape {source.shape}"
        return ""
    if isinstance(value, (bytes, bytearray, memoryview)) and field.base in ("uint8", "char", "byte"):
        return ""
    for index, item in enumerate(value):
        problem = _item_problem(field, item)
        if problem:
            return f"element {index} {problem}"
    return ""


def _item_problem(field: Field, value: Any) -> str:
    base = field.base
    if field.nested:
        fits = isinstance(value, message_class(field.nested))
        return "" if fits else f"must be a {field.nested}, got {_described(value)}"
    if base in ("float32", "float64"):
        if not isinstance(value, float):
            return f"must be a float, got {_described(value)}"
        if base == "float32" and _FLOAT32_MAX < abs(value) < float("inf"):
            return f"must fit into a float32, got {value!r}"
        return ""
    if base in NUMERIC:
        limits = np.iinfo(NUMERIC[base][1])
        if not isinstance(value, (int, np.integer)):
            return f"must be an int, got {_described(value)}"
        if not limits.min <= value <= limits.max:
            return f"must be in [{limits.min}, {limits.max}], got {value!r}"
        return ""
    if base == "bool":
        return "" if isinstance(value, (bool, np.bool_)) else f"must be a bool, got {_described(value)}"
    if base == "byte":
        fits = isinstance(value, bytes) and len(value) == 1
        return "" if fits else f"must be bytes of length 1, got {_described(value)}"
    if not isinstance(value, str):
        return f"must be a str, got {_described(value)}"
    if field.string_bound and len(value.encode()) > field.string_bound:
        return f"may have at most {field.string_bound} bytes, got {len(value.encode())}"
    return ""


def _described(value: Any) -> str:
    return f"{value!r} of type {type(value).__name__}"
