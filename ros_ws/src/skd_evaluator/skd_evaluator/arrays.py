"""Reads .npz files of unknown origin: no array is made before its size has been checked."""

from __future__ import annotations

import math
import zipfile
from collections import Counter
from collections.abc import Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from skd_sim.errors import UsageError
from skd_sim.inputs.outside import open_regular

LARGEST = 128 * 2**20
"""Bytes of all arrays of a file together, unpacked: some 400,000 episodes."""

FARTHEST = 1e6
"""m, m/s, s, rad: no state that is read is beyond; squares of what is 10¹⁴⁸ times as far are infinite."""

Array = npt.NDArray[Any]


class Column(NamedTuple):
    """What an array has to be: its type, and its shape with −1 for any length."""

    dtype: npt.DTypeLike
    shape: tuple[int, ...]


def within_reach(*arrays: Array) -> bool:
    """Tell whether all numbers are finite and none is beyond `FARTHEST`."""
    return all(bool((np.abs(one) <= FARTHEST).all()) for one in arrays)


def read_arrays(
    path: Path, columns: Mapping[str, Column], optional: Mapping[str, Column] | None = None
) -> dict[str, Array]:
    """Return named arrays of an .npz file; other arrays in it are not read.

    Args:
        path: path of the .npz file.
        columns: arrays that have to be in the file, by name.
        optional: arrays that may be in the file, by name.

    Raises:
        UsageError: it is no regular file or no .npz file, is damaged (its checksums are compared), lacks an array, has
            one of another type or shape, has one twice, or holds more than `LARGEST` bytes.
    """
    with open_regular(path) as stream:
        try:
            with zipfile.ZipFile(stream) as archive:
                names = archive.namelist()
                there = set(names)
                if len(there) < len(names):
                    twice = next(name for name, count in Counter(names).items() if count > 1)
                    raise UsageError(f"{twice[:60]!r} is in it twice: one reader takes the first, another the last")
                columns = {**columns, **{name: one for name, one in (optional or {}).items() if f"{name}.npy" in there}}
                members = {name: archive.getinfo(f"{name}.npy") for name in columns}
                size = sum(member.file_size for member in members.values())
                if size > LARGEST:
                    raise UsageError(f"its arrays have {size} bytes; at most {LARGEST // 2**20} MiB are read")
                return {name: _array(archive.read(members[name]), name, column) for name, column in columns.items()}
        except KeyError as error:
            raise UsageError(f"{path}: {error.args[0]}") from error
        except UsageError as error:
            raise UsageError(f"{path}: {error}") from error
        except Exception as error:  # its readers raise whatever the bytes make them raise
            said = " ".join(f"{type(error).__name__}: {error}".split())[:120]
            raise UsageError(f"{path}: is not an episodes.npz of SKD, or is damaged ({said})") from error


def _array(content: bytes, name: str, column: Column) -> Array:
    """Return the array in a member of the archive."""
    stream = BytesIO(content)
    version = np.lib.format.read_magic(stream)
    read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, fortran, dtype = read_header(stream)
    wanted_type = np.dtype(column.dtype)
    if wanted_type == np.dtype("U"):  # texts of any length
        wanted_type = dtype if dtype.kind == "U" and dtype.isnative else wanted_type
    if dtype != wanted_type or not _fits(shape, column.shape):
        wanted = " × ".join("n" if length < 0 else str(length) for length in column.shape) or "a single value"
        raise UsageError(f"{name} must be {np.dtype(column.dtype)}, {wanted}; it is {dtype}, {shape}")
    if math.prod(shape) * dtype.itemsize != len(content) - stream.tell():
        raise UsageError(f"{name} says that it has the shape {shape}, and has {len(content) - stream.tell()} bytes")
    values = np.frombuffer(content, dtype, offset=stream.tell())
    if dtype.kind == "U" and not _are_texts(np.frombuffer(content, np.uint32, offset=stream.tell())):
        raise UsageError(f"{name} has a text with a number that is of no character of Unicode")
    return values.reshape(shape, order="F" if fortran else "C")


def _are_texts(numbers: Array) -> bool:
    """Tell whether all are numbers of characters: Python cannot hold others, and half a character cannot be written."""
    return bool(((numbers < 0xD800) | ((numbers > 0xDFFF) & (numbers <= 0x10FFFF))).all())


def _fits(shape: Sequence[int], wanted: Sequence[int]) -> bool:
    return len(shape) == len(wanted) and all(
        length >= 0 and most in (-1, length) for length, most in zip(shape, wanted, strict=True)
    )
