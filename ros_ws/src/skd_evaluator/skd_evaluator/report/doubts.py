"""What a reader should know of the margin, and of what was planned beside it, before believing the figures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from skd_evaluator.measure.margins import CLOSENESS_WARNING

_FEWEST = 10
"""Attempts below which closeness says little."""


def margin_doubts(result: Mapping[str, Any], touched: int, hit: int) -> list[str]:
    """Return what is to be known of the margin, in one line each; nothing where it is not known.

    Args:
        result: content of assessment.json; of it the entries of the margin, `closeness` and `scenario`.
        touched: kamikazes that touched the car, at whatever speed.
        hit: kamikazes and runs along φ that the moving car hit.
    """
    if result["margin"] is None:
        return []
    found = []
    if not result["margin_converged"]:
        found.append(
            f"the search for the margin had not converged at {result['margin_budget']} ticks an attempt: the margin "
            "may be less; give a greater --margin-limit"
        )
    close = result["closeness"]
    if close is not None and close > CLOSENESS_WARNING and result["margin_attempts"] >= _FEWEST:
        found.append(
            f"planned kamikazes needed {close:.2f} times the margin: the planned deformation and SKD say as much about "
            "what they knew as about the car; judge it by the margin"
        )
    if touched and not hit and result["margin_beyond"] == result["margin_attempts"]:
        found.append(
            f"this car could only be walked into: {touched} kamikazes touched it, all of them while it drove slower "
            f"than {result['scenario']['collision']['hit_speed']:g} m/s"
        )
    return found
