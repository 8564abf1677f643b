"""What two assessments do not have in common: why they are not compared, or how sure a verdict of them is."""

from __future__ import annotations

from typing import Any

from skd_sim.inputs.files import one_line
from skd_sim.options.car_under_test import WORLD

from skd_evaluator.assessment.compare.scenario_difference import (
    FRICTION,
    differences,
    phi_differences,
    scenario_difference,
)
from skd_evaluator.assessment.files.results import StoredResult
from skd_evaluator.assessment.judge.planned_figures import hit_speed
from skd_evaluator.assessment.plan.options import OWN, SYNTHETIC, WALKERS
from skd_evaluator.metrics.aborted import UNDISTURBED, in_one_line, not_credible


def unlike_behaviours(first: StoredResult, second: StoredResult) -> str:
    """Return which behaviour models two risks are of; empty where they are of one, or where there is none."""
    both = [one.figures["risk"]["behaviour"] for one in (first, second) if one.figures.get("risk")]
    if len(both) < 2 or both[0] == both[1]:
        return ""
    names = [one_line(str(one["name"])) for one in both]
    if names[0] != names[1]:
        return " and ".join(names)
    differ = list(differences(*both))
    values = [(key.split(".")[1], *values) for key, *values in differ if key.endswith(".value")]
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
    simulators = [_simulator(one) for one in (first, second)]
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
    why = "made against each car" if kind == OWN else "others of one set"
    if kind in (SYNTHETIC, WALKERS):
        why = _why_generated(first, second)
    between = f"{first.folder} and {second.folder}"
    return [f"{between} are of different φ, {why}: compared as two samples, which takes more φ to tell apart"]


def _why_generated(first: StoredResult, second: StoredResult) -> str:
    """Return why two sets of generated φ are not the same: they follow from seed, scenario and version of SKD."""
    if first.figures["seed"] != second.figures["seed"]:
        return "of different seeds"
    if differ := phi_differences(first.scenario, second.scenario):
        return "made where " + ", ".join(f"{key} is {here} and {there}" for key, here, there in differ)
    if first.figures["version"] != second.figures["version"]:
        return "made by different versions of SKD"
    return "though of one seed and one scenario"


def _simulator(result: StoredResult) -> str:
    return str((result.figures.get("options") or {}).get("simulator", WORLD))


def warnings_of(result: StoredResult) -> list[str]:
    """Return the warnings of an assessment about itself, each in one line."""
    return in_one_line(result.figures.get("warnings") or ())
