"""Whether two assessments can be compared, in all or in part: what they do not have in common."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from skd_sim.inputs.files import one_line
from skd_sim.options.car_and_adversary import BASIC, DYNAMICS, RANKING_OBJECTIVES, SKD_OBJECTIVES, WORLD, first_of
from skd_sim.options.options import FIELDS, PLANNING, EpisodeOptions, options_of

from skd_evaluator.assessment.figure_table import Of, keys_of
from skd_evaluator.assessment.files.episode_store import changes
from skd_evaluator.assessment.files.results import StoredResult
from skd_evaluator.metrics.aborted import UNDISTURBED, in_one_line, not_credible

PLANNED = keys_of(Of.RANKING, Of.SKD)
"""Figures of planned kamikazes; all others are of the car alone."""
OF_SKD = keys_of(Of.SKD)
"""Those of them that are of the kamikazes that SKD is of."""

_PLANNING = tuple(
    one
    for one in options_of(EpisodeOptions)
    if PLANNING in one.marks and one.name not in {*FIELDS, "adversary_model", "steers"}
)


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
            "adversary model": str(one["adversary_model"]),
            "objective": first_of(RANKING_OBJECTIVES, one["objectives"]),
            "η_max (m)": f"{one['eta_max']:g}",
            "hit speed (m/s)": f"{hit_speed(one):g}",
            "maximum distance (m)": "none" if (most := one.get("maximum_distance")) is None else f"{most:g}",
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
            "adversary model": str(row["adversary_model"]),
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


_SAYS_NOTHING = frozenset({"name", "description", "sensor", "control_period"})
"""Keys of a scenario that say nothing about the scenario, and on which no safe trajectory depends."""
_FREE = (
    _SAYS_NOTHING
    | {f"car.{key}" for key in ("front", "rear", "width", "deceleration", "speed_noise", "acceleration_noise")}
    | {f"car.{key}" for key in ("dynamics", "brake_delay", "brake_rate", "brake_limit", "antilock")}
)
"""Keys of a scenario that are the car's own, or say nothing about the scenario."""
FRICTION = "road.friction"

Different = tuple[str, Any, Any]
"""A key, with its value in each of two scenarios."""


def scenario_difference(one: Mapping[str, Any], other: Mapping[str, Any]) -> Different | None:
    """Return the first key in which two scenarios differ, with its value in each; None if they are the same.

    The road's friction is of the scenario where both cars have tyres: only they feel it. A car without tyres has no
    other than 1.

    Args:
        one: a scenario as plain data.
        other: the other scenario, in the same form.
    """
    tyres = all(DYNAMICS[str(scenario["car"].get("dynamics", BASIC))].tyres for scenario in (one, other))
    free, found = _FREE if tyres else _FREE | {FRICTION}, changes(one, other)
    compared = (key for key in sorted(found) if free.isdisjoint((key, key.partition(".")[0])))
    return next(((key, *found[key]) for key in compared), None)


def unlike_behaviours(first: StoredResult, second: StoredResult) -> str:
    """Return which behaviour models two risks are of; empty where they are of one, or where there is none."""
    both = [one.figures["risk"]["behaviour"] for one in (first, second) if one.figures.get("risk")]
    if len(both) < 2 or both[0] == both[1]:
        return ""
    names = [one_line(str(one["name"])) for one in both]
    if names[0] != names[1]:
        return " and ".join(names)
    differ = sorted(changes(*both).items())
    values = [(key.split(".")[1], *values) for key, values in differ if key.endswith(".value")]
    said = ", ".join(f"{name} is {here} and {there}" for name, here, there in values) or f"other {differ[0][0]}"
    return f"both called {names[0]} ({said})"


def shared(first: StoredResult, second: StoredResult) -> list[tuple[int, int]]:
    """Return the places of the φ that both have, each counted once."""
    places: dict[bytes, list[int]] = {}
    for index, one in reversed(list(enumerate(second.safe))):
        places.setdefault(one.tobytes(), []).append(index)
    found = [(index, places.get(one.tobytes())) for index, one in enumerate(first.safe)]
    return [(index, left.pop()) for index, left in found if left]


def refusals(first: StoredResult, second: StoredResult) -> list[str]:
    """Return why a difference between two assessments would say nothing about their cars, a line each."""
    between = f"{first.folder} and {second.folder}"
    ours, theirs = first.figures, second.figures
    found = [
        f"{one.folder} is not compared, for its own assessment failed: {line}"
        for one in (first, second)
        for line in not_credible(warnings_of(one))
    ]
    if ours["eta_max"] != theirs["eta_max"]:
        found.append(f"{between} have different η_max, {ours['eta_max']:g} and {theirs['eta_max']:g}")
    if all("margin" in one.groups for one in (first, second)) and hit_speed(ours) != hit_speed(theirs):
        found.append(f"{between} have different hit speeds, {hit_speed(ours):g} and {hit_speed(theirs):g} m/s")
    if differs := scenario_difference(*(_scenario(one) for one in (first, second))):
        key, here, there = differs
        found.append(f"{between} are of different scenarios: {key} is {here} and {there}")
    kinds = ours["safe"], theirs["safe"]
    if kinds[0] != kinds[1] and not shared(first, second):
        found.append(f"{between} are of different φ, from {kinds[0]} and {kinds[1]}: their metres do not compare")
    return found


def _scenario(result: StoredResult) -> dict[str, Any]:
    """Return a result's scenario with every key of today, except for those that are compared separately."""
    scenario = result.scenario
    collision = {key: value for key, value in scenario["collision"].items() if key != "hit_speed"}
    return {**{key: value for key, value in scenario.items() if key != "eta_max"}, "collision": collision}


def warnings(first: StoredResult, second: StoredResult) -> list[str]:
    """Return what makes a difference between two assessments less certain than it looks, a line each."""
    between = f"{first.folder} and {second.folder}"
    found = []
    ours, theirs = first.figures, second.figures
    simulators = [str((one.get("options") or {}).get("simulator", WORLD)) for one in (ours, theirs)]
    if simulators[0] != simulators[1]:
        said = f"{simulators[0]} and {simulators[1]}"
        found.append(f"{between} are of different simulators, {said}: what differs may be these and not the cars")
    for name, what in (("seed", "seeds"), ("simulations", "budgets of the planner"), ("version", "versions of SKD")):
        if ours.get(name) != theirs.get(name):
            found.append(f"{between} have different {what}, {ours.get(name)} and {theirs.get(name)}")
    return found + [
        f"{one.folder}: {line}" for one in (first, second) for line in warnings_of(one) if line.startswith(UNDISTURBED)
    ]


def different_roads(first: StoredResult, second: StoredResult) -> list[str]:
    """Return a line that says so where roads differ in friction and a car has no tyres; see `scenario_difference`."""
    here, there = (float(one.scenario["road"]["friction"]) for one in (first, second))
    between = f"{first.folder} and {second.folder}"
    said = f"{FRICTION} is {here:g} and {there:g}, and one of the cars has no tyres to feel it"
    return [] if here == there else [f"{between} are of different roads: {said}"]


def different_phi(first: StoredResult, second: StoredResult) -> list[str]:
    """Return a line that says why two assessments of one kind of φ are of different ones; none if they are not."""
    kind = first.figures["safe"]
    if kind != second.figures["safe"] or len(shared(first, second)) == min(len(first.safe), len(second.safe)):
        return []
    between = f"{first.folder} and {second.folder}"
    return [f"{between} are of different φ: compared as two samples, which takes more φ to find a difference"]


def warnings_of(result: StoredResult) -> list[str]:
    """Return the warnings of an assessment about itself, each in one line."""
    return in_one_line(result.figures.get("warnings") or ())
