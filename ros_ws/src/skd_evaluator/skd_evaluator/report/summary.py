"""An assessment as a page of Markdown and as a table of comma-separated values."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from skd_evaluator.campaign.figure_names import scalar_figures
from skd_evaluator.campaign.gate import Check
from skd_evaluator.report.terminal import car_name

_ROWS = (
    ("deformation", "deformation (m)", 1.0),
    ("deformation_success_rate", "success rate of its kamikazes (%)", 100.0),
    ("equivalent_multiplier", "equivalent multiplier C", 1.0),
    ("collision_rate", "collision rate along φ (%)", 100.0),
    ("skd", "SKD (m)", 1.0),
    ("skd_prefix", "prefix distance (m)", 1.0),
)
_INDEPENDENT = ("pairs", "attempts", "runs", "these_phi")
_MARKS = {"passed": "✅", "failed": "❌", "error": "⚠️"}


def markdown(result: Mapping[str, Any], checks: Sequence[Check]) -> str:
    """Return a page: the verdict, the figures, each condition, and where it comes from.

    Args:
        result: content of assessment.json.
        checks: what became of each condition.
    """
    verdict = "passed" if all(one.passed for one in checks) else "failed" if any(c.failed for c in checks) else "error"
    said = {"passed": "passed", "failed": "the car failed", "error": "no statement about the car"}[verdict]
    lines = [f"## {_MARKS[verdict]} SKD: {_cell(car_name(result))}: {said}", ""]
    lines += ["| | value | 95 % by φ | 95 %, as independent |", "|---|---|---|---|"]
    for name, label, scale in _ROWS:
        if name == "equivalent_multiplier":
            ends = ("_text", "_ci95_text", "_ci95_these_phi_text")
            value, by_phi, independent = (result[f"{name}{end}"] or "—" for end in ends)
        else:
            value = _number(result[name], scale)
            by_phi = _interval(result.get(f"{name}_ci95"), scale)
            independent = _interval(_independent(result, name), scale)
        lines.append(f"| {label} | {value} | {by_phi} | {independent} |")
    lines += ["", "| condition | | found |", "|---|---|---|"]
    for one in checks:
        state = "passed" if one.passed else "error" if one.error else "failed"
        lines.append(f"| {_cell(one.name)} | {_MARKS[state]} {state} | {_cell(one.text)} |")
    lines += ["", *(f"* {_cell(warning)}" for warning in result["warnings"])]
    return "\n".join([*lines, _origin(result)]).rstrip() + "\n"


def _independent(around: Mapping[str, Any], name: str) -> Sequence[float] | None:
    """Return the interval of a figure that takes what it is over as independent: its pairs, attempts or runs."""
    return next((around[key] for end in _INDEPENDENT if around.get(key := f"{name}_ci95_{end}")), None)


def _origin(result: Mapping[str, Any]) -> str:
    origin = result["provenance"]
    said = f"SKD {result['version']}, seed {result['seed']}, {result['seconds']:.1f} s"
    if origin is None:
        return said
    revision = f", revision {origin['git']['revision'][:12]}" if origin["git"] else ""
    return f"{said}, {origin['date']}, {_cell(origin['host'])}{revision}: `{_cell(origin['command']).replace('`', '')}`"


def csv_table(result: Mapping[str, Any]) -> str:
    """Return every figure that is one number, a line each: its name, its value, its intervals where it has any."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["figure", "value", "ci95_low", "ci95_high", "ci95_independent_low", "ci95_independent_high"])
    names = {name.rpartition(".")[2] for name in scalar_figures()}
    for name, value, around in _numbers(result, ""):
        last = name.rpartition(".")[2]
        if last in names or "probability_bound." in name:
            ends = [*(around.get(f"{last}_ci95") or ("", "")), *(_independent(around, last) or ("", ""))]
            writer.writerow([name, value, *ends])
    return text.getvalue()


def _numbers(content: Any, name: str) -> Iterator[tuple[str, Any, Mapping[str, Any]]]:
    items = content.items() if isinstance(content, Mapping) else enumerate(content)
    for key, value in items:
        path = f"{name}.{key}" if name else str(key)
        if path in ("scenario", "car_model", "options", "provenance", "vulnerability_curve", "until_width"):
            continue
        if isinstance(value, (Mapping, list)) and not str(key).startswith("interval") and "ci95" not in str(key):
            yield from _numbers(value, path)
        elif isinstance(value, (int, float)) and not isinstance(value, bool) and isinstance(content, Mapping):
            yield path, value, content


def _number(value: float | None, scale: float) -> str:
    return "—" if value is None else f"{scale * value:.3f}" if scale == 1.0 else f"{scale * value:.1f}"


def _interval(pair: Sequence[float] | None, scale: float) -> str:
    return "—" if pair is None else f"[{_number(pair[0], scale)}, {_number(pair[1], scale)}]"


def _cell(text: str) -> str:
    """Return text that stays in its cell, whatever it is."""
    plain = " ".join(text.split()).replace("\\", "\\\\").replace("|", "\\|")
    return plain.replace("<", "&lt;").replace(">", "&gt;")
