"""Pictures that hold cars against each other: vulnerability curves, and margin against risk."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from skd_sim.arrays import FloatArray
from skd_sim.options.car_under_test import CarUnderTest

from skd_evaluator import palette
from skd_evaluator.metrics.risks import SCALES
from skd_evaluator.metrics.statistics import Interval
from skd_evaluator.report.drawing import PAGE, TYPE, save_picture
from skd_evaluator.report.terminal import car_name

mpl.use("Agg")


_TITLE = "How far one has to stray from a safe trajectory to be hit; shaded: 95 % interval by φ"
_OF_PLANNED = "#777777"
"""Colour of planned kamikazes beside the margin."""
_AIR = 1.15
"""How much further than the last hit the picture goes."""


@dataclass(frozen=True)
class ShownCurve:
    """A car in the picture.

    Attributes:
        label: name of the car.
        curve: curve of the margins, or of planned kamikazes if no margins are known; as `VulnerabilityCurve.as_dict`.
        nominal_collision_rate: share of runs along φ that were hit; None if there were no runs.
        nominal_collision_rate_ci95: 95 % interval of that share, by φ.
        budgets: points of kamikazes that were planned with a budget, as `BudgetPoint.as_dict` gives them.
        planned: the curve of planned kamikazes beside that of the margins; None where that is `curve`.
    """

    label: str
    curve: Mapping[str, Any]
    nominal_collision_rate: float | None
    nominal_collision_rate_ci95: Interval | None
    budgets: Sequence[Mapping[str, Any]] = ()
    planned: Mapping[str, Any] | None = None

    @property
    def of(self) -> str:
        """What the area above the curve is."""
        return "planned deviation" if self.planned is None else "margin"


def shown_curve(
    result: Mapping[str, Any], curves: Mapping[str, Any] | None = None, label: str | None = None
) -> ShownCurve:
    """Return what is to be drawn of an assessment.

    Args:
        result: content of the car's assessment.json.
        curves: curves of the car, as `Vulnerability.as_dict` gives them; by default those in the result.
        label: label of the car; by default its name.
    """
    found = result["vulnerability_curve"] if curves is None else curves
    return ShownCurve(
        label or car_name(result),
        found["margins"] or found["kamikazes"],
        result["nominal_collision_rate"],
        result["nominal_collision_rate_ci95"],
        [point for point in found["budgets"] if point["trials"]],
        found["kamikazes"] if found["margins"] else None,
    )


def save_vulnerability(path: Path, shown: Sequence[ShownCurve]) -> None:
    """Save one picture of the curves of one or more cars, the most vulnerable first.

    Args:
        path: file to which the picture is written.
        shown: cars that the picture shows.
    """
    ordered = sorted(shown, key=lambda one: float(one.curve["area_above"]))
    colours = palette.ordered(len(ordered))
    figure = Figure(figsize=(PAGE, 4.6), layout="constrained")
    axes = figure.subplots()
    end = _end(ordered)
    for one, colour, dash in zip(ordered, colours, palette.in_turn(len(ordered)), strict=True):
        _draw(axes, one, colour, dash, end, alone=len(ordered) == 1)
    axes.set_xlim(-0.015 * end, end)
    axes.set_ylim(-2.0, 104.0)
    axes.set_xlabel("η: how far the adversary may stray from the safe trajectory (m)")
    axes.set_ylabel("can be hit (% of trials)")
    axes.grid(alpha=0.3)
    axes.annotate(
        "safer cars lie to the right",
        xy=(0.985, 1.02),
        xytext=(0.66, 1.02),
        xycoords="axes fraction",
        ha="right",
        va="center",
        fontsize=TYPE,
        color="#555555",
        arrowprops={"arrowstyle": "->", "color": "#555555"},
        annotation_clip=False,
    )
    alone = len(ordered) == 1
    figure.suptitle(_TITLE, x=0.02, ha="left", fontsize=9)
    figure.legend(
        loc="outside lower center",
        ncols=2 if alone else 1,
        frameon=False,
        fontsize=TYPE,
    )
    save_picture(figure, path)


def _draw(axes: Axes, one: ShownCurve, colour: Any, dash: tuple[int, ...], end: float, *, alone: bool) -> None:
    steps = one.curve["steps"]
    of = f"{one.of} {one.curve['area_above']:.2f} m of {one.curve['trials']} trials"
    label = f"{one.label}: {of}"
    x = np.array([0.0, *steps["eta"], max(end, one.curve["eta_max"])])
    y = 100.0 * np.array([0.0, *steps["probability"], (steps["probability"] or [0.0])[-1]])
    axes.step(x, y, where="post", color=colour, lw=2.0, ls=(0, dash or None), zorder=4, label=label)
    etas, low, high = interval_band(one.curve)
    axes.fill_between(etas, 100.0 * low, 100.0 * high, step="post", color=colour, alpha=0.13, lw=0.0, zorder=2)
    if one.nominal_collision_rate is not None:
        rate, ends = (
            100.0 * one.nominal_collision_rate,
            np.array(one.nominal_collision_rate_ci95 or (one.nominal_collision_rate,) * 2),
        )
        errors = np.maximum(0.0, np.abs(100.0 * ends - rate))[:, None]
        axes.errorbar(
            [0.0], [rate], errors, fmt="o", ms=7.0, color=colour, capsize=3.0, clip_on=False, zorder=6,
            label="nominal collision rate (η = 0)" if alone else None,
        )  # fmt: skip
    if one.planned is not None and alone:
        steps = one.planned["steps"]
        x = np.array([0.0, *steps["eta"], max(end, one.planned["eta_max"])])
        y = 100.0 * np.array([0.0, *steps["probability"], (steps["probability"] or [0.0])[-1]])
        name = f"planned kamikazes: planned deviation {one.planned['area_above']:.2f} m"
        axes.step(x, y, where="post", color=_OF_PLANNED, lw=1.3, ls="-.", zorder=3, label=name)
    for number, point in enumerate(one.budgets if alone else ()):
        centre, ends = 100.0 * point["probability"], 100.0 * np.array(point["ci95_trials"])
        errors = np.maximum(0.0, np.abs(ends - centre))[:, None]
        axes.errorbar(
            [point["eta"]], [centre], errors, fmt="D", ms=5.0, mfc="white", color=_OF_PLANNED, capsize=3.0, zorder=5,
            label="planned kamikazes held to η" if number == 0 else None,
        )  # fmt: skip


def interval_band(curve: Mapping[str, Any]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return where the 95 % band steps (η, m), and its lower and upper end from there on.

    Intervals are known at evenly spaced η. Between them the band goes from one to the next as the curve does: a
    straight line would leave the curve where it jumps.
    """
    points, steps = curve["points"], curve["steps"]
    known = np.array([point["eta"] for point in points])
    ends = np.array([point["ci95"] or point["ci95_trials"] for point in points])
    at_known = np.array([point["probability"] for point in points])
    jumps, values = np.array(steps["eta"]), np.array([0.0, *steps["probability"]])
    etas = np.union1d(known, jumps)
    probability = values[np.searchsorted(jumps, etas, side="right")]
    before = np.searchsorted(known, etas, side="right") - 1
    after = np.minimum(before + 1, known.size - 1)
    rise = at_known[after] - at_known[before]
    share = np.divide(probability - at_known[before], rise, out=np.zeros_like(etas), where=rise > 0.0)
    low, high = (ends[before] + share[:, None] * (ends[after] - ends[before])).T
    return np.append(etas, curve["eta_max"]), np.append(low, low[-1]), np.append(high, high[-1])


def _end(shown: Sequence[ShownCurve]) -> float:
    """Return how far the picture goes (m): a little beyond the last hit, at most to the largest η_max."""
    curves = [one.curve for one in shown] + [one.planned for one in shown[:1] if one.planned and len(shown) == 1]
    last = max([one["steps"]["eta"][-1] for one in curves if one["steps"]["eta"]], default=0.0)
    limit = max(float(one.curve["eta_max"]) for one in shown)
    return min(limit, _AIR * last) if last > 0.0 else limit


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


mpl.use("Agg")


def save_rating(path: Path, cars: Sequence[RatedCar]) -> None:
    """Save the picture.

    Args:
        path: file to which the picture is written.
        cars: cars in it, those that are there for the curve alone included.
    """
    figure = Figure(figsize=(PAGE, 3.6), layout="constrained")
    panels = figure.subplots(1, len(SCALES), sharey=True)
    floor = min(floor_of(cars, place) for place in range(len(SCALES)))
    for place, axes in enumerate(panels):
        _draw_risk(axes, cars, place, floor)
    panels[0].set_ylabel("risk: hit by the front of the moving car", fontsize=9)
    hollow = any(risk[0] < floor for one in cars if not one.behind for risk in one.risks)
    figure.suptitle(
        "Margin against risk; bars: 95 % intervals by φ. Safer cars lie to the right and below"
        + ("\nhollow, at the edge: nobody was hit" if hollow else ""),
        x=0.02, ha="left", fontsize=9,
    )  # fmt: skip
    handles, labels = panels[0].get_legend_handles_labels()
    legend = figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False, fontsize=TYPE)
    for text in legend.get_texts():
        text.set_parse_math(False)  # a name may be anything
    save_picture(figure, path)


def _draw_risk(axes: Axes, cars: Sequence[RatedCar], place: int, floor: float) -> None:
    curve = basic_cars(cars)
    if curve:
        x, y = [one.margin for one in curve], [max(floor, one.risks[place][0]) for one in curve]
        axes.plot(x, y, "-", color=palette.BEHIND, lw=1.3, marker=".", ms=5, zorder=2, label="basic cars, by C")
        for text, across, up in zip(labelled(curve, place, floor), x, y, strict=True):
            axes.annotate(
                text, (across, up), xytext=(3, 3), textcoords="offset points", fontsize=TYPE, color=palette.BEHIND
            )
    for number, one in enumerate(one for one in cars if not one.behind):
        colour, marker = palette.SERIES[number % len(palette.SERIES)], palette.MARKERS[number % len(palette.MARKERS)]
        value, (low, high) = one.risks[place]
        at = max(floor, value)
        reach = [[max(0.0, one.margin - one.margin_ci95[0])], [max(0.0, one.margin_ci95[1] - one.margin)]]
        rise = [[max(0.0, at - max(floor, low))], [max(0.0, high - at)]]
        axes.errorbar(
            [one.margin], [at], yerr=rise, xerr=reach, fmt=marker, ms=6.5, color=colour, capsize=2.5, lw=1.3, zorder=4,
            label=one.label, mfc="white" if value < floor else colour, clip_on=False,
        )  # fmt: skip
    axes.margins(x=0.14)  # the last name stands beside its point
    axes.set_yscale("log")
    axes.set_ylim(floor, 1.0)
    axes.set_title(f"R({SCALES[place]:g})", loc="left", fontsize=10)
    axes.set_xlabel("margin (m)", fontsize=9)
    axes.grid(alpha=0.3)
