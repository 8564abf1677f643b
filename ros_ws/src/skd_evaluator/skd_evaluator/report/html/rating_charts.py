"""The charts of margin against risk, as Vega-Lite specifications: one for each scale, over like φ and behaviour."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import Any

from skd_evaluator import palette
from skd_evaluator.measure.risks import SCALES
from skd_evaluator.report.html.charts import Spec, axis, spec
from skd_evaluator.report.html.subjects import Subject
from skd_evaluator.report.risk.rating import RatedCar, basic_cars, floor_of, labelled, rated_car


def rating_charts(subjects: Sequence[Subject]) -> list[tuple[str, list[Spec]]]:
    """Return for each set of cars that can be compared a heading, empty for one set, and a chart for each scale."""
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
            [_chart([car for _, car in members], place) for place in range(len(SCALES))],
        )
        for members in shown
    ]


def _chart(cars: Sequence[RatedCar], place: int) -> Spec:
    floor, curve = floor_of(cars, place), basic_cars(cars)
    others = [one for one in cars if one not in curve]
    names = [one.label for one in others]
    x = axis("margin", "margin (m)", scale={"zero": True}, axis={"tickCount": 5})
    y = axis("risk", f"R({SCALES[place]:g})")
    y["scale"] = {"type": "log", "domain": [floor, 1.0], "clamp": True}
    decades = range(round(math.log10(floor)), 1)
    y["axis"] = {"format": "~g", "values": [float(f"1e{power}") for power in decades]}
    layers: list[Spec] = []
    if curve:
        layers += [
            {
                "mark": {"type": "line", "color": palette.BEHIND, "strokeWidth": 1.4},
                "encoding": {"order": {"field": "C"}},
            },
            *_points({"color": palette.BEHIND, "size": 22}, {"color": palette.BEHIND, "opacity": 0.5}, x, y, {}),
            {
                "mark": {"type": "text", "dx": 9, "dy": -7, "fontSize": 10, "color": palette.BEHIND},
                "encoding": {"text": {"field": "label"}},
            },
        ]
        texts = labelled(curve, place, floor)
        rows = [{**_row(one, place, floor), "label": text} for one, text in zip(curve, texts, strict=True)]
        for layer in layers:
            layer["data"] = {"values": rows}
            layer["encoding"] = {"x": x, "y": y, **layer["encoding"]}
    if others:
        few = len(others) <= len(palette.SERIES)
        colours = list(palette.SERIES[: len(names)]) if few else [palette.BLUE] * len(names)
        shapes = list(palette.SHAPES[: len(names)]) if few else ["circle"] * len(names)
        legend = {"title": None, "labelLimit": 260} if few else None
        named: Spec = {"field": "car", "type": "nominal", "sort": names, "legend": legend}
        colour = {**named, "scale": {"domain": names, "range": colours}}
        shape = {"shape": {**named, "scale": {"domain": names, "range": shapes}}}
        found = _points({"size": 75}, {"strokeWidth": 2}, x, y, {"color": colour}, shape)
        layers += [{"data": {"values": [_row(one, place, floor) for one in others]}, **layer} for layer in found]
    return spec(280, f"Margin against R({SCALES[place]:g}), with 95 % intervals", layer=layers)


def _points(dot: Spec, bar: Spec, x: Spec, y: Spec, colour: Spec, shape: Spec | None = None) -> list[Spec]:
    """Return the layers of points with both intervals."""
    tooltip = [
        {"field": "car"},
        {"field": "margin", "title": "margin (m)", "format": ".3f"},
        {"field": "value", "title": "risk", "format": ".2~g"},
        {"field": "interval", "title": "95 %"},
    ]
    return [
        {
            "mark": {"type": "rule", **bar},
            "encoding": {"x": {**x, "field": "low"}, "x2": {"field": "high"}, "y": y, **colour},
        },
        {
            "mark": {"type": "rule", **bar},
            "encoding": {"x": x, "y": {**y, "field": "risk_low"}, "y2": {"field": "risk_high"}, **colour},
        },
        {
            "mark": {"type": "point", "filled": True, "opacity": 1, **dot},
            "encoding": {"x": x, "y": y, **colour, **(shape or {}), "tooltip": tooltip},
        },
    ]


def _row(one: RatedCar, place: int, floor: float) -> dict[str, Any]:
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
