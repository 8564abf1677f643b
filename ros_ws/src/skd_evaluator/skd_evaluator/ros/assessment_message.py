"""The message of an assessment."""

from __future__ import annotations

import math
from collections.abc import Sequence

from skd_msgs.msg import Assessment as AssessmentMsg
from skd_sim.messages.to_messages import to_stamp

from skd_evaluator.campaign.judge.rating import Rating
from skd_evaluator.campaign.store.figure_names import figure

_NUMBERS = (
    "margin", "closeness", "hit_rate",
    "deformation", "deformation_of_successes", "deformation_success_rate", "eta_max", "skd", "skd_prefix", "variance",
    "kamikaze_success_rate", "collision_rate",
)  # fmt: skip
_INTERVALS = (
    "margin_ci95", "hit_rate_ci95",
    "deformation_ci95_attempts", "deformation_ci95", "skd_ci95_pairs", "skd_ci95", "collision_rate_ci95_runs",
)  # fmt: skip
_COUNTS = ("pairs", "kamikaze_attempts", "kamikaze_aborted", "collision_runs", "collision_standing_contacts")


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


def _interval(pair: Sequence[float] | None) -> list[float]:
    return [math.nan, math.nan] if pair is None else [float(pair[0]), float(pair[1])]


def _ends(ends: Sequence[float | None], text: str) -> list[float]:
    """Return an interval whose ends may lie beyond what was compared; of those the text says on which side."""
    sides = [math.inf if word.startswith("above") else -math.inf for word in text.strip("[]").split(", ")]
    return [side if end is None else end for end, side in zip(ends, sides, strict=True)]


def assessment_to_message(rating: Rating, campaign: str, stamp: int) -> AssessmentMsg:
    """Return the message of an assessment published at simulation time `stamp` (ns)."""
    result = rating.as_dict()
    message = AssessmentMsg()
    message.header.stamp = to_stamp(stamp)
    message.campaign = campaign
    message.controller = result["controller"]
    message.multiplier = _number(result["multiplier"])
    message.scenario_name = rating.plan.scenario.name
    message.seed = result["seed"]
    message.margin_converged = bool(result["margin_converged"])
    name = "equivalent_multiplier"
    text, interval = result[f"{name}_text"], result[f"{name}_ci95_text"]
    message.equivalent_multiplier = _number(figure(result, name)) if text else math.nan
    message.equivalent_multiplier_ci95 = _interval(_ends(result[f"{name}_ci95"], interval) if interval else None)
    for name in _NUMBERS:
        setattr(message, name, _number(result[name]))
    for name in _INTERVALS:
        setattr(message, name, _interval(result[name]))
    for name in _COUNTS:
        setattr(message, name, int(result[name]))
    return message
