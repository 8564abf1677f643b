"""Margin against risk: where cars stand, and the basic cars behind them, from what their results say."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from skd_sim.options.car_under_test import CarUnderTest

from skd_evaluator.metrics.risks import SCALES
from skd_evaluator.metrics.statistics.statistics import Interval

LEAST: Final = 1e-9
"""Below it no risk is drawn: subset simulation ends there."""
_APART: Final = 0.12  # of width and height between two names


@dataclass(frozen=True)
class RatedCar:
    """A car in the picture.

    Attributes:
        label: name of the car.
        multiplier: C of a basic car; None: it is another.
        margin: margin of the car, m.
        margin_ci95: 95 % interval of it, by φ.
        risks: at each of `SCALES`, the risk and its 95 % interval by φ, else that for these φ.
        behind: whether it is there for the curve alone.
    """

    label: str
    multiplier: float | None
    margin: float
    margin_ci95: Interval
    risks: tuple[tuple[float, Interval], ...]
    behind: bool = False

    def as_dict(self) -> dict[str, Any]:
        """Return its entry of comparison.json."""
        found: dict[str, Any] = {"car": self.label, "multiplier": self.multiplier, "margin": self.margin}
        found["margin_ci95"] = self.margin_ci95
        for scale, (value, ends) in zip(SCALES, self.risks, strict=True):
            found |= {f"risk_{scale:g}": value, f"risk_{scale:g}_ci95": ends}
        return found


def rated_car(figures: Mapping[str, Any], label: str, *, behind: bool = False) -> RatedCar | None:
    """Return what is drawn of an assessment; None where margin or risk is not known."""
    margin = figures["margin"]
    if margin is None or any(figures.get(f"risk_{scale:g}") is None for scale in SCALES):
        return None
    car = CarUnderTest(str(figures["controller"]))
    basic = car.is_known and car.has_multiplier and figures["multiplier"] is not None
    risks = []
    for scale in SCALES:
        value, key = float(figures[f"risk_{scale:g}"]), f"risk_{scale:g}_ci95"
        low, high = figures[key] or figures[f"{key}_runs"] or (value, value)
        if value == 0.0:  # of nobody who was hit there is no spread over φ: what the runs tell is more
            high = max(high, (figures[f"{key}_runs"] or (0.0, 0.0))[1])
        risks.append((value, (float(low), float(high))))
    low, high = figures["margin_ci95"] or (margin, margin)
    multiplier = float(figures["multiplier"]) if basic else None
    return RatedCar(label, multiplier, float(margin), (float(low), float(high)), tuple(risks), behind)


def basic_cars(cars: Sequence[RatedCar]) -> list[RatedCar]:
    """Return the basic cars, one of each C, in its order; none where there are fewer than two."""
    found = {one.multiplier: one for one in cars if one.multiplier is not None}
    ordered = [found[multiplier] for multiplier in sorted(found)]
    return ordered if len(ordered) > 1 else []


def labelled(curve: Sequence[RatedCar], place: int, floor: float) -> list[str]:
    """Return C of each basic car of a curve as text, empty where it would stand on that of the one before."""
    widest = max(one.margin for one in curve) or 1.0
    found: list[str] = []
    last = (-math.inf, 0.0)
    for one in curve:
        here = one.margin / widest, math.log(max(floor, one.risks[place][0])) / math.log(floor)
        far = math.dist(here, last) > _APART
        found.append(f"{one.multiplier:g}" if far else "")
        last = here if far else last
    return found


def floor_of(cars: Sequence[RatedCar], place: int) -> float:
    """Return the least risk of a picture with a logarithmic axis, a power of 10: what is less stands at its edge.

    Args:
        cars: cars in the picture.
        place: of the scale in `SCALES`.
    """
    seen = [one.risks[place] for one in cars]
    known = [value for value, _ in seen if value > 0.0]
    known += [ends[1] for value, ends in seen if value == 0.0 and ends[1] > 0.0]
    least = max(LEAST, min(known, default=0.1))
    return float(10.0 ** (math.ceil(math.log10(least) - 1e-9) - 1))


def alike(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Return whether the risks and margins of two results are of one behaviour model and one η_max."""
    models = [found["risk"]["behaviour"] if found.get("risk") else None for found in (one, other)]
    return models[0] == models[1] and one["eta_max"] == other["eta_max"]
