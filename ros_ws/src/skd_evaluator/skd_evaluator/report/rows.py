"""The rows of the tables of figures, on the terminal and on the page; nothing is computed anew but Cantelli's bound."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from skd_sim.options.car_and_adversary import RANKING_OBJECTIVES, first_of

from skd_evaluator.assessment.figure_table import AT_THE_TOP, CI95, THESE_PHI, Figure, Of, shown_in
from skd_evaluator.metrics.margins import GAP_WARNING, reference_text
from skd_evaluator.metrics.statistics import cantelli_bound
from skd_evaluator.report import formats

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
    clustered: str = formats.NOTHING
    plain: str = formats.NOTHING
    basis: str = ""
    note: str = ""
    main: bool = False
    alert: bool = False

    def texts(self) -> tuple[str, ...]:
        """Return the cells of a line: name, value, both intervals, and what it is of."""
        return self.name, self.value, self.clustered, self.plain, f" {self.basis}"


def figure_rows(figures: Mapping[str, Any], style: formats.Style = formats.PAGE) -> list[FigureRow]:
    """Return the figures of a car: those that are read first, in the order of the terminal, then others."""
    parts = (_first_rows, _margin_details, _planned_details, _skd_details)
    return [row for part in parts for row in part(figures, style)]


def _ranking(figures: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the figures of the kamikazes that rank the car."""
    found: Mapping[str, Any] = figures["objectives"][first_of(RANKING_OBJECTIVES, figures["objectives"])]
    return found


def _first_rows(figures: Mapping[str, Any], style: formats.Style) -> Iterator[FigureRow]:
    ranking = _ranking(figures)
    phis = formats.counted(len(figures["per_safe_trajectory"]), "φ")
    speed, model, close = figures["impact_speed"], figures.get("adversary_model"), figures["optimality_gap"]
    kamikazes, pairs = formats.counted(ranking["trials"], "kamikaze"), formats.counted(figures["pairs"], "pair")
    failed = f"{ranking['failed']} not hit, counted as {figures['eta_max']:g} m"
    basis = {
        "margin": _margin_basis(figures),
        "equivalent_multiplier": _equivalent_basis(figures),
        "nominal_collision_rate": f"{formats.counted(figures['collision_runs'], 'run')} over {phis}, along φ",
        "impact_speed": f"90 % below {speed['p90']:.1f} m/s; of the margin trajectories" if speed else "",
        "deviation": f"{f'adversary model: {model}; ' if model else ''}{kamikazes} over {phis}; {failed}",
        "optimality_gap": "planned kamikazes needed so many times the margin",
        "skd": f"{style.share(figures['kamikaze_success_rate'])} of kamikazes collide; {pairs} over {phis}",
    }
    if risk := figures.get("risk"):
        people = f"behaviour model {risk['behaviour']['name']}"
        basis |= {f"risk_{one['scale']:g}": f"{one['method']}; {people}" for one in risk["scales"]}
    if price := figures.get("price_of_caution"):
        runs = formats.counted(len(price["runs"]), "harmless run")
        basis["time_lost"] = "; ".join(filter(None, (runs, formats.beside(AT_THE_TOP["time_lost"], figures))))
    special: dict[str, dict[str, Any]] = {
        "equivalent_multiplier": {
            "clustered": _equivalent_interval(style, figures, CI95),
            "plain": _equivalent_interval(style, figures, THESE_PHI),
        },
        "optimality_gap": {"alert": close is not None and close > GAP_WARNING},
        "time_lost": {"note": formats.beside(AT_THE_TOP["time_lost"], figures)},
    }
    if figures["skd"] is None:
        special["skd"] = {"value": "none kept" if figures["discarded_by_distance"] else "no kamikaze found"}
    for one in shown_in("summary"):
        if one.first:
            row = _row(style, one, figures, main=True, basis=basis.get(one.key, ""))
            yield replace(row, **special.get(one.key, {}))


def _row(style: formats.Style, one: Figure, figures: Mapping[str, Any], **rest: Any) -> FigureRow:
    """Return the row of a figure, as the table of figures has it."""
    return FigureRow(
        one.title, style.value(one, figures), style.by_phi(one, figures), style.independent(one, figures), **rest
    )


def _further(style: formats.Style, figures: Mapping[str, Any], of: Of, basis: str = "") -> list[FigureRow]:
    """Return figures that need no words of their own."""
    found = [one for one in shown_in("details") if one.of is of and one.key in figures]
    return [_row(style, one, figures, basis=formats.beside(one, figures) or basis) for one in found]


def _margin_basis(figures: Mapping[str, Any]) -> str:
    """Return how the margin was come by, in a few words."""
    if figures["margin"] is None:
        return str(figures["margin_note"] or "not known")
    how = "exact" if figures["margin_budget"] is None else "found by search"
    how = how if figures["margin_converged"] else "not converged"
    phis = formats.counted(len(figures["per_safe_trajectory"]), "φ")
    return f"{how}; {formats.counted(figures['margin_trials'], 'trial')} over {phis}"


def _margin_details(figures: Mapping[str, Any], style: formats.Style) -> Iterator[FigureRow]:
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
    runs = formats.counted(figures["collision_runs"], "run") + _walked_into(figures["collision_standing_contacts"])
    yield _row(style, AT_THE_TOP["contact_rate"], figures, basis=runs)
    yield from _further(style, figures, Of.CAR)


def _walked_into(count: int) -> str:
    return f"; {count} walked into a standing car" if count else ""


def _planned_details(figures: Mapping[str, Any], style: formats.Style) -> Iterator[FigureRow]:
    if _ranking(figures)["failed"] and figures["deviation"] is not None:
        name = "planned deviation of those that were hit alone (m)"
        yield FigureRow(name, style.number(figures["deviation_of_successes"]))
    for name, found in figures["objectives"].items():
        hit = f"{found['trials'] - found['failed']} of {formats.counted(found['trials'], 'kamikaze')}"
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


def _skd_details(figures: Mapping[str, Any], style: formats.Style) -> Iterator[FigureRow]:
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


def _equivalent_interval(style: formats.Style, figures: Mapping[str, Any], name: str) -> str:
    """Return an interval of the equivalent multiplier, whose ends may lie beyond the sweep."""
    ends = figures.get(f"equivalent_multiplier_{name}") or (None, None)
    own = figures["multiplier"]
    # A basic car is compared with itself, in the same trials: there is no chance in it.
    if own is not None and all(end is not None and abs(end - own) < _SAME_MULTIPLIER for end in ends):
        return "exact by construction"
    text = formats.spoken_interval(figures, f"equivalent_multiplier_{name}_text")
    return style.around.format(*text.strip("[]").split(", ")) if ", " in text else text or style.nothing
