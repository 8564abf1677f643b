"""The actors that a scenario needs in CARLA, as the file of carla_spawn_objects: who is there, and by which blueprint.

`python -m skd_sim.simulators.carla_objects SCENARIO > objects.json`, with a scenario's name or file.
"""

from __future__ import annotations

import json
import sys
from typing import Any

from skd_sim.errors import UsageError
from skd_sim.scenario.kinds import called
from skd_sim.scenario.scenario import Scenario, load_scenario

CARLA = "carla"
"""What the kinds of road user know this simulator by."""
EGO, ADVERSARY, OTHER, OBSTACLE = "ego_vehicle", "adversary", "other_{}", "obstacle_{}"
"""Role names of actors; of the others and of the obstacles of a scenario with their place in it."""
ODOMETRY, CONTROL = "odometry", "control"
"""Ids of an actor's pseudo sensor and of its pseudo actor."""
_CAR = "vehicle.tesla.model3"


def walks(blueprint: str) -> bool:
    """Return whether an actor takes a walker's control; any other is put where it is to be, frame by frame."""
    return blueprint.startswith("walker.")


def blueprints(scenario: Scenario) -> dict[str, str]:
    """Return the blueprint of each actor of a scenario by its role name; cars under test have their own."""
    found = {EGO: _CAR, ADVERSARY: called(scenario.adversary, CARLA)}
    found |= {OTHER.format(index): called(other, CARLA) for index, other in enumerate(scenario.others)}
    return found | {OBSTACLE.format(index): _CAR for index in range(len(scenario.obstacles))}


def objects(scenario: Scenario) -> dict[str, Any]:
    """Return the content of a file for carla_spawn_objects; where actors appear is left to it."""
    control = {"type": "actor.pseudo.control", "id": CONTROL}
    odometry = {"type": "sensor.pseudo.odom", "id": ODOMETRY}
    found = [
        {"type": blueprint, "id": role, "sensors": [odometry, control] if role in (EGO, ADVERSARY) else [control]}
        for role, blueprint in blueprints(scenario).items()
    ]
    return {"objects": found}


def main() -> int:
    """Write the file of the scenario that the command line names to standard output."""
    try:
        if len(sys.argv) != 2:
            raise UsageError("give one scenario: python -m skd_sim.simulators.carla_objects SCENARIO > objects.json")
        print(json.dumps(objects(load_scenario(sys.argv[1])), indent=2))
    except UsageError as error:
        print(f"carla_objects: error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
