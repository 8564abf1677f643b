"""The states and commands of every tick, between bytes (CDR) and the library's own types, without message objects.

rclpy takes some 70 µs to make an Odometry of its bytes (two covariances of 36 numbers, which nobody here reads), and as
long to make bytes of it; a tick has two of them, and five receivers. The types of a tick are alike: a stamp, strings,
then nothing but float64. Plain CDR (DDSI-RTPS 2.2, section 10): a 4-byte encapsulation header whose second byte says
the byte order, then the members, each aligned to its size from there on.

Every float passes through unchanged, bit for bit.
"""

from __future__ import annotations

import functools
import math
import struct
from typing import Any

from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock

from skd_sim.choices.frames import FRAMES, Frames
from skd_sim.episode.stamps import NANOSECONDS
from skd_sim.geometry.heading import heading_of
from skd_sim.messages.to_messages import (
    acceleration_command,
    adversary_to_odometry,
    car_to_odometry,
    car_to_transform,
    inertia_to_message,
    velocity_command,
)
from skd_sim.sensors import Inertia
from skd_sim.state import AdversaryState, CarState

_ORIGIN = 4  # after the encapsulation header
_STAMP = 8  # bytes
# Places of an Odometry's numbers, as indices of its float64: position, orientation, covariance, twist.
_X, _Y, _QZ, _QW, _VX, _VY = 0, 1, 5, 6, 43, 44
# The same of a transform: translation, rotation; and of an Imu: orientation, turning, acceleration.
_TX, _TY, _TQZ, _TQW = 0, 1, 5, 6
_IQZ, _IQW, _IYAW, _IX, _IY, _IZ = 2, 3, 15, 25, 26, 27
_IN_SEQUENCE = _ORIGIN + 4  # where the stamp of a sequence's first element is, after the number of elements
_ODOMETRY, _VECTORS = (2, 85), (1, 6)  # strings and numbers: of nav_msgs/Odometry, and of AccelStamped and TwistStamped


class CdrError(ValueError):
    """Bytes that are no message of the type that was expected."""


def _first_number(data: bytes | bytearray, order: str, strings: int, stamp: int = _ORIGIN) -> int:
    """Return where the numbers begin, after a stamp at a place and the strings."""
    place = stamp + _STAMP
    for _ in range(strings):
        place += -(place - _ORIGIN) % 4
        place += 4 + int(struct.unpack_from(f"{order}I", data, place)[0])
    return place + -(place - _ORIGIN) % 8


def _read(data: bytes, strings: int, count: int) -> tuple[int, tuple[float, ...]]:
    """Return a message's stamp (ns) and numbers.

    Raises:
        CdrError: the bytes are no such message.
    """
    try:
        order = "<" if data[1] & 1 else ">"
        seconds, nanoseconds = struct.unpack_from(f"{order}iI", data, _ORIGIN)
        numbers = struct.unpack_from(f"{order}{count}d", data, _first_number(data, order, strings))
    except (struct.error, IndexError) as error:
        raise CdrError(f"its {len(data)} bytes are not of its type ({error})") from error
    return seconds * NANOSECONDS + nanoseconds, numbers


def _read_stamp(data: bytes, place: int) -> int:
    try:
        seconds, nanoseconds = struct.unpack_from("<iI" if data[1] & 1 else ">iI", data, place)
    except (struct.error, IndexError) as error:
        raise CdrError(f"its {len(data)} bytes are not of its type ({error})") from error
    return int(seconds) * NANOSECONDS + int(nanoseconds)


def read_car(data: bytes) -> tuple[int, CarState]:
    """Return stamp (ns) and state of the car from the bytes of its Odometry (planar).

    Raises:
        CdrError: they are none.
    """
    stamp, n = _read(data, *_ODOMETRY)
    return stamp, CarState(n[_X], n[_Y], heading_of(n[_QZ], n[_QW]), n[_VX])


def read_adversary(data: bytes) -> tuple[int, AdversaryState]:
    """Return stamp (ns) and state of the adversary from the bytes of its Odometry; errors as `read_car`."""
    stamp, n = _read(data, *_ODOMETRY)
    return stamp, AdversaryState(n[_X], n[_Y], n[_VX], n[_VY], heading_of(n[_QZ], n[_QW]))


def read_linear(data: bytes) -> tuple[int, tuple[float, float]]:
    """Return stamp (ns) and linear (x, y) from the bytes of an AccelStamped or a TwistStamped; errors as `read_car`."""
    stamp, n = _read(data, *_VECTORS)
    return stamp, (n[0], n[1])


def read_clock(data: bytes) -> tuple[int, None]:
    """Return the time (ns) that a Clock tells; errors as `read_car`."""
    return _read_stamp(data, _ORIGIN), None


def read_transforms(data: bytes) -> tuple[int, None]:
    """Return the stamp (ns) of the first transform of a TFMessage, 0 where it has none; errors as `read_car`."""
    empty = data[_ORIGIN:_IN_SEQUENCE] == bytes(_IN_SEQUENCE - _ORIGIN)
    return (0 if empty else _read_stamp(data, _IN_SEQUENCE)), None


class _Template:
    """The bytes of a message, into which stamp and numbers are written; its strings do not change."""

    def __init__(self, message: Any, strings: int, indices: tuple[int, ...], place: int = _ORIGIN) -> None:
        """Keep a message's bytes.

        Args:
            message: a message with the strings that all messages of the stream have.
            strings: number of them.
            indices: which of the message's numbers change.
            place: place of the stamp in the bytes.
        """
        self._bytes = bytearray(serialize_message(message))
        self._place = place
        order = "<" if self._bytes[1] & 1 else ">"
        first = _first_number(self._bytes, order, strings, place) if indices else 0
        self._stamp, self._number = struct.Struct(f"{order}iI"), struct.Struct(f"{order}d")
        self._places = [first + self._number.size * index for index in indices]

    def write(self, stamp: int, *numbers: float) -> bytes:
        """Return the bytes of a message with a stamp (ns) and the numbers that change, in the order of the indices."""
        self._stamp.pack_into(self._bytes, self._place, *divmod(stamp, NANOSECONDS))
        for place, number in zip(self._places, numbers, strict=True):
            self._number.pack_into(self._bytes, place, number)
        return bytes(self._bytes)


_NO_CAR = CarState(0.0, 0.0, 0.0, 0.0)


@functools.cache
def _car(frames: Frames) -> _Template:
    return _Template(car_to_odometry(_NO_CAR, 0, frames), 2, (_X, _Y, _QZ, _QW, _VX))


@functools.cache
def _car_transform(frames: Frames) -> _Template:
    return _Template(car_to_transform(_NO_CAR, 0, frames), 2, (_TX, _TY, _TQZ, _TQW), _IN_SEQUENCE)


@functools.cache
def _inertia(frames: Frames) -> _Template:
    nothing = Inertia(0.0, 0.0, (0.0, 0.0, 0.0))
    return _Template(inertia_to_message(nothing, 0, frames), 1, (_IQZ, _IQW, _IYAW, _IX, _IY, _IZ))


@functools.cache
def _clock() -> _Template:
    return _Template(Clock(), 0, ())


@functools.cache
def _adversary() -> _Template:
    return _Template(adversary_to_odometry(AdversaryState(0.0, 0.0, 0.0, 0.0), 0), 2, (_X, _Y, _QZ, _QW, _VX, _VY))


@functools.cache
def _acceleration() -> _Template:
    return _Template(acceleration_command(0.0, 0), 1, (0,))


@functools.cache
def _velocity() -> _Template:
    return _Template(velocity_command((0.0, 0.0), 0), 1, (0, 1))


def write_car(car: CarState, stamp: int, frames: Frames = FRAMES) -> bytes:
    """Return the bytes of `car_to_odometry`."""
    heading = 0.5 * car.heading
    return _car(frames).write(stamp, car.x, car.y, math.sin(heading), math.cos(heading), car.speed)


def write_car_transform(car: CarState, stamp: int, frames: Frames = FRAMES) -> bytes:
    """Return the bytes of `car_to_transform`."""
    heading = 0.5 * car.heading
    return _car_transform(frames).write(stamp, car.x, car.y, math.sin(heading), math.cos(heading))


def write_inertia(inertia: Inertia, stamp: int, frames: Frames = FRAMES) -> bytes:
    """Return the bytes of `inertia_to_message`."""
    heading, yaw_rate, acceleration = inertia
    return _inertia(frames).write(stamp, math.sin(0.5 * heading), math.cos(0.5 * heading), yaw_rate, *acceleration)


def write_clock(stamp: int) -> bytes:
    """Return the bytes of a rosgraph_msgs/Clock."""
    return _clock().write(stamp)


def write_adversary(adversary: AdversaryState, stamp: int) -> bytes:
    """Return the bytes of `adversary_to_odometry`."""
    x, y, vx, vy, heading = adversary
    return _adversary().write(stamp, x, y, math.sin(0.5 * heading), math.cos(0.5 * heading), vx, vy)


def write_acceleration(acceleration: float, stamp: int) -> bytes:
    """Return the bytes of `acceleration_command`."""
    return _acceleration().write(stamp, acceleration)


def write_velocity(velocity: tuple[float, float], stamp: int) -> bytes:
    """Return the bytes of `velocity_command`."""
    return _velocity().write(stamp, *velocity)
