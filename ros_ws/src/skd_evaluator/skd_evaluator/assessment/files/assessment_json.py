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
from skd_evaluator.assessment.figure_table import AT_THE_TOP, OF_OBJECTIVES, OF_PHI, Of, Schema, keys_of, or_null, ref
from skd_evaluator.metrics.aborted import value_of
from skd_evaluator.metrics.surrogate_measures import SURROGATE_MEASURES

_KINDS = (table.NUMBER, table.SHARE, table.INTERVAL, table.COUNT, table.FLAG, table.TEXT, table.LINES)
_FIGURE, _SHARE, _BETWEEN, _COUNT, _FLAG, _TEXT, _LINES = (one.schema for one in _KINDS)
_NUMBER = ref("number")


def _object(**properties: Schema) -> dict[str, Any]:
    """Return the schema of an object that has just these."""
    return {"type": "object", "properties": properties, "required": [*properties], "additionalProperties": False}


def _list(items: Schema) -> dict[str, Any]:
    return {"type": "array", "items": items}


def _clusterings(rows: Iterable[table.Figure]) -> dict[str, Any]:
    return _object(**{one.key: _said(or_null(ref("clustering")), f"of {one.key}") for one in rows if one.clustered})


def _pair(says: str, end: str) -> dict[str, Any]:
    return {"description": says, "type": ["array", "null"], "items": ref(end), "minItems": 2, "maxItems": 2}


def _said(schema: Schema, says: str) -> dict[str, Any]:
    return {**schema, "description": says}


_SAYS = {
    "speeds": {"mean": "m/s", "p90": "90 % quantile, m/s"},
    "aborted_reason": {"count": "episodes", "first": "reason of the first of them"},
    "commands_clipped": {"commands": "how many", "episodes": "in how many episodes"},
    "command_age": {
        "median": "s", "p99": "99 % quantile, s", "worst": "s", "control_periods": "how many there were",
        "held": "control periods without a new command", "greatest_delay": "of the simulator behind the clock, s"},
    "measure": {
        "label": "name in tables", "unit": "of mean and intervals", "shown": "whether tables have it",
        "mean": "over the pairs, in its unit", "ci95_pairs": "95 % interval, pairs taken as independent",
        "ci95": "95 % interval over φ", "pairs": "in which it is defined", "undefined": "pairs in which it is not",
        "error": "why it could not be computed; null: it was"},
    "risk": {
        "name": "of the behaviour model", "kind": "of road user", "description": "in words",
        "parameters": "of the behaviour model, by name",
        "value": "probability of a hit by the front; of a parameter, as in its file", "source": "of the value",
        "interval_95": "95 % interval of the parameter",
        "scales": "each scale s", "ci95_by_phi": "95 % interval over φ", "method": "crude, or subset simulation",
        "episodes": "crossings, of all kinds", "aborted": "crude crossings that were aborted", "note": "what to heed",
        "runs": "crude crossings", "kinds": "what walkers did, the most frequent first", "hits": "crossings",
        "share": "of the hits", "nearest": "the most likely of them", "safe_trajectory": "number of φ, from 0",
        "trial": "number of the crossing on it"},
    "price_of_caution": {"aborted": "runs that were aborted", "runs": "each run"},
    "clustering": {
        "safe_trajectories": "φ with values", "values": "how many", "standard_error": "of the mean, by φ",
        "degrees_of_freedom": "of it", "variance_between": "between φ, squared unit of the figure",
        "variance_within": "within φ, squared unit of the figure", "intraclass_correlation": "share between φ",
        "notes": "what to heed"},
    "margin_source": {"source": "name", "candidates": "that it brought"},
    "until_width": {
        "reached": "whether the interval is narrow enough", "text": "in words", "most_looks": "at most so many looks",
        "confidence": "of each look's interval", "looks": "each look", "safe_count": "φ by then",
        "deviation": "planned deviation by then, m", "interval": "of it, over φ, m"},
    "static_test": {"touched": "whether there was a contact", "aborted": "why it was aborted; empty: it was not"},
    "safe_trajectory": {
        "deviation": "mean planned deviation on φ, m", "deviation_of_successes": "of the trials with a hit, m",
        "skd": "mean discrete Fréchet distance, m", "skd_prefix": "mean prefix distance, m", "pairs": "pairs (φ, ψ)"},
    "curve": {
        "eta_max": "m", "trials": "aborted ones left out", "steps": "the whole curve", "eta": "deviation, m",
        "probability": "share of the trials with a hit within eta", "points": "the curve at some eta, with intervals",
        "ci95_trials": "Wilson's 95 % interval, trials taken as independent", "ci95": "95 % interval over φ",
        "bound": "Theorem 1's upper bound", "cantelli": "Cantelli's upper bound"},
    "surrogate_measure": {"median": "in the measure's unit", "worst": "in the measure's unit"},
    "surrogates": {"depends_on": "car, road user or both"},
    "surrogate_measures": {"along_phi": "of the runs along φ"},
    "vulnerability_curve": {
        "kamikazes": "of planned kamikazes", "budgets": "kamikazes bounded by eta", "eta": "bound, m",
        "probability": "share of the trials with a hit within eta", "ci95_trials": "Wilson's 95 % interval",
        "successes": "trials with a hit within eta", "aborted": "episodes", "margins": "null: not known"},
    "provenance": {
        "host": "name of the machine", "platform": "operating system and processor", "python": "its version",
        "revision": "commit", "path": "of the file", "sha256": "of the file"},
}  # fmt: skip
"""What the keys within each definition are, where the definition itself does not say it."""
_SAYS["safe_trajectory_of_objective"] = _SAYS["safe_trajectory"]


def _described(node: Any, says: Mapping[str, str]) -> Any:
    """Return a schema each of whose keys has a description."""
    if isinstance(node, list):
        return [_described(one, says) for one in node]
    if not isinstance(node, Mapping):
        return node
    found = {key: _described(value, says) for key, value in node.items() if key != "properties"}
    if "properties" in node:
        keys = {key: _described(one, says) for key, one in node["properties"].items()}
        found["properties"] = {
            key: {"description": says[key], **one} if key in says else one for key, one in keys.items()
        }
    return found


def _definitions() -> dict[str, Any]:
    of_phi = {key: one.kind.schema if one.per_phi else one.described() for key, one in OF_PHI.items()}
    at_the_top = {one.key: one.described() for one in table.FIGURES if one.of is Of.PHI_TOP}
    sha256 = {"type": "string", "pattern": "^[0-9a-f]{64}$"}
    git = _object(
        revision={"type": "string", "pattern": "^[0-9a-f]{40,64}$"},
        modified=_said(_FLAG, "whether files of the checkout differ from it"),
    )
    return {
        "number": {"type": "number"},
        "number_or_null": {"type": ["number", "null"]},
        "rate": {"type": ["number", "null"], "minimum": 0, "maximum": 1},
        "interval": _pair("[low, high]; null where it is not defined", "number"),
        "open_interval": _pair("[low, high]; an end beyond what was compared is null", "number_or_null"),
        "speeds": _object(mean=_NUMBER, p90=_NUMBER),
        "aborted_reason": _object(count={"type": "integer", "minimum": 1}, first=_TEXT),
        "commands_clipped": _object(commands=_COUNT, episodes=_COUNT),
        "simulator_contacts": _object(
            both=_said(_COUNT, "episodes in which both see a contact"),
            geometry_alone=_said(_COUNT, "in which SKD's geometry alone does"),
            simulator_alone=_said(_COUNT, "in which the simulator's shapes alone do"),
            episodes=_said(_COUNT, "episodes that were compared; aborted ones left out"),
            greatest_gap=_said(_FIGURE, "greatest time between the two contacts, s")),
        "simulation": {"type": "object", "properties": {
            "version": _said(_TEXT, "of the simulator"),
            "physics_step": _said(_NUMBER, "s"),
            "mass": _said(_NUMBER, "of the car, kg"),
            "wheel_friction": _said(_NUMBER, "coefficient of friction of a wheel"),
            "limits": _said(_list(_NUMBER), "least and greatest acceleration along the car's heading, m/s²"),
            "pedals": {
                "type": "object", "description": "acceleration along the heading by pedal position, as measured, m/s²",
                "properties": {
                    "brake": _said(_list(_list(_NUMBER)), "pairs of position, 0 to 1, and acceleration, m/s²"),
                    "throttle": _said(_list(_list(_NUMBER)), "pairs of position, 0 to 1, and acceleration, m/s²"),
                    "coasting": _said(_NUMBER, "acceleration without a pedal, m/s²")}}}},
        "command_age": _object(
            **{name: {"type": "number", "minimum": 0} for name in ("median", "p99", "worst")},
            control_periods={"type": "integer", "minimum": 1}, held=_COUNT, greatest_delay={"type": "number"}),
        "measure": _object(
            label=_TEXT, unit=_TEXT, shown=_FLAG, mean=_FIGURE, ci95_pairs=_BETWEEN, ci95=_BETWEEN, pairs=_COUNT,
            undefined=_COUNT, error={"type": ["string", "null"]}),
        "risk": _object(
            behaviour=_said(_object(
                name=_TEXT, kind=_TEXT, description=_TEXT,
                parameters={"type": "object", "additionalProperties": {
                    "type": "object", "required": ["value", "source"],
                    "properties": {"value": _NUMBER, "source": _TEXT, "interval_95": _BETWEEN},
                    "additionalProperties": False}}), "as in its file"),
            scales=_list(_object(
                scale=_said(_NUMBER, "s, by which all deviations are multiplied"), value=_SHARE,
                ci95=_said(_BETWEEN, "of the estimate, for these φ"), ci95_by_phi=_BETWEEN, method=_TEXT,
                episodes=_COUNT,
                gain=_said(_FIGURE, "times as many crude crossings would have the same error; null: crude"),
                runs=_said(_COUNT, "crude crossings, aborted ones left out"),
                hits=_said(_COUNT, "of these, by the front of the moving car"),
                flank=_said(_COUNT, "contacts with a side or the rear of the moving car"),
                standing=_said(_COUNT, "contacts with a car slower than hit_speed"), aborted=_COUNT,
                subset_aborted=_said(
                    {"type": ["integer", "null"], "minimum": 1},
                    "crossings of subset simulation that were aborted, with which it ended; null: none were"),
                note=_TEXT)),
            failures=_said(or_null(_object(
                scale=_said(_NUMBER, "s at which they are"), runs=_COUNT,
                hits=_said(_COUNT, "crude crossings in which the car hits"),
                looked_at=_said(_COUNT, "of these, classified: the first of them"),
                kinds=_list(_object(
                    kind=_said(_TEXT, "what the walker did"), hits=_COUNT, share=_SHARE,
                    nearest=_list(_object(
                        safe_trajectory=_COUNT, trial=_COUNT,
                        deviation=_said(_NUMBER, "from φ, in standard deviations of people"),
                        people=_said(_SHARE, "share of people who deviate as much or more"),
                        impact_speed=_said(_NUMBER, "m/s"))))))), "the most likely failures; null: no hit")),
        "price_of_caution": _object(
            horizon=_said(_NUMBER, "s after which the car has not got past"),
            hard_braking=_said(_NUMBER, "m/s², that counts as needless"), aborted=_COUNT,
            runs=_list(_object(
                kind=_said(_TEXT, "what the road user does"), passed=_said(_NUMBER, "when the car has got past, s"),
                undisturbed=_said(_NUMBER, "when it has with the road to itself, s"),
                unslowed=_said(_NUMBER, "when it would have at its start speed, s"),
                braked=_said(_FLAG, "whether it braked hard here alone")))),
        "clustering": _object(
            safe_trajectories=_COUNT, values=_COUNT, standard_error=_FIGURE, degrees_of_freedom=_FIGURE,
            variance_between=_FIGURE, variance_within=_FIGURE, intraclass_correlation=_FIGURE, notes=_LINES),
        "margin_excess": _object(
            mean=_said(_NUMBER, "m"), error=_said(_NUMBER, "standard error, m"),
            trials=_said(_COUNT, "trials that were searched deeper")),
        "margin_source": _object(
            source=_TEXT, candidates=_COUNT, hits=_said(_COUNT, "of them that were better than the best known"),
            lowered=_said(_NUMBER, "margins by, in all trials together, m")),
        "clusterings": _clusterings(AT_THE_TOP.values()),
        "clusterings_of_objective": _clusterings(OF_OBJECTIVES.values()),
        "until_width": _object(
            requested=_said(_NUMBER, "m"), reached=_FLAG, text=_TEXT, most_looks=_COUNT, confidence=_NUMBER,
            looks=_list(_object(safe_count=_COUNT, deviation=_FIGURE, interval=_BETWEEN))),
        "static_test": _object(
            place=_said(_NUMBER, "% of the car's width"), touched=_FLAG,
            target=_said(_FLAG, "whether the target was touched, and no other road user"),
            impact_speed=_said(_NUMBER, "of the car, m/s; 0 without a contact"),
            speed_ahead=_said(_NUMBER, "of the target, along the car's heading, m/s"),
            fastest=_said(_NUMBER, "greatest speed of the car, m/s"),
            braking_ttc=_said(_FIGURE, "time to collision when the car began to brake, s"), aborted=_TEXT),
        "safe_trajectory": _object(**of_phi, **at_the_top),
        "safe_trajectory_of_objective": _object(**of_phi),
        "objective": _object(**dict(pair for one in OF_OBJECTIVES.values() for pair in one.schemas())),
        "curve": _object(
            eta_max=_NUMBER, trials=_COUNT, area_above=_said(_NUMBER, "m"),
            steps=_object(eta=_list(_NUMBER), probability=_list(_SHARE)),
            points=_list(_object(
                eta=_NUMBER, probability=_SHARE, ci95_trials=_BETWEEN, ci95=_BETWEEN, bound=_SHARE,
                cantelli=_SHARE))),
        "surrogate_measure": _object(
            median=_FIGURE, worst=_FIGURE, defined=_said(_COUNT, "episodes in which it is defined")),
        "surrogates": _object(
            depends_on=_TEXT, episodes=_said(_COUNT, "aborted ones left out"),
            **{
                name: _said(ref("surrogate_measure"), one.label + (one.unit and f", {one.unit}"))
                for name, one in SURROGATE_MEASURES.items()
            }),
        "surrogate_measures": _object(
            along_phi=ref("surrogates"),
            kamikazes=_said({"type": "object", "additionalProperties": ref("surrogates")}, "by their objective")),
        "vulnerability_curve": _object(
            kamikazes=ref("curve"),
            budgets=_list(_object(
                eta=_NUMBER, probability=_SHARE, ci95_trials=_BETWEEN, successes=_COUNT,
                trials=_said(_COUNT, "aborted ones left out"), aborted=_COUNT)),
            margins=or_null(ref("curve"))),
        "provenance": _said(_object(
            date={"type": "string", "pattern": "^[0-9]{4}-[0-9]{2}-[0-9]{2}T[0-9]{2}:[0-9]{2}:[0-9]{2}Z$",
                  "description": "when it began, UTC"},
            host=_TEXT, platform=_TEXT, python=_TEXT,
            command=_said(_TEXT, "command line"), folder=_said(_TEXT, "where it ran"),
            git=_said(or_null(git), "of the checkout that SKD ran from; null: it was installed"),
            controller_files=_said(_list(_object(path=_TEXT, sha256=sha256)),
                                   "of the controller's module or what its command names, and what is beside it"),
            controller_git=_said(or_null(git), "of the checkout that the module, or last file named, is in"),
            car_model_sha256=_said({**sha256, "type": ["string", "null"]}, "of car_model above, as it was given"),
        ), "what ran, when and where; nothing in it is a figure, and two equal assessments differ in it"),
    }  # fmt: skip


@functools.cache
def assessment_schema() -> dict[str, Any]:
    """Return the JSON Schema of assessment.json; nobody may change it."""
    figures = _object(**dict(pair for one in AT_THE_TOP.values() for pair in one.schemas()))
    figures["required"] = [key for key in figures["required"] if key not in AT_THE_TOP or not AT_THE_TOP[key].optional]
    interrupted = {"const": True, "description": "only in what an interrupted command prints"}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "assessment.json of SKD",
        "description": "Figures of one car. Lengths in m, times in s, angles in rad; what cannot be computed is null.",
        **figures,
        "properties": {"interrupted": interrupted, **figures["properties"]},
        "$defs": {name: _described(one, _SAYS.get(name, {})) for name, one in _definitions().items()},
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
