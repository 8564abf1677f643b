"""Keys of a scenario's file that are said by time or by the car's speed, so that one file serves every test speed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from skd_sim.errors import UsageError

_BY_TIME = {"start_time": "start_gap", "start_time_range": "start_gap_range"}


def with_absolute_keys(data: Any, where: str) -> Any:
    """Return a scenario's content with lengths and speeds in place of what is said relative to the car's start speed.

    `car.start_time` and `car.start_time_range` (s) stand for `start_gap` and `start_gap_range`. A protocol without
    `speed` has a target as fast as the car; and an adversary without `start_speed` comes as fast as a target that has
    been moving before. What is no number is left to the reader.

    Args:
        data: content of a scenario; it is not changed.
        where: file or other origin, for messages.

    Raises:
        UsageError: a length is given in both ways.
    """
    if not isinstance(data, Mapping) or not isinstance(data.get("car"), Mapping):
        return data
    found, car = dict(data), dict(data["car"])
    speed = car.get("start_speed")
    for by_time, key in _BY_TIME.items():
        if by_time not in car:
            continue
        if key in car:
            raise UsageError(f"{where}: car.{by_time} and car.{key} both say where the car starts; leave one out")
        if _is_number(speed) and _is_number(car[by_time]):
            car[key] = car.pop(by_time) * speed
        else:
            raise UsageError(
                f"{where}: car.{by_time} must be a number (s), and go with the number car.start_speed (m/s)"
            )
    found["car"] = car
    if isinstance(data.get("protocol"), Mapping):
        protocol = {"speed": speed, **data["protocol"]}
        found["protocol"] = protocol
        adversary = data.get("adversary")
        if isinstance(adversary, Mapping) and not protocol.get("acceleration_distance"):
            found["adversary"] = {"start_speed": protocol["speed"], **adversary}
    return found


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)
