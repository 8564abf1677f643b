"""The page: what it says and shows, put into its template."""

from __future__ import annotations

import base64
import hashlib
import itertools
import json
from collections.abc import Mapping, Sequence
from importlib import resources
from shlex import join
from typing import Any

from skd_sim.errors import AssessmentError
from skd_sim.inputs.yaml_file import to_yaml
from skd_sim.options.car_and_adversary import CarUnderTest
from skd_sim.world.episode import Mode

from skd_evaluator import palette
from skd_evaluator.assessment.compare.comparison import compare
from skd_evaluator.assessment.figure_table import AT_THE_TOP
from skd_evaluator.assessment.files.results import read_result
from skd_evaluator.metrics.margins import GAP_WARNING
from skd_evaluator.metrics.price_of_caution import does_not_get_past
from skd_evaluator.metrics.risks import SCALES
from skd_evaluator.metrics.statistics import mean
from skd_evaluator.report import charts, formats, repeat
from skd_evaluator.report import warnings as of_assessments
from skd_evaluator.report.html.subjects import (
    Subject,
    episode_data,
    margin_hits,
    pack,
    scenarios_of,
    scene,
    worst_first,
)
from skd_evaluator.report.html.template import SECTIONS, filled
from skd_evaluator.report.terminal import credibility, headline, missing_figures
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
        **{one.__name__.rpartition(".")[2]: one for one in (charts, formats, palette, repeat)},
        **{
            one.__name__: one
            for one in (by_scenario, does_not_get_past, matrix_of, ranking_notes, same_safe, unranked_notes)
        },
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
        "state": state_of(subject),
        "sentences": sentences_of(subject),
        "rows": formats.figure_rows(found),
        "warnings": warnings_of(subject),
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


_FEW = 3
"""Most pairs of cars that a sentence names."""


def state_of(subject: Subject) -> str:
    """Return whether a rating can be believed: `failed` (there is none), `doubtful` (read the warnings) or `fine`."""
    figures = subject.figures
    if figures["margin"] is None and figures["deviation"] is None:
        return "failed"
    return "doubtful" if warnings_of(subject) else "fine"


def sentences_of(subject: Subject) -> list[str]:
    """Return what was found about a car: the headline of the terminal, and what it means."""
    figures = subject.figures
    if state_of(subject) == "failed":
        aborted = figures["aborted"]
        why = f"{formats.counted(aborted, 'episode')} were aborted" if aborted else "none was planned"
        return [f"This is no rating: no kamikaze ran to its end ({why}). It says nothing about the car."]
    found = [headline(figures, named=False)]  # the name stands above
    if figures["margin"] is not None and figures["margin_beyond"] < figures["margin_trials"]:
        deviates = f"The {subject.scenario.adversary.kind} may deviate by {_bounded(subject, 'margin')} on average"
        found.append(f"{deviates} before the moving car hits. More is better. Ranges are 95 % intervals.")
    nothing = [] if figures["deviation"] is not None else ["No planned kamikaze ran to its end."]
    return [*found, *missing_figures(figures), *nothing]


def warnings_of(subject: Subject) -> list[str]:
    """Return what a reader should know before believing the figures, a line each."""
    figures = subject.figures
    found = [*figures["warnings"], *of_assessments.warnings_of(subject.assessment, result=figures)]
    for kind, reasons in figures["aborted_reasons"].items():
        first = f", the first one so: {reasons['first']}" if reasons.get("first") else ""
        found.append(f"{formats.counted(reasons['count'], 'episode')} aborted ({kind}){first}; they count in no figure")
    found += [f"measure {one['label']} failed: {one['error']}" for one in figures["measures"].values() if one["error"]]
    if far := figures["discarded_by_distance"]:
        found.append(f"{formats.counted(far, 'pair')} discarded, above the maximum distance")
    found += [f"left out: {line}" for line in figures["left_out"]]
    return list(dict.fromkeys(map(str, found)))


def ranking_notes(subjects: Sequence[Subject]) -> list[str]:
    """Return who is safer than whom, for each set of φ; where φ differ metres do not compare.

    It is by the margin. Where nobody has one it is by the planned deviation, of one adversary model and one objective
    alone: what was planned with unlike adversary models says who knew more.
    """
    key = "margin" if any(one.figures["margin"] is not None for one in subjects) else "deviation"
    groups: dict[tuple[object, ...], list[Subject]] = {}
    for one in subjects:
        if one.figures[key] is not None:
            of = () if key == "margin" else (one.figures.get("adversary_model"), one.ranking_objective)
            groups.setdefault((one.safe_key, one.figures["eta_max"], *of), []).append(one)
    found = [_ranking(members, key) for members in groups.values() if len(members) > 1]
    if len(subjects) == 2 and found:
        found = [_verdict(*subjects) or found[0]]
    found = list(filter(None, found))
    for one in subjects if len(subjects) > 1 else ():  # of a single one that stands in the sentence about it
        if said := credibility(one.figures["warnings"]):
            found.append(f"What is said of {one.label} is {said}: its warnings say why.")
    left = [one.label for one in subjects if one.figures[key] is None]
    if key == "margin" and left:
        named = ", ".join(left) if len(left) <= _FEW else formats.counted(len(left), "car")
        found.append(f"The margin is not known of {named}, which no other figure ranks beside those that have one.")
    if len({one.safe_key for one in subjects}) > 1:
        found.append("Not all assessments are on the same φ: margins compare only where they are.")
    elif len(groups) > 1:
        found.append("η_max, or what the adversary knew or planned for, differ: such figures do not compare.")
    return found


def _verdict(first: Subject, second: Subject) -> str:
    """Return what `skd compare` says of the second of two cars by their results alone; empty if it says nothing."""
    found = compare(read_result(first.folder), read_result(second.folder))
    if found.decided_by is None:
        return ""
    figure, held = AT_THE_TOP[found.decided_by], found.differences[found.decided_by]
    verdict = f"{found.verdict} ({found.reason})" if found.reason else found.verdict
    difference = f"{held.value:+.3f}{figure.kind.unit and ' ' + figure.kind.unit}".replace("-", formats.PAGE.minus)
    sure = f"{100 * held.confidence:.3g} % interval {formats.number(held.interval)}"
    more = "skd compare also tries each car on the other's trajectories, so its figures may differ."
    return f"{second.label} compared with {first.label}: {verdict}; {figure.label} {difference}, {sure}. {more}"


def _bounded(one: Subject, key: str) -> str:
    text = formats.number(one.figures[key], 3, "m")
    return formats.bounded(one.figures, text) if key == "margin" else text


def _ranking(members: Sequence[Subject], key: str) -> str:
    name = AT_THE_TOP[key].label
    credible = [one for one in members if not credibility(one.figures["warnings"])]
    if len(credible) < 2:
        return ""
    ordered = sorted(credible, key=lambda one: float(one.figures[key]))
    passing = [one for one in ordered if not does_not_get_past(one.figures)]
    ranked, which = (passing, " of cars that get past people") if 1 < len(passing) < len(ordered) else (ordered, "")
    last, first = ranked[-1], ranked[0]
    close = [
        f"{low.label} and {high.label}"
        for low, high in itertools.pairwise(ordered)
        if _overlap(low.figures[f"{key}_ci95"], high.figures[f"{key}_ci95"])
    ]
    text = f"Greatest {name}{which}: {last.label}, {_bounded(last, key)}; least: {first.label}, {_bounded(first, key)}."
    if close:
        named = "; ".join(close) if len(close) <= _FEW else f"{len(close)} pairs"
        text += f" Intervals that overlap, or are not known: {named}. skd compare tells more."
    return text


def unranked_notes(subjects: Sequence[Subject]) -> list[str]:
    """Return why cars have no equivalent multiplier, once for all that have it in common."""
    groups: dict[str, list[str]] = {}
    for one in subjects:
        if not one.figures["equivalent_multiplier_text"] and one.figures["equivalent_multiplier_note"]:
            groups.setdefault(str(one.figures["equivalent_multiplier_note"]), []).append(one.label)
    return [
        f"{', '.join(labels) if len(labels) <= _FEW else formats.counted(len(labels), 'car')}: {note}"
        for note, labels in groups.items()
    ]


def _overlap(one: Sequence[float] | None, other: Sequence[float] | None) -> bool:
    return one is None or other is None or (one[0] <= other[1] and other[0] <= one[1])


def same_safe(subject: Subject) -> list[str]:
    """Return the names of φ that are one and the same: assessment.json counts the runs along them together."""
    names = [str(row["name"]) for row in subject.figures["per_safe_trajectory"]]
    groups: dict[bytes, list[str]] = {}
    for name, phi in zip(names, subject.episodes.safe, strict=True):
        groups.setdefault(phi.tobytes(), []).append(name)
    return [" and ".join(group) for group in groups.values() if len(group) > 1]


def matrix_of(subjects: Sequence[Subject]) -> dict[str, Any] | None:
    """Return the names of scenarios, and for each car and scenario its results; None unless both are several."""
    cars, scenarios = list(dict.fromkeys(str(one.figures["car"]) for one in subjects)), scenarios_of(subjects)
    if len(cars) < 2 or len(scenarios) < 2:
        return None
    cells: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for one in subjects:
        cells.setdefault((str(one.figures["car"]), one.scenario.name), []).append(one.figures)
    rows = [(car, [cells.get((car, name), []) for name in scenarios]) for car in cars]
    return {"scenarios": scenarios, "rows": rows}


def by_scenario(subjects: Sequence[Subject]) -> list[int]:
    """Return the places of subjects, those of one scenario together."""
    order = scenarios_of(subjects)
    return sorted(range(len(subjects)), key=lambda place: (order.index(subjects[place].scenario.name), place))
