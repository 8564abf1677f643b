"""The page: what it says and shows, put into its template."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Mapping, Sequence
from importlib import resources
from shlex import join
from typing import Any

from skd_sim.inputs.yaml_file import to_yaml
from skd_sim.options.car_and_adversary import CarUnderTest
from skd_sim.world.episode import Mode

from skd_evaluator import palette
from skd_evaluator.errors import AssessmentError
from skd_evaluator.metrics.margins import GAP_WARNING
from skd_evaluator.metrics.risks import SCALES
from skd_evaluator.metrics.statistics import mean
from skd_evaluator.report import charts, formats, repeat, rows
from skd_evaluator.report.html import figures
from skd_evaluator.report.html.subjects import Subject, episode_data, margin_hits, pack, scene, worst_first
from skd_evaluator.report.html.template import SECTIONS, filled
from skd_evaluator.version import version

LARGEST = 5_000_000
"""Bytes of a page."""
_TRAJECTORIES_OF_A_PHI, _TRAJECTORIES = 40, 4000
"""Most margin trajectories that are in the page, of one φ and of all."""
_SCRIPTS = ("data.js", "scene.js", "charts.js", "maps.js", "player.js", "table.js", "main.js")


def render(subjects: Sequence[Subject]) -> str:
    """Return the page, in at most `LARGEST` bytes: where need be without the paths of the best episodes.

    Raises:
        AssessmentError: it would be larger even without any path.
    """
    curves, comparisons = charts.vulnerability_charts(charts.charted(subjects)), charts.comparison_charts(subjects)
    rated, priced = charts.rated_cars(subjects), charts.priced_cars(subjects)
    headings = {"curves": [one for one, _ in curves], "ratings": [one for one, _ in rated]}
    page = _page(subjects, {**headings, "prices": [one for one, _ in priced]}, len(comparisons))
    content = _content(subjects)
    content["charts"] = {
        "curves": [spec for _, spec in curves],
        "comparisons": comparisons,
        "ratings": [charts.rating_chart(cars, scale) for _, cars in rated for scale in SCALES],
        "prices": [charts.price_chart(cars) for _, cars in priced],
    }
    kept = len(content["episodes"])
    while True:
        block = pack(content)
        if len(page.encode()) + len(block) <= LARGEST:
            return page.replace(_BLOCK, _BLOCK.replace("><", f">{block}<"))
        if not kept:
            size = f"{len(content['episodes']):,} episodes would be larger than {LARGEST / 1e6:g} MB"
            raise AssessmentError(f"a page of {size}; report fewer folders at a time")
        kept = int(0.8 * kept)
        for one in content["episodes"][kept:]:
            one["path"] = one["belief"] = None


_BLOCK = '<script type="text/plain" id="data"></script>'


def _page(subjects: Sequence[Subject], headings: Mapping[str, Sequence[str]], comparisons: int) -> str:
    """Return the page without its data: with the headings of its charts, and so many comparisons."""
    script, library = _joined(_SCRIPTS), charts.chart_library()
    return filled(
        "skd_evaluator.report.html",
        "report.html.j2",
        assessments=subjects,
        subjects=[_view(one, colour) for one, colour in zip(subjects, palette.of_cars(len(subjects)), strict=True)],
        sections=[section for name in SECTIONS.registered() if (section := SECTIONS.find(name)(subjects))],
        **headings,
        comparisons=comparisons,
        scales=len(SCALES),
        of_margins=any(one.figures["margin"] is not None for one in subjects),
        hit_speed=", ".join(dict.fromkeys(f"{3.6 * one.scenario.collision.hit_speed:.3g}" for one in subjects)),
        gap_warning=GAP_WARNING,
        mean=mean,
        style=_template("style.css"),
        scripts=[_in_html(one) for one in (library, script)],
        policy=f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src {_hashes(library, script)}",
        episodes=sum(len(one.episodes) for one in subjects),
        version=version(),
        **{one.__name__.rpartition(".")[2]: one for one in (charts, figures, formats, palette, repeat, rows)},
        failures=any(formats.failures_in(one.figures) for one in subjects),
    )


def _view(subject: Subject, colour: str) -> dict[str, Any]:
    """Return what the template says of a subject in several places, and the files that it has."""
    found, behaviour = subject.figures, ""
    if formats.failures_in(found) and not repeat.behaviour_name(found):
        behaviour = _link(to_yaml(found["risk"]["behaviour"]))
    return {
        "of": subject,
        "figures": found,
        "car": CarUnderTest(str(found["controller"])),
        "label": subject.label,
        "colour": colour,
        "state": figures.state_of(subject),
        "sentences": figures.sentences_of(subject),
        "rows": rows.figure_rows(found),
        "warnings": figures.warnings_of(subject),
        "scenario": _json_text(found["scenario"]),
        "scenario_link": "" if repeat.scenario_name(found) else _link(to_yaml(found["scenario"])),
        "car_model_link": _link(_json_text(found["car_model"])) if found["car_model"] else "",
        "behaviour_link": behaviour,
    }


def _json_text(data: Mapping[str, Any]) -> str:
    return json.dumps(data, indent=1, ensure_ascii=False)


def _link(text: str) -> str:
    """Return YAML as a link that saves a file."""
    return "data:application/yaml;base64," + base64.b64encode(text.encode()).decode("ascii")


def _content(subjects: Sequence[Subject]) -> dict[str, Any]:
    """Return what the page's script reads."""
    phis = sum(len(one.episodes.safe) for one in subjects)
    most = max(1, min(_TRAJECTORIES_OF_A_PHI, _TRAJECTORIES // max(1, phis)))
    return {
        "subjects": [_subject(index, one, most) for index, one in enumerate(subjects)],
        "episodes": [
            episode_data(index, subjects[index], subjects[index].episodes, number)
            for index, number in worst_first(subjects)
        ],
    }


def _subject(index: int, subject: Subject, most: int) -> dict[str, Any]:
    kept = formats.kept_failures(subject.figures)
    failures = [
        {**episode_data(index, subject, subject.failing, number), "failure": f"{one.text}; {one.likely}"}
        for number, one in enumerate(kept)
    ]
    return {
        "label": subject.label,
        "scene": scene(subject),
        "ranking": subject.ranking_objective,
        "etaMax": subject.figures["eta_max"],
        "margins": [[round(value, 3) for value in margins.tolist()] for margins in subject.margins],
        "least": margin_hits(subject, most),
        "failures": failures,
        "repeatFailure": join(repeat.crossing_prefix(subject.figures)) if kept else "",
        "repeat": {
            name: join(repeat.repeat_prefix(subject.figures, Mode.KAMIKAZE if name else Mode.REPLAY, name))
            for name in ("", *subject.figures["objectives"])
        },
    }


def _template(name: str) -> str:
    return (resources.files("skd_evaluator.report.html") / "templates" / name).read_text(encoding="utf-8")


def _joined(names: Sequence[str]) -> str:
    """Return the page's own scripts as one, with private names."""
    return '"use strict";\n(() => {\n' + "\n".join(map(_template, names)) + "\n})();\n"


def _in_html(script: str) -> str:
    """Return a script as it may stand in HTML.

    Raises:
        ValueError: it holds what would end it there, or what would hide its end.
    """
    if "</script" in script.lower() or "<!--" in script:
        raise ValueError("a script holds the end of a script, or the beginning of a comment of HTML")
    return script


def _hashes(*scripts: str) -> str:
    """Return what a content security policy is to say, so that these scripts run and none else."""
    digests = (hashlib.sha256(one.encode()).digest() for one in scripts)
    return " ".join(f"'sha256-{base64.b64encode(one).decode('ascii')}'" for one in digests)
