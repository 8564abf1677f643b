"""What an assessment or an episode leaves on disk, and the line that sums up an episode.

A test case of JUnit that *failed* says something about the car; one with an *error* that it could not be looked at.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from skd_sim.world.episode import EpisodeLog, Outcome

from skd_evaluator.assessment.assessment import Assessment, ObjectiveResult
from skd_evaluator.assessment.compare.gate import Check
from skd_evaluator.assessment.figure_table import shown_in
from skd_evaluator.assessment.files.result_folder import write_json
from skd_evaluator.assessment.files.results import episode_summary, write_assessment
from skd_evaluator.assessment.run.workers import available_workers, in_background
from skd_evaluator.report.formats import BARE, beside, bounded
from skd_evaluator.report.terminal import headline
from skd_evaluator.report.warnings import figure_warnings


def episode_line(log: EpisodeLog) -> str:
    """Return how an episode ended, in a few words."""
    impact, name = "", log.outcome.name.lower()
    if log.outcome == Outcome.TIMEOUT:
        name = "no collision until the time limit"
    elif log.outcome == Outcome.COLLISION:
        impact = f" after {log.impact_time:.2f} s at {log.impact_speed:.2f} m/s"
    return f"{name}{impact}; {len(log.adversary) - 1} ticks"


def fill(folder: Path, assessment: Assessment, *, may_fork: bool = False) -> None:
    """Write everything that an assessment leaves on disk.

    Args:
        folder: folder that is filled.
        assessment: assessment of the car.
        may_fork: whether another process may draw some of the pictures: not where other threads run, as those of ROS 2.
    """
    from skd_evaluator.report.pictures import save_trajectories  # slow to import, and needed only now

    def draw() -> None:
        for name, part in picture_names(assessment).items():
            save_trajectories(folder / name, assessment, part)

    with ExitStack() as stack:
        forks = may_fork and available_workers() > 1
        drawn = stack.enter_context(in_background(draw)) if forks else lambda: False
        write_assessment(folder, assessment)
        if assessment.vulnerability is not None:  # in this process: one forked from a user of Vega waits for ever
            from skd_evaluator.report.charts import ChartedCar, save_vulnerability

            figures = assessment.as_dict()
            car = ChartedCar(str(figures["car"]), figures, curves=figures["vulnerability_curve"])
            save_vulnerability(folder / "vulnerability.png", [car])
        if not drawn():
            draw()


def picture_names(assessment: Assessment) -> dict[str, ObjectiveResult]:
    """Return the file of each picture of trajectories: `trajectories.png` shows the kamikazes that rank the car."""
    first = assessment.for_deviation
    others = [one for one in assessment.results if one is not first]
    return {"trajectories.png": first, **{f"trajectories_{one.plan.objective}.png": one for one in others}}


def fill_episode(folder: Path, log: EpisodeLog) -> None:
    """Write what a single episode leaves on disk beside its bag."""
    write_json(folder / "episode.json", episode_summary(log))


def with_scratch(scratch: Path, write: Callable[[Path], None]) -> Callable[[Path], None]:
    """Return what writes results, and moves the bags and logs that are in `scratch` beside them."""

    def write_all(folder: Path) -> None:
        write(folder)
        for part in scratch.iterdir():
            if any(part.iterdir()):
                part.rename(folder / part.name)

    return write_all


_MARKS = {"passed": "✅", "failed": "❌", "error": "⚠️"}


def markdown(result: Mapping[str, Any], checks: Sequence[Check]) -> str:
    """Return a page: the verdict, the figures, each condition, and where it comes from.

    Args:
        result: content of assessment.json.
        checks: result of each condition.
    """
    verdict = "passed" if all(one.passed for one in checks) else "failed" if any(c.failed for c in checks) else "error"
    said = {"passed": "passed", "failed": "the car failed", "error": "no statement about the car"}[verdict]
    lines = [f"## {_MARKS[verdict]} SKD: {_cell(str(result['car']))}: {said}", ""]
    lines += [_cell(headline(result)), ""]
    lines += ["| | value | 95 % by φ | 95 %, as independent |", "|---|---|---|---|"]
    for figure in shown_in("summary"):
        known = _cell(str(result.get("adversary_model") or "")) if figure.planned else ""
        label = f"{figure.heading}, adversary model: {known}" if known else figure.heading
        value = ", ".join(filter(None, (BARE.value(figure, result), beside(figure, result))))
        lines.append(f"| {label} | {value} | {BARE.by_phi(figure, result)} | {BARE.independent(figure, result)} |")
    lines += ["", "| condition | | found |", "|---|---|---|"]
    for one in checks:
        said = "; ".join((one.text, *one.remarks))
        lines.append(f"| {_cell(one.name)} | {_MARKS[one.state]} {one.state} | {_cell(said)} |")
    warnings = dict.fromkeys([*figure_warnings(result), *result["warnings"]])
    lines += ["", *(f"* {_cell(line)}" for line in warnings)]
    return "\n".join([*lines, _origin(result)]).rstrip() + "\n"


def _origin(result: Mapping[str, Any]) -> str:
    origin = result["provenance"]
    said = f"SKD {result['version']}, seed {result['seed']}, {result['seconds']:.1f} s"
    if origin is None:
        return said
    revision = f", SKD revision {origin['git']['revision'][:12]}" if origin["git"] else ""
    return f"{said}, {origin['date']}, {_cell(origin['host'])}{revision}: `{_cell(origin['command']).replace('`', '')}`"


def _cell(text: str) -> str:
    """Return text that stays in its cell, whatever it is."""
    plain = " ".join(text.split()).replace("\\", "\\\\").replace("|", "\\|")
    return plain.replace("<", "&lt;").replace(">", "&gt;")


_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def junit_xml(result: Mapping[str, Any] | None, checks: Sequence[Check], *, car: str = "") -> str:
    """Return the XML, with one test case for each check.

    Args:
        result: content of assessment.json; None if there is no assessment.
        checks: result of each condition.
        car: name of the car if there is no assessment to take it from.
    """
    name = _plain(str(result["car"]) if result is not None else car)
    seconds = f"{result['seconds']:.3f}" if result is not None else "0"
    counts = {"failures": sum(one.failed for one in checks), "errors": sum(one.error for one in checks)}
    totals = {"tests": str(len(checks)), **{key: str(count) for key, count in counts.items()}, "time": seconds}
    root = ElementTree.Element("testsuites", totals)
    origin = (result or {}).get("provenance") or {}
    stamp = {"timestamp": origin["date"].removesuffix("Z"), "hostname": _plain(origin["host"])} if origin else {}
    suite = ElementTree.SubElement(root, "testsuite", {"name": f"skd {name}".strip(), **totals, **stamp})
    if result is not None:
        properties = ElementTree.SubElement(suite, "properties")
        for figure in shown_in("junit"):
            if result.get(figure.key) is None:
                continue
            value = str(result[figure.key])
            value = bounded(result, value) if figure.key == "equivalent_multiplier_text" else value
            ElementTree.SubElement(properties, "property", {"name": figure.key, "value": _plain(value)})
    for number, one in enumerate(checks):
        case = {"classname": f"skd.{name}", "name": _plain(one.name), "time": "0" if number else seconds}
        element = ElementTree.SubElement(suite, "testcase", case)
        text = _plain("\n".join((one.text, *one.remarks)))
        if one.passed:
            ElementTree.SubElement(element, "system-out").text = text
        else:
            kind = "error" if one.error else "failure"
            ElementTree.SubElement(element, kind, {"message": _plain(one.text), "type": kind}).text = text
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=False).join(
        ('<?xml version="1.0" encoding="UTF-8"?>\n', "\n")
    )


def _plain(text: str) -> str:
    """Return text without what XML cannot hold: reasons may come from a user's node."""
    return _NOT_XML.sub("\N{REPLACEMENT CHARACTER}", text)
