"""The charts of the page, as Vega-Lite specifications."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from skd_evaluator import palette
from skd_evaluator.campaign.judge.figure_table import CI95, SHARE, shown_in
from skd_evaluator.report.html.matrix import encounters_of
from skd_evaluator.report.html.subjects import Subject
from skd_evaluator.report.vulnerability import interval_band

_SCHEMA = "https://vega.github.io/schema/vega-lite/v6.json"  # a name; nobody asks for it
_AIR = 1.15
"""How much further than the last hit the curve goes."""
_BANDS = 4
"""Most curves whose intervals are shaded: more would lie on one another."""
_RATE = "hit along φ (%)"
"""Of what was planned, beside the margin: on paper and in the dark."""

Spec = dict[str, Any]


def spec(height: int, description: str, **rest: Any) -> Spec:
    """Return a chart as wide as its place; `height` is in px."""
    fit = {"type": "fit-x", "contains": "padding"}
    return {
        "$schema": _SCHEMA,
        "width": "container",
        "height": height,
        "autosize": fit,
        "description": description,
    } | rest


def axis(field: str, title: str, **more: Any) -> Spec:
    """Return the encoding of a number along an axis that need not begin at 0."""
    scale = more.pop("scale", {})
    return {"field": field, "type": "quantitative", "title": title, "scale": {"zero": False, **scale}, **more}


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
    alone = len(ordered) == 1
    colours = palette.ordered(len(ordered))
    dashes = [list(one) for one in palette.in_turn(len(ordered))]
    names = [one.label for one in ordered]
    planned_curve = _planned(ordered[0]) if alone else None
    end = _end([*(_main(one) for one in ordered), *([planned_curve] if planned_curve else [])])
    steps, bands, rates, budgets = [], [], [], []
    planned = _steps(names[0], planned_curve, end) if planned_curve else []
    for name, one in zip(names, ordered, strict=True):
        steps += _steps(name, _main(one), end)
        if len(ordered) <= _BANDS:
            bands += [
                {"car": name, "eta": round(eta, 5), "low": 100.0 * low, "high": 100.0 * high}
                for eta, low, high in zip(*(part.tolist() for part in interval_band(_main(one))), strict=True)
                if eta <= end
            ]
        rate = one.figures["hit_rate"]
        if rate is not None:
            ends = one.figures["hit_rate_ci95"] or (rate, rate)
            rates.append({"car": name, "eta": 0.0, "rate": 100.0 * rate, **_ends(ends)})
        if alone:
            budgets = [
                {"eta": point["eta"], "rate": 100.0 * point["probability"], **_ends(point["ci95_attempts"])}
                for point in (one.curve or {})["budgets"]
                if point["attempts"]
            ]
    scale = {"domain": names, "range": colours}
    legend = (
        None
        if len(names) == 1
        else {
            "title": "the most vulnerable first",
            "symbolLimit": 0,
            "labelLimit": 260,
            "symbolType": "stroke",
            "symbolSize": 600,
            "symbolStrokeWidth": 2.2,
        }
    )
    colour = {"field": "car", "type": "nominal", "scale": scale, "legend": legend, "sort": names}
    dash = {**colour, "scale": {"domain": names, "range": dashes}}
    x = axis("eta", "η: how far the adversary may stray from φ (m)", scale={"domain": [0.0, end], "nice": False})
    y = axis("rate", "can be hit (% of attempts)", scale={"domain": [0, 100]})
    line = {"type": "line", "interpolate": "step-after", "strokeWidth": 2.2, "clip": True}
    layers: list[Spec] = [
        {
            "data": {"values": bands},
            "mark": {"type": "area", "interpolate": "step-after", "opacity": 0.18, "clip": True},
            "encoding": {"x": x, "y": {**y, "field": "low"}, "y2": {"field": "high"}, "color": colour},
        },
        {
            "data": {"values": steps},
            "mark": line,
            "encoding": {
                "x": x,
                "y": y,
                "color": colour,
                "strokeDash": dash,
                "tooltip": [
                    {"field": "car"},
                    {"field": "eta", "title": "η (m)", "format": ".2f"},
                    {"field": "rate", "title": "hit (%)", "format": ".1f"},
                ],
            },
        },
        {
            "data": {"values": rates},
            "mark": {"type": "rule", "strokeWidth": 2},
            "encoding": {"x": x, "y": {**y, "field": "low"}, "y2": {"field": "high"}, "color": colour},
        },
        {
            "data": {"values": rates},
            "mark": {"type": "point", "filled": True, "size": 60, "opacity": 1},
            "encoding": {
                "x": x,
                "y": y,
                "color": colour,
                "tooltip": [
                    {"field": "car"},
                    {"field": "rate", "title": _RATE, "format": ".1f"},
                    {"field": "low", "title": "95 % from", "format": ".1f"},
                    {"field": "high", "title": "to", "format": ".1f"},
                ],
            },
        },
    ]
    if planned:
        layers.insert(
            1,
            {
                "data": {"values": planned},
                "mark": {**line, "strokeDash": [8, 2, 2, 2], "strokeWidth": 1.5, "color": palette.BEHIND},
                "encoding": {
                    "x": x,
                    "y": y,
                    "tooltip": [
                        {"field": "eta", "title": "η (m)", "format": ".2f"},
                        {"field": "rate", "title": "planned kamikazes, hit (%)", "format": ".1f"},
                    ],
                },
            },
        )
    if budgets:
        layers += [
            {
                "data": {"values": budgets},
                "mark": {"type": "rule", "color": palette.BEHIND},
                "encoding": {"x": x, "y": {**y, "field": "low"}, "y2": {"field": "high"}},
            },
            {
                "data": {"values": budgets},
                "mark": {
                    "type": "point",
                    "shape": "diamond",
                    "size": 60,
                    "color": palette.BEHIND,
                    "opacity": 1,
                    "strokeWidth": 2,
                },
                "encoding": {"x": x, "y": y},
            },
        ]
    return spec(
        320, "Vulnerability curve: share of attempts in which somebody who strays at most η can be hit", layer=layers
    )


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


def _end(curves: Sequence[Mapping[str, Any]]) -> float:
    """Return how far the chart goes (m): a little beyond the last hit, at most to η_max."""
    last = max((one["steps"]["eta"][-1] for one in curves if one["steps"]["eta"]), default=0.0)
    limit = max(float(one["eta_max"]) for one in curves)
    return float(min(limit, np.ceil(_AIR * last * 10.0) / 10.0)) if last > 0.0 else limit


_ROW, _NAME = 36, 240
"""Height of a car, and most width of its name, px."""


def against_multiplier(subjects: Sequence[Subject]) -> bool:
    """Return whether cars are drawn against C: all have one, and not all the same."""
    found = {one.figures["multiplier"] for one in subjects}
    return len(found) > 1 and None not in found


def comparison_charts(subjects: Sequence[Subject]) -> list[Spec]:
    """Return margin, hits along φ, planned deformation and SKD of several cars: against C where all have one."""
    if len(subjects) < 2:
        return []
    against = against_multiplier(subjects)
    several = len(encounters_of(subjects)) > 1
    series = {one.label: ", ".join(filter(None, (several * one.scenario.name, one.kind))) for one in subjects}
    kinds = list(dict.fromkeys(series.values()))
    labels = [one.label for one in subjects]
    across, up = ("x", "y") if against else ("y", "x")
    found = []
    for figure in shown_in("chart"):
        key, title, scale, values = figure.key, figure.heading, figure.kind.scale, []
        for one in subjects:
            if one.figures.get(key) is None:
                continue
            by_phi = one.figures.get(f"{key}_{CI95}") if figure.by_phi else None
            ends = by_phi or one.figures.get(f"{key}_{figure.independent}") or (one.figures[key],) * 2
            values.append(
                {
                    "car": one.label,
                    "kind": series[one.label],
                    "C": one.figures["multiplier"],
                    "value": scale * one.figures[key],
                    "low": scale * ends[0],
                    "high": scale * ends[1],
                    "of": "by φ"
                    if by_phi
                    else "attempts or pairs taken as independent"
                    if figure.independent
                    else "not known",
                }
            )
        if not values:
            continue
        x: Spec = axis("C", "multiplier C of the basic controller", scale={"padding": 12})
        if not against:
            # Names lie, in two lines: only then all of a name is seen, the end too that tells it from the next.
            names = {"labelExpr": "split(replace(datum.label, ' (', '\\n('), '\\n')", "labelLimit": _NAME}
            x = {"field": "car", "type": "nominal", "title": None, "sort": labels, "axis": names}
        y = axis("value", title, scale={"zero": figure.kind is SHARE})
        if not against:
            y["axis"] = {"tickCount": 6}
        colour = {
            "field": "kind",
            "type": "nominal",
            "title": "encounter" if several else "φ",
            "scale": {"domain": kinds, "range": list(palette.SERIES[: len(kinds)])},
            "legend": None if kinds == [""] else {"title": "φ"},
        }
        shape = {
            "field": "kind",
            "type": "nominal",
            "title": "φ",
            "scale": {"domain": kinds, "range": list(palette.SHAPES[: len(kinds)])},
            "legend": colour["legend"],
        }
        layers: list[Spec] = [
            {
                "mark": {"type": "rule", "strokeWidth": 2},
                "encoding": {up: {**y, "field": "low"}, f"{up}2": {"field": "high"}},
            },
            {
                "mark": {"type": "point", "filled": True, "size": 70, "opacity": 1},
                "encoding": {
                    up: y,
                    "shape": shape,
                    "tooltip": [
                        {"field": "car"},
                        {"field": "value", "title": title, "format": ".3f"},
                        {"field": "low", "title": "95 % from", "format": ".3f"},
                        {"field": "high", "title": "to", "format": ".3f"},
                        {"field": "of", "title": "interval"},
                    ],
                },
            },
        ]
        if against:
            layers.insert(0, {"mark": {"type": "line", "strokeWidth": 1.2, "opacity": 0.6}, "encoding": {"y": y}})
        found.append(
            spec(
                260 if against else 60 + _ROW * len(subjects),
                f"{title}, with 95 % intervals",
                data={"values": values},
                encoding={across: x, "color": colour},
                layer=layers,
            )
        )
    return found


def per_safe_chart() -> Spec:
    """Return the chart of distances per φ; the page puts in its height, and `pairs` and `means` of the chosen car."""
    y = {"field": "name", "type": "nominal", "title": None, "sort": None, "axis": {"labelLimit": 180}}
    kinds = {
        "domain": ["margin", "planned deformation", "Fréchet distance"],
        "range": [palette.MARGIN, palette.VERMILLION, palette.BLUE],
    }
    colour = {"field": "what", "type": "nominal", "scale": kinds, "legend": {"title": None}}
    offset = {"field": "what", "type": "nominal", "scale": {"domain": kinds["domain"]}}
    x = axis("value", "distance from φ (m)", scale={"zero": True})
    return spec(
        0,
        "Distances of each attempt per φ",
        layer=[
            {
                "data": {"name": "pairs", "values": []},
                "mark": {"type": "tick", "thickness": 1.2, "opacity": 0.45},
                "encoding": {"x": x, "y": y, "yOffset": offset, "color": colour},
            },
            {
                "data": {"name": "means", "values": []},
                "mark": {
                    "type": "point", "shape": "diamond", "filled": True, "size": 110, "opacity": 1,
                    "stroke": "white", "strokeWidth": 1,
                },
                "encoding": {
                    "x": x,
                    "y": y,
                    "yOffset": offset,
                    "color": colour,
                    "tooltip": [
                        {"field": "name", "title": "φ"},
                        {"field": "what"},
                        {"field": "value", "title": "mean (m)", "format": ".3f"},
                        {"field": "count", "title": "attempts"},
                    ],
                },
            },
        ],
    )  # fmt: skip
