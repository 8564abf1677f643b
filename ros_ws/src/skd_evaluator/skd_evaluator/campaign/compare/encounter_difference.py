"""Keys of a scenario that describe the encounter, and not the car: they have to be the same where cars are compared."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

_FREE = frozenset(
    {"name", "description", "sensor", "road.friction", "control_period"}
    | {f"car.{key}" for key in ("front", "rear", "width", "deceleration", "speed_noise", "acceleration_noise")}
    | {f"car.{key}" for key in ("dynamics", "brake_delay", "brake_rate", "brake_limit", "antilock")}
)
"""Keys of a scenario that are the car's own, or say nothing about the encounter."""


def encounter_difference(one: Mapping[str, Any], other: Mapping[str, Any]) -> tuple[str, Any, Any] | None:
    """Return the first key in which two encounters differ, with its value in each; None if they are the same.

    Args:
        one: a scenario as plain data.
        other: the other encounter, in the same form.
    """
    first, second = _flat(one), _flat(other)
    for key in sorted((first.keys() | second.keys()) - _FREE):
        if first.get(key) != second.get(key):
            return key, first.get(key), second.get(key)
    return None


def _flat(data: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in data.items():
        name = f"{prefix}{key}"
        if name in _FREE:
            continue
        if isinstance(value, Mapping):
            flat |= _flat(value, f"{name}.")
        else:
            flat[name] = value
    return flat
