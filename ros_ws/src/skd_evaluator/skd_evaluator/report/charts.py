"""Charts, drawn by altair: for the page as the Vega-Lite that its script gives to Vega, else as PNG files.

Vulnerability curves, several cars beside each other, margin against risk and against price. A car has one colour.
"""

from __future__ import annotations

import functools
import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import altair as alt
import numpy as np
from skd_sim.options.car_and_adversary import CarUnderTest
from skd_sim.world.state import FloatArray

from skd_evaluator import palette
from skd_evaluator.assessment.compare.comparison import MARGIN
from skd_evaluator.assessment.figure_table import AT_THE_TOP, CI95, SHARE, Figure, shown_in
from skd_evaluator.assessment.files.results import StoredResult
from skd_evaluator.metrics.aborted import not_credible
from skd_evaluator.metrics.margins import UPPER_BOUNDS
from skd_evaluator.metrics.price_of_caution import stored_price
from skd_evaluator.metrics.risks import SCALES
from skd_evaluator.report.formats import NOTHING
from skd_evaluator.report.html.subjects import Subject, scenarios_of

_AIR = 1.15
"""How much further than the last hit the curve goes."""
_BANDS = 4
"""Most curves whose intervals are shaded: more would lie on one another."""
_NAMED = 12
"""Most cars in a legend."""
_ROW, _NAME = 36, 240
"""Height of a car, and most width of its name, px."""
_WIDE, _NARROW, _HIGH = 560, 300, 240
"""Width of a single chart in a file, and size of one of several, px."""
LEAST: Final = 1e-9
"""Below it no risk is drawn: subset simulation ends there."""
VEGA_LITE = "6.4"

Spec = dict[str, Any]


@dataclass(frozen=True)
class ChartedCar:
    """A car in a chart.

    Attributes:
        label: its name, which no other car in the chart has.
        figures: content of its assessment.json.
        kind: what joins it with others (a scenario, a kind of φ).
        curves: its vulnerability curves, as `Vulnerability.as_dict` gives them; None where there are none.
        colour: its own in every chart.
    """

    label: str
    figures: Mapping[str, Any]
    kind: str = ""
    curves: Mapping[str, Any] | None = None
    colour: str = palette.BLUE

    @property
    def curve(self) -> Mapping[str, Any]:
        """The curve of the margins, or of planned kamikazes if no margins are known."""
        assert self.curves is not None
        found: Mapping[str, Any] = self.curves["margins"] or self.curves["kamikazes"]
        return found


def charted(subjects: Sequence[Subject]) -> list[ChartedCar]:
    """Return the cars of a page, each with its colour."""
    return coloured([ChartedCar(one.label, one.figures, one.kind, one.curve) for one in subjects])


def coloured(cars: Sequence[ChartedCar]) -> list[ChartedCar]:
    """Return cars that stand beside each other, each with a colour of its own."""
    return [replace(one, colour=colour) for one, colour in zip(cars, palette.of_cars(len(cars)), strict=True)]


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
    axis = {"titleFontWeight": "normal", "labelFlush": False}
    spec = {"$schema": f"https://vega.github.io/schema/vega-lite/v{VEGA_LITE}.json", "title": heading, "columns": 2}
    spec |= {"concat": shown, "background": "white", "config": {"legend": legend, "axis": axis}}
    path.write_bytes(vl_convert.vegalite_to_png(spec, vl_version=VEGA_LITE, scale=2.0))


def _drawn(layers: Sequence[alt.Chart], height: int, description: str) -> Spec:
    """Return a chart as wide as its place, `height` px high; the page's script has its theme."""
    fit = alt.AutoSizeParams(type="fit-x", contains="padding")
    alt.data_transformers.consolidate_datasets = False  # rows stand where they are drawn
    chart = alt.LayerChart(layer=[one for one in layers if one.data.values])  # of none Vega warns
    found: Spec = chart.properties(width="container", height=height, autosize=fit, description=description).to_dict()
    del found["config"]
    return found


def _of(rows: Iterable[Mapping[str, Any]]) -> alt.Chart:
    return alt.Chart(alt.InlineData(values=[dict(one) for one in rows]))


def _tooltip(**titles: tuple[str, str] | str) -> list[alt.Tooltip]:
    """Return lines of a tooltip: field=title, or field=(title, format)."""
    lines = ((name, (one, "") if isinstance(one, str) else one) for name, one in titles.items())
    return [alt.Tooltip(f"{name}:{'Q' if form else 'N'}", title=title, format=form) for name, (title, form) in lines]


def _hollow(figures: Mapping[str, Any], key: str = MARGIN) -> str:
    """Return why the point of a figure is hollow: its car is not credible, or it is an upper bound; else `NOTHING`."""
    if not_credible(figures.get("warnings") or ()):
        return "not credible"
    return "margin at most" if key in UPPER_BOUNDS and figures.get("margin_converged") is False else NOTHING


def _points(rows: Sequence[Mapping[str, Any]], **shown: Any) -> list[alt.Chart]:
    """Return the points of rows, hollow where these have a note."""
    solid, hollow = (_of(row for row in rows if (row["note"] == NOTHING) is plain) for plain in (True, False))
    dot: Spec = {"size": 75, "opacity": 1}
    points = solid.mark_point(filled=True, **dot), hollow.mark_point(filled=False, strokeWidth=2, **dot)
    return [one.encode(**shown) for one in points]


def _by_car(channel: type[Any], cars: Sequence[ChartedCar], values: Sequence[Any], **legend: Any) -> Any:
    """Return an encoding that tells cars apart, with a legend where there are some, but not too many."""
    names = [one.label for one in cars]
    shown = alt.Legend(title=None, symbolLimit=0, labelLimit=260, **legend) if 1 < len(cars) <= _NAMED else None
    return channel("car:N", sort=names, legend=shown).scale(domain=names, range=list(values))


def _colour(cars: Sequence[ChartedCar], **legend: Any) -> alt.Color:
    return _by_car(alt.Color, cars, [one.colour for one in cars], **legend)  # type: ignore[no-any-return]


def _shape(cars: Sequence[ChartedCar]) -> alt.Shape:
    shapes = [palette.SHAPES[place % len(palette.SHAPES)] for place in range(len(cars))]
    return _by_car(alt.Shape, cars, shapes)  # type: ignore[no-any-return]


# --- vulnerability curves


def vulnerability_charts(cars: Sequence[ChartedCar]) -> list[tuple[str, Spec]]:
    """Return a chart of vulnerability curves for each kind of φ, with a heading; none where no kamikaze ran."""
    found = []
    for kind in dict.fromkeys(one.kind for one in cars):
        if mine := [one for one in cars if one.kind == kind and one.curves is not None]:
            found.append((f"{kind} φ" if kind else "", vulnerability_chart(mine)))
    return found


def save_vulnerability(path: Path, cars: Sequence[ChartedCar]) -> None:
    """Save one picture of the curves of one or more cars."""
    title = "How far one has to deviate from a safe trajectory to be hit"
    title += "; shaded: 95 % interval by φ" if len(cars) <= _BANDS else ""
    if len(cars) == 1:
        title = f"{cars[0].label}. {title}\nDot: nominal collision rate; grey: planned kamikazes"
    save_charts(path, [vulnerability_chart(cars)], title)


def vulnerability_chart(cars: Sequence[ChartedCar]) -> Spec:
    """Return the chart of the curves of one or more cars; of a single one also planned kamikazes and budgets."""
    single = cars[0].curves if len(cars) == 1 else None
    planned = single["kamikazes"] if single and single["margins"] else None
    end = _end([*(one.curve for one in cars), *([planned] if planned else [])])
    x = alt.X("eta:Q", title="η: how far the adversary may deviate from φ (m)").scale(domain=[0.0, end], nice=False)
    x = x.axis(tickCount=8)
    y, low = (alt.Y(f"{name}:Q", title="can be hit (% of trials)").scale(domain=[0, 100]) for name in ("rate", "low"))
    stroke: Spec = {"symbolType": "stroke", "symbolSize": 600, "symbolOpacity": 1}
    colour = _colour(cars, **stroke)
    dashes = [list(palette.DASHES[place % 3]) for place in range(len(cars))]  # neighbours differ
    dash = _by_car(alt.StrokeDash, cars, dashes, **stroke)
    steps = [row for one in cars for row in _steps(one.label, one.curve, end)]
    bands = [row for one in cars for row in _band(one, end)] if len(cars) <= _BANDS else []
    rates = [row for one in cars for row in _rates(one)]
    line: Spec = {"interpolate": "step-after", "strokeWidth": 2.2, "clip": True}
    hit = _tooltip(car="car", eta=("η (m)", ".2f"), rate=("hit (%)", ".1f"))
    nominal = _tooltip(
        car="car", rate=("nominal collision rate (%)", ".1f"), low=("95 % from", ".1f"), high=("to", ".1f")
    )
    layers = [
        _of(bands)
        .mark_area(interpolate="step-after", opacity=0.18, clip=True)
        .encode(x=x, y=low, y2="high:Q", color=colour),
        _of(steps).mark_line(**line).encode(x=x, y=y, color=colour, strokeDash=dash, tooltip=hit),
        _of(rates).mark_rule(strokeWidth=2).encode(x=x, y=low, y2="high:Q", color=colour),
        _of(rates).mark_point(filled=True, size=60, opacity=1).encode(x=x, y=y, color=colour, tooltip=nominal),
    ]
    if planned:
        behind: Spec = {**line, "strokeDash": [8, 2, 2, 2], "strokeWidth": 1.5, "color": palette.BEHIND}
        said = _tooltip(eta=("η (m)", ".2f"), rate=("planned kamikazes, hit (%)", ".1f"))
        layers.insert(1, _of(_steps("", planned, end)).mark_line(**behind).encode(x=x, y=y, tooltip=said))
    if budgets := [point for point in (single or {}).get("budgets", ()) if point["trials"]]:
        rows = [{"eta": one["eta"], "rate": 100.0 * one["probability"], **_ends(one["ci95_trials"])} for one in budgets]
        diamond: Spec = {"shape": "diamond", "size": 60, "opacity": 1, "strokeWidth": 2}
        layers += [
            _of(rows).mark_rule(color=palette.BEHIND).encode(x=x, y=low, y2="high:Q"),
            _of(rows).mark_point(color=palette.BEHIND, **diamond).encode(x=x, y=y),
        ]
    described = "Vulnerability curve: share of trials in which a deviation of at most η suffices"
    return _drawn(layers, 320, described)


def _ends(pair: Sequence[float]) -> dict[str, float]:
    return {"low": 100.0 * pair[0], "high": 100.0 * pair[1]}


def _steps(name: str, curve: Mapping[str, Any], end: float) -> list[dict[str, Any]]:
    etas, values = curve["steps"]["eta"], curve["steps"]["probability"]
    kept = [(eta, value) for eta, value in zip(etas, values, strict=True) if eta < end]
    last = kept[-1][1] if kept else 0.0
    points = [*([] if kept and kept[0][0] == 0.0 else [(0.0, 0.0)]), *kept, (end, last)]
    return [{"car": name, "eta": round(eta, 4), "rate": round(100.0 * value, 3)} for eta, value in points]


def _band(one: ChartedCar, end: float) -> list[dict[str, Any]]:
    rows = zip(*(part.tolist() for part in interval_band(one.curve)), strict=True)
    return [{"car": one.label, "eta": round(eta, 5), **_ends((low, high))} for eta, low, high in rows if eta <= end]


def _rates(one: ChartedCar) -> list[dict[str, Any]]:
    if (rate := one.figures["nominal_collision_rate"]) is None:
        return []
    ends = _ends(one.figures["nominal_collision_rate_ci95"] or (rate, rate))
    return [{"car": one.label, "eta": 0.0, "rate": 100.0 * rate, **ends}]


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


# --- several cars beside each other


def against_multiplier(subjects: Sequence[Subject]) -> bool:
    """Return whether cars are drawn against C: all have one, not all the same, and none twice of what a line joins."""
    found = [one.figures["multiplier"] for one in subjects]
    joined = {(one.scenario.name, one.kind, one.figures["multiplier"]) for one in subjects}
    return len(set(found)) > 1 and None not in found and len(joined) == len(subjects)


def comparison_charts(subjects: Sequence[Subject]) -> list[Spec]:
    """Return margin, nominal collision rate, planned deviation and SKD of several cars, against C where all have it."""
    if len(subjects) < 2:
        return []
    several = len(scenarios_of(subjects)) > 1
    cars = [
        replace(car, kind=", ".join(filter(None, (several * one.scenario.name, one.kind))))
        for car, one in zip(charted(subjects), subjects, strict=True)
    ]
    against, legend = against_multiplier(subjects), "scenario" if several else "φ"
    charts = (_comparison(cars, figure, legend, against=against) for figure in shown_in("chart"))
    return [one for one in charts if one is not None]


def save_sweep(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Save margin, planned deviation, SKD and contact rate against C; the paper's figure has the last two."""
    cars = [ChartedCar(f"C = {row['multiplier']:g}", row, f"{row['kind']} φ") for row in rows]
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
        row["note"] = _hollow(one.figures, key)
        rows.append({**row, "low": scale * low, "high": scale * high, "of": "by φ" if by_phi else independent})
    return rows


def _comparison(cars: Sequence[ChartedCar], figure: Figure, named: str, *, against: bool) -> Spec | None:
    """Return the chart of a figure: by kind against C, else by car, each in its colour."""
    if not (rows := _compared(cars, figure)):
        return None
    title, zero = figure.heading, figure.kind is SHARE
    kinds = list(dict.fromkeys(str(one["kind"]) for one in rows))
    legend = None if kinds == [""] else alt.Legend(title=named or None, symbolLimit=0, labelLimit=260)
    shape = alt.Shape("kind:N", legend=legend).scale(domain=kinds, range=list(palette.SHAPES[: len(kinds)]))
    said = _tooltip(
        car="car", value=(title, ".3f"), low=("95 % from", ".3f"), high=("to", ".3f"), of="interval", note="note"
    )
    if against:
        value, low = (alt.Y(f"{name}:Q", title=title).scale(zero=zero) for name in ("value", "low"))
        colour = alt.Color("kind:N", legend=legend).scale(domain=kinds, range=list(palette.SERIES[: len(kinds)]))
        x = alt.X("C:Q", title="multiplier C of the basic controller").scale(zero=False, padding=12)
        base = _of(rows).encode(x=x, color=colour)
        layers = [
            base.mark_line(strokeWidth=1.2, opacity=0.6).encode(y=value),
            base.mark_rule(strokeWidth=2).encode(y=low, y2="high:Q"),
            *_points(rows, x=x, y=value, color=colour, shape=shape, tooltip=said),
        ]
        return _drawn(layers, 260, f"{title}, with 95 % intervals")
    right, left = (alt.X(f"{name}:Q", title=title).scale(zero=zero).axis(tickCount=6) for name in ("value", "low"))
    # Names lie, in two lines: only then all of a name is seen, the end too that tells it from the next.
    names = alt.Axis(labelExpr="split(replace(datum.label, ' (', '\\n('), '\\n')", labelLimit=_NAME)
    labels = [one.label for one in cars]
    colours = alt.Color("car:N", legend=None).scale(domain=labels, range=[one.colour for one in cars])
    y = alt.Y("car:N", title=None, sort=labels, axis=names)
    layers = [
        _of(rows).mark_rule(strokeWidth=2).encode(x=left, x2="high:Q", y=y, color=colours),
        *_points(rows, x=right, y=y, color=colours, shape=shape, tooltip=said),
    ]
    return _drawn(layers, 60 + _ROW * len(cars), f"{title}, with 95 % intervals")


# --- margin against risk, and against the price of caution


def has_risks(figures: Mapping[str, Any]) -> bool:
    """Return whether a result has a margin, and the risk at each scale."""
    return figures["margin"] is not None and all(figures.get(f"risk_{scale:g}") is not None for scale in SCALES)


def risk_of(figures: Mapping[str, Any], scale: float) -> tuple[float, float, float]:
    """Return the risk at a scale, and the ends of its 95 % interval by φ, else of that for these φ."""
    key = f"risk_{scale:g}"
    value, runs = float(figures[key]), figures[f"{key}_ci95_runs"]
    low, high = figures[f"{key}_ci95"] or runs or (value, value)
    if value == 0.0 and runs:  # without a hit there is no spread over φ: the interval of runs says more
        high = max(high, runs[1])
    return value, float(low), float(high)


def floor_of(risks: Sequence[tuple[float, float, float]]) -> float:
    """Return the least risk of a picture with a logarithmic axis, a power of 10: what is less stands at its edge.

    Args:
        risks: what `risk_of` says of each car.
    """
    known = [value or high for value, _, high in risks if value or high]
    return float(10.0 ** (math.ceil(math.log10(max(LEAST, min(known, default=0.1))) - 1e-9) - 1))


def has_price(figures: Mapping[str, Any]) -> bool:
    """Return whether a result has a margin, and a price of caution."""
    return figures["margin"] is not None and figures.get("price_of_caution") is not None


Headed = tuple[str, list[ChartedCar]]


def rated_cars(subjects: Sequence[Subject]) -> list[Headed]:
    """Return the sets of cars whose risks can be compared, rated on the same φ with one behaviour model."""
    return _sets(subjects, lambda one: json.dumps(one["risk"]["behaviour"], sort_keys=True) if has_risks(one) else None)


def priced_cars(subjects: Sequence[Subject]) -> list[Headed]:
    """Return the sets of cars whose margins and prices of caution can be compared, rated on the same φ."""
    return _sets(subjects, lambda one: "" if has_price(one) else None)


def _sets(subjects: Sequence[Subject], model: Callable[[Mapping[str, Any]], str | None]) -> list[Headed]:
    """Return sets of at least two cars of the same φ and model, each with a heading, empty for a single set."""
    groups: dict[tuple[object, ...], list[ChartedCar]] = {}
    for one, car in zip(subjects, charted(subjects), strict=True):
        if (kind := model(one.figures)) is not None:
            groups.setdefault((one.safe_key, one.figures["eta_max"], kind), []).append(car)
    shown = [members for members in groups.values() if len(members) > 1]
    return [(f"{one[0].kind or one[0].figures['safe']} φ" if len(shown) > 1 else "", one) for one in shown]


def save_comparison(folder: Path, results: Mapping[str, StoredResult], ranked_by: str | None) -> None:
    """Save the pictures of results by the names of their cars: curves, and margin against risk and against price.

    Args:
        folder: of the pictures.
        results: of at least two cars.
        ranked_by: the figure that ranks them; None: curves of unlike kind say nothing beside each other.
    """
    by_margin, first = ranked_by == MARGIN, next(iter(results.values()))
    cars = []
    for name, one in results.items():
        least, planned = one.margin_curve if by_margin else None, one.curve
        curves: Spec = {
            "kamikazes": planned.as_dict() if planned else {},
            "budgets": [],
            "margins": least and least.as_dict(),
        }
        cars.append(ChartedCar(name, one.figures, curves=curves))
    cars = coloured(cars)
    if ranked_by is not None:
        save_vulnerability(folder / "vulnerability.png", cars)
    same = by_margin and all(
        first.figures["eta_max"] == one.figures["eta_max"] and first.same_safe(one.safe) for one in results.values()
    )
    rated = same and all(has_risks(one.figures) for one in cars)
    if rated and all(one.figures["risk"]["behaviour"] == first.figures["risk"]["behaviour"] for one in cars):
        title = f"Margin against risk; bars: 95 % intervals by φ. Safer cars lie to the right and below\n{HOLLOW}"
        save_charts(folder / "rating.png", [rating_chart(cars, scale) for scale in SCALES], title)
    if same and all(has_price(one.figures) for one in cars):
        save_charts(folder / "price.png", [price_chart(cars)], f"Margin against the price of caution\n{PRICE_CAPTION}")


def rating_chart(cars: Sequence[ChartedCar], scale: float) -> Spec:
    """Return the chart of margin against the risk at a scale, of cars that have both; a line joins basic cars by C."""
    floor = floor_of([risk_of(one.figures, scale) for one in cars])
    rows = []
    for one in cars:
        value, low, high = risk_of(one.figures, scale)
        risk = {"y": max(floor, value), "y_low": max(floor, low), "y_high": max(floor, high), "value": value}
        interval = f"{low:.2g} to {high:.2g}"
        rows.append({**_margin_row(one), **risk, "interval": interval, "note": _hollow(one.figures)})
    basic = {row["C"]: row for row in rows if row["C"] is not None}
    line = [{**basic[multiplier], "order": multiplier} for multiplier in sorted(basic)] if len(basic) > 1 else []
    decades = [float(f"1e{power}") for power in range(round(math.log10(floor)), 1)]
    y, low_end = (
        alt.Y(f"{name}:Q", title=f"R({scale:g})")
        .scale(type="log", domain=[floor, 1.0], clamp=True)
        .axis(format="~g", values=decades)
        for name in ("y", "y_low")
    )
    said = _tooltip(car="car", margin=("margin (m)", ".3f"), value=("risk", ".2~g"), interval="95 %", note="note")
    joined = _of(line).mark_line(strokeWidth=1.2, color=palette.BEHIND)
    layers = _against_margin(cars, rows, joined, y, low_end, said)
    return _drawn(layers, 280, f"Margin against R({scale:g}), with 95 % intervals")


HOLLOW: Final = "Hollow: cars that are not credible, or whose margin is an upper bound"
PRICE_CAPTION: Final = f"Grey joins the best cars. {HOLLOW}, or that do not get past people"


def price_chart(cars: Sequence[ChartedCar]) -> Spec:
    """Return the chart of margin against the price of caution, of cars that have both, with the Pareto line.

    Many cars have their names beside their points.
    """
    rows: list[dict[str, Any]] = []
    for one in cars:
        price = stored_price(one.figures)
        assert price is not None
        mean = price.mean("late")
        low, high = price.ci95("late") or (mean, mean)
        note = "does not get past people" if price.does_not_get_past else _hollow(one.figures)
        lost, slow = map(price.mean, ("time_lost", "slow"))
        late = {"y": mean, "y_low": low, "y_high": high, "lost": lost, "slow": slow}
        rows.append({**_margin_row(one), **late, "note": note})
    title = "time lost and slow driving, for each harmless road user (s)"
    y, low_end = (alt.Y(f"{name}:Q", title=title) for name in ("y", "y_low"))
    said = _tooltip(
        car="car", margin=("margin (m)", ".3f"), y=("price (s)", ".2f"), lost=("time lost (s)", ".2f"),
        slow=("slow by (s)", ".2f"), note="note",
    )  # fmt: skip
    best = pareto([row for row in rows if row["note"] == NOTHING])
    line = _of({**row, "order": row["margin"]} for row in best).mark_line(
        strokeWidth=1.5, color=palette.BEHIND, interpolate="step-before"
    )
    if len(cars) <= _NAMED:
        layers = _against_margin(cars, rows, line, y, low_end, said)
    else:
        named = sorted(rows, key=lambda row: row["margin"])
        least, most = (limit(row["y"] for row in named) for limit in (min, max))
        y, low_end = (one.scale(domainMin=least - 0.3 * (most - least)) for one in (y, low_end))
        layers = _against_margin(cars, rows, line, y, low_end, said)
        x = alt.X("margin:Q").scale(domainMin=-0.1 * named[-1]["margin"])  # room for the name of a car without margin
        for place, above in enumerate((False, True)):  # in turn: cars of the same price stand close together
            text = _of(named[place::2]).mark_text(angle=300, align="left" if above else "right", dx=9 if above else -9)
            layers.append(text.encode(x=x, y=y, text="car:N"))
    return _drawn(layers, 320, "Margin against the price of caution, with 95 % intervals")


def pareto(rows: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Return the cars that no other one beats in margin without a higher price, the cheapest first."""
    found: list[Mapping[str, Any]] = []
    for row in sorted(rows, key=lambda one: (one["y"], -one["margin"])):
        if not found or row["margin"] > found[-1]["margin"]:
            found.append(row)
    return found


def _margin_row(one: ChartedCar) -> dict[str, Any]:
    margin = float(one.figures["margin"])
    low, high = one.figures["margin_ci95"] or (margin, margin)
    car = CarUnderTest(str(one.figures["controller"]))
    multiplier = one.figures["multiplier"] if car.is_known and car.has_multiplier else None
    return {"car": one.label, "C": multiplier, "margin": margin, "low": low, "high": high}


def _against_margin(
    cars: Sequence[ChartedCar],
    rows: Sequence[Mapping[str, Any]],
    line: alt.Chart,
    y: alt.Y,
    low_end: alt.Y,
    said: Sequence[alt.Tooltip],
) -> list[alt.Chart]:
    """Return a line, bars of both intervals, and points."""
    x, left = (alt.X(f"{name}:Q", title="margin (m)").scale(zero=True).axis(tickCount=5) for name in ("margin", "low"))
    every, colour = _of(rows), _colour(cars)
    return [
        line.encode(x=x, y=y, order="order:Q"),
        every.mark_rule(strokeWidth=2).encode(x=left, x2="high:Q", y=y, color=colour),
        every.mark_rule(strokeWidth=2).encode(x=x, y=low_end, y2="y_high:Q", color=colour),
        *_points(rows, x=x, y=y, color=colour, shape=_shape(cars), tooltip=list(said)),
    ]
