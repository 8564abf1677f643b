"""The report without a browser: what the file holds, that it is the results', and that no name of anybody's is code."""

import base64
import gzip
import hashlib
import itertools
import json
import re
import shlex
from html.parser import HTMLParser

import numpy as np
import pytest
from cli_support import names, one_line
from report_support import edited
from skd_evaluator.assessment.from_options import plan_of, scenario_for
from skd_evaluator.assessment.run.episodes import run_episode
from skd_evaluator.assessment.stages.safe_trajectories import single_episode
from skd_evaluator.cli.main import make_parser
from skd_evaluator.report.formats import how_unusual
from skd_evaluator.report.html import page
from skd_evaluator.report.html.subjects import RESOLUTION, pack, read_subjects
from skd_evaluator.report.repeat import repeat_command
from skd_evaluator.report.terminal import headline
from skd_sim.world.episode import Mode, Outcome

VOID = {"meta", "link", "br", "input", "img"}


class Reader(HTMLParser):
    """Reads a page as a browser does; knows what is open, what refers elsewhere, and what is text."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.scripts: list[str] = []
        self.text = ""

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)
        if tag == "script":
            self.scripts.append("")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] == "script":
            self.scripts[-1] += data
        elif self.open and self.open[-1] != "style":
            self.text += data


def unpack(block: str) -> dict:
    return json.loads(gzip.decompress(base64.b64decode(block)))


def read(html: str) -> Reader:
    reader = Reader()
    reader.feed(html)
    reader.close()
    assert reader.open == []
    return reader


@pytest.fixture(scope="module")
def subjects(sweep):
    return read_subjects([sweep])


@pytest.fixture(scope="module")
def report(subjects) -> Reader:
    return read(page.render(subjects))


def test_the_file_asks_nobody_for_anything(report):
    for tag, attributes in report.elements:
        for name in ("src", "href", "srcset", "action", "data", "poster"):
            value = attributes.get(name)
            assert value is None or value.startswith(("#", "data:")), (tag, value)
    (policy,) = [one["content"] for tag, one in report.elements if tag == "meta" and "http-equiv" in one]
    assert policy.startswith("default-src 'none';")
    allowed = set(re.findall(r"'sha256-([^']+)'", policy))
    run = [script for script in report.scripts if script != report.scripts[0]]
    assert {base64.b64encode(hashlib.sha256(one.encode()).digest()).decode() for one in run} == allowed
    assert len(run) == len(allowed) == 2


def test_figures_are_those_of_the_assessments(report, sweep, subjects):
    for part in sorted(sweep.glob("synthetic/*/assessment.json")):
        figures = json.loads(part.read_text())
        low, high = figures["margin_ci95"]
        assert headline(figures, named=False) in report.text
        for text in (
            f"{figures['margin']:.3f}", f"{figures['deviation']:.3f}",
            f"{100 * figures['nominal_collision_rate']:.1f} %",
            f"{figures['optimality_gap']:.2f}", f"{figures['impact_speed']['mean']:.1f}",
            f"{low:.3f} to {high:.3f}", f"{figures['skd']:.3f}",
            f"{100 * figures['contact_rate']:.1f} %", f"basic, C = {figures['multiplier']:g}",
        ):  # fmt: skip
            assert text in report.text
        assert all(f"{row['deviation']:.3f}" in report.text for row in figures["per_safe_trajectory"])
    lower, higher = sorted(subjects, key=lambda one: one.figures["margin"])
    gains = [after.mean() - before.mean() for before, after in zip(lower.margins, higher.margins, strict=True)]
    low, high = np.mean(gains) + 12.7062 * abs(gains[0] - gains[1]) / 2 * np.array([-1.0, 1.0])  # Student, two φ
    said = f"{higher.label} compared with {lower.label}: inconclusive; margin {np.mean(gains):+.3f} m, 95 % interval "
    assert f"{said}{low:.3f} to {high:.3f}.".replace("-", "−") in report.text


def test_curves_are_told_apart_in_grey_and_begin_at_the_rate_of_the_table(report, subjects):
    content = unpack(report.scripts[0])
    (spec,) = content["charts"]["curves"]
    (lines,) = [one for one in spec["layer"] if one["mark"].get("type") == "line"]
    dashes = lines["encoding"]["strokeDash"]["scale"]["range"]
    assert len(dashes) == len(subjects)
    assert all(one != other for one, other in itertools.pairwise(dashes))
    (dots,) = [one["data"]["values"] for one in spec["layer"] if one["mark"]["type"] == "point"]
    for one in subjects:
        (dot,) = [dot for dot in dots if dot["car"] == one.label]
        ends = [100.0 * end for end in one.figures["nominal_collision_rate_ci95"]]
        assert [dot["low"], dot["high"]] == ends
        assert f"{ends[0]:.1f} to {ends[1]:.1f} %" in report.text


def test_episodes_are_those_of_the_trajectories(report, sweep):
    content = unpack(report.scripts[0])
    episodes = content["episodes"]
    for index, one in enumerate(content["subjects"]):
        with np.load(sweep / "synthetic" / f"C_{one['label'].split('= ')[1]}" / "episodes.npz") as stored:
            arrays = dict(stored)
        trials, phis, objectives = arrays["episode_id"] & 0xFFFFFFFF, arrays["safe_index"], arrays["objective"]
        ran = np.flatnonzero(arrays["mode"] != Mode.SAFE).tolist()
        keys = {(int(trials[row]), int(phis[row]), str(objectives[row])): row for row in ran}
        for episode in (episode for episode in episodes if episode["subject"] == index):
            row = keys.pop((episode["trial"], episode["phi"], episode["objective"]))
            low, high = arrays["offsets"][row : row + 2]
            walked = RESOLUTION * np.cumsum(episode["path"], axis=1)[:2].T
            psi = arrays["positions"][low:high]
            np.testing.assert_allclose(walked[:-1], psi[:-1], atol=0.51 * RESOLUTION)
            assert episode["touched"] == (arrays["outcome"][row] == Outcome.COLLISION)
            if episode["touched"]:
                share = arrays["impact_time"][row] / arrays["time_step"] - (len(psi) - 2)
                np.testing.assert_allclose(walked[-1], psi[-2] + share * (psi[-1] - psi[-2]), atol=0.51 * RESOLUTION)
        assert keys == {}
    # The worst first, by the definition in the page's own words.
    hits = [one["outcome"] == "hit" for one in episodes]
    assert hits == [one["touched"] and one["speed"] >= 0.556 for one in episodes]
    assert hits == sorted(hits, reverse=True)
    deviations = [one["deviation"] for one in episodes if one["outcome"] == "hit"]
    assert deviations == sorted(deviations)


def test_the_curve_is_of_the_margins_and_planned_ones_stand_beside_it(subjects):
    one = subjects[0]
    content = unpack(read(page.render([one])).scripts[0])
    lines = [layer for layer in content["charts"]["curves"][0]["layer"] if layer["mark"].get("type") == "line"]
    assert len(lines) == 2  # no bound: what two figures alone allow is in the details
    with np.load(one.folder / "episodes.npz") as stored:
        margins = np.where(np.isfinite(stored["margin"]), stored["margin"], stored["eta_max"])
    planned, main = (layer["data"]["values"] for layer in lines)
    for values, trials in ((main, margins), (planned, np.concatenate(one.assessment.for_deviation.trial_deviations))):
        for at in values[:-1]:
            low, high = (100.0 * np.mean(trials <= at["eta"] + error) for error in (-1e-4, 1e-4))
            assert low - 0.01 <= at["rate"] <= high + 0.01
    area = one.figures["vulnerability_curve"]["margins"]["area_above"]
    assert area == pytest.approx(margins.mean()) == one.figures["margin"]


def test_each_command_repeats_its_episode(subjects):
    parser = make_parser()
    for subject in subjects:
        episodes = subject.episodes
        picked = [
            int(np.flatnonzero((episodes.objective == kind) & (episodes.safe_index == 1))[-1])
            for kind in ("", "deviation", "paper")
        ]
        for number in picked:
            words = repeat_command(
                subject.figures, Mode(int(episodes.mode[number])), str(episodes.objective[number]),
                int(episodes.episode_id[number]),
            )  # fmt: skip
            asked = parser.parse_args(shlex.split(shlex.join(words))[1:])
            plan = plan_of(vars(asked), scenario_for(asked.scenario, asked.safe))
            mode = Mode[asked.mode.upper()]
            log = run_episode(single_episode(plan, mode, asked.trial, safe_number=asked.safe_number))
            np.testing.assert_array_equal(log.adversary, episodes.adversary[number])
            np.testing.assert_array_equal(log.car, episodes.car[number])


def test_what_was_aborted_is_said_first(subjects, tmp_path):
    aborted = {"no answer": {"count": 5, "first": "no answer: car_controller was silent"}}
    (some,) = read_subjects([edited(subjects[0].folder, tmp_path / "some", aborted=5, aborted_reasons=aborted)])
    text = read(page.render([some])).text
    assert "5 episodes aborted (no answer)" in text
    assert "no warnings" not in text


def test_a_page_that_would_be_too_large_keeps_its_figures(subjects, monkeypatch):
    """Paths of the best episodes go first; the table stays whole."""
    whole = page.render(subjects[:1])
    monkeypatch.setattr(page, "LARGEST", len(whole.encode()) - 2000)
    html = page.render(subjects[:1])
    assert len(html.encode()) <= page.LARGEST
    content = unpack(read(html).scripts[0])
    assert len(content["episodes"]) == len(subjects[0].episodes)
    assert all(one["path"] for one in content["subjects"][0]["failures"])  # they are few
    there = [one["path"] is not None for one in content["episodes"]]
    assert there == sorted(there, reverse=True)
    assert 0 < sum(there) < len(there)


def test_how_few_people_are_more_unusual():
    assert how_unusual(1e-9) == "more unusual than almost everybody"
    assert how_unusual(4e-4) == "1 in 2,500 people walk more unusually"


def test_what_a_name_says_is_no_code():
    name = {"φ": "</script><!-- "}
    assert unpack(pack(name)) == name
    assert "<" not in pack(name)


def test_report_and_show_as_commands(skd_here, here, sweep):
    done = skd_here("report", str(sweep), "--out", "r.html")
    assert done.returncode == 0, done.stderr
    assert "report of 2 assessments in r.html" in done.stdout
    assert names(here) == ["good.csv", "my_cars.py", "r.html"]
    one_line(skd_here("report", str(sweep), "--out", "r.html"), 2, "--overwrite")
    one_line(skd_here("report", str(sweep), str(sweep), "--out", "s.html"), 2, "twice")
    one_line(skd_here("report", ".", "--out", "s.html"), 2, "assessment.json")
    one_line(skd_here("report", str(sweep), "--out", "s.pdf"), 2, ".html")
    for name in ("deviation", "margin"):
        other = edited(sweep / "synthetic" / "C_1", here / name, **{name: 0.0})
        one_line(skd_here("report", str(other), "--out", "s.html"), 2, "not of one assessment")
    (other / "assessment.json").write_text("{}")
    one_line(skd_here("report", str(other), "--out", "s.html"), 2, "no assessment of this version")
    assert not (here / "s.html").exists()
