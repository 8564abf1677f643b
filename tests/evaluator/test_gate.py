"""The gate: which conditions hold, what continuous integration is told, and that a wrong name is said at once."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from cli_support import SMALL, one_line
from skd_evaluator.assessment.compare.gate import Check, Limit, check_limits
from skd_evaluator.assessment.files.results import read_result, write_assessment
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.episodes import aborted
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories
from skd_evaluator.cli.gate import Gate
from skd_evaluator.margin.common_trajectories import check_not_worse
from skd_evaluator.metrics.aborted import NOT_CREDIBLE, at_worst
from skd_evaluator.metrics.price_of_caution import HORIZON, HarmlessRun, PriceOfCaution
from skd_evaluator.metrics.statistics import mean
from skd_evaluator.report.formats import figure_rows
from skd_evaluator.report.presentation import junit_xml, markdown
from skd_evaluator.report.terminal import headline
from skd_sim import EpisodeLog, EpisodeSpec, Mode, load_scenario
from skd_sim.errors import AssessmentError
from skd_sim.options.car_and_adversary import DEFAULT_OBJECTIVES
from stages import rate

PLAN = Plan(
    load_scenario("crossing"), multiplier=1.15, safe_count=4, kamikaze_count=4, collision_runs=8, seed=5, simulations=30
)


@pytest.fixture(scope="module")
def cars(sweep: Path) -> list[Path]:
    """Results of a car that is easily hit, and of one that is less so."""
    return [sweep / "synthetic" / name for name in ("C_0.5", "C_1")]


@pytest.fixture(scope="module")
def result(cars: list[Path]) -> dict[str, Any]:
    return json.loads((cars[0] / "assessment.json").read_text(encoding="utf-8"))


def test_limits_hold_on_their_own_side(result):
    value = result["deviation"]
    for limit, passed in ((value, True), (np.nextafter(value, 9.0), False), (np.nextafter(value, 0.0), True)):
        (least,) = check_limits(result, [Limit("deviation", float(limit))])
        assert (least.passed, least.failed, least.error) == (passed, not passed, False)
        (most,) = check_limits(result, [Limit("deviation", float(limit), is_least=False)])
        assert most.passed == (value <= limit)


def test_a_limit_holds_for_each_of_several_cars(cars, result, skd_here):
    deviation = result["deviation"]  # the lesser one
    for limit, code in ((9.0, 0), (deviation, 1)):
        words = ("--no-pictures", "--fail-above", f"deviation={limit!r}", "--overwrite", "--out", "both")
        done = skd_here("compare", *cars, *words)
        assert done.returncode == code
        assert ("gate: basic, C = 1: deviation ≤" in done.stderr) == bool(code)
        assert "gate: basic, C = 0.5" not in done.stderr


def test_no_gate_passes_with_figures_that_are_not_credible(result):
    """A car that counts its episodes passed, with a warning that nobody reads where a machine decides."""
    doubted = {**result, "warnings": [f"{NOT_CREDIBLE}it counts"]}
    assert headline(doubted) == f"Not credible (the warnings say why): {headline(result)}"
    checks = Gate((Limit("deviation", 0.0),), None, {}).checks(doubted, None, [])
    assert [(one.error, one.passed) for one in checks] == [(True, False), (True, False)]
    assert checks[1].text.startswith("not judged, for the assessment is an error: ")
    assert checks[0].text == f"{NOT_CREDIBLE}it counts"
    assert markdown(doubted, checks).startswith("## ⚠️")
    assert Gate((), None, {}).checks(result, None, [])[0].passed


def test_a_car_that_stands_has_no_price(result):
    price = PriceOfCaution((HarmlessRun("waits", HORIZON, HORIZON, 6.0, braked=False),) * 2)
    assert (price.time_lost, price.mean("deadlock")) == (None, 1.0)
    stands = {**result, "deadlock": 1.0, "time_lost": None, "time_lost_ci95": None}
    assert "| price of caution (s) | —, never passes, on the empty road either | — | — |" in markdown(stands, [])
    assert [row.value for row in figure_rows(stands) if row.name == "price of caution (s)"] == ["never passes"]


class Aborting:
    """A runner of whose kamikazes every second trial is aborted."""

    def __init__(self, runner: InProcessRunner) -> None:
        self.runner = runner

    def run(self, episodes: Sequence[EpisodeSpec]) -> Iterator[EpisodeLog]:
        for log in self.runner.run(episodes):
            lost = log.episode.mode == Mode.KAMIKAZE and log.episode.episode_id % 2
            yield aborted(log.episode, "process ended: it did") if lost else log


def test_a_car_that_may_be_behind_by_its_aborted_episodes_is_not_judged(tmp_path):
    """It passed: its planned deviation is that of the trials that it let go on."""
    whole = InProcessRunner(1)
    safe = safe_trajectories(PLAN, whole)
    for name, runner in (("whole", whole), ("aborting", Aborting(whole))):
        (tmp_path / name).mkdir()
        write_assessment(tmp_path / name, rate(PLAN, DEFAULT_OBJECTIVES, safe, runner))
    earlier, mine = read_result(tmp_path / "whole"), read_result(tmp_path / "aborting")
    counts = mine.figures["objectives"]["deviation"]
    assert sum(map(len, mine.worst["deviation"])) == counts["trials"] + counts["aborted"]
    assert mean(np.concatenate(mine.worst["deviation"])) == pytest.approx(at_worst(mine.figures, "deviation").value)
    found = check_not_worse(tmp_path / "aborting", earlier)
    assert (found.failed, found.error) == (False, True)
    assert "it would be less safe by deviation if it had hit in all of its aborted episodes" in found.text
    assert check_not_worse(tmp_path / "aborting", mine).error
    assert check_not_worse(tmp_path / "whole", mine).passed


@pytest.mark.parametrize("name", ["margin", "margin_p10", "equivalent_multiplier"])
def test_an_upper_bound_shows_no_least(result, name):
    """With a longer search the same car may be below the limit."""
    bound = {**result, name: 0.8, "margin_converged": False, "margin_budget": 16}
    (passed,) = check_limits(bound, [Limit(name, 0.5)])
    assert (passed.failed, passed.error) == (False, True)
    assert "had not converged at 16 candidates a trial, so this is an upper bound" in passed.remarks[0]
    (failed,) = check_limits(bound, [Limit(name, 0.9)])
    assert (failed.failed, failed.error) == (True, False)
    (most,) = check_limits(bound, [Limit(name, 0.9, is_least=False)])
    assert most.passed
    (other,) = check_limits({**bound, "deviation": 0.8}, [Limit("deviation", 0.5)])
    assert other.passed
    assert check_limits({**bound, "margin_converged": True}, [Limit(name, 0.5)])[0].passed


CHECKS = [
    Check("assessment", "1 aborted: \x1b[31mno answer"),
    Check("a < b & c", "said | \"quoted\" <script>", failed=True, remarks=("b is at most 3", "so it is")),
    Check("not worse", "not compared\x00", error=True),
]  # fmt: skip


def test_junit_tells_failures_of_the_car_from_errors(result, tmp_path):
    root = ElementTree.fromstring(junit_xml(result, CHECKS).encode())
    (suite,) = root
    assert {key: suite.attrib[key] for key in ("tests", "failures", "errors")} == {
        "tests": "3", "failures": "1", "errors": "1",
    }  # fmt: skip
    cases = suite.findall("testcase")
    assert [[child.tag for child in case] for case in cases] == [["system-out"], ["failure"], ["error"]]
    assert [case.attrib["name"] for case in cases] == [one.name for one in CHECKS]
    bound = junit_xml({**result, "margin_converged": False, "equivalent_multiplier_text": "1.140"}, CHECKS)
    assert 'name="equivalent_multiplier_text" value="at most 1.140"' in bound
    assert cases[1][0].attrib["message"] == CHECKS[1].text
    assert "�" in cases[2][0].text
    assert cases[1][0].text.splitlines() == [CHECKS[1].text, *CHECKS[1].remarks]
    assert float(suite.attrib["time"]) == pytest.approx(result["seconds"], abs=1e-3)
    gate = Gate((Limit("margin", 0.5),), None, {"junit": tmp_path / "j.xml"})
    with pytest.raises(AssessmentError), gate.watch("x:Y"):
        raise AssessmentError("it died")
    lost = ElementTree.parse(tmp_path / "j.xml").findall(".//testcase[error]")
    assert [case.attrib["name"] for case in lost] == ["assessment", "margin ≥ 0.5"]


def test_the_command_line_decides(skd_here, here, cars):
    conditions = ["--fail-below", "objectives.paper.skd=0.1", "--fail-above", "margin_trials=0"]
    files = ["--junit", "j.xml", "--markdown", "m.md"]
    earlier = ["--fail-if-worse-than", cars[1]]
    done = skd_here("assess", *SMALL, *conditions, *earlier, *files, "--out", "out")
    assert done.returncode == 1
    passed, failed, error = [line for line in done.stdout.splitlines() if line.startswith("gate: ")]
    assert "gate: objectives.paper.skd ≥ 0.1: passed" in passed
    assert "gate: margin_trials ≤ 0: failed" in failed
    assert "not compared" in error
    assert "gate: 2 of 3 conditions not passed: margin_trials ≤ 0, " in done.stderr
    assert (here / "out" / "assessment.json").exists()
    suite = ElementTree.parse(here / "j.xml").getroot()
    assert (suite.attrib["failures"], suite.attrib["errors"]) == ("1", "1")
    assert {path.name for path in here.iterdir()} == {"out", "j.xml", "m.md", "my_cars.py", "good.csv"}


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (["--fail-below", "deviatoin=1"], ["--fail-below deviatoin=1", "did you mean 'deviation'?"]),
        (["--fail-above", "price=1"], ["no figure 'price'", "did you mean time_lost?"]),
        (["--fail-above", "impact_speed=1"], ["did you mean impact_speed.mean?"]),
        (["--fail-below", "safety=1"], ["one number; it has margin, risk_1, time_lost"]),
        (["--fail-below", "deviation=much"], ["FIGURE=NUMBER"]),
        (["--fail-above", "contact_rate=5"], ["--fail-above contact_rate=5", "from 0 to 1, where 0.05 is 5 %"]),
        (["--fail-below", "margin=-1"], ["--fail-below margin=-1", "at least 0"]),
        (["--junit", "same.out", "--markdown", "./same.out"], ["--junit same.out: --markdown is written there, too"]),
        (["--fail-if-worse-than", "nowhere"], ["--fail-if-worse-than nowhere: there is no such folder"]),
        (["--fail-if-worse-than", "."], ["--fail-if-worse-than .: holds no assessment.json; give a folder that"]),
        (["--junit", "nowhere/j.xml"], ["--junit nowhere/j.xml", "folder"]),
    ],
)
def test_wrong_conditions_are_said_before_anything_runs(skd_here, here, arguments, parts):
    one_line(skd_here("assess", *SMALL, *arguments), 2, *parts)
    assert not (here / "skd_results").exists()


def test_what_an_earlier_run_wrote_does_not_stay_beside_a_car_that_cannot_be_loaded(skd_here, tmp_path):
    for name in ("gate.xml", "gate.md"):
        (tmp_path / name).write_text("passed")
    done = skd_here("assess", "--controller", "nobody:Car", "--junit", "gate.xml", "--markdown", "gate.md")
    assert done.returncode == 2
    assert not list(tmp_path.glob("gate.*"))
