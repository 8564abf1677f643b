"""The margin of a node of somebody else's, and what an adversary learns of it: as of the same law in process."""

import dataclasses
import json
import shlex
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest
from common import PATIENCE
from graph_support import assert_same_log, skd, skd_here, whole_graph
from skd_adversary.car_models.car_model_file import car_model_text
from skd_evaluator.assessment.options import GraphOptions
from skd_evaluator.assessment.plan import Plan, follows_other_trajectory
from skd_evaluator.assessment.run.episodes import run_episode
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages import car_model as learning
from skd_evaluator.assessment.stages.car_model import graph_settings, learned
from skd_evaluator.assessment.stages.safe_trajectories import single_episode
from skd_evaluator.bags.read import read_episodes
from skd_evaluator.metrics.aborted import not_credible
from skd_sim.controllers.basic import BasicController
from skd_sim.options.adversary import DEFAULT_OBJECTIVES, AdversaryModel
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Mode

BASIC = [sys.executable, "-m", "skd_sim.ros.controller_node", "--ros-args", "-p", "controller:=basic"]
NODE = shlex.join([*BASIC, "-p", "multiplier:=1.0"])
RUNS = 6
COUNTS = ("--safe-count", 2, "--kamikaze-count", 2, "--collision-runs", RUNS, "--seed", 3)
PLANNED = ("deviation", "deviation_ci95", "skd", "skd_ci95", "variance", "pairs", "contact_rate", "adversary_model")


def test_the_margin_of_a_node_is_that_of_its_law(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """That of the basic car is known exactly; whoever drives a node can find no less, and little more."""
    car = (
        "--controller",
        "external",
        "--controller-command",
        NODE,
        "--adversary-model",
        "generic",
        "--margin-limit",
        256,
    )
    graph = skd("assess", "--graph", *car, *COUNTS, "--record", "--out", tmp_path / "graph")
    assert graph.code == 0, graph.err
    ours = ("--multiplier", 1.0, *COUNTS, "--workers", 1, "-p", f"risk_runs:={RUNS}")
    known = skd_here(capsys, "assess", *ours, "--out", tmp_path / "exact")
    assert known.code == 0, known.err
    walked, exact = (json.loads((tmp_path / name / "assessment.json").read_text()) for name in ("graph", "exact"))
    assert exact["margin_how"] != walked["margin_how"]
    assert walked["margin_trials"] == exact["margin_trials"] == 4
    assert walked["margin"] >= exact["margin"] - exact["margin_gap"] - 1e-9
    assert walked["margin"] <= 1.1 * exact["margin"]
    assert walked["margin"] < walked["deviation"]  # they knew nothing of the car; the ways are planned
    assert "4 of 4 hits came again" in walked["margin_how"]  # in lockstep it repeats itself
    assert not not_credible(walked["warnings"])  # also where it is run again, through another graph

    # The risk takes one crossing more for each run along φ, at each scale, and is that of the law to the last digit.
    assert [one["episodes"] for one in walked["risk"]["scales"]] == [RUNS] * 3
    assert 0.0 < walked["risk_1"] < 1.0
    for key in (one for one in exact if one.startswith("risk")):
        assert walked[key] == exact[key], key
    with np.load(tmp_path / "graph" / "episodes.npz") as mine, np.load(tmp_path / "exact" / "episodes.npz") as its:
        names = [name for name in its.files if name.startswith("risk_")]
        assert "risk_failure_car" in names
        for name in names:
            assert mine[name].tobytes() == its[name].tobytes(), name

    recorded = [one.log.episode for one in read_episodes([tmp_path / "graph"])]
    assert recorded
    assert not any(follows_other_trajectory(episode) for episode in recorded)
    modes = [episode.mode for episode in recorded]
    assert modes.count(Mode.REPLAY) == RUNS
    assert modes.count(Mode.KAMIKAZE) == 4 * len(DEFAULT_OBJECTIVES)

    replayed = skd_here(capsys, "replay", tmp_path / "graph" / "bags", "--out", tmp_path / "replayed")
    assert replayed.code == 0, replayed.err
    again = json.loads((tmp_path / "replayed" / "assessment.json").read_text())
    assert {key: again[key] for key in PLANNED} == {key: walked[key] for key in PLANNED}
    assert again["margin"] is None  # recordings do not say what else could have happened
    assert again["margin_note"]


class Law(BasicController):
    """What the node drives by, as a class of somebody else's."""

    def __init__(self) -> None:
        super().__init__(1.0)


class Counted:
    """Counts the episodes that somebody else runs."""

    def __init__(self, runner) -> None:
        self.runner, self.logs = runner, []

    def run(self, episodes: Sequence[EpisodeSpec]) -> Iterator[EpisodeLog]:
        for log in self.runner.run(episodes):
            self.logs.append(log)
            yield log


def test_a_node_is_learned_as_its_law_is_and_only_once(tmp_path: Path, plan: Plan, small_lesson: Path) -> None:
    options = GraphOptions(controller_command=NODE, command_timeout=PATIENCE, startup_timeout=PATIENCE)
    theirs = dataclasses.replace(plan, controller="external", adversary_model=AdversaryModel.LEARNED)
    said: list[str] = []
    with whole_graph(tmp_path, options) as (node, _):
        graph = Counted(node)
        how = {"graph": graph_settings(options)}
        informed = learned(theirs, graph, say=said.append, **how)
        after_lesson = len(graph.logs)
        episode = single_episode(informed, Mode.KAMIKAZE, 0, safe_number=0)
        log = node.run_episode(episode)
        again = learned(theirs, graph, say=said.append, **how)
        another = dataclasses.replace(theirs, seed=theirs.seed + 1, kamikaze_count=1)
        learned(another, graph, say=said.append, **how)

    assert after_lesson in (66 + 2, 66 + 3 * 2)  # one way to wait was tried, or all of them
    assert len(graph.logs) == after_lesson  # kept: whatever the seed and the budget
    assert again == informed
    kept = next(small_lesson.iterdir())
    assert said[0].startswith("learned the car from 60 probes and 6 trials of kamikazes in ")
    assert said[1] == said[2]
    assert said[1].startswith("the car was learned before, on 20")
    assert said[1].endswith(f" files, kept in {kept}; --adversary-model generic does without")
    assert said[0].endswith(f"kept in {kept}; --adversary-model generic does without")

    ours = dataclasses.replace(plan, controller=f"{__name__}:Law", adversary_model=AdversaryModel.LEARNED)
    in_process = Counted(InProcessRunner(1))
    known = learning.learn(ours, in_process)
    taught = [one for one in in_process.logs if one.episode.mode != Mode.SAFE]
    for mine, its in zip(taught, graph.logs, strict=True):
        assert_same_log(mine, its)
    assert informed.car_model == car_model_text(known)
    assert log.episode.car_model == informed.car_model
    assert_same_log(log, run_episode(episode, Law()))
