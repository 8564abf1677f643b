"""Figures, their rows in tables, failures and scenarios as text: on the page, on the terminal, and in Markdown."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from skd_adversary.crossing.road_users import road_user_named
from skd_adversary.safe_trajectories.sources import count_safe_trajectories
from skd_sim.options.car_and_adversary import RANKING_OBJECTIVES, AdversaryModel, first_of
from skd_sim.scenario.scenario import Scenario
from skd_sim.scenario.scenario_file import REGULATORY

from skd_evaluator.assessment.figure_table import AT_THE_TOP, CI95, PROBABILITY, SPEEDS, THESE_PHI, Figure, Of, shown_in
from skd_evaluator.assessment.options import OWN, SYNTHETIC, WALKERS
from skd_evaluator.metrics.margins import GAP_WARNING, UPPER_BOUNDS, reference_text
from skd_evaluator.metrics.statistics import cantelli_bound
from skd_evaluator.metrics.surrogate_measures import SURROGATE_MEASURES

NOTHING = "–"
Value = float | Sequence[float] | None
"""A number or the ends of an interval; None where it is not defined."""


@dataclass(frozen=True)
class Style:
    """How a number, or an interval, is written.

    Attributes:
        nothing: text for a number that is not defined.
        around: format of an interval, with a place for each end.
        minus: minus sign.
        percent: text that follows a percentage.
    """

    nothing: str
    around: str
    minus: str = "-"
    percent: str = " %"

    def number(self, found: Value, digits: int = 3, unit: str = "") -> str:
        """Return a number with so many digits after the point, and its unit."""
        return self._text(found, f".{digits}f", unit and f" {unit}").replace("-", self.minus)

    def share(self, found: Value, digits: int = 1) -> str:
        """Return a share as a percentage."""
        return self._text(found, f".{digits}f", self.percent, 100.0)

    def probability(self, found: Value, digits: int = 2) -> str:
        """Return a probability, which may be very small, with so many significant digits."""
        return self._text(found, f"#.{digits}g")

    def _text(self, found: Value, form: str, unit: str = "", times: float = 1.0) -> str:
        if found is None:
            return self.nothing
        if isinstance(found, Sequence):
            return self.around.format(*(f"{times * end:{form}}" for end in found)) + unit
        return f"{times * found:{form}}{unit}"

    def value(self, figure: Figure, result: Mapping[str, Any]) -> str:
        """Return a figure of an assessment; of one that is spoken, its text."""
        found = result.get(figure.key)
        if figure.spoken:
            return bounded(result, str(result[f"{figure.key}_text"] or self.nothing))
        if figure.key in UPPER_BOUNDS and found is not None:
            return bounded(result, self.number(found, figure.kind.digits))
        return self._of_kind(figure, found and found["mean"] if figure.kind is SPEEDS else found)

    def by_phi(self, figure: Figure, result: Mapping[str, Any]) -> str:
        """Return a figure's interval by φ."""
        return self._around(figure, result, CI95 if figure.by_phi else "")

    def independent(self, figure: Figure, result: Mapping[str, Any]) -> str:
        """Return a figure's interval that takes trials, pairs or runs as independent."""
        return self._around(figure, result, THESE_PHI if figure.spoken else figure.independent)

    def _around(self, figure: Figure, result: Mapping[str, Any], end: str) -> str:
        if figure.spoken:
            return spoken_interval(result, f"{figure.key}_{end or CI95}_text") or self.nothing
        return self._of_kind(figure, result.get(f"{figure.key}_{end}") if end else None)

    def _of_kind(self, figure: Figure, found: Value) -> str:
        kind = figure.kind
        write = self.probability if kind is PROBABILITY else self.share if kind.unit == "%" else self.number
        return write(found, kind.digits)


def never_passes(result: Mapping[str, Any]) -> bool:
    """Return whether a car stands on the empty road, too: there is no time that it could lose."""
    return result.get("deadlock") == 1.0 and result["time_lost"] is None


PAGE = Style(NOTHING, "{} to {}", "−")
TERMINAL = Style("—", "[{}, {}]")
BARE = Style("—", "[{}, {}]", percent="")
"""Where the unit stands above."""
number, percent = PAGE.number, PAGE.share


def beside(figure: Figure, result: Mapping[str, Any]) -> str:
    """Return, in words, what 90 % of some speeds stay below, or in how many runs a car never passes; else nothing."""
    if figure.key == "time_lost" and result.get("deadlock"):
        stands = never_passes(result)
        return "never passes, on the empty road either" if stands else f"{percent(result['deadlock'])} never pass"
    found = result.get(figure.key) if figure.kind is SPEEDS else None
    return f"90 % below {found['p90']:.{figure.kind.digits}f}" if found else ""


def bounded(result: Mapping[str, Any], text: str) -> str:
    """Return the text of a margin, or of what follows from it, as the bound that it is until the search converges.

    Args:
        result: content of assessment.json.
        text: a number, `above` or `below` one, or that there is none.
    """
    if result.get("margin_converged") is not False:
        return text
    if text.startswith("above"):
        return "not known"
    return f"at most {text}" if text[:1].isdigit() else text


def spoken_interval(result: Mapping[str, Any], key: str) -> str:
    """Return an interval of the equivalent multiplier as its text says; its upper end where the margin is a bound."""
    text = str(result.get(key) or "")
    if not text or result.get("margin_converged") is not False:
        return text
    return bounded(result, text.strip("[]").split(", ")[-1])


def counted(count: int, thing: str) -> str:
    """Return a number with its noun, in the plural for all but one; thousands apart, φ as it is."""
    plural = f"{thing[:-1]}ies" if thing.endswith("ory") else thing if thing.endswith("φ") else f"{thing}s"
    return f"{count:,} {thing if count == 1 else plural}"


NO_RATING = "They are no rating: they depend on the road user, and along φ none aims at the car."


def surrogate_groups(figures: Mapping[str, Any]) -> list[tuple[str, Mapping[str, Any]]]:
    """Return who walks, and what the measures come to; nothing where there are none."""
    found = figures.get("surrogate_measures")
    if not found:
        return []
    kamikazes = [(f"kamikazes, {name}", group) for name, group in found["kamikazes"].items()]
    groups = [("along φ", found["along_phi"]), *kamikazes]
    return [(f"{name} ({group['episodes']})", group) for name, group in groups if group["episodes"]]


def surrogate_rows(figures: Mapping[str, Any]) -> list[tuple[str, list[str]]]:
    """Return each measure with its unit, and for each group median, worst and in how many episodes it is defined."""
    groups = [group for _, group in surrogate_groups(figures)]
    rows = []
    for name, measure in SURROGATE_MEASURES.items():
        label = f"{measure.label} ({measure.unit})" if measure.unit else measure.label
        cells = [group.get(name) or {"median": None, "worst": None, "defined": 0} for group in groups]
        texts = [[_surrogate(one["median"]), _surrogate(one["worst"]), str(one["defined"])] for one in cells]
        rows.append((label, [text for one in texts for text in one]))
    return rows


def _surrogate(value: float | None) -> str:
    return "–" if value is None else f"{value:.3g}" if 0.0 < abs(value) < 0.1 else f"{value:.2f}"


@dataclass(frozen=True)
class KeptFailure:
    """A failure that is kept.

    Attributes:
        kind: what the walker did.
        row: number of the crossing.
        rank: how many of its kind are nearer to how people walk.
        deviation: from φ, in standard deviations of people.
        people: share of people who deviate as much or more.
        scale: by which all deviations were multiplied.
    """

    kind: str
    row: int
    rank: int
    deviation: float
    people: float
    scale: float

    @property
    def text(self) -> str:
        """What the road user did."""
        scaled = f", deviations times {self.scale:g}" if self.scale != 1.0 else ""
        return f"as people walk{scaled}: {self.kind}"

    @property
    def likely(self) -> str:
        """How likely such deviations are, in words."""
        return how_unusual(self.people)


def how_unusual(people: float) -> str:
    """Return how unusual a walk is, in words, from the share of people who differ more from the average."""
    if people <= 1e-4:
        return "more unusual than almost everybody"
    share = percent(people, 0 if people >= 0.01 else 1)
    some = f"1 in {1.0 / people:,.0f} people" if people < 5e-4 else f"{share} of people"
    return f"{'nearly all people' if people > 0.995 else some} walk more unusually"


def kept_failures(figures: Mapping[str, Any]) -> list[KeptFailure]:
    """Return the failures that are kept, kind by kind, the most frequent kind first; none where there are none."""
    found = failures_in(figures)
    if found is None:
        return []
    phis, kept = len(figures["per_safe_trajectory"]), []
    for group in found["kinds"]:
        for rank, one in enumerate(group["nearest"]):
            row, scale = one["trial"] * phis + one["safe_trajectory"], found["scale"]
            kept.append(KeptFailure(str(group["kind"]), row, rank, one["deviation"], one["people"], scale))
    return kept


def failures_in(figures: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """Return the failures of assessment.json; None where there are none."""
    risk = figures.get("risk")
    found: Mapping[str, Any] | None = risk.get("failures") if risk else None
    return found


def failures_sentence(figures: Mapping[str, Any]) -> str:
    """Return what the failures are of; empty where there are none."""
    found = failures_in(figures)
    if found is None:
        return ""
    scaled = "" if found["scale"] == 1.0 else f" whose deviations are {found['scale']:g} times as large"
    first = "" if found["looked_at"] == found["hits"] else f" (the first {found['looked_at']} are classified)"
    return f"{found['hits']} of {found['runs']} crossings of people{scaled} ended in a hit by the moving car{first}."


_KMH = 3.6


def sources_of(scenario: Scenario) -> list[str]:
    """Return where a scenario's safe trajectories can come from, beside files."""
    walkers = [WALKERS] if scenario.adversary.kind == "pedestrian" else []
    return [SYNTHETIC, OWN, *walkers, *([REGULATORY] if scenario.protocol is not None else [])]


def places_of(scenario: Scenario) -> list[float]:
    """Return the impact places of its protocol, % of the car's width; none where it has no protocol."""
    return [] if scenario.protocol is None else list(scenario.protocol.impact_places)


def scenario_data(scenario: Scenario, known: str | None) -> dict[str, Any]:
    """Return what is said of a scenario as plain data.

    Args:
        scenario: the scenario.
        known: why the basic car's margin is not exact in it, in a few words; None where it is.
    """
    return {
        "name": scenario.name,
        "description": scenario.description,
        "adversary": scenario.adversary.kind,
        "car_speed": scenario.car.start_speed,
        "impact_places": places_of(scenario),
        "safe": sources_of(scenario),
        "basic_margin": "exact" if known is None else f"searched; it is not exact {known}",
        "source": "" if scenario.protocol is None else scenario.protocol.source,
    }


def scenario_lines(scenario: Scenario, known: str | None) -> list[str]:
    """Return what is said of a scenario, line by line; arguments as of `scenario_data`."""
    return [f"{scenario.name}: {scenario.description}", *(f"  {line}" for line in _lines(scenario, known))]


def _lines(scenario: Scenario, known: str | None) -> Iterator[str]:
    car, adversary, protocol = scenario.car, scenario.adversary, scenario.protocol
    user = road_user_named(adversary.kind)
    body = f"{adversary.length:g} × {adversary.width:g} m" if adversary.is_box else f"a disc of {adversary.radius:g} m"
    gaps = f"{car.start_gap:.1f} to {car.start_gap + car.start_gap_range:.1f} m"
    yield f"car: {_KMH * car.start_speed:.0f} km/h, its front {gaps} before the crossing line"
    yield f"adversary: {user.name}, {body}, at most {_KMH * adversary.speed:.0f} km/h"
    if scenario.obstacles or scenario.others:
        yield f"beside it: {len(scenario.obstacles)} parked, {len(scenario.others)} others"
    if protocol is not None:
        yield f"target of its protocol: {_KMH * protocol.speed:.0f} km/h, at {_listed(protocol.impact_places)} %"
        yield f"source: {protocol.source}"
    yield f"safe trajectories: {', '.join(sources_of(scenario))}, or files{_count(scenario)}"
    yield f"margin of the basic car: {'exact' if known is None else f'found by search; it is not exact {known}'}"


def _count(scenario: Scenario) -> str:
    return "" if scenario.protocol is None else f" ({count_safe_trajectories(REGULATORY, scenario)} regulatory ones)"


def _listed(places: Sequence[float]) -> str:
    return ", ".join(f"{place:g}" for place in places)


_SAME_MULTIPLIER = 1e-9


@dataclass(frozen=True)
class FigureRow:
    """A figure with its intervals.

    Attributes:
        name: name of the figure.
        value: value of the figure, as text.
        clustered: 95 % interval of the figure by φ, as text.
        plain: 95 % interval that takes trials, pairs or runs as independent of one another, as text.
        basis: how many trials, pairs or runs the figure is of, as text.
        note: what to know of the value beside its interval, as text.
        main: whether the figure is one of those that are read first.
        alert: whether a warning is about the figure.
    """

    name: str
    value: str
    clustered: str = NOTHING
    plain: str = NOTHING
    basis: str = ""
    note: str = ""
    main: bool = False
    alert: bool = False

    def texts(self) -> tuple[str, ...]:
        """Return the cells of a line: name, value, both intervals, and what it is of."""
        return self.name, self.value, self.clustered, self.plain, f" {self.basis}"


def figure_rows(figures: Mapping[str, Any], style: Style = PAGE) -> list[FigureRow]:
    """Return the figures of a car: those that are read first, in the order of the terminal, then others."""
    parts = (_first_rows, _margin_details, _planned_details, _skd_details)
    return [row for part in parts for row in part(figures, style)]


def _ranking(figures: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the figures of the kamikazes that rank the car."""
    found: Mapping[str, Any] = figures["objectives"][first_of(RANKING_OBJECTIVES, figures["objectives"])]
    return found


def _first_rows(figures: Mapping[str, Any], style: Style) -> Iterator[FigureRow]:
    ranking = _ranking(figures)
    phis = counted(len(figures["per_safe_trajectory"]), "φ")
    speed, model, close = figures["impact_speed"], figures.get("adversary_model"), figures["optimality_gap"]
    kamikazes, pairs = counted(ranking["trials"], "kamikaze"), counted(figures["pairs"], "pair")
    failed = f"{ranking['failed']} not hit, counted as {figures['eta_max']:g} m"
    basis = {
        "margin": _margin_basis(figures),
        "equivalent_multiplier": _equivalent_basis(figures),
        "nominal_collision_rate": f"{counted(figures['collision_runs'], 'run')} over {phis}, along φ",
        "impact_speed": f"90 % below {speed['p90']:.1f} m/s; of the margin trajectories" if speed else "",
        "deviation": f"{f'adversary model: {model}; ' if model else ''}{kamikazes} over {phis}; {failed}",
        "optimality_gap": gap_basis(figures),
        "skd": f"{style.share(figures['kamikaze_success_rate'])} of kamikazes collide; {pairs} over {phis}",
    }
    if risk := figures.get("risk"):
        people = f"behaviour model {risk['behaviour']['name']}"
        basis |= {f"risk_{one['scale']:g}": f"{one['method']}; {people}" for one in risk["scales"]}
    if price := figures.get("price_of_caution"):
        runs = counted(len(price["runs"]), "harmless run")
        basis["time_lost"] = "; ".join(filter(None, (runs, beside(AT_THE_TOP["time_lost"], figures))))
    special: dict[str, dict[str, Any]] = {
        "equivalent_multiplier": {
            "clustered": _equivalent_interval(style, figures, CI95),
            "plain": _equivalent_interval(style, figures, THESE_PHI),
        },
        "optimality_gap": {"alert": close is not None and close > GAP_WARNING},
        "time_lost": {"note": beside(AT_THE_TOP["time_lost"], figures)},
    }
    if never_passes(figures):
        special["time_lost"] = {"value": "never passes", "note": "on the empty road either"}
    if figures["skd"] is None:
        special["skd"] = {"value": "none kept" if figures["discarded_by_distance"] else "no kamikaze found"}
    for one in shown_in("summary"):
        if one.first:
            row = _row(style, one, figures, main=True, basis=basis.get(one.key, ""))
            yield replace(row, **special.get(one.key, {}))


def gap_basis(figures: Mapping[str, Any]) -> str:
    """Return what the optimality gap is, and where it is wide what to judge the car by."""
    said, close = "planned kamikazes needed so many times the margin", figures["optimality_gap"]
    wide = close is not None and close > GAP_WARNING
    unseen = wide and figures.get("lane_left") and figures["adversary_model"] == AdversaryModel.GENERIC
    said += ": judge the car by its margin, not by planned deviation or SKD" if wide else ""
    return said + ("; they do not see it leave its lane, unless by --adversary-model learned" if unseen else "")


def _row(style: Style, one: Figure, figures: Mapping[str, Any], **rest: Any) -> FigureRow:
    """Return the row of a figure, as the table of figures has it."""
    return FigureRow(
        one.title, style.value(one, figures), style.by_phi(one, figures), style.independent(one, figures), **rest
    )


def _further(style: Style, figures: Mapping[str, Any], of: Of, basis: str = "") -> list[FigureRow]:
    """Return figures that need no words of their own."""
    found = [one for one in shown_in("details") if one.of is of and one.key in figures]
    return [_row(style, one, figures, basis=beside(one, figures) or basis) for one in found]


def _margin_basis(figures: Mapping[str, Any]) -> str:
    """Return how the margin was come by, in a few words."""
    if figures["margin"] is None:
        return str(figures["margin_note"] or "not known")
    how = "exact" if figures["margin_budget"] is None else "found by search"
    how = how if figures["margin_converged"] else "not converged"
    phis = counted(len(figures["per_safe_trajectory"]), "φ")
    return f"{how}; {counted(figures['margin_trials'], 'trial')} over {phis}"


def _margin_details(figures: Mapping[str, Any], style: Style) -> Iterator[FigureRow]:
    if figures["margin"] is not None:
        trials = figures["margin_trials"]
        if figures["margin_budget"] is not None:
            stopped = "converged" if figures["margin_converged"] else "not converged"
            yield FigureRow("margin: candidates driven in a trial", f"{figures['margin_budget']:,}", basis=stopped)
            for one in figures["margin_sources"] or ():
                basis = f"{one['hits']:,} better hits of {one['candidates']:,} candidates"
                lowered = style.number(one["lowered"] / trials, 3)
                yield FigureRow(f"  lowered by {one['source']} (m)", lowered, basis=basis)
        elif gap := figures["margin_gap"]:
            yield FigureRow("margin: the least is at most this much less (m)", style.number(gap, 4))
        if figures["margin_how"]:
            yield FigureRow("margin: what was searched", "", basis=str(figures["margin_how"]))
        name = f"margin: trials without a hit within {figures['eta_max']:g} m"
        yield FigureRow(name, f"{figures['margin_beyond']} of {trials}")
        yield from _further(style, figures, Of.MARGIN)
    runs = counted(figures["collision_runs"], "run") + _walked_into(figures["collision_standing_contacts"])
    yield _row(style, AT_THE_TOP["contact_rate"], figures, basis=runs)
    yield from _further(style, figures, Of.CAR)


def _walked_into(count: int) -> str:
    return f"; {count} walked into a standing car" if count else ""


def _planned_details(figures: Mapping[str, Any], style: Style) -> Iterator[FigureRow]:
    if _ranking(figures)["failed"] and figures["deviation"] is not None:
        name = "planned deviation of those that were hit alone (m)"
        yield FigureRow(name, style.number(figures["deviation_of_successes"]))
    for name, found in figures["objectives"].items():
        hit = f"{found['trials'] - found['failed']} of {counted(found['trials'], 'kamikaze')}"
        basis = f"{hit} {'were hit' if found['plans_deviation'] else 'collided'}"
        basis += _walked_into(found["standing_contacts"])
        rate, by_phi, plain = (style.share(found.get(f"success_rate{end}")) for end in ("", "_ci95", "_ci95_trials"))
        yield FigureRow(f"success rate, {name}", rate, by_phi, plain, basis)
    for one in figures["measures"].values():
        if one["shown"] and not one["error"]:
            name = f"{one['label']} ({one['unit']})" if one["unit"] else one["label"]
            undefined = f"{one['undefined']} pairs without" if one["undefined"] else ""
            mean, by_phi, plain = (style.number(one[key]) for key in ("mean", "ci95", "ci95_pairs"))
            yield FigureRow(name, mean, by_phi, plain, undefined)
    yield from _further(style, figures, Of.RANKING)


def _skd_details(figures: Mapping[str, Any], style: Style) -> Iterator[FigureRow]:
    yield _row(style, AT_THE_TOP["skd_prefix"], figures, basis="as SKD, φ cut at the duration of ψ")
    yield from _further(style, figures, Of.SKD, "of the pairs of SKD")
    for eta, bound in figures["probability_bound"].items() if figures["skd"] is not None else ():
        name, of = f"P(Fréchet distance ≤ {eta} m) at most", "of these kamikazes, from its mean and variance"
        known = style.number(figures["probability_bound_ci95"][eta])
        sharper = cantelli_bound(float(eta), figures["skd"], figures["variance"])
        yield FigureRow(f"{name}, Theorem 1", style.number(bound), known, basis=of)
        yield FigureRow(f"{name}, Cantelli", style.number(sharper), basis="never above Theorem 1")


_EVERY = 5
"""One in so many points of the curve is in the table of bounds."""


def bounds_of(curves: Mapping[str, Any] | None) -> list[Mapping[str, Any]]:
    """Return what mean and variance alone say of the curve that is drawn, beside what was found.

    By η (m): the share P(η) of trials that needed at most η (`probability`), and its upper bounds by Theorem 1
    (`bound`) and by Cantelli's inequality, up to where these say nothing. None where the curve is not known.
    """
    curve = (curves or {}).get("margins") or (curves or {}).get("kamikazes")
    points = curve["points"][::_EVERY] if curve else ()
    return [one for one in points if "cantelli" in one and one["cantelli"] < 1.0]


def _equivalent_basis(figures: Mapping[str, Any]) -> str:
    """Return what C is, and what a C of 1 or more is worth: the paper's car keeps its room by standing still."""
    said = figures["equivalent_multiplier_note"] or "the basic car with the same margin on the same φ"
    value, text = figures["equivalent_multiplier"], figures["equivalent_multiplier_text"] or ""
    stuck = text.startswith("above") if value is None else value >= 1.0
    said += "; with C ≥ 1 that car itself does not get past people" if stuck else ""
    beside = reference_text(figures.get("reference") or ())
    return f"{said}; {beside}" if beside else said


def _equivalent_interval(style: Style, figures: Mapping[str, Any], name: str) -> str:
    """Return an interval of the equivalent multiplier, whose ends may lie beyond the sweep."""
    ends = figures.get(f"equivalent_multiplier_{name}") or (None, None)
    own = figures["multiplier"]
    # A basic car is compared with itself, in the same trials: there is no chance in it.
    if own is not None and all(end is not None and abs(end - own) < _SAME_MULTIPLIER for end in ends):
        return "exact by construction"
    text = spoken_interval(figures, f"equivalent_multiplier_{name}_text")
    return style.around.format(*text.strip("[]").split(", ")) if ", " in text else text or style.nothing
