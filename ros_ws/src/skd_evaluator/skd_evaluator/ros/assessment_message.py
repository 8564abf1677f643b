"""The message of an assessment."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from skd_msgs.msg import Assessment as AssessmentMsg
from skd_sim.ros.to_messages import to_stamp

from skd_evaluator.assessment.judge.figure_table import Of, keys_of
from skd_evaluator.assessment.judge.rating import Rating
from skd_evaluator.assessment.store.figure_names import figure

_FIGURES = ("double", "double[2]", "boolean")
"""Kinds of fields that say something of the car; the others count episodes."""


def _field(kind: str, value: Any) -> Any:
    """Return a figure as a field of a message has it: nan, or false, where it is not defined."""
    if kind == "double":
        return math.nan if value is None else float(value)
    if kind == "double[2]":
        return [math.nan, math.nan] if value is None else [float(value[0]), float(value[1])]
    return bool(value) if kind == "boolean" else value


def _ends(ends: Sequence[float | None], text: str) -> list[float]:
    """Return an interval whose ends may lie beyond what was compared; of those the text says on which side."""
    sides = [math.inf if word.startswith("above") else -math.inf for word in text.strip("[]").split(", ")]
    return [side if end is None else end for end, side in zip(ends, sides, strict=True)]


def assessment_to_message(rating: Rating, campaign: str, stamp: int) -> AssessmentMsg:
    """Return the message of an assessment published at simulation time `stamp` (ns).

    A field has the figure of its name. Figures that are not credible are not defined: whoever reads a message sees no
    warning beside it.
    """
    settings, unsaid = keys_of(Of.SETTING), not rating.credible
    result = rating.as_dict()
    name = "equivalent_multiplier"
    text, interval = result[f"{name}_text"], result[f"{name}_ci95_text"]
    equivalent = {
        name: figure(result, name) if text else None,
        f"{name}_ci95": _ends(result[f"{name}_ci95"], interval) if interval else None,
    }
    found = {**result, **equivalent, "campaign": campaign, "scenario_name": rating.plan.scenario.name}
    message = AssessmentMsg()
    for field, kind in message.get_fields_and_field_types().items():
        if field != "header":
            of_the_car = kind in _FIGURES and field not in settings
            setattr(message, field, _field(kind, None if unsaid and of_the_car else found[field]))
    message.header.stamp = to_stamp(stamp)
    return message
