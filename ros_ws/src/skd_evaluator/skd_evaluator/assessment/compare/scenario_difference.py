"""Keys of a scenario that describe the scenario, and not the car: they have to be the same where cars are compared."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from skd_sim.options.car_under_test import BASIC, DYNAMICS

_SAYS_NOTHING = frozenset({"name", "description", "sensor", "control_period"})
"""Keys of a scenario that say nothing about the scenario, and on which no safe trajectory depends."""
_FREE = (
    _SAYS_NOTHING
    | {f"car.{key}" for key in ("front", "rear", "width", "deceleration", "speed_noise", "acceleration_noise")}
    | {f"car.{key}" for key in ("dynamics", "brake_delay", "brake_rate", "brake_limit", "antilock")}
)
"""Keys of a scenario that are the car's own, or say nothing about the scenario."""
FRICTION = "road.friction"

Different = tuple[str, Any, Any]
"""A key, with its value in each of two scenarios."""


def scenario_difference(one: Mapping[str, Any], other: Mapping[str, Any]) -> Different | None:
    """Return the first key in which two scenarios differ, with its value in each; None if they are the same.

    The road's friction is of the scenario where both cars have tyres. A car without tyres has no other than 1.

    Args:
        one: a scenario as plain data.
        other: the other scenario, in the same form.
    """
    tyres = all(has_tyres(scenario) for scenario in (one, other))
    return next(differences(one, other, _FREE if tyres else _FREE | {FRICTION}), None)


def phi_differences(one: Mapping[str, Any], other: Mapping[str, Any]) -> list[Different]:
    """Return all keys in which two scenarios differ that safe trajectories can depend on, the car's own among them."""
    return list(differences(one, other, _SAYS_NOTHING))


def has_tyres(scenario: Mapping[str, Any]) -> bool:
    """Return whether the car of a scenario, as plain data, has tyres: only they feel the road's friction."""
    return DYNAMICS[str(scenario["car"].get("dynamics", BASIC))].tyres


def differences(
    one: Mapping[str, Any], other: Mapping[str, Any], free: frozenset[str] = frozenset()
) -> Iterator[Different]:
    """Yield the keys in which plain data differ, `section.key`, in their order; those that are free may."""
    first, second = _flat(one, free), _flat(other, free)
    for key in sorted(first.keys() | second.keys()):
        if first.get(key) != second.get(key):
            yield key, first.get(key), second.get(key)


def _flat(data: Mapping[str, Any], free: frozenset[str], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in data.items():
        name = f"{prefix}{key}"
        if name in free:
            continue
        if isinstance(value, Mapping):
            flat |= _flat(value, free, f"{name}.")
        else:
            flat[name] = value
    return flat
