"""Where the basic car is known in a scenario, its exact margin is what the search against the car itself finds."""

from __future__ import annotations

from typing import Any

from skd_evaluator import assess

LAW = "skd_sim.controllers.basic:BasicController"


def test_the_exact_margin_along_the_lane_is_that_of_the_search() -> None:
    """Where nobody crosses; the same law as somebody's class is searched, not predictable."""
    few: dict[str, Any] = {"scenario": "cpla", "safe": "regulatory", "safe_count": 2, "kamikaze_count": 2}
    few |= {"collision_runs": 2, "simulations": 20, "knowledge": "nothing", "behaviour": "none", "margin_limit": 1024}
    known, searched = (assess(car, **few).as_dict() for car in ("basic", LAW))
    assert known["margin_budget"] is None  # it is exact
    assert searched["margin_budget"] > 0
    assert known["margin"] > 0.05
    assert known["margin"] - 1e-9 <= searched["margin"] <= 1.02 * known["margin"]
