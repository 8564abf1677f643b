"""Whether figures of planned kamikazes can be compared: they depend on the car *and* on who planned against it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from skd_sim.options.adversary import RANKING_OBJECTIVES, SKD_OBJECTIVES, first_of
from skd_sim.options.options import FIELDS, EpisodeOptions, options_of

from skd_evaluator.assessment.judge.figure_table import Of, keys_of

PLANNED = keys_of(Of.RANKING, Of.SKD)
"""Figures of planned kamikazes; all others are of the car alone."""
OF_SKD = keys_of(Of.SKD)
"""Those of them that are of the kamikazes that SKD is of."""

_PLANNING = tuple(one for one in options_of(EpisodeOptions) if one.planning and one.name not in {*FIELDS, "knowledge"})


def hit_speed(figures: Mapping[str, Any]) -> float:
    """Return the speed of the car from which on a collision counted as a hit, m/s; 0 in old results, where any did."""
    return float(figures["scenario"]["collision"].get("hit_speed", 0.0))


def unlike_plans(figures: Iterable[Mapping[str, Any]]) -> str:
    """Return how the planned kamikazes of some results differ, in a few words; empty if they can be compared.

    Args:
        figures: content of each assessment.json, under the keys of today.
    """
    known = [
        {
            "knowledge of the car": str(one["knowledge"]),
            "objective": first_of(RANKING_OBJECTIVES, one["objectives"]),
            "η_max (m)": f"{one['eta_max']:g}",
            "hit speed (m/s)": f"{hit_speed(one):g}",
            "maximum distance (m)": _or_none(one.get("maximum_distance")),
            **_planning(one.get("options") or {}),
        }
        for one in figures
    ]
    return _unlike(known)


def unlike_skd(figures: Iterable[Mapping[str, Any]]) -> str:
    """Return how the kamikazes that give SKD differ, beside `unlike_plans`; empty if they do not."""
    return _unlike([{"objective": first_of(SKD_OBJECTIVES, one["objectives"])} for one in figures])


def unlike_rows(rows: Iterable[Mapping[str, Any]]) -> str:
    """Return how the planned kamikazes of a campaign's rows differ, as `unlike_plans`; only rows with figures count.

    Args:
        rows: rows of a campaign, each with the further options of its cell as `options`.
    """
    known = [
        {
            "knowledge of the car": str(row["knowledge"]),
            "objective": str(row["ranking_objective"]),
            "η_max (m)": f"{row['eta_max']:g}",
            **_planning(row["options"]),
        }
        for row in rows
        if row["eta_max"] is not None
    ]
    return _unlike(known)


def _planning(options: Mapping[str, Any]) -> dict[str, str]:
    """Return by what else kamikazes were planned, by name: all further options that change what is planned."""
    return {one.name.replace("_", " "): _text(options.get(one.name, one.plain(one.default))) for one in _PLANNING}


def _text(value: Any) -> str:
    """Return the value of an option in words; 0 stands for what is usual."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    return str(value or "the usual number")


def _unlike(known: list[dict[str, str]]) -> str:
    """Return the names whose values differ, each with these in their first order."""
    found = []
    for name in known[0] if known else ():
        values = list(dict.fromkeys(one[name] for one in known))
        if len(values) > 1:
            found.append(f"{name} {', '.join(values[:-1])} and {values[-1]}")
    return "; ".join(found)


def _or_none(value: float | None) -> str:
    return "none" if value is None else f"{value:g}"
