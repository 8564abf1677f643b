"""The rows of the page's tables of figures, named as on the terminal; nothing is computed anew but Cantelli's bound."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from skd_evaluator.measure.margins import CLOSENESS_WARNING
from skd_evaluator.measure.statistics.statistics import cantelli_bound
from skd_evaluator.report.formats import NOTHING, counted, interval, number, percent, percent_interval
from skd_evaluator.report.html.subjects import Subject

_SAME_MULTIPLIER = 1e-9


@dataclass(frozen=True)
class Row:
    """A figure with its intervals.

    Attributes:
        name: of the figure.
        value: of it.
        clustered: its 95 % interval by φ.
        plain: its 95 % interval with attempts, pairs or runs taken as independent of one another.
        basis: of how many it is.
        main: it is one of those that are read first.
        alert: it is one that a warning is about.
    """

    name: str
    value: str
    clustered: str = NOTHING
    plain: str = NOTHING
    basis: str = ""
    main: bool = False
    alert: bool = False


def figure_rows(subject: Subject) -> list[Row]:
    """Return the figures of a car: those that are read first, in the order of the terminal, then others."""
    return [*_first_rows(subject), *_margin_details(subject), *_planned_details(subject), *_skd_details(subject)]


def _first_rows(subject: Subject) -> list[Row]:
    figures, ranking = subject.figures, subject.ranking
    phis = counted(len(figures["per_safe_trajectory"]), "φ")
    eta_max = f"{figures['eta_max']:g} m"
    speed, knowledge = figures["impact_speed"], figures.get("knowledge")
    skd = "none kept" if figures["discarded_by_distance"] else "no kamikaze found"
    close = figures["closeness"]
    rows = [
        Row("margin (m)", number(figures["margin"]), interval(figures["margin_ci95"]), basis=_margin_basis(figures)),
        Row(
            "equivalent multiplier C",
            figures["equivalent_multiplier_text"] or NOTHING,
            _equivalent_interval(figures, "ci95"),
            _equivalent_interval(figures, "ci95_these_phi"),
            figures["equivalent_multiplier_note"] or "the basic car with the same margin on the same φ",
        ),
        Row(
            "hit along φ",
            percent(figures["hit_rate"]),
            percent_interval(figures["hit_rate_ci95"]),
            basis=f"{counted(figures['collision_runs'], 'run')} over {phis}, in which nobody planned",
        ),
        Row(
            "impact speed (m/s)",
            NOTHING if speed is None else number(speed["mean"], 1),
            basis="" if speed is None else f"90 % below {speed['p90']:.1f} m/s; of the ways of the margin",
        ),
        Row(
            "planned deformation (m)",
            number(figures["deformation"]),
            interval(figures["deformation_ci95"]),
            interval(figures["deformation_ci95_attempts"]),
            f"{f'knowledge: {knowledge}; ' if knowledge else ''}{counted(ranking['attempts'], 'attempt')} over {phis}; "
            f"{ranking['failed']} not hit, counted as {eta_max}",
        ),
        Row(
            "closeness, planned / margin",
            number(close, 2),
            interval(figures["closeness_ci95"], 2),
            basis="how many times the margin planned kamikazes needed, in the same attempts",
            alert=close is not None and close > CLOSENESS_WARNING,
        ),
        Row(
            "SKD (m)",
            skd if figures["skd"] is None else number(figures["skd"]),
            interval(figures["skd_ci95"]),
            interval(figures["skd_ci95_pairs"]),
            f"{percent(figures['kamikaze_success_rate'])} of attempts collide; {counted(figures['pairs'], 'pair')} "
            f"over {phis}",
        ),
    ]
    return [replace(row, main=True) for row in rows]


def _margin_basis(figures: Mapping[str, Any]) -> str:
    """Return how the margin was come by, in a few words."""
    if figures["margin"] is None:
        return str(figures["margin_note"] or "not known")
    how = "exact" if figures["margin_budget"] is None else "found by search"
    how = how if figures["margin_converged"] else "not converged"
    phis = counted(len(figures["per_safe_trajectory"]), "φ")
    return f"{how}; {counted(figures['margin_attempts'], 'attempt')} over {phis}"


def _margin_details(subject: Subject) -> list[Row]:
    figures = subject.figures
    rows = []
    if figures["margin"] is not None:
        if figures["margin_budget"] is not None:
            stopped = "converged" if figures["margin_converged"] else "not converged"
            name = "margin: ticks of the car searched, per attempt"
            rows.append(Row(name, f"{figures['margin_budget']:,}", basis=stopped))
        elif figures["margin_gap"]:
            rows.append(Row("margin: the least is at most this much less (m)", number(figures["margin_gap"], 4)))
        if figures["margin_how"]:
            rows.append(Row("margin: what was searched", "", basis=str(figures["margin_how"])))
        name = f"margin: attempts in which nobody is hit within {figures['eta_max']:g} m"
        rows.append(Row(name, f"{figures['margin_beyond']} of {figures['margin_attempts']}"))
    walked = figures["collision_standing_contacts"]
    rows.append(
        Row(
            "collisions along φ, any touch",
            percent(figures["collision_rate"]),
            percent_interval(figures["collision_rate_ci95"]),
            percent_interval(figures["collision_rate_ci95_runs"]),
            counted(figures["collision_runs"], "run") + (f"; {walked} walked into a standing car" if walked else ""),
        )
    )
    return rows


def _planned_details(subject: Subject) -> list[Row]:
    figures, ranking = subject.figures, subject.ranking
    rows = []
    if ranking["failed"] and figures["deformation"] is not None:
        rows.append(
            Row("planned deformation of those that were hit alone (m)", number(figures["deformation_of_successes"]))
        )
    for name, found in figures["objectives"].items():
        tried = f"{found['attempts'] - found['failed']} of {counted(found['attempts'], 'attempt')}"
        walked = f"; {found['standing_contacts']} walked into a standing car" if found["standing_contacts"] else ""
        rows.append(
            Row(
                f"success rate, {name}",
                percent(found["success_rate"]),
                percent_interval(found.get("success_rate_ci95")),
                percent_interval(found.get("success_rate_ci95_attempts")),
                f"{tried} {'were hit' if found['plans_deformation'] else 'collided'}{walked}",
            )
        )
    for one in figures["measures"].values():
        if one["shown"] and not one["error"]:
            name = f"{one['label']} ({one['unit']})" if one["unit"] else one["label"]
            undefined = f"{one['undefined']} pairs without" if one["undefined"] else ""
            rows.append(Row(name, number(one["mean"]), interval(one["ci95"]), interval(one["ci95_pairs"]), undefined))
    return rows


def _skd_details(subject: Subject) -> list[Row]:
    figures = subject.figures
    rows = [
        Row(
            "prefix distance (m)",
            number(figures["skd_prefix"]),
            interval(figures.get("skd_prefix_ci95")),
            interval(figures["skd_prefix_ci95_pairs"]),
            "as SKD, φ cut at the duration of ψ",
        )
    ]
    if figures["floor"] is not None:
        rows += [
            Row(
                "clairvoyant floor (m)",
                number(figures["floor"]),
                plain=interval(figures["floor_ci95"]),
                basis="least Fréchet distance in the episodes of the pairs",
            ),
            Row("SKD / floor", number(figures["floor_ratio"], 2), plain=interval(figures["floor_ratio_ci95"], 2)),
        ]
    rows.append(
        Row("mean impact speed of these (m/s)", number(figures["mean_impact_speed"], 2), basis="of the pairs of SKD")
    )
    for eta, bound in figures["probability_bound"].items() if figures["skd"] is not None else ():
        known = figures["probability_bound_ci95"][eta]
        sharper = cantelli_bound(float(eta), figures["skd"], figures["variance"])
        of = "of these kamikazes, from mean and variance of their distances"
        rows += [
            Row(f"P(d ≤ {eta} m) at most, Theorem 1", number(bound), interval(known), basis=of),
            Row(f"P(d ≤ {eta} m) at most, Cantelli", number(sharper), basis="likewise; never above Theorem 1"),
        ]
    return rows


@dataclass(frozen=True)
class Bound:
    """What mean and variance alone say of a point of the vulnerability curve, beside what was found.

    Attributes:
        eta: η, m.
        found: P(η).
        theorem: Theorem 1's bound of it.
        cantelli: Cantelli's.
    """

    eta: str
    found: str
    theorem: str
    cantelli: str


_EVERY = 5
"""One in so many points of the curve is in the table of bounds."""


def bounds_of(subject: Subject) -> list[Bound]:
    """Return the bounds of the curve that is drawn, up to where they say nothing; none where they are not known."""
    curve = (subject.curve or {}).get("margins") or (subject.curve or {}).get("kamikazes")
    points = curve["points"][::_EVERY] if curve else []
    return [
        Bound(f"{one['eta']:.2f}", number(one["probability"]), number(one["bound"]), number(one["cantelli"]))
        for one in points
        if "cantelli" in one and one["cantelli"] < 1.0
    ]


def _equivalent_interval(figures: Mapping[str, Any], name: str) -> str:
    """Return an interval of the equivalent multiplier, whose ends may lie beyond the sweep."""
    ends = figures.get(f"equivalent_multiplier_{name}") or (None, None)
    own = figures["multiplier"]
    # A basic car is compared with itself, in the same attempts: there is no chance in it.
    if own is not None and all(end is not None and abs(end - own) < _SAME_MULTIPLIER for end in ends):
        return "exact by construction"
    return str(figures.get(f"equivalent_multiplier_{name}_text") or NOTHING).strip("[]").replace(", ", " to ")
