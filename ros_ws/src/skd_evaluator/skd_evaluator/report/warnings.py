"""What a reader should know of the margin, and of what was planned beside it, before believing the figures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from skd_evaluator.metrics.margins import GAP_WARNING, stopped_at

_FEWEST = 10
"""Trials below which optimality gap, or a quantile of impacts, says little."""
_JUST_ABOVE = 0.25
"""m/s above the hit speed within which nearly all hits are a matter of where it is set."""


def margin_warnings(result: Mapping[str, Any], touched: int, hit: int) -> list[str]:
    """Return what is to be known of the margin, in one line each; nothing where it is not known.

    Args:
        result: content of assessment.json; of it margin and interval, `impact_speed`, `optimality_gap` and
            `scenario` count.
        touched: number of kamikazes that touched the car, at whatever speed.
        hit: number of kamikazes and of runs along φ that the moving car hit.
    """
    if result["margin"] is None:
        return []
    found = []
    if not result["margin_converged"]:
        found.append(
            f"the search for the margin {stopped_at(result)}: the margin may be less; give a greater --margin-limit"
        )
    close = result["optimality_gap"]
    if close is not None and close > GAP_WARNING and result["margin_trials"] >= _FEWEST:
        found.append(
            f"planned kamikazes needed {close:.2f} times the margin: the planned deviation and SKD say as much about "
            "what they knew as about the car; judge it by the margin"
        )
    impact, least = result["impact_speed"], result["scenario"]["collision"].get("hit_speed", 0.0)
    slow = impact is not None and least > 0.0 and impact["p90"] <= least + _JUST_ABOVE
    if slow and result["margin_trials"] - result["margin_beyond"] >= _FEWEST:
        found.append(
            f"90 % of the margin's hits are at {impact['p90']:.2f} m/s or less, and a hit begins at {least:g} m/s: "
            "this car is judged by slow touches, and another collision.hit_speed would give another margin"
        )
    nobody = result["margin_beyond"] == result["margin_trials"]
    if hit and nobody:
        found.append(
            f"nobody could be hit within η_max in the {result['margin_trials']} trials of which the margin is "
            f"made, but {hit} other {'episodes' if hit > 1 else 'episode'} ended in a hit: hits are rarer than so few "
            "trials show, or take more than η_max, and neither the margin nor its interval knows of them; give a "
            "greater --kamikaze-count or --safe-count, or a scenario with a greater eta_max"
        )
    elif result["margin_ci95"] is not None and result["margin_ci95"][0] == result["margin_ci95"][1]:
        found.append(
            f"all {result['margin_trials']} trials have the same margin, so its interval has no width: trials on "
            "other safe trajectories may still have another one; a greater --safe-count says more"
        )
    if touched and not hit and nobody:
        found.append(
            f"this car could only be walked into: {touched} kamikazes touched it, all of them while it drove slower "
            f"than {result['scenario']['collision']['hit_speed']:g} m/s"
        )
    return found


def contact_warnings(figures: Mapping[str, Any]) -> list[str]:
    """Return, in one line, that a simulator's contacts are others than SKD's; nothing where they are the same.

    Args:
        figures: content of assessment.json.
    """
    found = figures.get("simulator_contacts")
    if found is None or not found["geometry_alone"] + found["simulator_alone"]:
        return []
    return [
        f"of {found['episodes']} episodes the car touched somebody by SKD's geometry alone in "
        f"{found['geometry_alone']}, and by the simulator's own shapes alone in {found['simulator_alone']}; SKD's "
        "geometry counts"
    ]
