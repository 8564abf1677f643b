"""A message of its bytes, which anybody may have published: what is none is said as of all other bytes."""

from __future__ import annotations

from typing import Any

from rclpy.serialization import deserialize_message

from skd_sim.choices.registry import reason_of
from skd_sim.messages.stream_cdr import CdrError


def read_message(data: bytes, kind: type) -> Any:
    """Return the message of a class that bytes are of.

    Raises:
        CdrError: they are no message of it.
    """
    try:
        return deserialize_message(data, kind)
    except Exception as error:  # whatever rmw finds wrong with them
        raise CdrError(reason_of(error)) from error
