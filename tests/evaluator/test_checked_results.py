"""Results are believed as far as their files are what was written and their figures follow from their episodes."""

from __future__ import annotations

import hashlib
import json
import math
import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_support import one_line, skd
from skd_evaluator.campaign.judge.rating import judge_all
from skd_evaluator.campaign.plan.plan import Plan, collision_runs, kamikaze_set, kamikaze_sets, safe_trajectories
from skd_evaluator.campaign.run.assembly import aborted
from skd_evaluator.campaign.run.workers import InProcessRunner
from skd_evaluator.campaign.store.checked import starts_that_differ
from skd_evaluator.campaign.store.manifest import MANIFEST, Held, hold, write_manifests
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

CAMPAIGN = """
cars: [{controller: basic, sweep: {multiplier: [0.5, 1.0]}}]
defaults: {safe_count: 2, kamikaze_count: 2, collision_runs: 4, simulations: 20}
"""


@pytest.fixture
def result(sweep: Path, tmp_path: Path) -> Path:
    shutil.copytree(sweep / "synthetic" / "C_1", tmp_path / "result")
    return tmp_path / "result"


def edit(folder: Path, change: Callable[[dict[str, Any]], object], manifest: str = "kept") -> None:
    """Change assessment.json; the manifest is kept, written anew, or removed."""
    path = folder / "assessment.json"
    figures = json.loads(path.read_text())
    change(figures)
    path.write_text(json.dumps(figures))
    follow(folder, manifest)


def follow(folder: Path, manifest: str) -> None:
    if manifest == "removed":
        (folder / MANIFEST).unlink()
    elif manifest == "rewritten":
        write_manifests(folder)


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
    "gone of what older versions lack": lambda figures: figures["surrogate_measures"]["kamikazes"]["deformation"][
        "fatality_risk"
    ].pop("defined"),
    "equivalent": lambda figures: figures.update(equivalent_multiplier=1.5),
    "text": lambda figures: figures.update(equivalent_multiplier_text="1.500"),
}
UNSAID = {"gone"}
"""Of these, those that older versions need not have had."""
SAID = {
    "gone inside",
    "gone of what older versions lack",
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


@pytest.mark.parametrize("name", sorted(set(FORGERIES) - SAID - UNSAID))
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
    figures, stored = read_figures(result)[0], read_episodes(result)
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


def change_array(folder: Path, name: str, change: Callable[[np.ndarray], np.ndarray]) -> None:
    with np.load(folder / "episodes.npz") as file:
        arrays = {key: file[key].copy() for key in file.files}
    arrays[name] = change(arrays[name])
    np.savez(folder / "episodes.npz", **arrays)
    write_manifests(folder)


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
    figures, _ = read_figures(result)
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
    figures, former = read_figures(result)
    found = recompute(figures, read_episodes(result))
    assert not former
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
    assert recompute(read_figures(tmp_path)[0], read_episodes(tmp_path)).contradict == ()
    assert "2 episodes aborted" in render(read_subjects([tmp_path]))


# --- the manifest, and skd verify


def test_a_result_has_a_manifest_of_all_its_files(sweep):
    for folder in (sweep, sweep / "synthetic" / "C_1"):
        lines = (folder / MANIFEST).read_text().splitlines()
        said = {line[66:]: line[:64] for line in lines}
        files = [path for path in folder.rglob("*") if path.is_file() and path != folder / MANIFEST]
        assert said == {
            path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in files
        }


def test_verify_says_which_figures_agree(result, skd_here):
    done = skd_here("verify", str(result))
    assert done.returncode == 0
    assert "fine" in done.stdout
    assert "figures recomputed, and as said" in done.stdout
    assert "margin_converged" in done.stdout  # cannot be had from the folder
    assert "can have happened" in done.stdout
    found = json.loads(skd_here("verify", str(result), "--json").stdout)
    (one,) = found["results"]
    assert found["fine"]
    assert "skd" in one["agree"]
    assert one["contradict"] == one["problems"] == one["files"]["changed"] == []


def test_verify_says_which_do_not(result, skd_here):
    edit(result, lambda figures: figures.update(skd=9.9, collision_rate=0.123), "rewritten")
    done = skd_here("verify", str(result))
    assert done.returncode == 1
    assert "contradicted: skd is 9.9, its episodes give" in done.stdout
    assert "contradicted: collision_rate is 0.123" in done.stdout
    assert "NOT FINE" in done.stdout


def test_verify_says_which_files_changed(result, skd_here):
    (result / "trajectories.png").write_bytes(b"another")
    (result / "vulnerability.png").unlink()
    (result / "notes.txt").write_text("mine")
    done = skd_here("verify", str(result))
    assert done.returncode == 1
    for line in ("trajectories.png: changed", "vulnerability.png: gone", "notes.txt: not of this result"):
        assert line in done.stdout


def test_verify_finds_an_episode_that_cannot_have_happened(result, skd_here):
    def change(values: np.ndarray) -> np.ndarray:
        return np.where(np.isfinite(values), values + 1e-9, values)

    change_array(result, "car", change)  # too little for any figure
    read_result(result)
    done = skd_here("verify", str(result))
    assert done.returncode == 1 or "did not run in SKD's own world" in done.stdout


def test_verify_reads_sweeps_older_results_and_says_what_is_none(sweep, result, skd_here, here):
    assert skd_here("verify", str(sweep)).stdout.count(": fine") == 3
    (result / MANIFEST).unlink()
    older = skd_here("verify", str(result))
    assert older.returncode == 0
    assert f"no {MANIFEST}" in older.stdout
    (here / "nothing").mkdir()
    one_line(skd_here("verify", "nothing"), 2, "holds no assessment.json")
    one_line(skd_here("verify", "nowhere"), 2, "no such folder")
    (result / "assessment.json").write_text("[" * 1000)
    assert "wrong: " in skd_here("verify", str(result)).stdout


def test_verify_holds_a_sweep_against_its_cars(sweep, tmp_path):
    shutil.copytree(sweep, tmp_path / "sweep")
    path, table = tmp_path / "sweep" / "sweep.json", tmp_path / "sweep" / "sweep.csv"
    assert verify(tmp_path / "sweep").fine
    content = json.loads(path.read_text())
    content["rows"][0]["margin"] = 4.9
    path.write_text(json.dumps(content))
    write_manifests(tmp_path / "sweep")
    problems = verify(tmp_path / "sweep").problems
    assert [line.partition(": ")[2].partition(" is 4.9")[0] for line in problems[:1]] == ["synthetic, C_0.5: margin"]
    assert f"{table}, line 2: margin is" in problems[1]


@pytest.mark.parametrize("line", ["x", f"{'0' * 64}  ../a", f"{'0' * 64}  /a", f"{'0' * 64}  a\n{'0' * 64}  a"])
def test_a_manifest_that_is_none_is_refused(result, line):
    (result / MANIFEST).write_text(line)
    with pytest.raises(UsageError, match=MANIFEST):
        read_result(result)


# --- campaigns


@pytest.fixture
def campaign(here: Path, skd_here) -> Path:
    (here / "cars.yaml").write_text(CAMPAIGN)
    done = skd_here("campaign", "cars.yaml", "--out", "out", "--workers", "1")
    assert done.returncode == 0, done.stderr
    return here / "out"


RESUME = ("campaign", "cars.yaml", "--out", "out", "--workers", "1", "--resume")


def test_rows_of_a_campaign_are_made_from_its_cells(campaign, skd_here):
    written, table = (campaign / "campaign.json").read_text(), (campaign / "campaign.csv").read_text()
    content = json.loads(written)
    for row in content["cells"]:
        row.update(deformation=4.9, margin=4.9, skd_ci95=[1, 2], problems=["none"], warnings=["none"], episodes=10**6)
    (campaign / "campaign.json").write_text(json.dumps(content))
    assert skd_here("verify", "out").returncode == 1
    assert skd_here(*RESUME).returncode == 0
    again = json.loads((campaign / "campaign.json").read_text())
    assert again["cells"] == json.loads(written)["cells"]
    assert again["episodes_run"] == 0
    assert (campaign / "campaign.csv").read_text() == table
    assert skd_here("verify", "out").returncode == 0


def _without_a_row(content: dict[str, Any]) -> None:
    del content["cells"][0]


CAMPAIGNS: dict[str, tuple[Callable[[Path], object], str]] = {
    "a row is gone": (lambda out: _rows(out, _without_a_row), "has no row of cell"),
    "a row is left open": (lambda out: _rows(out, lambda content: content["cells"][0].update(state="open")), "done"),
    "a table": (
        lambda out: (out / "campaign.csv").write_text((out / "campaign.csv").read_text().replace("done", "fine")),
        "campaign.csv, line 2: state is 'fine'",
    ),
    "a cell whose manifest is written anew": (
        lambda out: edit(next(out.glob("*/assessment.json")).parent, lambda one: one.update(seconds=1), "rewritten"),
        "is not the file that the row is of",
    ),
    "a warning of a cell that its row does not say": (
        lambda out: edit(next(out.glob("*/assessment.json")).parent, lambda one: one["warnings"].append("x"), "kept"),
        "does not say 'x'",
    ),
}


def _rows(campaign: Path, change: Callable[[dict[str, Any]], object]) -> None:
    path = campaign / "campaign.json"
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def test_verify_holds_a_campaign_against_its_cells(campaign):
    assert verify(campaign).fine
    for name, (change, says) in CAMPAIGNS.items():
        out = campaign.parent / name
        shutil.copytree(campaign, out)
        change(out)
        found = verify(out)
        assert any(says in line for line in found.problems), (name, found.problems)


def test_cells_that_are_not_what_was_written_are_refused(campaign, skd_here):
    cells = sorted(path.parent for path in campaign.glob("*/assessment.json"))
    edit(cells[0], lambda figures: figures.update(skd=9.9))
    one_line(skd_here(*RESUME), 2, "assessment.json: is not what was written", "--resume makes it again")
    edit(cells[0], lambda figures: None, "rewritten")
    one_line(skd_here(*RESUME), 2, cells[0].name, "--resume makes it again")
    (campaign / "campaign.json").unlink()
    one_line(skd_here(*RESUME), 2, cells[0].name, "its episodes give", "--resume makes it again")
    shutil.rmtree(cells[0])
    shutil.copytree(cells[1], cells[0])
    one_line(skd_here(*RESUME), 2, "is the result of another cell")
    shutil.rmtree(cells[0])
    assert skd_here(*RESUME).returncode == 0


@pytest.mark.parametrize("name", ["cells.json", "campaign.json", "episodes.sqlite"])
def test_a_pipe_in_a_campaign_does_not_hold_it_up(campaign, name):
    if name == "episodes.sqlite":
        shutil.rmtree(next(campaign.glob("*/assessment.json")).parent)  # or nothing is to be stored
    (campaign / name).unlink(missing_ok=True)
    os.mkfifo(campaign / name)
    one_line(skd(*RESUME, cwd=campaign.parent), 2, f"{name}: is no regular file")


def test_a_cell_in_another_folder_is_no_cell(campaign, skd_here):
    outside = campaign.parent / "mine"
    shutil.copytree(next(campaign.glob("*/assessment.json")).parent, outside)
    content = json.loads((campaign / "cells.json").read_text())
    content["cells"][0]["name"] = "../mine"
    (campaign / "cells.json").write_text(json.dumps(content))
    words = ("campaign", "cars.yaml", "--out", "out", "--workers", "1", "--overwrite")
    one_line(skd_here(*words), 2, "is no name of a cell's folder")
    assert outside.exists()


# --- surrogate safety measures


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda text: text.replace(",collision,0,0,", ",collision,0.25,0,", 1), "line 2: clearance is 0.25"),
        (lambda text: text.rsplit("\n", 2)[0] + "\n", "has other columns or rows"),
        (lambda text: text.replace("headway", "headroom"), "has other columns or rows"),
        (lambda text: text.replace(text.splitlines()[1], text.splitlines()[1] + ","), "the number of its cells"),
    ],
)
def test_verify_finds_surrogate_measures_that_do_not_follow(result, change, says):
    path = result / "surrogate_measures.csv"
    text = path.read_text(encoding="utf-8")
    path.write_text(change(text), encoding="utf-8")
    write_manifests(result)
    (problem,) = verify(result).problems
    assert says in problem
    path.write_text(text, encoding="utf-8")
    write_manifests(result)
    assert verify(result).fine


def test_a_result_that_goes_while_it_is_verified_is_not_fine(result, monkeypatch):
    """Its files had been held against the manifest, and its figures, which were not there any more, against nothing."""

    def hold_and_lose(folder: Path, manifest: dict[str, str]) -> Held:
        found = hold(folder, manifest)
        (folder / "assessment.json").unlink()
        return found

    monkeypatch.setattr("skd_evaluator.campaign.store.verification.hold", hold_and_lose)
    found = verify(result)
    assert not found.fine
    assert "assessment.json: cannot be read" in found.problems[0]


def test_what_says_nothing_may_be_missing_inside(result: Path):
    """Results of before lack what their version did not look for, as the likely failures of a risk."""
    figures, _ = read_figures(result)
    stored = read_episodes(result)
    floor = figures["objectives"]["paper"].pop("floor")
    assert (floor, recompute(figures, stored).contradict) == (None, ())
    figures["objectives"]["paper"].pop("skd")
    assert [one.name for one in recompute(figures, stored).contradict] == ["objectives.paper.skd"]
