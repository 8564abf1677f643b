"""Charts, drawn by altair: for the page as the Vega-Lite that its script gives to Vega, else as PNG files.

Vulnerability curves, cars side by side, the distances of each φ, and margin against risk.
"""

from __future__ import annotations

import functools
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import altair as alt
import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.options.car_under_test import CarUnderTest

from skd_evaluator import palette
from skd_evaluator.assessment.figure_table import AT_THE_TOP, CI95, SHARE, Figure, shown_in
from skd_evaluator.metrics.risks import SCALES
from skd_evaluator.metrics.statistics import Interval
from skd_evaluator.report.html.subjects import Subject, scenarios_of
from skd_evaluator.report.terminal import car_name

_AIR = 1.15
"""How much further than the last hit the curve goes."""
_BANDS = 4
"""Most curves whose intervals are shaded: more would lie on one another."""
_ROW, _NAME = 36, 240
"""Height of a car, and most width of its name, px."""
_WIDE, _NARROW, _HIGH = 560, 300, 240
"""Width of a single chart in a file, and size of one of several, px."""
LEAST: Final = 1e-9
"""Below it no risk is drawn: subset simulation ends there."""
_APART: Final = 0.12  # of width and height between two names

VEGA_LITE = "6.4"

Spec = dict[str, Any]


@functools.cache
def chart_library() -> str:
    """Return the script that defines `vegaEmbed`: Vega, Vega-Lite and what embeds them; it needs no network."""
    import vl_convert

    # In a block of its own: its names must not meet those of the page.
    return "{" + str(vl_convert.javascript_bundle("window.vegaEmbed = vegaEmbed;", VEGA_LITE)) + "}"


def save_charts(path: Path, charts: Sequence[Spec], title: str) -> None:
    """Save charts as one PNG file, two side by side, below a title of one or more lines."""
    import vl_convert

    width = _WIDE if len(charts) == 1 else _NARROW
    shown = [{key: value for key, value in one.items() if key != "autosize"} | {"width": width} for one in charts]
    for one in shown:
        one["height"] = max(one["height"] if len(charts) == 1 else 0, _HIGH)
    heading = {"text": title.splitlines(), "anchor": "start", "fontWeight": "normal", "fontSize": 13}
    legend = {"orient": "bottom", "columns": 2, "labelLimit": 400, "symbolLimit": 0}
    spec = {"$schema": f"https://vega.github.io/schema/vega-lite/v{VEGA_LITE}.json", "title": heading, "columns": 2}
    spec |= {"concat": shown, "background": "white", "config": {"legend": legend}}
    path.write_bytes(vl_convert.vegalite_to_png(spec, vl_version=VEGA_LITE, scale=2.0))


def _drawn(layers: Sequence[alt.Chart], height: int, description: str) -> Spec:
    """Return a chart as wide as its place, `height` px high; the page's script has its theme."""
    fit = alt.AutoSizeParams(type="fit-x", contains="padding")
    alt.data_transformers.consolidate_datasets = False  # rows stand where they are drawn
    chart = alt.LayerChart(layer=list(layers))
    found: Spec = chart.properties(width="container", height=height, autosize=fit, description=description).to_dict()
    del found["config"]
    return found


def _of(rows: Iterable[Mapping[str, Any]]) -> alt.Chart:
    return alt.Chart(alt.InlineData(values=[dict(one) for one in rows]))


def _tooltip(**titles: tuple[str, str] | str) -> list[alt.Tooltip]:
    """Return lines of a tooltip: field=title, or field=(title, format)."""
    lines = ((name, (one, "") if isinstance(one, str) else one) for name, one in titles.items())
    return [alt.Tooltip(f"{name}:{'Q' if form else 'N'}", title=title, format=form) for name, (title, form) in lines]


# --- vulnerability curves


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


def vulnerability_charts(subjects: Sequence[Subject]) -> list[tuple[str, Spec]]:
    """Return a chart of vulnerability curves for each kind of φ, with a heading; none where no kamikaze ran."""
    found = []
    for kind in dict.fromkeys(one.kind for one in subjects):
        mine = [
            shown_curve(one.figures, one.curve, one.label)
            for one in subjects
            if one.kind == kind and one.curve is not None
        ]
        if mine:
            found.append((f"{kind} φ" if kind else "", vulnerability_chart(mine)))
    return found


def save_vulnerability(path: Path, shown: Sequence[ShownCurve]) -> None:
    """Save one picture of the curves of one or more cars, the most vulnerable first."""
    title = "How far one has to deviate from a safe trajectory to be hit; shaded: 95 % interval by φ"
    if len(shown) == 1:
        title = f"{shown[0].label}. {title}\nDot: nominal collision rate; grey: planned kamikazes"
    save_charts(path, [vulnerability_chart(shown)], title)


def vulnerability_chart(shown: Sequence[ShownCurve]) -> Spec:
    """Return the chart of the curves of one or more cars; of a single one also planned kamikazes and budgets."""
    ordered = sorted(shown, key=lambda one: float(one.curve["area_above"]))
    names, alone = [one.label for one in ordered], len(ordered) == 1
    planned = ordered[0].planned if alone else None
    end = _end([*(one.curve for one in ordered), *([planned] if planned else [])])
    x = alt.X("eta:Q", title="η: how far the adversary may deviate from φ (m)")
    x = x.scale(domain=[0.0, end], nice=False)
    y, low = (alt.Y(f"{name}:Q", title="can be hit (% of trials)").scale(domain=[0, 100]) for name in ("rate", "low"))
    more: Spec = {"symbolType": "stroke", "symbolSize": 600, "symbolOpacity": 1}
    legend = None if alone else _legend("the most vulnerable first", **more)
    dashes = [list(one) for one in palette.in_turn(len(names))]
    colour = alt.Color("car:N", sort=names, legend=legend).scale(domain=names, range=palette.ordered(len(names)))
    dash = alt.StrokeDash("car:N", sort=names, legend=legend).scale(domain=names, range=dashes)
    steps = [row for one in ordered for row in _steps(one.label, one.curve, end)]
    bands = [row for one in ordered for row in _band(one, end)] if len(ordered) <= _BANDS else []
    rates = [row for one in ordered for row in _rates(one)]
    line: Spec = {"interpolate": "step-after", "strokeWidth": 2.2, "clip": True}
    hit = _tooltip(car="car", eta=("η (m)", ".2f"), rate=("hit (%)", ".1f"))
    layers = [
        _of(bands)
        .mark_area(interpolate="step-after", opacity=0.18, clip=True)
        .encode(x=x, y=low, y2="high:Q", color=colour),
        _of(steps).mark_line(**line).encode(x=x, y=y, color=colour, strokeDash=dash, tooltip=hit),
        _of(rates).mark_rule(strokeWidth=2).encode(x=x, y=low, y2="high:Q", color=colour),
        _of(rates)
        .mark_point(filled=True, size=60, opacity=1)
        .encode(
            x=x, y=y, color=colour, tooltip=_tooltip(car="car", rate=("nominal collision rate (%)", ".1f"), **_ENDS)
        ),
    ]
    if planned:
        behind: Spec = {**line, "strokeDash": [8, 2, 2, 2], "strokeWidth": 1.5, "color": palette.BEHIND}
        said = _tooltip(eta=("η (m)", ".2f"), rate=("planned kamikazes, hit (%)", ".1f"))
        layers.insert(1, _of(_steps(names[0], planned, end)).mark_line(**behind).encode(x=x, y=y, tooltip=said))
    if alone and (budgets := _budgets(ordered[0])):
        diamond: Spec = {"shape": "diamond", "size": 60, "opacity": 1, "strokeWidth": 2}
        layers += [
            _of(budgets).mark_rule(color=palette.BEHIND).encode(x=x, y=low, y2="high:Q"),
            _of(budgets).mark_point(color=palette.BEHIND, **diamond).encode(x=x, y=y),
        ]
    described = "Vulnerability curve: share of trials in which a deviation of at most η suffices"
    return _drawn(layers, 320, described)


_ENDS: dict[str, tuple[str, str] | str] = {"low": ("95 % from", ".1f"), "high": ("to", ".1f")}


def _legend(title: str | None, **more: Any) -> alt.Legend:
    return alt.Legend(title=title, symbolLimit=0, labelLimit=260, **more)


def _ends(pair: Sequence[float]) -> dict[str, float]:
    return {"low": 100.0 * pair[0], "high": 100.0 * pair[1]}


def _steps(name: str, curve: Mapping[str, Any], end: float) -> list[dict[str, Any]]:
    etas, values = curve["steps"]["eta"], curve["steps"]["probability"]
    kept = [(eta, value) for eta, value in zip(etas, values, strict=True) if eta < end]
    last = kept[-1][1] if kept else 0.0
    points = [*([] if kept and kept[0][0] == 0.0 else [(0.0, 0.0)]), *kept, (end, last)]
    return [{"car": name, "eta": round(eta, 4), "rate": round(100.0 * value, 3)} for eta, value in points]


def _band(one: ShownCurve, end: float) -> list[dict[str, Any]]:
    columns = (part.tolist() for part in interval_band(one.curve))
    rows = zip(*columns, strict=True)
    return [{"car": one.label, "eta": round(eta, 5), **_ends((low, high))} for eta, low, high in rows if eta <= end]


def _rates(one: ShownCurve) -> list[dict[str, Any]]:
    if (rate := one.nominal_collision_rate) is None:
        return []
    ends = _ends(one.nominal_collision_rate_ci95 or (rate, rate))
    return [{"car": one.label, "eta": 0.0, "rate": 100.0 * rate, **ends}]


def _budgets(one: ShownCurve) -> list[dict[str, Any]]:
    return [
        {"eta": point["eta"], "rate": 100.0 * point["probability"], **_ends(point["ci95_trials"])}
        for point in one.budgets
    ]


def _end(curves: Sequence[Mapping[str, Any]]) -> float:
    """Return how far the chart goes (m): a little beyond the last hit, at most to η_max."""
    last = max((one["steps"]["eta"][-1] for one in curves if one["steps"]["eta"]), default=0.0)
    limit = max(float(one["eta_max"]) for one in curves)
    return float(min(limit, np.ceil(_AIR * last * 10.0) / 10.0)) if last > 0.0 else limit


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


# --- several cars side by side


@dataclass(frozen=True)
class ChartedCar:
    """A car among several: its name, what joins it with others (a scenario, a kind of φ), and its figures."""

    label: str
    kind: str
    figures: Mapping[str, Any]


def against_multiplier(subjects: Sequence[Subject]) -> bool:
    """Return whether cars are drawn against C: all have one, and not all the same."""
    return _differ([one.figures["multiplier"] for one in subjects])


def _differ(multipliers: Iterable[float | None]) -> bool:
    found = set(multipliers)
    return len(found) > 1 and None not in found


def comparison_charts(subjects: Sequence[Subject]) -> list[Spec]:
    """Return margin, nominal collision rate, planned deviation and SKD of several cars, against C where all have it."""
    if len(subjects) < 2:
        return []
    several = len(scenarios_of(subjects)) > 1
    cars = [
        ChartedCar(one.label, ", ".join(filter(None, (several * one.scenario.name, one.kind))), one.figures)
        for one in subjects
    ]
    against, legend = against_multiplier(subjects), "scenario" if several else "φ"
    charts = (_comparison(cars, figure, legend, against=against) for figure in shown_in("chart"))
    return [one for one in charts if one is not None]


def save_sweep(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Save margin, planned deviation, SKD and contact rate against C; the paper's figure has the last two."""
    cars = [ChartedCar(f"C = {row['multiplier']:g}", f"{row['kind']} φ", row) for row in rows]
    figures = [AT_THE_TOP[key] for key in ("margin", "deviation", "skd", "contact_rate")]
    charts = (_comparison(cars, figure, "", against=True) for figure in figures)
    title = "The basic car against its multiplier C, with 95 % intervals: by φ where known, else as independent"
    save_charts(path, [one for one in charts if one is not None], title)


def _compared(cars: Sequence[ChartedCar], figure: Figure) -> list[dict[str, Any]]:
    """Return a figure of each car that has one, with its interval."""
    key, scale, rows = figure.key, figure.kind.scale, []
    for one in cars:
        value = one.figures.get(key)
        if value is None:
            continue
        by_phi = one.figures.get(f"{key}_{CI95}") if figure.by_phi else None
        low, high = by_phi or one.figures.get(f"{key}_{figure.independent}") or (value, value)
        independent = "trials or pairs taken as independent" if figure.independent else "not known"
        row = {"car": one.label, "kind": one.kind, "C": one.figures["multiplier"], "value": scale * value}
        rows.append({**row, "low": scale * low, "high": scale * high, "of": "by φ" if by_phi else independent})
    return rows


def _comparison(cars: Sequence[ChartedCar], figure: Figure, named: str, *, against: bool) -> Spec | None:
    if not (rows := _compared(cars, figure)):
        return None
    title = figure.heading
    kinds = list(dict.fromkeys(str(one["kind"]) for one in rows))
    legend = None if kinds == [""] else _legend(named or None)
    colour = alt.Color("kind:N", legend=legend).scale(domain=kinds, range=list(palette.SERIES[: len(kinds)]))
    shape = alt.Shape("kind:N", legend=legend).scale(domain=kinds, range=list(palette.SHAPES[: len(kinds)]))
    zero, ends = figure.kind is SHARE, ("value", "low")
    said = _tooltip(car="car", value=(title, ".3f"), low=("95 % from", ".3f"), high=("to", ".3f"), of="interval")
    if against:
        value, low = (alt.Y(f"{name}:Q", title=title).scale(zero=zero) for name in ends)
        base = _of(rows).encode(
            x=alt.X("C:Q", title="multiplier C of the basic controller").scale(zero=False, padding=12), color=colour
        )
        layers = [
            base.mark_line(strokeWidth=1.2, opacity=0.6).encode(y=value),
            base.mark_rule(strokeWidth=2).encode(y=low, y2="high:Q"),
            base.mark_point(filled=True, size=70, opacity=1).encode(y=value, shape=shape, tooltip=said),
        ]
    else:
        right, left = (alt.X(f"{name}:Q", title=title).scale(zero=zero).axis(tickCount=6) for name in ends)
        # Names lie, in two lines: only then all of a name is seen, the end too that tells it from the next.
        names = alt.Axis(labelExpr="split(replace(datum.label, ' (', '\\n('), '\\n')", labelLimit=_NAME)
        labels = [one.label for one in cars]
        base = _of(rows).encode(y=alt.Y("car:N", title=None, sort=labels, axis=names), color=colour)
        layers = [
            base.mark_rule(strokeWidth=2).encode(x=left, x2="high:Q"),
            base.mark_point(filled=True, size=70, opacity=1).encode(x=right, shape=shape, tooltip=said),
        ]
    return _drawn(layers, 260 if against else 60 + _ROW * len(cars), f"{title}, with 95 % intervals")


def per_safe_chart() -> Spec:
    """Return the chart of distances per φ; the page puts in its height, and `pairs` and `means` of the chosen car."""
    what = ["margin", "planned deviation", "Fréchet distance"]
    colours = alt.Color("what:N", legend=alt.Legend(title=None))
    colours = colours.scale(domain=what, range=[palette.MARGIN, palette.VERMILLION, palette.BLUE])
    placed: Spec = {
        "x": alt.X("value:Q", title="distance from φ (m)").scale(zero=True),
        "y": alt.Y("name:N", title=None, sort=None).axis(labelLimit=180),
        "yOffset": alt.YOffset("what:N").scale(domain=what),
        "color": colours,
    }
    pairs, means = (alt.Chart(alt.InlineData(values=[], name=name)) for name in ("pairs", "means"))
    diamond: Spec = {"shape": "diamond", "filled": True, "size": 110, "opacity": 1, "stroke": "white", "strokeWidth": 1}
    said = _tooltip(name="φ", what="what", value=("mean (m)", ".3f"), count=("trials", "d"))
    layers = [
        pairs.mark_tick(thickness=1.2, opacity=0.45).encode(**placed),
        means.mark_point(**diamond).encode(**placed, tooltip=said),
    ]
    return _drawn(layers, 0, "Distances of each trial per φ")


# --- margin against risk


@dataclass(frozen=True)
class RatedCar:
    """A car in the picture.

    Attributes:
        label: name of the car.
        multiplier: C of a basic car; None: it is another.
        margin: margin of the car, m.
        margin_ci95: 95 % interval of it, by φ.
        risks: at each of `SCALES`, the risk and its 95 % interval by φ, else that for these φ.
    """

    label: str
    multiplier: float | None
    margin: float
    margin_ci95: Interval
    risks: tuple[tuple[float, Interval], ...]


def rated_car(figures: Mapping[str, Any], label: str) -> RatedCar | None:
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
    return RatedCar(label, multiplier, float(margin), (float(low), float(high)), tuple(risks))


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


def rating_charts(subjects: Sequence[Subject]) -> list[tuple[str, list[Spec]]]:
    """Return for each set of cars that can be compared a heading, empty for one set, and a chart for each scale.

    Cars can be compared that are rated on the same φ, with one behaviour model.
    """
    groups: dict[tuple[object, ...], list[tuple[Subject, RatedCar]]] = {}
    for one in subjects:
        car = rated_car(one.figures, one.label)
        if car is not None:
            model = json.dumps(one.figures["risk"]["behaviour"], sort_keys=True)
            groups.setdefault((one.safe_key, one.figures["eta_max"], model), []).append((one, car))
    shown = [members for members in groups.values() if len(members) > 1]
    return [
        (
            f"{members[0][0].kind or members[0][0].figures['safe']} φ" if len(shown) > 1 else "",
            [_rating([car for _, car in members], place) for place in range(len(SCALES))],
        )
        for members in shown
    ]


def save_rating(path: Path, cars: Sequence[RatedCar]) -> None:
    """Save margin against the risk at each scale, basic cars as a curve where there are several."""
    charts = [_rating(cars, place) for place in range(len(SCALES))]
    save_charts(path, charts, "Margin against risk; bars: 95 % intervals by φ. Safer cars lie to the right and below")


def _rating(cars: Sequence[RatedCar], place: int) -> Spec:
    floor, curve = floor_of(cars, place), basic_cars(cars)
    others = [one for one in cars if one not in curve]
    decades = [float(f"1e{power}") for power in range(round(math.log10(floor)), 1)]
    x, left = (alt.X(f"{name}:Q", title="margin (m)").scale(zero=True).axis(tickCount=5) for name in ("margin", "low"))
    y, below = (
        alt.Y(f"{name}:Q", title=f"R({SCALES[place]:g})")
        .scale(type="log", domain=[floor, 1.0], clamp=True)
        .axis(format="~g", values=decades)
        for name in ("risk", "risk_low")
    )
    said = _tooltip(car="car", margin=("margin (m)", ".3f"), value=("risk", ".2~g"), interval="95 %")

    def points(base: alt.Chart, dot: Spec, bar: Spec, **encoding: Any) -> list[alt.Chart]:
        return [
            base.mark_rule(**bar).encode(x=left, x2="high:Q", y=y),
            base.mark_rule(**bar).encode(x=x, y=below, y2="risk_high:Q"),
            base.mark_point(filled=True, opacity=1, **dot).encode(x=x, y=y, tooltip=said, **encoding),
        ]

    layers: list[alt.Chart] = []
    if curve:
        texts = labelled(curve, place, floor)
        base = _of({**_rated(one, place, floor), "label": text} for one, text in zip(curve, texts, strict=True))
        grey: Spec = {"color": palette.BEHIND}
        layers += [
            base.mark_line(strokeWidth=1.4, **grey).encode(x=x, y=y, order="C:Q"),
            *points(base, {"size": 22, **grey}, {"opacity": 0.5, **grey}),
            base.mark_text(dx=9, dy=-7, fontSize=10, **grey).encode(x=x, y=y, text="label:N"),
        ]
    if others:
        names, few = [one.label for one in others], len(others) <= len(palette.SERIES)
        legend = _legend(None) if few else None
        colours = list(palette.SERIES[: len(names)]) if few else [palette.BLUE] * len(names)
        shapes = list(palette.SHAPES[: len(names)]) if few else ["circle"] * len(names)
        colour = alt.Color("car:N", sort=names, legend=legend).scale(domain=names, range=colours)
        shape = alt.Shape("car:N", sort=names, legend=legend).scale(domain=names, range=shapes)
        base = _of(_rated(one, place, floor) for one in others).encode(color=colour)
        layers += points(base, {"size": 75}, {"strokeWidth": 2}, shape=shape)
    return _drawn(layers, 280, f"Margin against R({SCALES[place]:g}), with 95 % intervals")


def _rated(one: RatedCar, place: int, floor: float) -> dict[str, Any]:
    value, (low, high) = one.risks[place]
    return {
        "car": one.label,
        "C": one.multiplier,
        "margin": one.margin,
        "low": one.margin_ci95[0],
        "high": one.margin_ci95[1],
        "value": value,
        "risk": max(floor, value),
        "risk_low": max(floor, low),
        "risk_high": max(floor, high),
        "interval": f"{low:.2g} to {high:.2g}",
    }
