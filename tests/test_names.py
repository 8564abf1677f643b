"""What is chosen by name is asked what it is: nothing outside the registries compares names of what is registered."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from skd_evaluator.measure.distances.measures import MEASURES
from skd_sim.choices.car_dynamics import DYNAMICS
from skd_sim.choices.car_under_test import CONTROLLERS, EXTERNAL
from skd_sim.choices.objective import BOTH, OBJECTIVES
from skd_sim.choices.simulators import SIMULATORS
from skd_sim.encounter.known_scenarios import SCENARIOS

SOURCE = Path(__file__).resolve().parents[1] / "ros_ws" / "src"
MODULES = sorted(path for path in SOURCE.glob("*/*/**/*.py") if path.parts[-2] != "test")
REGISTRIES = {
    "skd_sim/choices/car_under_test.py",
    "skd_sim/choices/objective.py",
    "skd_sim/choices/simulators.py",
}  # each knows its own names, and no others
NAMES = {*CONTROLLERS.own, EXTERNAL, *DYNAMICS, *OBJECTIVES.own, BOTH, *SCENARIOS.own, *MEASURES.own, *SIMULATORS.own}
CLASSES = {"Objective"}  # whose members are such names


def constants(tree: ast.AST) -> set[str]:
    """Variables that are bound to a registered name, wherever in a module."""
    return {
        target.id
        for node in ast.walk(tree)
        if isinstance(node, (ast.Assign, ast.AnnAssign)) and isinstance(node.value, ast.Constant)
        if node.value.value in NAMES
        for target in (node.targets if isinstance(node, ast.Assign) else [node.target])
        if isinstance(target, ast.Name)
    }


def named(node: ast.AST, variables: set[str]) -> bool:
    """Whether an operand is a registered name, or a collection of which one is."""
    if isinstance(node, ast.Constant):
        return isinstance(node.value, str) and node.value in NAMES
    if isinstance(node, ast.Name):
        return node.id in variables
    if isinstance(node, ast.Attribute):
        return node.attr in variables or (isinstance(node.value, ast.Name) and node.value.id in CLASSES)
    if isinstance(node, (ast.Tuple, ast.List, ast.Set)):
        return any(named(part, variables) for part in node.elts)
    return False


@cache
def parsed(text: str) -> ast.Module:
    return ast.parse(text)


def comparisons(text: str, variables: set[str]) -> Iterator[int]:
    """Yield the line of each comparison with a registered name: ==, !=, in, not in, is, and cases of a match."""
    for node in ast.walk(parsed(text)):
        if isinstance(node, ast.Compare) and any(named(part, variables) for part in (node.left, *node.comparators)):
            key = isinstance(node.ops[0], (ast.In, ast.NotIn)) and isinstance(node.left, ast.Constant)
            if not key:  # whether a mapping has a key of that name is another question
                yield node.lineno
        elif isinstance(node, ast.MatchValue) and named(node.value, variables):
            yield node.lineno


def test_names_are_compared_nowhere_else():
    assert MODULES
    texts = {str(path.relative_to(SOURCE).as_posix()).split("/", 1)[1]: path.read_text("utf-8") for path in MODULES}
    assert set(texts) >= REGISTRIES
    variables = set().union(*(constants(parsed(text)) for text in texts.values()))
    assert {"DEFAULT", "EXTERNAL", "BOTH", "BASIC"} <= variables
    found = {name: list(comparisons(text, variables)) for name, text in texts.items() if name not in REGISTRIES}
    assert {name: lines for name, lines in found.items() if lines} == {}


@pytest.mark.parametrize(
    "text",
    [
        "a.controller == 'basic'",
        "'cal' != name",
        "name in ('basic', 'cal')",
        "name not in {'external'}",
        "one is Objective.PAPER",
        "episode.objective != objective.Objective.FRECHET",
        "car.controller == car_under_test.EXTERNAL",
        "name == EXTERNAL",
        "match name:\n    case 'frechet':\n        pass",
    ],
)
def test_such_a_comparison_is_found(text):
    assert list(comparisons(text, {"EXTERNAL", "FRECHET"}))


@pytest.mark.parametrize("text", ["name == 'lockstep'", "'deformation' in figures", "x == 'basic, C = 1'"])
def test_another_comparison_is_none(text):
    assert not list(comparisons(text, {"EXTERNAL"}))


KIND = "pedestrian"
"""A kind of road user, and no name of the adversary: that may be of any kind."""


def names_of(node: ast.AST) -> Iterator[str]:
    """Yield what a node of a module names or calls something: variables that are set, arguments, attributes, topics."""
    if isinstance(node, (ast.arg, ast.keyword)):
        yield node.arg or ""
    elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
        yield node.id
    elif isinstance(node, (ast.FunctionDef, ast.ClassDef)):
        yield node.name.lower()
    elif isinstance(node, ast.Attribute):
        yield node.attr
    elif isinstance(node, ast.Constant) and isinstance(node.value, str) and "/" in node.value:
        yield from node.value.split("/")


def test_the_adversary_bears_the_name_of_no_kind():
    found = {
        path.relative_to(SOURCE).as_posix()
        for path in MODULES
        for node in ast.walk(parsed(path.read_text(encoding="utf-8")))
        if KIND in names_of(node)
    }
    assert found == set()  # imports of the kind's module set no name of theirs
