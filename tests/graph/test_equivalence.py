"""The graph gives what the plain loop gives, to the last bit."""

import dataclasses
import json
import shlex
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest
from common import PATIENCE, assert_valid
from graph_support import HERE, MULTIPLIERS, Campaign, assert_same_log, assert_same_results, skd, skd_here, whole_graph
from skd_adversary.car_models.car_model_file import car_model_text
from skd_evaluator.assessment.options import GraphOptions
from skd_evaluator.assessment.plan import Plan, follows_other_trajectory
from skd_evaluator.assessment.plausibility import examine
from skd_evaluator.assessment.run.episodes import run_episode
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages import car_model as learning
from skd_evaluator.assessment.stages.car_model import graph_settings, learned
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories, single_episode
from skd_evaluator.bags.read import read_bags
from skd_evaluator.metrics.aborted import not_credible
from skd_evaluator.ros.evaluator import Evaluator
from skd_sim.controllers.basic import BasicController
from skd_sim.controllers.controller import Controller
from skd_sim.options.car_and_adversary import DEFAULT_OBJECTIVES, AdversaryModel, Objective
from skd_sim.scenario.scenario import Scenario, load_scenario
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Mode, Outcome
from skd_sim.world.sensors import Scan
from skd_sim.world.state import AdversaryState, CarState, Trajectory


def episodes(name: str, objective: Objective) -> list[EpisodeSpec]:
    """Four trials of each mode at each of two multipliers."""
    scenario = load_scenario(name)
    safe = safe_trajectories(Plan(scenario, safe_count=1, seed=11), InProcessRunner(1))[0]
    how = {"seed": 11, "simulations": 500, "objective": objective}
    plans = [Plan(scenario, multiplier=multiplier, **how) for multiplier in MULTIPLIERS]
    return [single_episode(plan, mode, trial, safe) for plan in plans for mode in Mode for trial in range(4)]


@pytest.fixture(scope="module")
def evaluator(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Evaluator]:
    """Of a graph that runs episodes of any car and scenario, one after another; nothing is left of it."""
    with whole_graph(tmp_path_factory.mktemp("graph")) as (evaluator, _):
        yield evaluator


def same_through_the_graph(evaluator: Evaluator, wanted: list[EpisodeSpec], *law: Controller) -> list[EpisodeLog]:
    """Run episodes through a graph, and return their logs, which are those of the plain loop."""
    expected = [run_episode(episode, *law) for episode in wanted]
    logs = list(evaluator.run(wanted))
    for one, other in zip(expected, logs, strict=True):
        assert_same_log(one, other)
    return logs


def same_in_recordings(folder: Path, controller: str, wanted: list[EpisodeSpec]) -> list[EpisodeLog]:
    """The same through a graph of its own, and in its bags, whose logs are returned."""
    with whole_graph(folder, controller=controller, record_to=folder / "bags") as (evaluator, _):
        logs = same_through_the_graph(evaluator, wanted)
    recorded = {
        (one.log.episode.mode, one.log.episode.episode_id): one.log for one in read_bags([folder / "bags"]).episodes
    }
    kept = [recorded[one.episode.mode, one.episode.episode_id] for one in logs]
    for one, other in zip(logs, kept, strict=True):
        assert_same_log(one, other)
    return kept


def trials(plan: Plan) -> list[EpisodeSpec]:
    """Three kamikazes and three runs along one φ."""
    safe = safe_trajectories(dataclasses.replace(plan, safe_count=1), InProcessRunner(1))[0]
    return [single_episode(plan, mode, trial, safe) for mode in (Mode.KAMIKAZE, Mode.REPLAY) for trial in range(3)]


@pytest.mark.parametrize(
    ("scenario", "objectives"),
    [("crossing", (Objective.PAPER, Objective.DEVIATION)), ("crossing_multi_body", (Objective.PAPER,))],
)
def test_episodes_are_the_same_to_the_last_bit(evaluator, scenario, objectives):
    wanted = [episode for objective in objectives for episode in episodes(scenario, objective)]
    assert len(wanted) >= 20 * len(objectives)
    logs = same_through_the_graph(evaluator, wanted)
    for objective in objectives:
        outcomes = {log.outcome for log in logs if log.episode.objective == objective}
        assert outcomes >= {Outcome.COLLISION, Outcome.ARRIVED}


@pytest.mark.parametrize("controller", ["basic", "cal"])
def test_cars_that_decide_between_ticks(tmp_path: Path, controller: str) -> None:
    """States and scans between ticks, commands for them, and bags with all of it: the same log every way."""
    scenario = load_scenario("crossing")
    if controller == "basic":
        scenario = dataclasses.replace(scenario, control_period=0.1)
    plan = Plan(scenario, controller=controller, multiplier=0.75 if controller == "basic" else 1.0, simulations=200)
    assert plan.scenario.control_periods > 1
    logs = same_in_recordings(tmp_path, controller, trials(plan))
    assert Outcome.COLLISION in {log.outcome for log in logs}


def test_a_car_that_steers_is_the_same_to_the_last_bit(tmp_path: Path) -> None:
    """Its commands, too, and a state that does not follow from them is found in the bag."""
    weaving, scenario = f"{HERE.parent}/sim/test_steering.py:Weaving", load_scenario("crossing")
    scenario = dataclasses.replace(scenario, control_period=0.05)
    plan = Plan(scenario, controller=weaving, simulations=100, adversary_model="generic")
    for kept in same_in_recordings(tmp_path, weaving, trials(plan)):
        assert np.ptp(kept.car[:, 2]) > 0.05
        assert run_episode(kept.episode).commands.tobytes() == kept.commands.tobytes()
        assert examine(kept).ours
        turned = kept.car + (np.arange(len(kept.car)) == 3)[:, None] * np.array([0.0, 0.0, 0.05, 0.0])
        assert not examine(dataclasses.replace(kept, car=turned)).ours


@pytest.mark.parametrize("multiplier", MULTIPLIERS)
def test_assessments_are_the_same_to_the_last_bit(campaigns: dict[float, Campaign], multiplier: float) -> None:
    campaign = campaigns[multiplier]
    assert_same_results(campaign.graph, campaign.in_process)
    one, other = (json.loads((path / "assessment.json").read_text()) for path in (campaign.graph, campaign.in_process))
    for said in (one, other):
        assert_valid(said)
        assert said["provenance"]["command"].startswith("skd assess ")
    assert one["skd"] is not None
    assert {key for key in one if one[key] != other[key]} <= {"seconds", "command_age", "provenance"}


class ScanBraker:
    """The law of the foreign node of that name in fake_nodes.py, as a class."""

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        pass

    def sense(self, scan: Scan) -> None:
        self._nearest = scan.ranges.min()

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        return -3.0 if self._nearest < 9.0 else 0.0


def test_a_foreign_node_that_reads_only_the_scan(tmp_path: Path, plan: Plan) -> None:
    safe = safe_trajectories(plan, InProcessRunner(1))[0]
    external = dataclasses.replace(plan, controller="external")
    wanted = [single_episode(external, Mode.REPLAY, trial, safe) for trial in range(3)]
    node = shlex.join([sys.executable, str(HERE / "fake_nodes.py"), "scan"])
    with whole_graph(tmp_path, GraphOptions(controller_command=node)) as (evaluator, _):
        logs = same_through_the_graph(evaluator, wanted, ScanBraker())
    assert min(log.car[:, 3].min() for log in logs) < 5.0


def test_curves_and_boxes_are_the_same_to_the_last_bit(evaluator: Evaluator) -> None:
    """The car's heading and the box's go through quaternions, and the agent's law is not the same for two headings."""
    turn = load_scenario("right_turn")
    adversary = dataclasses.replace(turn.adversary, radius=None, length=1.8, width=0.6, start_x=-4.5)
    x = np.minimum(-4.5 + 0.75 * np.arange(16), 2.5)
    phi = Trajectory(np.column_stack([x, 0.2 * np.sin(x)]), turn.time_step, "by hand")
    scenarios = (turn, dataclasses.replace(turn, adversary=adversary))
    plans = [Plan(scenario, controller="carla", seed=11) for scenario in scenarios]
    wanted = [single_episode(plan, Mode.REPLAY, trial, phi) for plan in plans for trial in range(4)]
    logs = same_through_the_graph(evaluator, wanted)
    assert all(log.car[0, 0] > 1.0 > 0.01 > abs(log.car[-1, 0]) for log in logs)  # they came around the corner
    assert [log.impact_time for log in logs[4:]] != [log.impact_time for log in logs[:4]]  # and the shape counts


@pytest.mark.parametrize(
    ("names", "safe"),
    [
        (("child", "bystanders", "cut_in"), "synthetic"),  # from the right between parked cars, others, another car
        (("cpna-75", "cbfa-25", "cpla-50", "ccrb-50", "cmrs-25"), "regulatory"),  # along the protocol's own target
    ],
)
def test_other_kinds_and_others_are_the_same_to_the_last_bit(tmp_path: Path, names: Sequence[str], safe: str) -> None:
    """Through the graph, and in its recordings."""
    wanted = []
    for index, name in enumerate(names):
        small = {"multiplier": 0.5, "safe_count": 1, "seed": 11, "simulations": 100}
        plan = Plan(load_scenario(name), safe=safe, objective=Objective.DEVIATION, **small)
        (phi,) = safe_trajectories(plan, InProcessRunner(1))
        wanted += [single_episode(plan, mode, index, phi) for mode in (Mode.REPLAY, Mode.KAMIKAZE)]
    logs = same_in_recordings(tmp_path, "basic", wanted)
    assert all(examine(log).ours for log in logs)
    assert sum(log.outcome == Outcome.COLLISION for log in logs) >= 2


# --- The margin of a node of somebody else's, and what an adversary learns of it: as of the same law in process.


BASIC = [sys.executable, "-m", "skd_sim.ros.controller_node", "--ros-args", "-p", "controller:=basic"]
NODE = shlex.join([*BASIC, "-p", "multiplier:=1.0"])
RUNS = 6
COUNTS = ("--safe-count", 2, "--kamikaze-count", 2, "--collision-runs", RUNS, "--seed", 3)
PLANNED = ("deviation", "deviation_ci95", "skd", "skd_ci95", "variance", "pairs", "contact_rate", "adversary_model")


def test_the_margin_of_a_node_is_that_of_its_law(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """That of the basic car is known exactly; whoever drives a node can find no less, and little more."""
    car = ("--controller", "external", "--controller-command", NODE, "--adversary-model", "generic")
    limit = ("--margin-limit", 256)
    graph = skd("assess", "--graph", *car, *limit, *COUNTS, "--record", "--out", tmp_path / "graph")
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

    recorded = [one.log.episode for one in read_bags([tmp_path / "graph"]).episodes]
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
