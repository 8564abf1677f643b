"""The message of an assessment."""

from __future__ import annotations

import math
from collections.abc import Sequence

from skd_msgs.msg import Assessment as AssessmentMsg
from skd_sim.nodes.to_messages import to_stamp

from skd_evaluator.campaign.rating import Rating
from skd_evaluator.measure.equivalent_multiplier import EquivalentMultiplier

_NUMBERS = (
    "margin", "closeness", "hit_rate", "deformation", "deformation_of_successes", "deformation_success_rate",
    "eta_max", "skd", "skd_prefix", "variance", "kamikaze_success_rate", "collision_rate",
)  # fmt: skip
_INTERVALS = (
    "margin_ci95", "hit_rate_ci95", "deformation_ci95_attempts", "deformation_ci95", "skd_ci95_pairs", "skd_ci95",
    "collision_rate_ci95_runs",
)  # fmt: skip
_COUNTS = ("pairs", "kamikaze_attempts", "kamikaze_aborted", "collision_runs", "collision_standing_contacts")


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


def _interval(pair: Sequence[float] | None) -> list[float]:
    return [math.nan, math.nan] if pair is None else [float(pair[0]), float(pair[1])]


def _by_phi(found: EquivalentMultiplier | None) -> Sequence[float] | None:
    """Return the interval by φ of an equivalent multiplier; an end may be infinite."""
    return None if found is None else found.ci95


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
    found = rating.equivalent  # of which assessment.json says in words what is beyond those it was compared with
    message.equivalent_multiplier = _number(None if found is None else found.value)
    message.equivalent_multiplier_ci95 = _interval(_by_phi(found))
    for name in _NUMBERS:
        setattr(message, name, _number(result[name]))
    for name in _INTERVALS:
        setattr(message, name, _interval(result[name]))
    for name in _COUNTS:
        setattr(message, name, int(result[name]))
    return message
