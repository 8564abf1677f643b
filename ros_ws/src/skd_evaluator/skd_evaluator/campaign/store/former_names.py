"""Results of before: the keys that assessment.json had then, and what they are called today.

Results of before the adversary was called so have its section in the scenario under another name, which
`skd_sim.former_names` knows. Those of before the margin have other figures. A measure was renamed since.

Before, a plain `…_ci95` took attempts, pairs or runs as independent, and `…_ci95_clustered` was the interval by φ;
today the plain one is by φ. So the same key had another meaning, and has to be translated before anybody looks at it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from skd_sim.choices.car_under_test import CarUnderTest
from skd_sim.choices.knowledge import Knowledge, implied_knowledge
from skd_sim.choices.objective import SKD_OBJECTIVES, first_of
from skd_sim.former_names import scenario_of_today

from skd_evaluator.campaign.judge.figure_table import CI95, FIGURES, Of, keys_of

NOTE = "a result of before the margin"
"""Why a result that was translated has no margin."""
TODAYS = ("margin", "margin_note", "deformation_ci95_attempts")
"""Keys that every result has today, whatever of them is null, and that none had before."""
MEASURES_OF_TODAY = {"required_deceleration": "required_deceleration_at_entry"}
"""Measures of pairs that were called otherwise: the greatest required deceleration of an episode is another figure."""
_OF_BEFORE = "_ci95_clustered"
"""In names of keys that there were before, and are no more."""
_INDEPENDENT = {one.key: one.independent for one in FIGURES if one.independent not in ("", CI95)}
"""Figures with both intervals, and the end of the key, today, of what then was the plain one."""
_FLOOR = ("floor", "floor_ci95", "floor_missing")
_DROPPED = ("floor_of_all", "floor_of_all_ci95", "floor_gap", "floor_budget")
_DROPPED_AT_THE_TOP = (
    "deformation_floor",
    "deformation_floor_ci95",
    "deformation_closeness",
    "deformation_closeness_ci95",
)
_EQUIVALENT = ("", "_text", "_ci95", "_ci95_text", "_ci95_these_phi", "_ci95_these_phi_text")
_NEEDED = ("objectives", "measures", "probability_bound")
_NEEDED_OF_OBJECTIVES = ("plans_deformation", "measures", "probability_bound")
"""Keys without which a result of before the margin is of the first versions, which this one cannot read."""


class OlderResultError(ValueError):
    """A result is of a version whose figures this one cannot tell; the message says which, and what to do."""


def of_today(figures: Mapping[str, Any]) -> dict[str, Any]:
    """Return the content of an assessment.json under the keys of today, whichever it was written with.

    What has no counterpart is null or left out: the least deformation of *pairs* that `--floor` gave is no margin, and
    an equivalent multiplier that was read off planned deformations is none of margins. Of no older file it is said what
    the adversary knew of the car; that follows from the car and its model.

    Args:
        figures: content of the file; it is not changed.

    Raises:
        OlderResultError: it is of a version that cannot be translated.
        ValueError: it has keys of both, or only some of today's: nobody can tell what its intervals are.
    """
    present = [name for name in TODAYS if name in figures]
    before = next((name for name in figures if _OF_BEFORE in name), None)
    if present and (before is not None or len(present) < len(TODAYS)):
        other = before or f"no {next(name for name in TODAYS if name not in figures)}"
        raise ValueError(f"it has {present[0]} and {other}: its keys are of different versions")
    found = dict(figures) if present else _translated(figures)
    found |= {"measures": _renamed(found["measures"])} if "measures" in found else {}
    if "objectives" in found:
        objectives = {name: {**one, "measures": _renamed(one["measures"])} for name, one in found["objectives"].items()}
        found["objectives"] = objectives
    found["knowledge"] = str(knowledge_of(figures))
    if "scenario" in found:
        found["scenario"] = scenario_of_today(found["scenario"], "scenario")
    return found


def knowledge_of(figures: Mapping[str, Any]) -> Knowledge:
    """Return what the adversary of a result knew of the car.

    Raises:
        ValueError: it says something that there is not.
    """
    if figures.get("knowledge") is not None:
        return Knowledge(figures["knowledge"])
    return implied_knowledge(CarUnderTest(str(figures["controller"])), "{}" if figures["car_model"] else "")


def _translated(figures: Mapping[str, Any]) -> dict[str, Any]:
    """Return a result of before under the keys of today."""
    lacking = [name for name in _NEEDED if name not in figures]
    for one in figures.get("objectives", {}).values():
        lacking += [name for name in _NEEDED_OF_OBJECTIVES if name not in one]
    if lacking and "scenario" in figures:
        git = (figures.get("provenance") or {}).get("git") or {}
        by = f" at revision {git['revision'][:7]}" if git.get("revision") else ""
        raise OlderResultError(
            f"was written by an early SKD {figures.get('version', '')}{by}, when results had no {lacking[0]}: this "
            "version cannot read its figures; run the assessment again, or read it with the SKD that wrote it"
        )
    objectives = {name: _planned(one) for name, one in figures["objectives"].items()}
    of_skd = objectives[first_of(SKD_OBJECTIVES, figures["objectives"])]
    top = {name: value for name, value in figures.items() if name not in _DROPPED_AT_THE_TOP}
    top = {name: value for name, value in top.items() if not name.startswith("equivalent_multiplier")}
    floors = {name: of_skd[name] for name in (*_FLOOR, "floor_ratio", "floor_ratio_ci95")}
    return {
        **dict.fromkeys(keys_of(Of.MARGIN)),
        "margin_note": NOTE,
        **_planned({**top, "plans_deformation": False}, at_the_top=True),
        **floors,
        **_no_equivalent(figures),
        "closeness": None,
        "closeness_ci95": None,
        "hit_rate": None,  # only that somebody was touched was noted, at whatever speed
        "hit_rate_ci95": None,
        "options": figures.get("options", {}),
        "objectives": objectives,
        "vulnerability_curve": _curves(figures.get("vulnerability_curve")),
    }


def _planned(figures: Mapping[str, Any], *, at_the_top: bool = False) -> dict[str, Any]:
    """Return the figures of kamikazes of one objective, or those at the top, under the keys of today."""
    found = {name: value for name, value in figures.items() if name not in _DROPPED}
    for name, end in _INDEPENDENT.items():
        if f"{name}_ci95" in figures:
            _by_phi_plain(found, figures, name, end)
    found["probability_bound_ci95"] = found.pop(f"probability_bound{_OF_BEFORE}", {}) or dict.fromkeys(
        figures["probability_bound"]
    )
    found["measures"] = {name: _measure(one) for name, one in figures["measures"].items()}
    # The floor of kamikazes that plan for the deformation was one of the deformation, under the same key.
    frechet = not figures["plans_deformation"]
    found |= {name: figures.get(name) if frechet else None for name in _FLOOR}
    for end in ("", "_ci95"):
        found[f"floor_ratio{end}"] = figures.get(f"closeness{end}") if frechet else None
        found.pop(f"closeness{end}", None)
    if at_the_top:
        del found["plans_deformation"]
    return found


def _by_phi_plain(found: dict[str, Any], figures: Mapping[str, Any], name: str, end: str) -> None:
    """Give the interval by φ the plain key, and the other one a name that says what it takes as independent."""
    found[f"{name}_{end}"] = figures[f"{name}_ci95"]
    found[f"{name}_ci95"] = figures.get(f"{name}{_OF_BEFORE}")
    found.pop(f"{name}{_OF_BEFORE}", None)


def _measure(one: Mapping[str, Any]) -> dict[str, Any]:
    rest = {name: value for name, value in one.items() if name not in ("ci95", "ci95_clustered")}
    return {**rest, "ci95_pairs": one["ci95"], "ci95": one.get("ci95_clustered")}


def _renamed(measures: Mapping[str, Any]) -> dict[str, Any]:
    """Return measures of pairs under the names that they have today."""
    names = {name: MEASURES_OF_TODAY.get(name, name) for name in measures}
    labels = {today: today.replace("_", " ") for before, today in names.items() if before != today}
    renamed = {names[name]: one for name, one in measures.items()}
    return renamed | {name: {**renamed[name], "label": label} for name, label in labels.items()}


def _no_equivalent(figures: Mapping[str, Any]) -> dict[str, Any]:
    """Return the entries of an equivalent multiplier that is not known, with what there was in the note."""
    text, note = figures.get("equivalent_multiplier_text"), figures.get("equivalent_multiplier_note", "")
    if text is not None:
        note = f"{NOTE}: {text} was read off planned deformations"
    entries: dict[str, Any] = dict.fromkeys(f"equivalent_multiplier{end}" for end in _EQUIVALENT)
    return {**entries, "equivalent_multiplier_note": note}


def _curves(curves: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """Return the vulnerability curves; that of the floors is none of margins."""
    if curves is None:
        return None
    budgets = [_point(one) for one in curves["budgets"]]
    kamikazes = {**curves["kamikazes"], "points": [_point(one) for one in curves["kamikazes"]["points"]]}
    return {"kamikazes": kamikazes, "budgets": budgets, "margins": None}


def _point(one: Mapping[str, Any]) -> dict[str, Any]:
    rest = {name: value for name, value in one.items() if name not in ("ci95", "ci95_clustered")}
    by_phi = {"ci95": one.get("ci95_clustered")} if "bound" in one else {}
    return {**rest, "ci95_attempts": one["ci95"], **by_phi}
