"""Results of before: that their keys, of which some meant something else, are read as what they are."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_support import one_line
from common import assert_valid, scenario_of_before
from skd_evaluator.campaign.compare.comparison import compare
from skd_evaluator.campaign.compare.gate import check_not_worse
from skd_evaluator.campaign.judge.rating import Rating, rate
from skd_evaluator.campaign.plan.plan import Plan, safe_trajectories
from skd_evaluator.campaign.run.workers import InProcessRunner
from skd_evaluator.campaign.store.former_names import NOTE, of_today
from skd_evaluator.campaign.store.manifest import write_manifests
from skd_evaluator.campaign.store.result_file import ASSESSMENT, read_figures
from skd_evaluator.campaign.store.results import write_assessment
from skd_evaluator.campaign.store.stored_result import read_result
from skd_evaluator.campaign.store.verification import verify
from skd_evaluator.floor.assessment_floor import with_floors
from skd_evaluator.margin.assessment_margin import with_margins
from skd_evaluator.report.history.runs import read_run
from skd_evaluator.report.html.subjects import read_subjects
from skd_evaluator.report.repeat import scenario_name
from skd_sim.choices.objective import DEFAULT_OBJECTIVES
from skd_sim.encounter.scenario import load_scenario
from skd_sim.errors import UsageError

CROSSING = load_scenario("crossing")
# Before, any touch was a hit: with this speed a rating of today counts as one of then.
TOUCH = replace(CROSSING, collision=replace(CROSSING.collision, hit_speed=0.0))
PLAN = Plan(TOUCH, safe_count=3, kamikaze_count=3, collision_runs=6, seed=5, simulations=30)

RENAMED = {
    "deformation_ci95_attempts": "deformation_ci95", "deformation_ci95": "deformation_ci95_clustered",
    "deformation_success_rate_ci95_attempts": "deformation_success_rate_ci95",
    "deformation_success_rate_ci95": "deformation_success_rate_ci95_clustered",
    "success_rate_ci95_attempts": "success_rate_ci95", "success_rate_ci95": "success_rate_ci95_clustered",
    "kamikaze_success_rate_ci95_attempts": "kamikaze_success_rate_ci95",
    "kamikaze_success_rate_ci95": "kamikaze_success_rate_ci95_clustered",
    "skd_ci95_pairs": "skd_ci95", "skd_ci95": "skd_ci95_clustered",
    "skd_prefix_ci95_pairs": "skd_prefix_ci95", "skd_prefix_ci95": "skd_prefix_ci95_clustered",
    "collision_rate_ci95_runs": "collision_rate_ci95", "collision_rate_ci95": "collision_rate_ci95_clustered",
    "probability_bound_ci95": "probability_bound_ci95_clustered",
    "floor_ratio": "closeness", "floor_ratio_ci95": "closeness_ci95",
}  # fmt: skip
"""Keys of today, and what they were called before; what became of others stands in `before`."""
NEW = (
    "margin", "margin_ci95", "margin_converged", "margin_budget", "margin_gap", "margin_attempts", "margin_beyond",
    "margin_how", "margin_note", "impact_speed", "closeness", "closeness_ci95", "hit_rate", "hit_rate_ci95",
    "knowledge", "margin_p10",
)  # fmt: skip
EQUIVALENT = {"": 1.02, "_text": "1.020", "_ci95": [0.98, 1.05], "_ci95_clustered": [0.9, 1.1],
              "_ci95_text": "[0.980, 1.050]", "_ci95_clustered_text": "[0.900, 1.100]", "_note": ""}  # fmt: skip


def renamed(figures: dict[str, Any]) -> dict[str, Any]:
    return {RENAMED.get(name, name): value for name, value in figures.items() if name not in NEW}


def points(curve: list[dict[str, Any]]) -> list[dict[str, Any]]:
    names = {"ci95_attempts": "ci95", "ci95": "ci95_clustered"}
    return [{names.get(name, name): value for name, value in one.items()} for one in curve]


def measures(figures: dict[str, Any]) -> dict[str, Any]:
    names = {"ci95_pairs": "ci95", "ci95": "ci95_clustered"}
    return {
        key: {names.get(name, name): value for name, value in one.items()} for key, one in figures["measures"].items()
    }


def before(today: dict[str, Any]) -> dict[str, Any]:
    """Return what assessment.json of a result was before the margin."""
    found = renamed(today)
    found["measures"] = measures(today)
    found["objectives"] = {}
    for name, one in today["objectives"].items():
        mine = renamed(one) | {"floor_of_all": 0.2, "floor_of_all_ci95": None, "floor_gap": 0.0, "floor_budget": None}
        mine["measures"] = measures(one)
        if name == "deformation":  # a floor of deformations, under the name of the Fréchet one
            mine |= {"floor": 0.1, "floor_ci95": [0.05, 0.15], "floor_missing": 0, "closeness": 1.3}
        found["objectives"][name] = mine
    found |= {"deformation_floor": 0.1, "deformation_floor_ci95": [0.05, 0.15], "deformation_closeness": 1.3}
    found = {name: value for name, value in found.items() if not name.startswith("equivalent_multiplier")}
    found |= {f"equivalent_multiplier{end}": value for end, value in EQUIVALENT.items()}
    curve = today["vulnerability_curve"]
    found["vulnerability_curve"] = {
        "kamikazes": {**curve["kamikazes"], "points": points(curve["kamikazes"]["points"])},
        "budgets": [{"eta": 0.5, "probability": 0.5, "ci95": [0.1, 0.9], "successes": 1, "attempts": 2}],
        "floors": {**curve["kamikazes"], "points": points(curve["kamikazes"]["points"])},
    }
    del found["scenario"]["collision"]["hit_speed"]
    return called_pedestrian(found)


def called_pedestrian(today: dict[str, Any]) -> dict[str, Any]:
    """Return what assessment.json of a result was before the adversary was called so."""
    return {**today, "scenario": scenario_of_before(today["scenario"])}


@pytest.fixture(scope="module")
def ratings() -> dict[float, Rating]:
    with InProcessRunner(1) as runner:
        safe = safe_trajectories(PLAN, runner)
        plans = {multiplier: replace(PLAN, multiplier=multiplier) for multiplier in (0.5, 1.15)}
        return {
            multiplier: with_floors(
                rate(plan, DEFAULT_OBJECTIVES, safe, runner, lambda *_told: None), runner, lambda *_told: None
            )
            for multiplier, plan in plans.items()
        }


@pytest.fixture(scope="module")
def folders(ratings: dict[float, Rating], tmp_path_factory: pytest.TempPathFactory) -> dict[float, Path]:
    """Results as they were before."""
    found = {}
    for multiplier, rating in ratings.items():
        folder = found[multiplier] = tmp_path_factory.mktemp("before") / f"C{multiplier}"
        folder.mkdir()
        write_assessment(folder, rating)
        rewrite(folder, before)
        with np.load(folder / "episodes.npz") as arrays:
            kept = {name: arrays[name] for name in arrays.files if name != "hit_speed"}
        np.savez_compressed(folder / "episodes.npz", **kept)
    return found


def rewrite(folder: Path, change: Callable[[dict[str, Any]], dict[str, Any]]) -> None:
    path = folder / "assessment.json"
    path.write_text(json.dumps(change(json.loads(path.read_text(encoding="utf-8")))), encoding="utf-8")


def plain(rating: Rating) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(json.dumps(rating.as_dict()))
    return found


def test_every_figure_is_found_again_under_the_key_of_today(ratings):
    expected, told = plain(ratings[0.5]), plain(ratings[0.5])
    found = of_today(before(told))
    assert "_clustered" not in json.dumps({name: value for name, value in found.items() if name != "provenance"})
    assert (found["margin"], found["margin_note"], found["knowledge"]) == (None, NOTE, "known")
    assert found["deformation_ci95"] != found["deformation_ci95_attempts"]
    assert found["floor_ratio"] == expected["floor_ratio"] > 1.0
    assert found["vulnerability_curve"]["margins"] is None
    assert found["vulnerability_curve"]["budgets"][0]["ci95_attempts"] == [0.1, 0.9]
    # Read off planned deformations it is none of margins; what it was is not hidden.
    assert found["equivalent_multiplier"] is None
    assert found["equivalent_multiplier_note"] == f"{NOTE}: 1.020 was read off planned deformations"
    unlike = {
        "margin_note", "hit_rate", "hit_rate_ci95", "knowledge", "equivalent_multiplier_note", "scenario",
        "vulnerability_curve",
    }  # fmt: skip
    for name in expected.keys() - unlike:
        assert found[name] == expected[name], name
    curves = found["vulnerability_curve"]["kamikazes"], expected["vulnerability_curve"]["kamikazes"]
    assert curves[0] == curves[1]
    assert found.keys() - {"knowledge"} == expected.keys() - {"knowledge"}


def test_what_was_read_is_a_result_by_the_schema(ratings):
    found = of_today(before(plain(ratings[0.5])))
    if "knowledge" not in plain(ratings[0.5]):
        del found["knowledge"]
    assert_valid(found)


def test_a_result_of_today_is_left_alone(ratings):
    today = plain(ratings[1.15])
    assert of_today(today) == {**today, "knowledge": "known"}


def test_the_adversary_of_before_is_the_one_of_today(ratings, tmp_path):
    """In every figure, the picture of it, the command that repeats it, and beside a result of today."""
    for name in ("before", "today"):
        (tmp_path / name).mkdir()
        write_assessment(tmp_path / name, ratings[0.5])
    rewrite(tmp_path / "before", called_pedestrian)
    before, today = (read_result(tmp_path / name) for name in ("before", "today"))
    assert before.figures == today.figures
    assert "pedestrian" in json.loads((tmp_path / "before" / "assessment.json").read_text())["scenario"]
    assert compare(before, today).differences["deformation"].value == 0.0
    subjects = read_subjects([tmp_path / "before", tmp_path / "today"])
    assert subjects[0].scenario == subjects[1].scenario == TOUCH
    both = called_pedestrian(plain(ratings[0.5]))
    both["scenario"] |= plain(ratings[0.5])["scenario"]
    with pytest.raises(ValueError, match="section adversary and section pedestrian"):
        of_today(both)


def test_a_result_of_before_is_of_the_shipped_scenario(ratings):
    figures = called_pedestrian(plain(ratings[0.5])) | {"scenario": scenario_of_before(CROSSING.as_dict())}
    assert scenario_name(of_today(json.loads(json.dumps(figures)))) == "crossing"


def test_before_there_were_intervals_by_phi_they_are_not_known(ratings):
    old = before(plain(ratings[0.5]))
    for one in (old, *old["objectives"].values()):
        for name in [name for name in one if name.endswith(("_clustered", "_clustered_text"))]:
            del one[name]
    found = of_today(old)
    assert found["deformation_ci95"] is None
    assert found["deformation_ci95_attempts"] == plain(ratings[0.5])["deformation_ci95_attempts"]
    assert set(found["probability_bound_ci95"].values()) <= {None}


@pytest.mark.parametrize("change", ["margin", "margin_note", "deformation_ci95_attempts", "skd_ci95_clustered"])
def test_keys_of_different_versions_are_refused(ratings, folders, tmp_path, change):
    """A plain interval could then be either of two."""
    mixed = plain(ratings[0.5])
    if change in mixed:
        del mixed[change]
    else:
        mixed[change] = [1.0, 2.0]
    with pytest.raises(ValueError, match="different versions"):
        of_today(mixed)
    shutil.copytree(folders[0.5], tmp_path / "mixed")
    rewrite(tmp_path / "mixed", lambda _old: mixed)
    for read in (read_result, lambda folder: read_subjects([folder])):
        with pytest.raises(UsageError, match="different versions"):
            read(tmp_path / "mixed")


@pytest.mark.parametrize(
    ("controller", "model", "knowledge"),
    [("basic", None, "known"), ("basic", {"a": 1}, "learned"), ("cal", {"a": 1}, "learned"), ("x:Y", None, "nothing")],
)
def test_what_the_adversary_knew_follows_from_the_car_and_its_model(ratings, controller, model, knowledge):
    old = {**before(plain(ratings[0.5])), "controller": controller, "car_model": model}
    assert of_today(old)["knowledge"] == knowledge
    assert of_today({**old, "knowledge": "itself"})["knowledge"] == "itself"


def test_results_of_before_are_held_against_each_other_by_deformation(ratings, folders):
    first, second = (read_result(folders[multiplier]) for multiplier in (0.5, 1.15))
    held = compare(first, second)
    assert (held.judged_by, held.verdict) == ("deformation", "safer")
    assert held.lines()[0].count(NOTE) == 2
    assert held.differences["deformation"].value == pytest.approx(
        ratings[1.15].as_dict()["deformation"] - ratings[0.5].as_dict()["deformation"]
    )
    assert "hit_rate" not in held.differences
    (subject,) = read_subjects([folders[0.5]])
    assert subject.figures["deformation"] == ratings[0.5].as_dict()["deformation"]


def test_a_touch_of_before_is_no_hit_of_today(folders, tmp_path):
    """A deformation then was of any touch, so it says nothing beside one of today."""
    with InProcessRunner(1) as runner:
        plan = replace(PLAN, scenario=CROSSING)
        safe = safe_trajectories(plan, runner)
        rating = rate(plan, DEFAULT_OBJECTIVES, safe, runner, lambda *_told: None)
        write_assessment(tmp_path, with_margins(rating, runner, lambda *_told: None, 100))
    held = compare(read_result(folders[0.5]), read_result(tmp_path))
    assert held.verdict == "not compared"
    assert "hit speed (m/s) 0 and 0.556" in held.planned_refusal
    assert "collision_rate" in held.differences
    check = check_not_worse(tmp_path, read_result(folders[0.5]))
    assert (check.error, check.failed) == (True, False)
    assert "planned figures are not compared" in check.text
    assert NOTE in check.text


def test_commands_read_results_of_before(skd_here, here, folders):
    done = skd_here("compare", str(folders[0.5]), str(folders[1.15]), "--json")
    assert done.returncode == 0, done.stderr
    content = json.loads(done.stdout)
    assert [row["margin_note"] for row in content["rows"]] == [NOTE, NOTE]
    assert content["ranked_by"] == "deformation"
    done = skd_here("show", str(folders[0.5]), "--worst", "1", "--out", "shown", "--json")
    assert done.returncode == 0, done.stderr
    one_line(skd_here("plan", str(folders[0.5]), "--width", "0.1"), 2, "has no margin", NOTE)
    done = skd_here("plan", str(folders[0.5]), "--width", "0.5", "--figure", "deformation")
    assert done.returncode == 0, done.stderr


def test_a_measure_that_was_renamed_is_read_under_the_name_of_today(ratings, tmp_path):
    """Its figures as they are, and the result is still believed with its manifest."""

    def before_its_name(today: dict[str, Any]) -> dict[str, Any]:
        found = json.loads(json.dumps(today))
        for one in (found, *found["objectives"].values()):
            one["measures"]["required_deceleration"] = one["measures"].pop("required_deceleration_at_entry")
            one["measures"]["required_deceleration"]["label"] = "required deceleration"
        del found["surrogate_measures"]
        return found

    write_assessment(tmp_path, ratings[0.5])
    rewrite(tmp_path, before_its_name)
    (tmp_path / "surrogate_measures.csv").unlink()
    write_manifests(tmp_path, None)
    read = read_result(tmp_path).figures
    said = plain(ratings[0.5])["measures"]["required_deceleration_at_entry"]
    assert read["measures"]["required_deceleration_at_entry"] == said
    assert "required_deceleration" not in read["measures"]
    found = verify(tmp_path)
    assert found.fine
    assert "measures.required_deceleration_at_entry.mean" in found.agree


@pytest.mark.parametrize("lacks", ["objectives", "measures"])
def test_a_result_of_the_first_versions_is_refused_by_what_wrote_it_and_what_to_do(tmp_path, lacks):
    """They had neither objectives nor measures: both had been a bare KeyError."""
    figures = {
        "skd": 3.4,
        "controller": "basic",
        "scenario": {"name": "crossing"},
        "version": "0.1.0",
        "car_model": None,
    }
    if lacks == "measures":
        figures |= {"objectives": {"paper": {"skd": 3.4}}}
    (tmp_path / ASSESSMENT).write_text(json.dumps(figures))
    said = f"an early SKD 0.1.0, when results had no {lacks}"
    with pytest.raises(UsageError, match=f"{said}.*run the assessment again") as refused:
        read_figures(tmp_path)
    assert "\n" not in str(refused.value)
    assert said in read_run(tmp_path).remark
