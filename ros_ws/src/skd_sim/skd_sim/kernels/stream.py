"""Random generators as kernels take them: by the address of their state, without a question to Python.

Numba asks a `numpy.random.Generator` for its functions anew in each call of a kernel, which takes longer than many a
kernel does, and calls them by pointer for each number. A `Stream` is the same generator: its numbers, to the last bit,
and its state, so that both can draw in turns. PCG64 (O'Neill, HMC-CS-2014-0905) is written into kernels as numpy
computes it.

To numba a stream is a generator, so all that kernels can ask of a generator they can ask of it; only where the numbers
come from is another way. It has nothing that would be counted, so whoever makes a call keeps the generator alive.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar, Final, cast

import numba.core.cgutils
import numba.core.extending
import numba.np.random.generator_core
import numpy as np
from llvmlite import ir
from numba.core import types

_capsule_pointer: Any = ctypes.pythonapi.PyCapsule_GetPointer
_capsule_pointer.restype = ctypes.c_void_p
_capsule_pointer.argtypes = [ctypes.py_object, ctypes.c_char_p]


class PcgState(ctypes.Structure):
    """What numpy keeps of a PCG64 (O'Neill, HMC-CS-2014-0905; numpy/random/src/pcg64/pcg64.h)."""

    _fields_: ClassVar = [
        ("numbers", ctypes.POINTER(ctypes.c_uint64 * 4)),  # state and increment, low half first
        ("has_uint32", ctypes.c_int),
        ("uinteger", ctypes.c_uint32),  # half of the last number, where only the other was asked for
    ]


HAS_HALF: Final = PcgState.has_uint32.offset
"""Where it is said in a `PcgState` whether half of a number is left, bytes from its beginning."""
HALF: Final = PcgState.uinteger.offset
"""Where that half is."""


class Stream:
    """A generator of PCG64 as kernels take it; anything else asked of it is asked of the generator.

    Attributes:
        generator: the generator itself, which has to live as long as its state is read.
        address: address of its `PcgState`.
    """

    __slots__ = ("address", "generator")
    _numba_type_: ClassVar[Any]

    def __init__(self, generator: np.random.Generator, address: int) -> None:
        """Name the generator and its state; `stream_of` finds the latter."""
        self.generator, self.address = generator, address

    def __getattr__(self, name: str) -> Any:
        return getattr(self.generator, name)

    def __reduce__(self) -> tuple[Any, ...]:
        return stream_of, (self.generator,)  # a copy has a state of its own, elsewhere


def stream_of(generator: np.random.Generator) -> np.random.Generator:
    """Return a generator as kernels take it fastest: a `Stream` of it, or itself where its state is of another kind."""
    if isinstance(generator, Stream):
        return generator
    bits = generator.bit_generator
    if type(bits) is not np.random.PCG64 or not _is_as_described():
        return generator
    return cast("np.random.Generator", Stream(generator, _address_of(bits)))


def _address_of(bits: np.random.BitGenerator) -> int:
    """Return the address of a bit generator's state: the first thing in its `bitgen_t` (numpy/random/bitgen.h)."""
    return int(ctypes.c_void_p.from_address(_capsule_pointer(bits.capsule, b"BitGenerator")).value or 0)


@functools.cache
def _is_as_described() -> bool:
    """Return whether this numpy keeps a PCG64 on this machine as `PcgState` says, which is no part of its interface."""
    if ctypes.sizeof(ctypes.c_void_p) != 8:
        return False
    bits = np.random.PCG64(0x5EED)
    np.random.Generator(bits).integers(0, 1 << 32, dtype=np.uint32)
    said: Any = bits.state
    found = PcgState.from_address(_address_of(bits))
    low, high, low_step, high_step = found.numbers.contents
    return bool(
        (high << 64 | low, high_step << 64 | low_step) == (said["state"]["state"], said["state"]["inc"])
        and (found.has_uint32, found.uinteger) == (said["has_uint32"], said["uinteger"])
    )


# Numba has no types for these.
_cgutils: Any = numba.core.cgutils
_extending: Any = numba.core.extending
_generator_core: Any = numba.np.random.generator_core
_Type: Any = types.Type
_GeneratorType: Any = types.NumPyRandomGeneratorType
_StructModel: Any = _extending.models.StructModel

_MULTIPLIER: Final = 0x2360ED051FC65DA44385DF649FCCF645


def _next_word(builder: Any, address: Any) -> Any:
    """Advance the generator, and return the 64 bits (XSL-RR) of its new state."""
    word, long = ir.IntType(64), ir.IntType(128)
    place = builder.load(builder.inttoptr(address, long.as_pointer().as_pointer()))
    increment = builder.load(builder.gep(place, [word(1)]), align=8)
    state = builder.add(builder.mul(builder.load(place, align=8), long(_MULTIPLIER)), increment)
    builder.store(state, place, align=8)
    high, low = builder.trunc(builder.lshr(state, long(64)), word), builder.trunc(state, word)
    mixed, turn = builder.xor(high, low), builder.lshr(high, word(58))
    back = builder.and_(builder.neg(turn), word(63))
    return builder.or_(builder.lshr(mixed, turn), builder.shl(mixed, back))


def _next_half(builder: Any, address: Any) -> Any:
    """Return 32 bits: the half that the last call left, or the lower one of the next 64 bits, and leave the other."""
    word, half = ir.IntType(64), ir.IntType(32)
    left = builder.inttoptr(builder.add(address, word(HAS_HALF)), half.as_pointer())
    other = builder.inttoptr(builder.add(address, word(HALF)), half.as_pointer())
    is_left = builder.icmp_unsigned("!=", builder.load(left), half(0))
    with builder.if_else(is_left) as (there, drawn):
        with there:
            kept = builder.load(other)
            builder.store(half(0), left)
            kept_in = builder.block
        with drawn:
            bits = _next_word(builder, address)
            lower = builder.trunc(bits, half)
            builder.store(builder.trunc(builder.lshr(bits, word(32)), half), other)
            builder.store(half(1), left)
            drawn_in = builder.block
    found = builder.phi(half)
    found.add_incoming(kept, kept_in)
    found.add_incoming(lower, drawn_in)
    return found


def _next_double(builder: Any, address: Any) -> Any:
    """Return a number in [0, 1): 53 bits."""
    double = ir.DoubleType()
    bits = builder.lshr(_next_word(builder, address), ir.IntType(64)(11))
    return builder.fmul(builder.sitofp(bits, double), double(1.0 / (1 << 53)))


_DIGEST: Final = hashlib.sha256(Path(__file__).read_bytes()).hexdigest()


class _BitsType(_Type):  # type: ignore[misc]
    """Where a stream's numbers come from: the address of its state."""

    def __init__(self) -> None:
        """Name it by how it is drawn from: names of types are part of what tells kernels on disk apart."""
        super().__init__(name=f"Pcg64Bits_{_DIGEST[:16]}")


class _StreamType(_GeneratorType):  # type: ignore[misc]
    """A `Stream`, which can do whatever numba's generators can."""

    def __init__(self) -> None:
        """Name it as `_BitsType`."""
        _Type.__init__(self, name=f"Pcg64Stream_{_DIGEST[:16]}")


_BITS: Final = _BitsType()
_STREAM: Final = _StreamType()


@_extending.register_model(_BitsType)
class _BitsModel(_StructModel):  # type: ignore[misc]
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, [("address", types.uintp)])


@_extending.register_model(_StreamType)
class _StreamModel(_StructModel):  # type: ignore[misc]
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, [("bit_generator", _BITS)])


_extending.make_attribute_wrapper(_StreamType, "bit_generator", "bit_generator")


@_extending.unbox(_StreamType)  # type: ignore[untyped-decorator]
def _taken(kind: Any, stream: Any, context: Any) -> Any:
    """Take the address out of a `Stream`."""
    number = context.pyapi.object_getattr_string(stream, "address")
    bits = _cgutils.create_struct_proxy(_BITS)(context.context, context.builder)
    bits.address = context.pyapi.long_as_ulonglong(number)
    context.pyapi.decref(number)
    taken = _cgutils.create_struct_proxy(kind)(context.context, context.builder)
    taken.bit_generator = bits._getvalue()
    failed = _cgutils.is_not_null(context.builder, context.pyapi.err_occurred())
    return _extending.NativeValue(taken._getvalue(), is_error=failed)


def _draw_by(named: Any, write: Callable[[Any, Any], Any], result: Any) -> None:
    """Have one of numba's functions of a bit generator be what `write` writes, where the generator is a stream's."""

    @_extending.intrinsic  # type: ignore[untyped-decorator]
    def drawn(_context: Any, bits: Any) -> Any:
        def code(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            return write(builder, _cgutils.create_struct_proxy(_BITS)(context, builder, value=arguments[0]).address)

        return result(bits), code

    @_extending.overload(named)  # type: ignore[untyped-decorator]
    def drawn_from(bitgen: Any) -> Any:
        def called(bitgen: Any) -> Any:
            return drawn(bitgen)

        return called if isinstance(bitgen, _BitsType) else None


_draw_by(_generator_core.next_uint64, _next_word, types.uint64)
_draw_by(_generator_core.next_uint32, _next_half, types.uint32)
_draw_by(_generator_core.next_double, _next_double, types.float64)
Stream._numba_type_ = _STREAM
