"""Random generators as kernels take them: by the address of their state, without a question to Python.

Numba asks a `numpy.random.Generator` for its functions anew in each call of a kernel, which takes longer than many a
kernel does, and calls them by pointer for each number. A `Stream` is the same generator: its numbers, to the last bit,
and its state, so that both can draw in turns. `stream_type.py` says how kernels draw from it.
"""

from __future__ import annotations

import ctypes
import functools
from typing import Any, ClassVar, Final, cast

import numpy as np

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
    """Return whether this numpy keeps a PCG64 on this machine as `PcgState` says; it promises so to nobody."""
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
