"""assessment.json: its JSON Schema, which the table of figures gives, its reader, and its figures by name.

`python -m skd_evaluator.assessment.files.assessment_json` prints the schema.
"""

from __future__ import annotations

import functools
import json
import math
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from skd_sim.errors import UsageError
from skd_sim.inputs.files import did_you_mean, read_json

from skd_evaluator.assessment import figure_table as table
from skd_evaluator.assessment.episode_figures import StaticTest
from skd_evaluator.assessment.failures import Failures
from skd_evaluator.assessment.figure_table import AT_THE_TOP, OF_OBJECTIVES, OF_PHI, PROBABILITY, Figure, Of, keys_of
from skd_evaluator.metrics.aborted import value_of
from skd_evaluator.metrics.clustered import Clustered
from skd_evaluator.metrics.entry import Schema, object_of, or_null, ref
from skd_evaluator.metrics.margins import Excess, ReferenceMargin
from skd_evaluator.metrics.measures import Measured
from skd_evaluator.metrics.risks import Risks
from skd_evaluator.metrics.sample_size import UntilWidth
from skd_evaluator.metrics.surrogate_measures import SURROGATE_MEASURES
from skd_evaluator.metrics.vulnerability_curve import Vulnerability

_KINDS: Mapping[str, Schema] = {
    "number": ref("number"), "figure": table.NUMBER.schema, "share": table.SHARE.schema,
    "interval": table.INTERVAL.schema, "count": table.COUNT.schema, "flag": table.FLAG.schema,
    "text": table.TEXT.schema, "time": {"type": "number", "minimum": 0},
    "digest": {"type": "string", "pattern": "^[0-9a-f]{64}$"},
}  # fmt: skip


def _object(**properties: Schema | str) -> dict[str, Any]:
    """Return the schema of an object that has just these, each a schema or its kind and what it is."""
    found = {}
    for key, one in properties.items():
        kind, _, says = one.partition(" ") if isinstance(one, str) else ("", "", "")
        found[key] = {**_KINDS[kind], "description": says} if isinstance(one, str) else one
    return object_of(found)


def _list(items: Schema) -> dict[str, Any]:
    return {"type": "array", "items": items}


def _clusterings(rows: Iterable[table.Figure]) -> dict[str, Any]:
    return _object(**{one.key: _said(or_null(ref("clustering")), f"of {one.key}") for one in rows if one.clustered})


def _pair(says: str, end: str) -> dict[str, Any]:
    return {"description": says, "type": ["array", "null"], "items": ref(end), "minItems": 2, "maxItems": 2}


def _said(schema: Schema, says: str) -> dict[str, Any]:
    return {**schema, "description": says}


_OF_PHI = {
    "deviation": "mean planned deviation on φ, m", "deviation_of_successes": "of the trials with a hit, m",
    "skd": "mean discrete Fréchet distance, m", "skd_prefix": "mean prefix distance, m", "pairs": "pairs (φ, ψ)",
}  # fmt: skip


# fmt: off
def _definitions() -> dict[str, Any]:
    of_phi = {key: _said(one.kind.schema, _OF_PHI[key]) if one.per_phi else one.described()
              for key, one in OF_PHI.items()}
    at_the_top = {one.key: one.described() for one in table.FIGURES if one.of is Of.PHI_TOP}
    parameter = _object(value="number as in its file", source="text of the value",
                        interval_95="interval 95 % interval of the parameter")
    parameters = {"type": "object", "additionalProperties": {**parameter, "required": ["value", "source"]}}
    risk = Risks.schema()
    risk["properties"]["behaviour"] = _said(_object(
        name="text of the behaviour model", kind="text of road user", description="text in words",
        parameters=_said(parameters, "of the behaviour model, by name")), "as in its file")
    risk["properties"]["failures"] = _said(or_null(Failures.schema()), "the most likely failures; null: no hit")
    git = or_null(_object(revision={"type": "string", "pattern": "^[0-9a-f]{40,64}$", "description": "commit"},
                          modified="flag whether files of the checkout differ from it"))
    pairs = _said(_list(_list(ref("number"))), "pairs of position, 0 to 1, and acceleration, m/s²")
    return {
        "number": {"type": "number"},
        "number_or_null": {"type": ["number", "null"]},
        "rate": {"type": ["number", "null"], "minimum": 0, "maximum": 1},
        "interval": _pair("[low, high]; null where it is not defined", "number"),
        "open_interval": _pair("[low, high]; an end beyond what was compared is null", "number_or_null"),
        "speeds": _object(mean="number m/s", p90="number 90 % quantile, m/s"),
        "aborted_reason": _object(count="count episodes", first="text reason of the first of them"),
        "commands_clipped": _object(commands="count how many", episodes="count in how many episodes"),
        "simulator_contacts": _object(
            both="count episodes in which both see a contact",
            geometry_alone="count in which SKD's geometry alone does",
            simulator_alone="count in which the simulator's shapes alone do",
            episodes="count episodes that were compared; aborted ones left out",
            greatest_gap="figure greatest time between the two contacts, s"),
        "simulation": {"type": "object", "properties": _object(
            version="text of the simulator", physics_step="number s", mass="number of the car, kg",
            wheel_friction="number coefficient of friction of a wheel",
            limits=_said(_list(ref("number")), "least and greatest acceleration along the car's heading, m/s²"),
            pedals={"type": "object", "properties": _object(
                brake=pairs, throttle=pairs, coasting="number acceleration without a pedal, m/s²")["properties"],
                "description": "acceleration along the heading by pedal position, as measured, m/s²"})["properties"]},
        "command_age": _object(
            median="time s", p99="time 99 % quantile, s", worst="time s",
            control_periods="count how many there were", held="count control periods without a new command",
            greatest_delay="number of the simulator behind the clock, s"),
        "measure": Measured.schema(),
        "risk": risk,
        "price_of_caution": _object(
            horizon="number s after which the car has not got past",
            hard_braking="number m/s², that counts as needless", aborted="count runs that were aborted",
            runs=_said(_list(_object(
                kind="text what the road user does", passed="number when the car has got past, s",
                undisturbed="number when it has with the road to itself, s",
                unslowed="number when it would have at its start speed, s",
                braked="flag whether it braked hard here alone",
                lane_left="number for how long a corner was beyond its lane, s")), "each run")),
        "clustering": Clustered.schema(),
        "margin_excess": Excess.schema(),
        "margin_source": _object(
            source="text name", candidates="count that it brought",
            hits="count of them that were better than the best known",
            lowered="number margins by, in all trials together, m"),
        "clusterings": _clusterings(AT_THE_TOP.values()),
        "clusterings_of_objective": _clusterings(OF_OBJECTIVES.values()),
        "until_width": UntilWidth.schema(),
        "reference": ReferenceMargin.schema(),
        "static_test": StaticTest.schema(),
        "safe_trajectory": _object(**of_phi, **at_the_top),
        "safe_trajectory_of_objective": _object(**of_phi),
        "objective": _object(**dict(pair for one in OF_OBJECTIVES.values() for pair in one.schemas())),
        "surrogate_measure": _object(
            median="figure in the measure's unit", worst="figure in the measure's unit",
            defined="count episodes in which it is defined"),
        "surrogates": _object(
            depends_on="text car, road user or both", episodes="count aborted ones left out",
            **{name: _said(ref("surrogate_measure"), one.label + (one.unit and f", {one.unit}"))
               for name, one in SURROGATE_MEASURES.items()}),
        "surrogate_measures": _object(
            along_phi=_said(ref("surrogates"), "of the runs along φ"),
            kamikazes=_said({"type": "object", "additionalProperties": ref("surrogates")}, "by their objective")),
        "vulnerability_curve": Vulnerability.schema(),
        "provenance": _said(_object(
            date={"type": "string", "pattern": "^[0-9]{4}-[0-9]{2}-[0-9]{2}T[0-9]{2}:[0-9]{2}:[0-9]{2}Z$",
                  "description": "when it began, UTC"},
            host="text name of the machine", platform="text operating system and processor", python="text its version",
            command="text command line", folder="text where it ran",
            git=_said(git, "of the checkout that SKD ran from; null: it was installed"),
            controller_files=_said(_list(_object(path="text of the file", sha256="digest of the file")),
                                   "of the controller's module or what its command names, and what is beside it"),
            controller_git=_said(git, "of the checkout that the module, or last file named, is in"),
            car_model_sha256=_said({**_KINDS["digest"], "type": ["string", "null"]},
                                   "of car_model above, as it was given"),
            inputs_sha256=_said({**_KINDS["digest"], "type": ["string", "null"]},
                                "of options, files and versions that it follows from; null: not known"),
        ), "what ran, when and where; nothing in it is a figure, and two equal assessments differ in it"),
    }
# fmt: on


@functools.cache
def assessment_schema() -> dict[str, Any]:
    """Return the JSON Schema of assessment.json; it is not to be changed."""
    figures = _object(**dict(pair for one in AT_THE_TOP.values() for pair in one.schemas()))
    figures["required"] = [key for key in figures["required"] if key not in AT_THE_TOP or not AT_THE_TOP[key].optional]
    interrupted = {"const": True, "description": "only in what an interrupted command prints"}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "assessment.json of SKD",
        "description": "Figures of one car. Lengths in m, times in s, angles in rad; what cannot be computed is null.",
        **figures,
        "properties": {"interrupted": interrupted, **figures["properties"]},
        "$defs": _definitions(),
    }


ASSESSMENT = "assessment.json"


def read_figures(folder: Path) -> dict[str, Any]:
    """Return the content of the assessment.json of a folder.

    Raises:
        UsageError: there is none, it is no JSON, is of another version, or has a value that cannot be there.
    """
    path = folder / ASSESSMENT
    figures: dict[str, Any] = read_json(path)
    if fault := fault_of(figures):
        raise UsageError(f"{path}: no assessment of this version ({fault})")
    return figures


@contextmanager
def understood(path: Path) -> Iterator[None]:
    """Say in one line that a file is no assessment of ours, where that is found while it is used.

    Raises:
        UsageError: a key or an item is not there, or of a kind that nothing can be done with.
    """
    try:
        yield
    except UsageError:
        raise
    except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError, RecursionError) as error:
        said = " ".join(str(error).split())[:120]
        raise UsageError(f"{path}: no assessment of this version ({type(error).__name__}: {said})") from error


def fault_of(figures: Mapping[str, Any]) -> str:
    """Return which value is not as the schema has it, in a few words; empty: all are."""
    from jsonschema import Draft202012Validator  # slow to import, and only what reads results needs it
    from jsonschema.exceptions import best_match

    error = best_match(Draft202012Validator(assessment_schema()).iter_errors(figures))
    if error is None:
        return ""
    where, said = ".".join(map(str, error.absolute_path)), " ".join(error.message.split())[:160]
    return f"{where}: {said}" if where else said


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
    row = _row_of(words)
    return (max(low, 0.0) if row is not None and row.kind.unit == "m" else low), high  # no length is below 0


def better_of(name: str) -> str:
    """Return whether more or less of a figure is better, in a word; empty where neither is."""
    row = _row_of(name.split("."))
    return "" if row is None else row.better.value


def form_of(name: str) -> str:
    """Return the format of a figure, with the digits that tables show of it; a share stays one."""
    if (row := _row_of(name.split("."))) is None:
        return ".6g"
    return f"#.{row.kind.digits}g" if row.kind is PROBABILITY else f"z.{row.kind.digits + 2 * (row.kind.unit == '%')}f"


def _row_of(words: list[str]) -> Figure | None:
    return (OF_OBJECTIVES if words[0] == "objectives" else AT_THE_TOP).get(words[-1])


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
    if not any(_fits(name.split("."), one.split(".")) for one in scalar_figures()):
        raise UsageError(f"assessment.json has no figure {name!r} that is one number{near_figure(name)}")


def near_figure(name: str) -> str:
    """Return `; did you mean …?` with the figures that tables call so, or one of nearly this name; else the first."""
    words, known = name.split("."), scalar_figures()
    rows = [row for key, row in AT_THE_TOP.items() if key in known]
    called = " or ".join(row.key for row in rows if name.lower().replace("_", " ") in row.label.lower())
    called = f"{name}.mean" if f"{name}.mean" in known else called
    near = f"; did you mean {called}?" if called else did_you_mean(name, [_filled(one, words) for one in known])
    return near or f"; it has {', '.join(row.key for row in rows if row.first)} and more"


def _fits(words: list[str], pattern: list[str]) -> bool:
    return len(words) == len(pattern) and all(one in (_ANY, word) for word, one in zip(words, pattern, strict=True))


def _filled(pattern: str, words: list[str]) -> str:
    """Return a name with what was given in the places that may be anything."""
    parts = pattern.split(".")
    return ".".join(words[i] if part == _ANY and i < len(words) else part for i, part in enumerate(parts))


def figure(result: Mapping[str, Any], name: str) -> float | None:
    """Return a figure; None where it is not defined, or the file has none of this name.

    An equivalent multiplier beyond all C that were compared is infinite.
    """
    value = value_of(result, name)
    if value is None and name == "equivalent_multiplier":
        side = (result["equivalent_multiplier_text"] or "").partition(" ")[0]
        return {"above": math.inf, "below": -math.inf}.get(side)
    return value


if __name__ == "__main__":
    print(json.dumps(assessment_schema(), indent=2, ensure_ascii=False))
