"""The page: what it says and shows, put into its template."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Mapping, Sequence
from importlib import resources
from shlex import join
from typing import Any

from skd_sim.options.car_under_test import CarUnderTest
from skd_sim.world.episode import Mode, Outcome

from skd_evaluator import palette
from skd_evaluator.errors import AssessmentError
from skd_evaluator.metrics.margins import GAP_WARNING
from skd_evaluator.metrics.risks import SCALES
from skd_evaluator.metrics.statistics import mean
from skd_evaluator.report.charts import (
    against_multiplier,
    chart_library,
    comparison_charts,
    per_safe_chart,
    rating_charts,
    vulnerability_charts,
)
from skd_evaluator.report.formats import (
    NO_RATING,
    failures_in,
    failures_sentence,
    kept_failures,
    surrogate_groups,
    surrogate_rows,
)
from skd_evaluator.report.html import figures
from skd_evaluator.report.html.episodes import episode_columns, margin_hits, objective_names, pack, scene, worst_first
from skd_evaluator.report.html.figures import by_scenario, matrix_of
from skd_evaluator.report.html.subjects import Subject
from skd_evaluator.report.html.template import SECTIONS, filled
from skd_evaluator.report.repeat import (
    BEHAVIOUR_FILE,
    CAR_MODEL_FILE,
    SCENARIO_FILE,
    behaviour_name,
    crossing_prefix,
    repeat_prefix,
    scenario_name,
)
from skd_evaluator.report.rows import bounds_of, failure_rows, figure_rows
from skd_evaluator.version import version

LARGEST = 5_000_000
"""Bytes of a page."""
_WAYS_SHARE = 0.97  # of the positions that would fill the page to the last byte
_WAYS_OF_A_PHI, _WAYS_OF_MARGINS = 40, 4000
"""Most margin trajectories that are in the page, of one φ and of all."""
_SCRIPTS = ("data.js", "scene.js", "charts.js", "detail.js", "player.js", "table.js", "main.js")
_OUTCOMES = {
    Outcome.COLLISION: "touched", Outcome.ARRIVED: "arrived", Outcome.MISSED: "missed", Outcome.TIMEOUT: "time was up",
    Outcome.ABORTED: "aborted", Outcome.RUNNING: "not ended",
}  # fmt: skip


def render(subjects: Sequence[Subject]) -> str:
    """Return the page, in at most `LARGEST` bytes: where need be without the positions of the best episodes.

    Raises:
        AssessmentError: it would be larger even without any positions.
    """
    order = worst_first(subjects)
    ways = len(order)
    for _ in range(4):
        page = _render(subjects, order, ways)
        size = len(page.encode())
        if size <= LARGEST:
            return page
        bare = len(_render(subjects, order, 0).encode())
        if bare > LARGEST:
            break
        ways = int(_WAYS_SHARE * ways * (LARGEST - bare) / (size - bare))
    raise AssessmentError(
        f"a page of {len(order):,} episodes would be larger than {LARGEST / 1e6:g} MB; report fewer folders at a time"
    )


def _render(subjects: Sequence[Subject], order: Sequence[tuple[int, int]], ways: int) -> str:
    block = pack({**_content(subjects), "listed": len(order)}, episode_columns(subjects, order, ways))
    views = [_view(one) for one in subjects]
    script, library, style = _joined(_SCRIPTS), chart_library(), _template("style.css")
    return filled(
        "skd_evaluator.report.html",
        "report.html.j2",
        subjects=views,
        listed=[views[place] for place in by_scenario(subjects)],
        matrix=matrix_of(subjects),
        notes=figures.ranking_notes(subjects),
        sections=[section for name in SECTIONS.registered() if (section := SECTIONS.find(name)(subjects))],
        curves=[heading for heading, _ in vulnerability_charts(subjects)],
        comparisons=len(comparison_charts(subjects)),
        ratings=[heading for heading, _ in rating_charts(subjects)],
        scales=len(SCALES),
        against=against_multiplier(subjects),
        unranked=figures.unranked_notes(subjects),
        by_phi=any(one.figures["nominal_collision_rate_ci95"] for one in subjects),
        of_margins=any(one.figures["margin"] is not None for one in subjects),
        hit_speed=", ".join(dict.fromkeys(f"{one.scenario.collision.hit_speed:g}" for one in subjects)),
        gap_warning=GAP_WARNING,
        style=style,
        no_rating=NO_RATING,
        scripts=[_in_html(one) for one in (library, script)],
        policy=f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src {_hashes(library, script)}",
        block=block,
        episodes=len(order),
        ways=min(ways, len(order)),
        version=version(),
        palette=palette,
        scenario_file=SCENARIO_FILE,
        car_model_file=CAR_MODEL_FILE,
        behaviour_file=BEHAVIOUR_FILE,
        failures=any(failures_in(one.figures) for one in subjects),
        externals=any(CarUnderTest(str(one.figures["controller"])).is_external for one in subjects),
    )


def _view(subject: Subject) -> dict[str, Any]:
    """Return what the template says of a subject."""
    model = subject.figures["car_model"]
    return {
        "label": subject.label,
        "state": figures.state_of(subject),
        "sentences": figures.sentences_of(subject),
        "rows": figure_rows(subject.figures),
        "bounds": bounds_of(subject.curve),
        "has_margin": subject.figures["margin"] is not None,
        "failures": failure_rows(subject.figures),
        "failures_sentence": failures_sentence(subject.figures),
        "behaviour": subject.figures["risk"]["behaviour"]["name"] if failures_in(subject.figures) else "",
        "behaviour_link": ""
        if not failures_in(subject.figures) or behaviour_name(subject.figures)
        else _link(subject.figures["risk"]["behaviour"]),
        "per_safe": figures.per_safe_rows(subject),
        "surrogates": surrogate_rows(subject.figures),
        "walkers": [name for name, _ in surrogate_groups(subject.figures)],
        "same_safe": figures.same_safe(subject),
        "warnings": figures.warnings_of(subject),
        "made": figures.made_rows(subject),
        "scenario": _json_text(subject.figures["scenario"]),
        "scenario_link": "" if scenario_name(subject.figures) else _link(subject.figures["scenario"]),
        "car_model_link": _link(model) if model else "",
    }


def _json_text(data: Mapping[str, Any]) -> str:
    return json.dumps(data, indent=1, ensure_ascii=False)


def _link(data: Mapping[str, Any]) -> str:
    """Return data as a link that saves a file; JSON is YAML."""
    return "data:application/yaml;base64," + base64.b64encode(_json_text(data).encode()).decode("ascii")


def _content(subjects: Sequence[Subject]) -> dict[str, Any]:
    """Return what the page's script knows beside the episodes."""
    objectives = objective_names(subjects)
    shown = max(1, min(_WAYS_OF_A_PHI, _WAYS_OF_MARGINS // max(1, sum(len(one.episodes.safe) for one in subjects))))
    return {
        "subjects": [
            {
                "label": one.label,
                "scene": scene(one),
                "ranking": objectives.index(one.ranking_objective),
                "skd": objectives.index(one.skd_objective),
                "perSafe": [
                    {
                        "margin": mean(margins) if margins.size else None,
                        "deviation": ranked["deviation_of_successes"],
                        "skd": row["skd"],
                    }
                    for row, ranked, margins in zip(
                        one.figures["per_safe_trajectory"],
                        one.ranking["per_safe_trajectory"],
                        one.margins,
                        strict=True,
                    )
                ],
                "etaMax": one.figures["eta_max"],
                "margins": [[round(value, 3) for value in margins.tolist()] for margins in one.margins],
                "ways": margin_hits(one, shown),
                "repeatFailure": join(crossing_prefix(one.figures)) if failures_in(one.figures) else "",
                "failures": [f"{failure.text}, {failure.likely}" for failure in kept_failures(one.figures)],
                "repeat": {name: _prefix(one, name) for name in ("", *one.figures["objectives"])},
            }
            for one in subjects
        ],
        "objectives": objectives,
        "outcomes": {str(int(outcome)): text for outcome, text in _OUTCOMES.items()},
        "collision": int(Outcome.COLLISION),
        "hitText": "hit",
        "charts": {
            "curves": [spec for _, spec in vulnerability_charts(subjects)],
            "comparisons": comparison_charts(subjects),
            "perSafe": per_safe_chart(),
            "ratings": [one for _, charts in rating_charts(subjects) for one in charts],
        },
    }


def _prefix(subject: Subject, objective: str) -> str:
    return join(repeat_prefix(subject.figures, Mode.KAMIKAZE if objective else Mode.REPLAY, objective))


def _template(name: str) -> str:
    return (resources.files("skd_evaluator.report.html") / "templates" / name).read_text(encoding="utf-8")


def _joined(names: Sequence[str]) -> str:
    """Return the page's own scripts as one, whose names nobody outside sees."""
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
