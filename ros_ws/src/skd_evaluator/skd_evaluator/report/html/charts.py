"""The charts of the page, drawn by altair: as the Vega-Lite that the page's own script gives to Vega."""

from __future__ import annotations

import functools
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import altair as alt
import numpy as np

from skd_evaluator import palette
from skd_evaluator.assessment.figure_table import CI95, SHARE, Figure, shown_in
from skd_evaluator.metrics.risks import SCALES
from skd_evaluator.report.curves import RatedCar, basic_cars, floor_of, interval_band, labelled, rated_car
from skd_evaluator.report.html.figures import scenarios_of
from skd_evaluator.report.html.subjects import Subject

_AIR = 1.15
"""How much further than the last hit the curve goes."""
_BANDS = 4
"""Most curves whose intervals are shaded: more would lie on one another."""
_ROW, _NAME = 36, 240
"""Height of a car, and most width of its name, px."""

VEGA_LITE = "6.4"

Spec = dict[str, Any]


@functools.cache
def chart_library() -> str:
    """Return the script that defines `vegaEmbed`: Vega, Vega-Lite and what embeds them; it needs no network."""
    import vl_convert

    # In a block of its own: its names must not meet those of the page.
    return "{" + str(vl_convert.javascript_bundle("window.vegaEmbed = vegaEmbed;", VEGA_LITE)) + "}"


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


def vulnerability_charts(subjects: Sequence[Subject]) -> list[tuple[str, Spec]]:
    """Return a chart of vulnerability curves for each kind of φ, with a heading; none where no kamikaze ran."""
    found = []
    for kind in dict.fromkeys(one.kind for one in subjects):
        mine = [one for one in subjects if one.kind == kind and one.curve is not None]
        if mine:
            found.append((f"{kind} φ" if kind else "", _vulnerability(mine)))
    return found


def _vulnerability(subjects: Sequence[Subject]) -> Spec:
    ordered = sorted(subjects, key=lambda one: float(_main(one)["area_above"]))
    names, alone = [one.label for one in ordered], len(ordered) == 1
    planned = _planned(ordered[0]) if alone else None
    end = _end([*map(_main, ordered), *([planned] if planned else [])])
    x = alt.X("eta:Q", title="η: how far the adversary may stray from φ (m)")
    x = x.scale(domain=[0.0, end], nice=False)
    y, low = (alt.Y(f"{name}:Q", title="can be hit (% of trials)").scale(domain=[0, 100]) for name in ("rate", "low"))
    legend = None if alone else _legend("the most vulnerable first", symbolType="stroke", symbolSize=600)
    dashes = [list(one) for one in palette.in_turn(len(names))]
    colour = alt.Color("car:N", sort=names, legend=legend).scale(domain=names, range=palette.ordered(len(names)))
    dash = alt.StrokeDash("car:N", sort=names, legend=legend).scale(domain=names, range=dashes)
    steps = [row for one in ordered for row in _steps(one.label, _main(one), end)]
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
    described = "Vulnerability curve: share of trials in which somebody who strays at most η can be hit"
    return _drawn(layers, 320, described)


_ENDS: dict[str, tuple[str, str] | str] = {"low": ("95 % from", ".1f"), "high": ("to", ".1f")}


def _legend(title: str | None, **more: Any) -> alt.Legend:
    return alt.Legend(title=title, symbolLimit=0, labelLimit=260, **more)


def _main(one: Subject) -> Mapping[str, Any]:
    """Return the curve of the margins, or of planned kamikazes where margins are not known."""
    curves = one.curve or {}
    found: Mapping[str, Any] = curves.get("margins") or curves["kamikazes"]
    return found


def _planned(one: Subject) -> Mapping[str, Any] | None:
    """Return the curve of planned kamikazes, where it is not the main one."""
    curves = one.curve or {}
    found: Mapping[str, Any] | None = curves["kamikazes"] if curves.get("margins") else None
    return found


def _ends(pair: Sequence[float]) -> dict[str, float]:
    return {"low": 100.0 * pair[0], "high": 100.0 * pair[1]}


def _steps(name: str, curve: Mapping[str, Any], end: float) -> list[dict[str, Any]]:
    etas, values = curve["steps"]["eta"], curve["steps"]["probability"]
    kept = [(eta, value) for eta, value in zip(etas, values, strict=True) if eta < end]
    last = kept[-1][1] if kept else 0.0
    points = [*([] if kept and kept[0][0] == 0.0 else [(0.0, 0.0)]), *kept, (end, last)]
    return [{"car": name, "eta": round(eta, 4), "rate": round(100.0 * value, 3)} for eta, value in points]


def _band(one: Subject, end: float) -> list[dict[str, Any]]:
    columns = (part.tolist() for part in interval_band(_main(one)))
    rows = zip(*columns, strict=True)
    return [{"car": one.label, "eta": round(eta, 5), **_ends((low, high))} for eta, low, high in rows if eta <= end]


def _rates(one: Subject) -> list[dict[str, Any]]:
    rate = one.figures["nominal_collision_rate"]
    if rate is None:
        return []
    return [
        {
            "car": one.label,
            "eta": 0.0,
            "rate": 100.0 * rate,
            **_ends(one.figures["nominal_collision_rate_ci95"] or (rate, rate)),
        }
    ]


def _budgets(one: Subject) -> list[dict[str, Any]]:
    points = [point for point in (one.curve or {})["budgets"] if point["trials"]]
    return [
        {"eta": point["eta"], "rate": 100.0 * point["probability"], **_ends(point["ci95_trials"])} for point in points
    ]


def _end(curves: Sequence[Mapping[str, Any]]) -> float:
    """Return how far the chart goes (m): a little beyond the last hit, at most to η_max."""
    last = max((one["steps"]["eta"][-1] for one in curves if one["steps"]["eta"]), default=0.0)
    limit = max(float(one["eta_max"]) for one in curves)
    return float(min(limit, np.ceil(_AIR * last * 10.0) / 10.0)) if last > 0.0 else limit


# --- several cars side by side


def against_multiplier(subjects: Sequence[Subject]) -> bool:
    """Return whether cars are drawn against C: all have one, and not all the same."""
    found = {one.figures["multiplier"] for one in subjects}
    return len(found) > 1 and None not in found


def comparison_charts(subjects: Sequence[Subject]) -> list[Spec]:
    """Return margin, nominal collision rate, planned deviation and SKD of several cars, against C where all have it."""
    if len(subjects) < 2:
        return []
    return [
        _comparison(subjects, figure, rows) for figure in shown_in("chart") if (rows := _compared(subjects, figure))
    ]


def _compared(subjects: Sequence[Subject], figure: Figure) -> list[dict[str, Any]]:
    """Return a figure of each car that has one, with its interval."""
    several = len(scenarios_of(subjects)) > 1
    key, scale, rows = figure.key, figure.kind.scale, []
    for one in subjects:
        value = one.figures.get(key)
        if value is None:
            continue
        by_phi = one.figures.get(f"{key}_{CI95}") if figure.by_phi else None
        low, high = by_phi or one.figures.get(f"{key}_{figure.independent}") or (value, value)
        independent = "trials or pairs taken as independent" if figure.independent else "not known"
        rows.append(
            {
                "car": one.label,
                "kind": ", ".join(filter(None, (several * one.scenario.name, one.kind))),
                "C": one.figures["multiplier"],
                "value": scale * value,
                "low": scale * low,
                "high": scale * high,
                "of": "by φ" if by_phi else independent,
            }
        )
    return rows


def _comparison(subjects: Sequence[Subject], figure: Figure, rows: Sequence[Mapping[str, Any]]) -> Spec:
    title, against = figure.heading, against_multiplier(subjects)
    kinds = list(dict.fromkeys(str(one["kind"]) for one in rows))
    legend = None if kinds == [""] else _legend("scenario" if len(scenarios_of(subjects)) > 1 else "φ")
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
        labels = [one.label for one in subjects]
        base = _of(rows).encode(y=alt.Y("car:N", title=None, sort=labels, axis=names), color=colour)
        layers = [
            base.mark_rule(strokeWidth=2).encode(x=left, x2="high:Q"),
            base.mark_point(filled=True, size=70, opacity=1).encode(x=right, shape=shape, tooltip=said),
        ]
    return _drawn(layers, 260 if against else 60 + _ROW * len(subjects), f"{title}, with 95 % intervals")


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
