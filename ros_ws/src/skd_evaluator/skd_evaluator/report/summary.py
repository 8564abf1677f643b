"""An assessment as a page of Markdown and as a table of comma-separated values."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from skd_evaluator.campaign.compare.gate import Check
from skd_evaluator.campaign.store.figure_names import scalar_figures
from skd_evaluator.report.doubts import margin_doubts
from skd_evaluator.report.terminal import car_name, headline

_ROWS = (
    ("margin", "margin (m)", 1.0),
    ("equivalent_multiplier", "equivalent multiplier C", 1.0),
    ("hit_rate", "hit along φ (%)", 100.0),
    ("impact_speed", "impact speed (m/s)", 1.0),
    ("deformation", "planned deformation (m)", 1.0),
    ("closeness", "closeness, planned / margin", 1.0),
    ("skd", "SKD (m)", 1.0),
    ("kamikaze_success_rate", "of the attempts of SKD collide (%)", 100.0),
    ("collision_rate", "collisions along φ, any touch (%)", 100.0),
    ("skd_prefix", "prefix distance (m)", 1.0),
)
_INDEPENDENT = ("pairs", "attempts", "runs", "these_phi")
_NOT_BY_PHI = ("deformation_of_successes", "floor", "floor_ratio")
"""Figures whose only interval takes attempts or pairs as independent, under the plain key."""
_SETTINGS = ("scenario", "car_model", "options", "provenance", "vulnerability_curve", "until_width")
_PLANNED = frozenset({"deformation"})
"""Figures that depend on what planned kamikazes know of the car."""
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
    lines += [_cell(headline(result)), ""]
    lines += ["| | value | 95 % by φ | 95 %, as independent |", "|---|---|---|---|"]
    for name, label, scale in _ROWS:
        if name == "equivalent_multiplier":
            ends = ("_text", "_ci95_text", "_ci95_these_phi_text")
            value, by_phi, independent = (result[f"{name}{end}"] or "—" for end in ends)
        elif name == "impact_speed":
            speed = result[name]
            value = "—" if speed is None else f"{speed['mean']:.1f}, 90 % below {speed['p90']:.1f}"
            by_phi = independent = "—"
        elif name in _PLANNED and result.get("knowledge"):
            label = f"{label}, knowledge: {_cell(str(result['knowledge']))}"
            value, by_phi, independent = _three(result, name, scale)
        else:
            value, by_phi, independent = _three(result, name, scale)
        lines.append(f"| {label} | {value} | {by_phi} | {independent} |")
    lines += ["", "| condition | | found |", "|---|---|---|"]
    for one in checks:
        state = "passed" if one.passed else "error" if one.error else "failed"
        lines.append(f"| {_cell(one.name)} | {_MARKS[state]} {state} | {_cell(one.text)} |")
    doubts = [*margin_doubts(result, 0, 0), *result["warnings"]]
    lines += ["", *(f"* {_cell(doubt)}" for doubt in doubts)]
    return "\n".join([*lines, _origin(result)]).rstrip() + "\n"


def _three(result: Mapping[str, Any], name: str, scale: float) -> tuple[str, str, str]:
    """Return a figure, its interval by φ and the other one."""
    by_phi, independent = result.get(f"{name}_ci95"), _independent(result, name)
    return _number(result[name], scale), _interval(by_phi, scale), _interval(independent, scale)


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
    """Return every figure that is one number, a line each: its name, its value, its intervals where it has any.

    What intervals are made of (`clustering`) is left to assessment.json.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["figure", "value", "ci95_low", "ci95_high", "ci95_independent_low", "ci95_independent_high"])
    names = {name.rpartition(".")[2] for name in scalar_figures()}
    for name, value, around in _numbers(result, ""):
        last = name.rpartition(".")[2]
        if last in names or "probability_bound." in name:
            by_phi, independent = around.get(f"{last}_ci95"), _independent(around, last)
            if last in _NOT_BY_PHI:
                by_phi, independent = None, by_phi
            writer.writerow([name, value, *(by_phi or ("", "")), *(independent or ("", ""))])
    return text.getvalue()


def _numbers(content: Any, name: str) -> Iterator[tuple[str, Any, Mapping[str, Any]]]:
    items = content.items() if isinstance(content, Mapping) else enumerate(content)
    for key, value in items:
        path = f"{name}.{key}" if name else str(key)
        if path in _SETTINGS or key == "clustering":
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
