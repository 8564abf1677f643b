"""Scenarios from validated YAML, by name or from a file.

Every key is known and in range, and required unless it has a default: those of `car.dynamics: multi_body`, `eta_max`,
the parts of a road that is not straight and its further lanes, and the sections `sensor`, `obstacles`, `others`,
`ending` and `protocol`. A mistake is one line that names file, key and allowed range.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from skd_sim.choices.car_dynamics import DYNAMICS
from skd_sim.encounter.checks import (
    check_control_period,
    check_destination,
    check_obstacles,
    check_others,
    check_start,
)
from skd_sim.encounter.definition import Scenario as Scenario
from skd_sim.encounter.known_scenarios import scenario_data
from skd_sim.encounter.lanes import off_lanes
from skd_sim.encounter.protocol.relative import with_absolute_keys
from skd_sim.encounter.reader import build
from skd_sim.errors import UsageError


def scenario_from_dict(data: Any, where: str = "scenario") -> Scenario:
    """Build and check a scenario from plain data.

    Args:
        data: nested mapping with the keys of `Scenario`; places may be given by lanes (`skd_sim.encounter.lanes`).
        where: file or other origin, for messages.

    Raises:
        UsageError: a key is missing, unknown or out of range, or the car overlaps the adversary at the start.
    """
    data = with_absolute_keys(off_lanes(data, where), where)
    scenario = build(Scenario, data, where, "")
    scenario.road.check(where)
    scenario.adversary.check(where)
    for index, other in enumerate(scenario.others):
        other.check(where, f"others[{index}]")
    if scenario.protocol is not None:
        scenario.protocol.check(where)
    if scenario.horizon < scenario.time_step:
        raise UsageError(f"{where}: horizon must be at least time_step ({scenario.time_step:g} s)")
    check_control_period(scenario, where)
    check_destination(scenario, where)
    if not DYNAMICS[scenario.car.dynamics].tyres and scenario.road.friction != 1.0:
        others = " or ".join(name for name, kind in DYNAMICS.items() if kind.tyres)
        raise UsageError(
            f"{where}: road.friction {scenario.road.friction:g} has no effect on car.dynamics {scenario.car.dynamics}; "
            f"set car.dynamics to {others}, or leave road.friction out"
        )
    if not DYNAMICS[scenario.car.dynamics].steers and not scenario.road.straight:
        others = " or ".join(name for name, kind in DYNAMICS.items() if kind.steers)
        raise UsageError(
            f"{where}: car.dynamics {scenario.car.dynamics} does not steer, so it cannot follow the curves of "
            f"road.parts; set car.dynamics to {others}, or leave road.parts out"
        )
    check_obstacles(scenario, where)
    check_others(scenario, where)
    if not scenario.car.meet_safe_trajectory:
        check_start(scenario, scenario.adversary.start_x, scenario.adversary.start_y, where)
    return scenario


def load_scenario(source: str) -> Scenario:
    """Load a scenario by name, shipped or of an installed package, or one from a YAML file by path.

    Raises:
        UsageError: no such scenario, not YAML, or not a valid scenario.
    """
    return scenario_from_dict(scenario_data(source), source)


def changed_scenario(source: str, changes: Mapping[str, Any]) -> Scenario:
    """Return a scenario with some keys of its file changed; what is said relative to its test speed changes with it.

    A place on a lane is coordinates before anything is changed.

    Args:
        source: its name, or the path of its YAML file.
        changes: values by the key's place in the file, as `car.start_speed`.

    Raises:
        UsageError: there is no such scenario or place in it, or it is none with these values.
    """
    content = off_lanes(scenario_data(source), source)
    if not isinstance(content, Mapping):
        return load_scenario(source)  # says what is wrong
    data = dict(content)
    for place, value in changes.items():
        *sections, key = place.split(".")
        section = data
        for name in sections:
            inner = section.get(name, {})
            if not isinstance(inner, Mapping):
                raise UsageError(f"scenario {data.get('name', source)}: {place}: {name} has no keys")
            section[name] = section = dict(inner)
        section[key] = value
    return scenario_from_dict(data, f"scenario {data.get('name', source)}, changed")
