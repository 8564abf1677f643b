"""Results are believed as far as their files are what was written and their figures follow from their episodes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_support import one_line
from edited_results import change_array, edit
from skd_evaluator.campaign.judge.rating import judge_all
from skd_evaluator.campaign.plan.plan import Plan, collision_runs, kamikaze_set, kamikaze_sets, safe_trajectories
from skd_evaluator.campaign.run.assembly import aborted
from skd_evaluator.campaign.run.workers import InProcessRunner
from skd_evaluator.campaign.store.checked import starts_that_differ
from skd_evaluator.campaign.store.manifest import MANIFEST, write_manifests
from skd_evaluator.campaign.store.rebuilt import rebuilt, recompute
from skd_evaluator.campaign.store.result_file import read_figures
from skd_evaluator.campaign.store.results import write_assessment
from skd_evaluator.campaign.store.stored_episodes import read_episodes
from skd_evaluator.campaign.store.stored_result import read_result
from skd_evaluator.campaign.store.verification import verify
from skd_evaluator.report.html.page import render
from skd_evaluator.report.html.subjects import read_subjects
from skd_sim.encounter.scenario import load_scenario
from skd_sim.episode.episode import EpisodeLog, Outcome
from skd_sim.errors import UsageError


def commands(folder: Path, other: Path) -> list[list[str]]:
    return [
        ["report", str(folder), "--out", "r.html"],
        ["show", str(folder), "--out", "shown"],
        ["compare", str(other), str(folder), "--out", "compared"],
        ["plan", str(folder), "--width", "0.2"],
        ["assess", "--fail-if-worse-than", str(folder), "--out", "assessed"],
    ]


def widen(figures: dict[str, Any], *path: str) -> None:
    for word in path[:-1]:
        figures = figures[word]
    figures[path[-1]][0] -= 0.01


def grow(figures: dict[str, Any], *path: str) -> None:
    for word in path[:-1]:
        figures = figures[word]
    figures[path[-1]] += 1


FORGERIES: dict[str, Callable[[dict[str, Any]], object]] = {
    "skd": lambda figures: figures.update(skd=9.9),
    "collision_rate": lambda figures: figures.update(collision_rate=0.0 if figures["collision_rate"] else 0.5),
    "hit_rate": lambda figures: figures.update(hit_rate=0.0 if figures["hit_rate"] else 0.5),
    "margin": lambda figures: figures.update(margin=4.9),
    "deformation": lambda figures: figures.update(deformation=4.9),
    "margin_beyond": lambda figures: grow(figures, "margin_beyond"),
    "impact_speed": lambda figures: figures["impact_speed"].update(p90=0.1),
    "success": lambda figures: figures.update(kamikaze_success_rate=0.123),
    "inside": lambda figures: figures["objectives"]["paper"].update(skd=9.9),
    "curve": lambda figures: figures["vulnerability_curve"]["margins"]["points"][20].update(probability=0.123),
    "row": lambda figures: figures["per_safe_trajectory"][1].update(collision_rate=0.123),
    "name": lambda figures: figures["per_safe_trajectory"][1].update(name="another"),
    "seed": lambda figures: grow(figures, "seed"),
    "eta_max": lambda figures: figures["scenario"].update(eta_max=figures["scenario"]["eta_max"] - 1),
    "eta_max of the figures": lambda figures: figures.update(eta_max=2 * figures["eta_max"]),
    "hit_speed": lambda figures: figures["scenario"]["collision"].update(hit_speed=3.0),
    "nothing": lambda figures: figures.update(margin=None),
    "gone": lambda figures: figures.pop("skd_ci95"),
    "gone inside": lambda figures: figures["vulnerability_curve"]["margins"]["points"][3].pop("ci95_attempts"),
    "gone of a measure": lambda figures: figures["surrogate_measures"]["kamikazes"]["deformation"]["fatality_risk"].pop(
        "defined"
    ),
    "equivalent": lambda figures: figures.update(equivalent_multiplier=1.5),
    "text": lambda figures: figures.update(equivalent_multiplier_text="1.500"),
}
SAID = {
    "margin_beyond",
    "inside",
    "curve",
    "row",
    "name",
    "equivalent",
    "text",
}
"""Of these, those that are said and not refused where there is no manifest."""
INTERVALS: dict[str, Callable[[dict[str, Any]], object]] = {
    "margin_ci95": lambda figures: widen(figures, "margin_ci95"),
    "skd_ci95": lambda figures: widen(figures, "skd_ci95"),
    "deformation_ci95_attempts": lambda figures: widen(figures, "deformation_ci95_attempts"),
    "collision_rate_ci95_runs": lambda figures: widen(figures, "collision_rate_ci95_runs"),
    "warped": lambda figures: widen(figures, "measures", "warped", "ci95"),
    "clustering": lambda figures: figures["clustering"]["skd"].update(standard_error=0.001),
    "null": lambda figures: figures.update(skd_ci95=None),
}


@pytest.mark.parametrize("name", [*FORGERIES, *INTERVALS])
def test_a_figure_that_does_not_follow_is_refused(result, name):
    """Also where whoever changed it wrote the manifest anew."""
    assert read_result(result).remarks == ()
    edit(result, {**FORGERIES, **INTERVALS}[name], "rewritten")
    with pytest.raises(UsageError):
        read_result(result)


@pytest.mark.parametrize("name", sorted(set(FORGERIES) - SAID))
def test_a_headline_of_an_older_result_that_does_not_follow_is_refused(result, name):
    edit(result, FORGERIES[name], "removed")
    with pytest.raises(UsageError):
        read_result(result)


@pytest.mark.parametrize("name", [*sorted(SAID), *INTERVALS])
def test_what_else_of_an_older_result_does_not_follow_is_said(result, name):
    edit(result, {**FORGERIES, **INTERVALS}[name], "removed")
    (line,) = read_result(result).remarks
    assert "no manifest" in line


@pytest.mark.parametrize("manifest", ["kept", "rewritten"])
@pytest.mark.parametrize("name", ["skd", "collision_rate", "margin", "skd_ci95"])
def test_every_reader_refuses_it_in_one_line(result, sweep, skd_here, name, manifest):
    edit(result, {**FORGERIES, **INTERVALS}[name], manifest)
    said = ("is not what was written",) if manifest == "kept" else (name, "its episodes give")
    for words in commands(result, sweep / "synthetic" / "C_0.5"):
        one_line(skd_here(*words), 2, "assessment.json", *said)


def test_results_are_read_with_and_without_a_manifest(result, sweep, skd_here):
    for warned in (0, 1):
        for words in commands(result, sweep / "synthetic" / "C_0.5")[:4]:
            done = skd_here(*words, *([] if words[0] == "plan" else ["--overwrite"]))
            assert done.returncode == 0, done
            assert done.stderr.count("manifest") == warned, done.stderr
            assert done.stderr.count("nothing but its figures and the starts of its episodes was checked") == warned
        (result / MANIFEST).unlink(missing_ok=True)


STARTS: dict[str, Callable[[dict[str, Any]], object]] = {
    "start_speed": lambda figures: grow(figures, "scenario", "car", "start_speed"),
    "start_gap": lambda figures: grow(figures, "scenario", "car", "start_gap"),
    "start_gap_range": lambda figures: grow(figures, "scenario", "car", "start_gap_range"),
    "meet_safe_trajectory": lambda figures: figures["scenario"]["car"].update(meet_safe_trajectory=True),
}


@pytest.mark.parametrize("manifest", ["removed", "rewritten"])
@pytest.mark.parametrize("name", STARTS)
def test_a_scenario_with_another_start_is_refused(result, name, manifest):
    edit(result, STARTS[name], manifest)
    for read in (read_result, lambda folder: read_subjects([folder])):
        with pytest.raises(UsageError, match="episodes the car does not start as its seed and scenario have it"):
            read(result)
    assert any("does not start" in line for line in verify(result).problems)


def test_starts_are_said_by_how_much_they_differ(result):
    """All start as the scenario has it; a car that is 1.5 m/s faster is so by that much, in each of them."""
    figures, stored = read_figures(result), read_episodes(result)
    assert starts_that_differ(result, figures, stored) is None
    figures["scenario"]["car"]["start_speed"] += 1.5
    found = starts_that_differ(result, figures, stored)
    assert found is not None
    assert found.refused
    assert f"in {len(stored)} of {len(stored)} episodes" in found.line
    assert "by 1.5 m or m/s" in found.line


@pytest.mark.parametrize(
    "elsewhere",
    [
        lambda figures: figures.update(safe="bags"),  # a recording, in whatever simulator it was made
        lambda figures: figures["provenance"].update(command="evaluator --ros-args"),  # beside nodes of others
        lambda figures: figures.update(provenance=None),  # of before there was any
    ],
)
def test_starts_of_what_may_be_another_simulators_are_said(result, elsewhere):
    edit(result, lambda figures: (elsewhere(figures), STARTS["start_speed"](figures)), "rewritten")
    (line,) = read_result(result).remarks
    assert "does not start as its seed and scenario have it" in line
    assert "the simulator, the seed, the scenario or the episodes are others" in line


def test_starts_of_another_simulator_are_its_own(result):
    def change(figures: dict[str, Any]) -> None:
        figures["options"]["simulator"] = "metadrive"
        STARTS["start_speed"](figures)

    edit(result, change, "rewritten")
    assert read_result(result).remarks == ()


@pytest.mark.parametrize("name", ["clipped", "margin_gap", "impact_speed", "safe_name", "eta_max", "seed"])
def test_an_array_that_does_not_go_with_the_figures_is_refused(result, name):
    def change(values: np.ndarray) -> np.ndarray:
        if values.dtype.kind == "U":
            return np.array([f"{one}!" for one in values])
        return values + 1

    change_array(result, name, change)
    with pytest.raises(UsageError):
        read_result(result)


def beyond_any_hit(values: np.ndarray) -> np.ndarray:
    return np.full_like(values, np.inf)


@pytest.mark.parametrize("manifest", ["rewritten", "removed"])
def test_margins_greater_than_what_a_kamikaze_needed_are_found(result, manifest):
    """Whoever writes all files anew can lower no kamikaze's deformation below the margin of its attempt."""
    change_array(result, "margin", beyond_any_hit)
    figures = read_figures(result)
    given = rebuilt(figures, read_episodes(result)).as_dict()
    keys = [key for key in given if not key.startswith("equivalent")]  # which are told of this car
    edit(result, lambda one: one.update({key: given[key] for key in keys if key in one}), manifest)
    found = verify(result).contradict
    assert found
    assert all(line.startswith("margin of attempt ") for line in found), found
    if manifest == "rewritten":
        with pytest.raises(UsageError, match="margin of attempt"):
            read_result(result)
    else:
        assert any("not what this version computes" in line for line in read_result(result).remarks)


def test_the_margin_of_a_basic_car_is_computed_and_so_converged(result):
    edit(result, lambda figures: figures.update(margin_converged=False), "rewritten")
    assert verify(result).contradict == ("margin_converged is False, its episodes give True",)


def test_whose_behaviour_a_risk_is_of_is_not_said_to_be_recomputed(result):
    assert not any(name.startswith("risk.behaviour") for name in verify(result).agree)


def test_every_figure_but_what_was_asked_for_is_recomputed(result):
    figures = read_figures(result)
    found = recompute(figures, read_episodes(result))
    assert found.contradict == ()
    tops = {name.partition(".")[0] for name in found.unknown}
    assert {"margin", "skd", "skd_ci95", "collision_rate", "measures", "clustering", "objectives"}.isdisjoint(tops)
    assert "vulnerability_curve.margins.points.3.bound" in found.agree
    assert len(found.agree) > 900


@pytest.mark.parametrize("began", [True, False])
def test_a_result_with_aborted_episodes_follows_from_them(tmp_path, began):
    """Also one that never began, of which there is no state of the car."""
    plan = Plan(load_scenario("crossing"), safe_count=2, kamikaze_count=2, collision_runs=4, simulations=20)
    runner = InProcessRunner(1)
    safe = safe_trajectories(plan, runner)
    sets, replays = kamikaze_sets(plan, safe, runner), collision_runs(plan, safe, runner)

    def lost(log: EpisodeLog) -> EpisodeLog:
        reason = "no answer: car_controller was silent"
        if not began:
            return aborted(log.episode, reason)
        return replace(log, outcome=Outcome.ABORTED, reason=reason, impact_time=math.nan, impact_speed=math.nan)

    logs = sets[0].in_order
    sets[0] = kamikaze_set(safe[0], [lost(logs[0]), *logs[1:]])
    rating = judge_all(plan, safe, {plan.objective: sets}, [lost(replays[0]), *replays[1:]], 1.0)
    write_assessment(tmp_path, rating)
    write_manifests(tmp_path)
    assert read_result(tmp_path).figures["aborted"] == 2
    assert recompute(read_figures(tmp_path), read_episodes(tmp_path)).contradict == ()
    assert "2 episodes aborted" in render(read_subjects([tmp_path]))


# --- the manifest, and skd verify
