"""Scenarios by name or from a YAML file, checked.

Every key is known and in range, and required unless it has a default. A mistake is one line that names file, key and
what would be right.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from skd_sim.errors import UsageError
from skd_sim.inputs.model import read_model
from skd_sim.scenario.checks import check_scenario
from skd_sim.scenario.definition import Scenario as Scenario
from skd_sim.scenario.known_scenarios import scenario_data
from skd_sim.scenario.shorthand import with_absolute_keys, without_lanes


def scenario_from_dict(data: Any, where: str = "scenario") -> Scenario:
    """Build and check a scenario from plain data.

    Args:
        data: nested mapping with the keys of `Scenario`; places may be given by lanes, and the car's start by time
            (`skd_sim.scenario.shorthand`).
        where: file or other origin, for messages.

    Raises:
        UsageError: a key is missing, unknown or out of range, or the car overlaps the adversary at the start.
    """
    scenario = read_model(Scenario, with_absolute_keys(without_lanes(data, where), where), where)
    check_scenario(scenario, where)
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
    content = without_lanes(scenario_data(source), source)
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
