"""An assessment as JUnit XML, which every system of continuous integration reads.

A test case that *failed* says something about the car; one with an *error* says that it could not be looked at.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any
from xml.etree import ElementTree

from skd_evaluator.assessment.compare.gate import Check
from skd_evaluator.assessment.judge.figure_table import shown_in
from skd_evaluator.report.terminal import car_name

_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def junit_xml(result: Mapping[str, Any] | None, checks: Sequence[Check], *, car: str = "") -> str:
    """Return the XML, with one test case for each check.

    Args:
        result: content of assessment.json; None if there is no assessment.
        checks: result of each condition.
        car: name of the car if there is no assessment to take it from.
    """
    name = _plain(car_name(result) if result is not None else car)
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
            said = {"name": figure.key, "value": _plain(str(result.get(figure.key)))}
            ElementTree.SubElement(properties, "property", said)
    for number, one in enumerate(checks):
        case = {"classname": f"skd.{name}", "name": _plain(one.name), "time": "0" if number else seconds}
        element = ElementTree.SubElement(suite, "testcase", case)
        if one.passed:
            ElementTree.SubElement(element, "system-out").text = _plain(one.text)
        else:
            kind = "error" if one.error else "failure"
            ElementTree.SubElement(element, kind, {"message": _plain(one.text), "type": kind}).text = _plain(one.text)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=False).join(
        ('<?xml version="1.0" encoding="UTF-8"?>\n', "\n")
    )


def _plain(text: str) -> str:
    """Return text without what XML cannot hold: reasons may have been said by anybody's node."""
    return _NOT_XML.sub("\N{REPLACEMENT CHARACTER}", text)
