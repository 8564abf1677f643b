"""The table of figures is what assessment.json, its schema, the documents and every output of figures have."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from skd_evaluator.assessment.figure_table import AT_THE_TOP, FIGURES, OF_OBJECTIVES, OF_PHI, Of, shown_in
from skd_evaluator.assessment.files.assessment_json import assessment_schema
from skd_evaluator.assessment.files.results import StoredResult, read_result, write_assessment
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages.risk import risk_request
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories
from skd_sim.options.adversary import DEFAULT_OBJECTIVES
from skd_sim.scenario.scenario import load_scenario
from stages import rate, with_margins, with_risks

MEASURE = Path(__file__).parents[2] / "docs" / "metrics.md"


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> StoredResult:
    plan = Plan(load_scenario("crossing"), safe_count=2, kamikaze_count=3, collision_runs=4, simulations=20)
    folder = tmp_path_factory.mktemp("result")
    with InProcessRunner(1) as runner:
        safe = safe_trajectories(plan, runner)
        rating = rate(plan, DEFAULT_OBJECTIVES, safe, runner)
        rating = with_margins(rating, runner, 300)
        write_assessment(folder, with_risks(rating, risk_request("walkers"), runner))
    return read_result(folder)


def test_a_result_has_the_rows_of_the_table_and_no_others(result):
    figures = result.figures
    assert list(figures) == [key for one in AT_THE_TOP.values() if not one.optional for key in one.keys]
    for objective in figures["objectives"].values():
        assert set(objective) == {key for one in OF_OBJECTIVES.values() for key in one.keys}
        assert {key for row in objective["per_safe_trajectory"] for key in row} == set(OF_PHI)
    at_the_top = {one.key for one in FIGURES if one.of is Of.PHI_TOP}
    assert {key for row in figures["per_safe_trajectory"] for key in row} == set(OF_PHI) | at_the_top


def without_description(node: Any, path: str) -> Iterator[str]:
    for key, one in node.get("properties", {}).items():
        if not one.get("description"):
            yield f"{path}.{key}"
    for key, one in node.items():
        for inside in one if isinstance(one, list) else [one]:
            if isinstance(inside, dict):
                yield from without_description(inside, f"{path}.{key}")


def test_the_schema_says_what_every_key_is():
    assert list(without_description(assessment_schema(), "")) == []


def test_what_is_shown_to_people_has_a_name_and_a_figure_behind_it(result):
    for output in ("summary", "details", "chart"):
        assert all(one.label and one.key in AT_THE_TOP for one in shown_in(output))
    assert {one.key for one in shown_in("difference")} <= set(result.groups)


def test_the_documents_name_the_first_figures_and_which_way_is_better():
    rows = re.findall(r"^\| \*\*(.+?)\*\*(.*?) \|.*\| (.+?) \|$", MEASURE.read_text(encoding="utf-8"), re.MULTILINE)
    said = {name + rest: better for name, rest, better in rows}
    first = [one for one in shown_in("summary") if one.first]
    assert said == {one.title.partition(",")[0]: str(one.better) for one in first}
