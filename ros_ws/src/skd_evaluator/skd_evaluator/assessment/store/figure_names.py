"""Figures of assessment.json by name, as `deviation` or `objectives.paper.skd`: which there are, and their values."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Mapping
from typing import Any

from skd_sim.errors import UsageError
from skd_sim.inputs.suggestion import did_you_mean

from skd_evaluator.assessment.judge.figure_table import AT_THE_TOP, OF_OBJECTIVES, Of, keys_of
from skd_evaluator.assessment.store.schema import assessment_schema

_ANY = "*"


@functools.cache
def scalar_figures() -> Mapping[str, tuple[float, float]]:
    """Return the names of all figures that are one number, and from what to what they can be, as far as that is said.

    `*` stands for what is named in the file alone.
    """
    schema = assessment_schema()
    settings = keys_of(Of.SETTING)  # numbers that were asked for, or say nothing about the car
    return {name: span for name, span in _scalars(schema, schema["$defs"], ()) if name not in settings}


def span_of(name: str) -> tuple[float, float]:
    """Return from what to what a figure can be, as far as that is said.

    Args:
        name: name of a figure that there is.
    """
    words = name.split(".")
    low, high = next(span for one, span in scalar_figures().items() if _fits(words, one.split(".")))
    row = (OF_OBJECTIVES if words[0] == "objectives" else AT_THE_TOP).get(words[-1])
    return (max(low, 0.0) if row is not None and row.kind.unit == "m" else low), high  # no length is below 0


def _scalars(
    node: Mapping[str, Any], definitions: Mapping[str, Any], path: tuple[str, ...]
) -> Iterator[tuple[str, tuple[float, float]]]:
    if "$ref" in node:
        node = definitions[node["$ref"].rpartition("/")[2]]
    for branch in node.get("anyOf", ()):
        yield from _scalars(branch, definitions, path)
    kinds = node.get("type", ())
    kinds = {kinds} if isinstance(kinds, str) else set(kinds)
    if kinds & {"number", "integer"}:
        yield ".".join(path), (node.get("minimum", -math.inf), node.get("maximum", math.inf))
    for key, value in node.get("properties", {}).items():
        yield from _scalars(value, definitions, (*path, key))
    for key in ("additionalProperties", "items"):
        inside = node.get(key)
        if isinstance(inside, Mapping) and "maxItems" not in node:  # an interval is not one number
            yield from _scalars(inside, definitions, (*path, _ANY))


def check_figure(name: str) -> None:
    """Refuse a name that no figure can have.

    Raises:
        UsageError: it is so; the line says which one is near.
    """
    words = name.split(".")
    known = scalar_figures()
    if any(_fits(words, one.split(".")) for one in known):
        return
    near = did_you_mean(name, [_filled(one, words) for one in known])
    raise UsageError(f"assessment.json has no figure {name!r} that is one number{near}")


def _fits(words: list[str], pattern: list[str]) -> bool:
    return len(words) == len(pattern) and all(
        wanted in (_ANY, word) for word, wanted in zip(words, pattern, strict=True)
    )


def _filled(pattern: str, words: list[str]) -> str:
    """Return a name with what was given in the places that may be anything."""
    parts = pattern.split(".")
    return ".".join(words[i] if part == _ANY and i < len(words) else part for i, part in enumerate(parts))


def figure(result: Mapping[str, Any], name: str) -> float | None:
    """Return a figure; None where it is not defined, or the file has none of this name.

    An equivalent multiplier beyond all C that were compared is infinite.
    """
    value: Any = result
    for word in name.split("."):
        if isinstance(value, list) and word.isdigit() and int(word) < len(value):
            value = value[int(word)]
        else:
            value = value.get(word) if isinstance(value, Mapping) else None
    if value is None and name == "equivalent_multiplier":
        side = (result["equivalent_multiplier_text"] or "").partition(" ")[0]
        return {"above": math.inf, "below": -math.inf}.get(side)
    return float(value) if isinstance(value, (int, float)) and not isinstance(value, bool) else None
