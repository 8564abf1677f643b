"""Ways out of CommonRoad XML: the trajectories of its dynamic obstacles, by their ids."""

from __future__ import annotations

from xml.etree.ElementTree import Element

import numpy as np
from skd_sim.errors import UsageError
from skd_sim.inputs.numbers import finite_number

from skd_evaluator.extensions.exchange.coming_in.found import Found, track_of

ROOT = "commonRoad"


def read_commonroad(root: Element, where: str) -> list[Found]:
    """Return every dynamic obstacle that has a trajectory, at its places, which are the middle of its shape.

    Args:
        root: root of the document.
        where: name of the file, for messages.

    Raises:
        UsageError: the time step is none, two obstacles have one id, or a state has no exact time or place.
    """
    step = finite_number(root.get("timeStepSize", ""), f"{where}: timeStepSize")
    if not 0.0 < step < 1e3:
        raise UsageError(f"{where}: timeStepSize must be above 0 s, got {step:g}")
    found: dict[str, Found] = {}
    for obstacle in root.findall("dynamicObstacle"):
        name = obstacle.get("id", "")
        here = f"{where}, obstacle {name}"
        first, rest = obstacle.find("initialState"), obstacle.findall("trajectory/state")
        if first is None or not rest:
            continue  # occupancies, or nothing
        if name in found:
            raise UsageError(f"{here}: two obstacles have this id; give a file in which each has its own")
        rows = np.array([_state(one, here) for one in (first, *rest)], np.float64)
        track = track_of(step * rows[:, 0], rows[:, 1:], here)
        found[name] = Found(name, track, (obstacle.findtext("type") or "").strip())
    return list(found.values())


def _state(state: Element, where: str) -> tuple[float, float, float]:
    values = []
    for path in ("time/exact", "position/point/x", "position/point/y"):
        said = state.findtext(path)
        if said is None:
            raise UsageError(f"{where}: a state has no {path}; sets of places or times are not read")
        values.append(finite_number(said.strip(), f"{where}: {path}"))
    tick, x, y = values
    return tick, x, y
