"""What the two sides of a pipe say to each other: a process that runs episodes, and the one of a user's controller.

A message holds operations, one after the other, and gets one answer, to the last of them: a number, or a text. What the
controller's side sends is never unpickled, so that it can hand over nothing but these.
"""

from __future__ import annotations

import json
import os
import struct
from enum import IntEnum
from typing import Any, Final

import numpy as np

from skd_sim.errors import AssessmentError, NoNumberError, UsageError


class Op(IntEnum):
    """The first byte of an operation; but for the first two, a number names the controller that it is of."""

    BEGIN = 0
    """What to load: a pickled `Beginning`."""
    DRAWN = 1
    """Ask for the state of the random generators that everybody in the process has, as a text."""
    MAKE = 2
    """A controller; the answer is a text of what is to be known of it."""
    RESET = 3
    """With what: a pickled scenario and generator."""
    SENSE = 4
    """A scan; without an answer of its own where `command` follows."""
    COMMAND = 5
    """Both states; the answer is the acceleration."""
    COPY = 6
    """As a controller, of another: a second number."""
    GENERATORS = 7
    """Ask how many random generators it keeps."""
    SEED = 8
    """Its generators, from pickled integers."""
    FORGET = 9
    SCENE = 10
    """As a command, of a controller that asks for the scene: with the states of the others behind."""
    COMMANDS = 11
    """As a command, of many episodes at once: how many, then each number of the states for all of them."""


class Kind(IntEnum):
    """The first byte of an answer."""

    NUMBER = 0
    TEXT = 1
    FAILED = 2
    REFUSED = 3
    NO_NUMBER = 4
    NUMBERS = 5


HEADER: Final = struct.Struct("<I")  # bytes that follow
OF_ONE: Final = struct.Struct("<BI")  # operation, controller
COPY: Final = struct.Struct("<BII")  # operation, new controller, controller
COMMAND: Final = struct.Struct("<BI9d")  # operation, controller, states of the car and the adversary
SCENE: Final = struct.Struct("<BI9dI")  # the same, and how many numbers follow: the states of the others
SENSE: Final = struct.Struct("<BI3dI")  # operation, controller, the scan's bearings and range, bytes of ranges
COMMANDS: Final = struct.Struct("<BII")  # operation, controller, episodes; nine numbers of each follow
LOADED: Final = struct.Struct("<BII")  # operation, controller, bytes of a pickle
ANSWER: Final = struct.Struct("<Bd")  # kind; the number, or how many bytes of text follow
_LONGEST: Final = 1 << 24  # bytes of an answer: states of all its generators are the most that a controller tells
_PIECE: Final = 1 << 12  # of what is read at once: room for any answer, and for most questions


class ClosedError(EOFError):
    """The other side has ended."""


def write_all(file: int, message: bytes) -> None:
    """Write a message.

    Raises:
        ClosedError: nobody reads it any more.
    """
    try:
        written = os.write(file, message)
        while written < len(message):
            written += os.write(file, message[written:])
    except OSError:
        raise ClosedError from None


def read_some(file: int, most: int = _PIECE) -> bytes:
    """Return what has come, at least a byte and at most so many.

    Raises:
        ClosedError: nothing will come any more.
    """
    try:
        found = os.read(file, most)
    except OSError:
        found = b""
    if not found:
        raise ClosedError
    return found


def read_message(file: int) -> bytes:
    """Return the operations of the next message.

    Raises:
        ClosedError: there is none any more.
    """
    found = read_some(file)
    while len(found) < HEADER.size:
        found += read_some(file)
    size = HEADER.size + HEADER.unpack_from(found)[0]
    if len(found) < size:
        parts, missing = [found], size - len(found)
        while missing > 0:
            parts.append(read_some(file, missing))
            missing -= len(parts[-1])
        found = b"".join(parts)
    return found[HEADER.size :]


def answer_with(kind: Kind, value: Any) -> bytes:
    """Return an answer: with a number, an array of them (float64), or anything that JSON can say."""
    if kind == Kind.NUMBER:
        return ANSWER.pack(0, value)
    if kind == Kind.NUMBERS:
        packed: bytes = value.tobytes()
        return ANSWER.pack(kind, len(packed)) + packed
    text = json.dumps(value).encode()
    return ANSWER.pack(kind, len(text)) + text


def read_answer(file: int) -> Any:
    """Return what the next answer says: a float, an array of them, or what was said in JSON.

    Raises:
        ClosedError: there is none any more.
        AssessmentError: the controller failed, or its side of the pipe says what it never would.
        NoNumberError: its command is no finite number.
        UsageError: it cannot be loaded.
    """
    found = read_some(file)
    while len(found) < ANSWER.size:
        found += read_some(file)
    kind, value = ANSWER.unpack_from(found)
    if kind == 0 and len(found) == ANSWER.size:  # a number, of which there are many
        return value
    try:
        size = ANSWER.size + int(value)
        if size > _LONGEST:
            raise ValueError("no text of ours is so long")
        while len(found) < size:
            found += read_some(file)
        if kind == Kind.NUMBERS:
            return np.frombuffer(found, np.float64, -1, ANSWER.size)
        told = json.loads(found[ANSWER.size :])
        if kind == Kind.TEXT:
            return told
        reason = str(told)[:1000]
    except (ValueError, OverflowError, RecursionError):
        kind, reason = Kind.FAILED, "the controller's process answered with something else than an acceleration"
    errors: dict[int, type[Exception]] = {Kind.REFUSED: UsageError, Kind.NO_NUMBER: NoNumberError}
    raise errors.get(kind, AssessmentError)(reason)
