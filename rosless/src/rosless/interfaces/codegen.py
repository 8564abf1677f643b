"""Source code of (de)serialisers.

CDR aligns every primitive to its own size, counted from the end of the 4-byte header. While generating, a
position is known as ``offset`` modulo ``modulus``: padding that follows from it goes into the struct format,
the rest is computed when running.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable
from struct import Struct
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype

from rosless.interfaces import checks
from rosless.interfaces.classes import NUMERIC, Message, attribute_name, message_class
from rosless.interfaces.definitions import Field

FORMATS = {
    "bool": "?",
    "byte": "c",
    "char": "B",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
SIZES = {name: Struct(f"={code}").size for name, code in FORMATS.items()}
_EXACT_CLASSES = {"float32": "float", "float64": "float", "bool": "bool"}
_PADDING = [bytes(count) for count in range(8)]


class _Alignment:
    """What is known, while generating, about the position when running."""

    def __init__(self, modulus: int) -> None:
        self.modulus = modulus
        self.offset = 0

    def static_padding(self, size: int) -> int | None:
        """Padding in front of a primitive of this size, or None if it depends on the data."""
        return -self.offset % size if size <= self.modulus else None

    def aligned(self, size: int) -> None:
        self.modulus, self.offset = size, 0

    def advance(self, size: int) -> None:
        self.offset = (self.offset + size) % self.modulus

    def forget(self, modulus: int) -> None:
        """After data of unknown length in steps of ``modulus``, from a position with that alignment."""
        self.modulus, self.offset = max(1, modulus), 0


class _Generator:
    """What serialisers and deserialisers have in common: runs of fixed-size primitives."""

    def __init__(self, order: str, *, top_level: bool) -> None:
        self.order = order
        self.lines: list[str] = []
        self.scope: dict[str, Any] = {"array": array, "np": np, "PADDING": _PADDING}
        self.alignment = _Alignment(8 if top_level else 1)
        self.run_format = ""
        self.run: list[str] = []
        self._counter = 0

    def fresh(self, prefix: str) -> str:
        self._counter += 1
        return f"{prefix}{self._counter}"

    def constant(self, prefix: str, value: Any) -> str:
        name = self.fresh(prefix)
        self.scope[name] = value
        return name

    def align(self, size: int) -> None:
        """Pad to a multiple of size, in the current run's format if that much is known."""
        padding = self.alignment.static_padding(size)
        if padding is None:
            self.flush()
            self.emit_padding(size)
            self.alignment.aligned(size)
        elif padding:
            self.run_format += f"{padding}x"
            self.alignment.advance(padding)

    def primitive(self, code: str, size: int, expression: str) -> None:
        self.align(size)
        self.run_format += code
        self.run.append(expression)
        self.alignment.advance(size)

    def flush(self) -> None:
        if self.run_format:
            self.emit_run(Struct(self.order + self.run_format))
            self.run_format, self.run = "", []

    def emit_padding(self, size: int) -> None:
        raise NotImplementedError

    def emit_run(self, layout: Struct) -> None:
        raise NotImplementedError

    def compile(self, name: str, header: str, footer: str) -> Any:
        self.flush()
        source = header + "".join(f"    {line}\n" for line in self.lines) + f"    {footer}\n"
        exec(compile(source, f"<{name} cdr>", "exec"), self.scope)
        return self.scope["function"]


class _SerializerGenerator(_Generator):
    def __init__(self, nested: Callable[[str], Any], *, top_level: bool) -> None:
        super().__init__("<", top_level=top_level)
        self.nested = nested
        self.exact: list[tuple[str, str]] = []
        self.scope["Mismatch"] = checks.Mismatch

    def emit_padding(self, size: int) -> None:
        self.lines.append(f"out += PADDING[(4 - len(out)) & {size - 1}]")

    def emit_run(self, layout: Struct) -> None:
        if self.exact:
            tests = " and ".join(f"{variable}.__class__ is {cls}" for variable, cls in self.exact)
            self.lines.append(f"if not ({tests}): check(({', '.join(v for v, _ in self.exact)},), "
                              f"({', '.join(c for _, c in self.exact)},))")  # fmt: skip
            self.scope["check"] = checks.check_exact
            self.exact = []
        pack = self.constant("pack", layout.pack)
        self.lines.append(f"out += {pack}({', '.join(self.run)})")

    def message(self, cls: type[Message], variable: str) -> None:
        if cls._definition.is_empty:
            self.primitive("B", 1, "0")
            return
        for field in cls._definition.fields:
            value = self.fresh("v")
            self.lines.append(f"{value} = {variable}.{attribute_name(field.name)}")
            if field.kind == Nodetype.NAME:
                nested = message_class(field.nested)
                expected = self.constant("class_", nested)
                self.lines.append(f"if {value}.__class__ is not {expected}: raise Mismatch")
                self.message(nested, value)
            elif field.kind == Nodetype.BASE:
                self.scalar(field, value)
            else:
                self.collection(field, value)

    def scalar(self, field: Field, value: str) -> None:
        if field.base == "string":
            self.lines.append(f"{value} = {value}.encode()")
            if field.string_bound:
                self.lines.append(f"if len({value}) > {field.string_bound}: raise Mismatch")
            self.primitive("I", 4, f"len({value}) + 1")
            self.flush()
            self.lines.append(f"out += {value}")
            self.lines.append("out.append(0)")
            self.alignment.forget(1)
            return
        if field.base in _EXACT_CLASSES:
            self.exact.append((value, _EXACT_CLASSES[field.base]))
        self.primitive(FORMATS[field.base], SIZES[field.base], value)

    def collection(self, field: Field, value: str) -> None:
        if field.kind == Nodetype.ARRAY:
            self.lines.append(f"if len({value}) != {field.size}: raise Mismatch")
        else:
            if field.size:
                self.lines.append(f"if len({value}) > {field.size}: raise Mismatch")
            self.primitive("I", 4, f"len({value})")
        self.flush()
        if field.nested:
            function = self.constant("append", self.nested(field.nested))
            expected = self.constant("class_", message_class(field.nested))
            self.lines.append(f"for item in {value}:")
            self.lines.append(f"    if item.__class__ is not {expected}: raise Mismatch")
            self.lines.append(f"    {function}(out, item)")
            self.alignment.forget(1)
        elif field.base == "string":
            pack = self.constant("pack", Struct("<I").pack)
            self.lines.append(f"for item in {value}:")
            self.lines.append("    item = item.encode()")
            if field.string_bound:
                self.lines.append(f"    if len(item) > {field.string_bound}: raise Mismatch")
            self.lines.append("    out += PADDING[(4 - len(out)) & 3]")
            self.lines.append(f"    out += {pack}(len(item) + 1)")
            self.lines.append("    out += item")
            self.lines.append("    out.append(0)")
            self.alignment.forget(1)
        else:
            self.primitives(field, value)

    def primitives(self, field: Field, value: str) -> None:
        size = SIZES[field.base]
        if field.kind == Nodetype.ARRAY:
            self.align(size)
            self.flush()
        elif size > 4:
            # no element, no padding: an empty sequence ends right after its length
            self.lines.append(f"if len({value}): out += PADDING[(4 - len(out)) & {size - 1}]")
        if field.base in NUMERIC:
            _, dtype_name, code = NUMERIC[field.base]
            dtype = self.constant("dtype", np.dtype(dtype_name))
            convert = self.constant("convert", checks.numeric_bytes)
            self.lines.append(f"if {value}.__class__ is np.ndarray and {value}.dtype is {dtype} "
                              f"and {value}.ndim == 1: out += {value}.tobytes()")  # fmt: skip
            self.lines.append(
                f"elif {value}.__class__ is array and {value}.typecode == {code!r}: out += {value}.tobytes()"
            )
            self.lines.append(f"else: out += {convert}({value}, {dtype})")
        else:
            convert = self.constant("convert", checks.bool_bytes if field.base == "bool" else checks.byte_bytes)
            self.lines.append(f"out += {convert}({value})")
        if field.kind == Nodetype.ARRAY:
            self.alignment.advance(size * field.size)
        else:
            self.alignment.forget(min(4, size))


class _DeserializerGenerator(_Generator):
    def __init__(self, order: str, nested: Callable[[str, str], Any], *, top_level: bool) -> None:
        super().__init__(order, top_level=top_level)
        self.nested = nested
        self.scope["checked"] = checks.checked_end

    def emit_padding(self, size: int) -> None:
        self.lines.append(f"position += (4 - position) & {size - 1}")

    def emit_run(self, layout: Struct) -> None:
        unpack = self.constant("unpack", layout.unpack_from)
        if self.run:
            self.lines.append(f"{', '.join(self.run)}, = {unpack}(buffer, position)")
        self.lines.append(f"position += {layout.size}")

    def message(self, cls: type[Message], variable: str) -> None:
        created = self.constant("class_", cls)
        self.lines.append(f"{variable} = {created}.__new__({created})")
        if cls._definition.is_empty:
            self.primitive("B", 1, "_")
            return
        for field in cls._definition.fields:
            target = f"{variable}.{attribute_name(field.name)}"
            if field.kind == Nodetype.NAME:
                nested = self.fresh("m")
                self.message(message_class(field.nested), nested)
                self.lines.append(f"{target} = {nested}")
            elif field.kind == Nodetype.BASE:
                self.scalar(field, target)
            else:
                self.collection(field, target)

    def scalar(self, field: Field, target: str) -> None:
        if field.base != "string":
            self.primitive(FORMATS[field.base], SIZES[field.base], target)
            return
        self.primitive("I", 4, "length")
        self.flush()
        self.lines.append("end = checked(buffer, position, length)")
        self.lines.append(f"{target} = buffer[position:end - 1].decode()")
        self.lines.append("position = end")
        self.alignment.forget(1)

    def collection(self, field: Field, target: str) -> None:
        count: str | int = field.size
        if field.kind == Nodetype.SEQUENCE:
            self.primitive("I", 4, "count")
            count = "count"
        self.flush()
        if field.nested:
            function = self.constant("read", self.nested(field.nested, self.order))
            self.lines.append("items = []")
            self.lines.append(f"for _ in range(checked(buffer, 0, {count})):")
            self.lines.append(f"    item, position = {function}(buffer, position)")
            self.lines.append("    items.append(item)")
            self.lines.append(f"{target} = items")
            self.alignment.forget(1)
        elif field.base == "string":
            unpack = self.constant("unpack", Struct(f"{self.order}I").unpack_from)
            self.lines.append("items = []")
            self.lines.append(f"for _ in range(checked(buffer, 0, {count})):")
            self.lines.append("    position += (4 - position) & 3")
            self.lines.append(f"    end = checked(buffer, position + 4, {unpack}(buffer, position)[0])")
            self.lines.append("    items.append(buffer[position + 4:end - 1].decode())")
            self.lines.append("    position = end")
            self.lines.append(f"{target} = items")
            self.alignment.forget(1)
        else:
            self.primitives(field, target, count)

    def primitives(self, field: Field, target: str, count: str | int) -> None:
        size = SIZES[field.base]
        if field.kind == Nodetype.ARRAY:
            self.align(size)
            self.flush()
        elif size > 4:
            self.lines.append(f"if count: position += (4 - position) & {size - 1}")
        self.lines.append(f"end = checked(buffer, position, {count} * {size})")
        if field.base == "byte":
            self.lines.append(f"{target} = [bytes((item,)) for item in buffer[position:end]]")
        elif field.base == "bool":
            self.lines.append(f"{target} = [item != 0 for item in buffer[position:end]]")
        elif field.kind == Nodetype.ARRAY:
            native = np.dtype(NUMERIC[field.base][1])
            # the native dtype object itself lets the serialiser recognise the array at once
            dtype = self.constant("dtype", native if self.order == "<" else native.newbyteorder(">"))
            self.lines.append(f"{target} = np.frombuffer(buffer, {dtype}, {count}, position)")
            if self.order == ">" and size > 1:
                self.lines.append(f"{target} = {target}.astype({dtype}.newbyteorder('='))")
        else:
            self.lines.append(f"values = array({NUMERIC[field.base][2]!r})")
            self.lines.append("values.frombytes(buffer[position:end])")
            if self.order == ">":
                self.lines.append("values.byteswap()")
            self.lines.append(f"{target} = values")
        self.lines.append("position = end")
        if field.kind == Nodetype.ARRAY:
            self.alignment.advance(size * field.size)
        else:
            self.alignment.forget(min(4, size))


def compile_serializer(cls: type[Message], nested: Callable[[str], Any]) -> Any:
    """A function ``append(out, message)``; ``nested`` gives that of another type."""
    # Only elements of sequences start at a position that is not known, so both kinds share one function.
    generator = _SerializerGenerator(nested, top_level=False)
    generator.message(cls, "message")
    return generator.compile(cls.__msgtype__, "def function(out, message):\n", "return")


def compile_deserializer(cls: type[Message], order: str, nested: Callable[[str, str], Any]) -> Any:
    """A function ``read(buffer, position) -> message, end``."""
    generator = _DeserializerGenerator(order, nested, top_level=False)
    generator.message(cls, "result")
    return generator.compile(cls.__msgtype__, "def function(buffer, position):\n", "return result, position")
