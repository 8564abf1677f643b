"""Figures that made-up results have in common: of 1 m of planned deviation, in `crossing`."""

from typing import Any

from skd_sim.scenario.scenario import load_scenario

FIGURES: dict[str, Any] = {
    "eta_max": 5.0,
    "scenario": load_scenario("crossing").as_dict(),
    "safe": "synthetic",
    "seed": 0,
    "simulations": 1000,
    "version": "1",
    "maximum_distance": None,
    "margin_converged": True,
    "margin_budget": None,
    "margin_how": "",
    "margin_note": "",
    "deviation": 1.0,
    "nominal_collision_rate": 0.0,
    "adversary_model": "exact",
    "objectives": {"deviation": {}, "paper": {}},
}
