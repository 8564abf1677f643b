"""Fixtures of the tests of the graph. Campaigns are recorded once and read by many tests."""

import os
import sys
import uuid
from collections.abc import Iterator
from multiprocessing.context import ForkServerContext
from pathlib import Path

import pytest
import rclpy
from rclpy.signals import SignalHandlerOptions

sys.path.insert(0, str(Path(__file__).resolve().parent))

from common import new_domain
from compile_kernels import CARS, compile_planners
from graph_nodes import fork_server
from graph_support import CAMPAIGN, MULTIPLIERS, Campaign, Skd, in_domain
from skd_evaluator import Plan, run_episode
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages import car_model as learning
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories, single_episode
from skd_sim import EpisodeLog, EpisodeSpec, Mode, load_scenario

SIMULATIONS = 300

# Of nodes that a test makes in its own process, and of those that it forks; `skd` and the scripts set both themselves.
os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
os.environ.setdefault("ROS_PYTHON_CHECK_FIELDS", "1")


@pytest.fixture(scope="session", autouse=True)
def compiled() -> None:
    """Kernels are on disk before a node starts: dozens that each compile them all would come too late for any limit."""
    for car in CARS:
        compile_planners(*car)


@pytest.fixture(scope="session")
def campaigns(tmp_path_factory: pytest.TempPathFactory) -> dict[float, Campaign]:
    """The same campaign at two multipliers, through the graph (recorded) and in process."""
    folder = tmp_path_factory.mktemp("campaigns")
    made = {}
    programs = []
    for multiplier in MULTIPLIERS:
        made[multiplier] = Campaign(folder / f"graph-{multiplier}", folder / f"process-{multiplier}")
        arguments = ("assess", "--multiplier", multiplier, *CAMPAIGN)
        programs += [
            Skd(*arguments, "--graph", "--record", "--out", made[multiplier].graph),
            Skd(*arguments, "--workers", 1, "--out", made[multiplier].in_process),
        ]
    ends = [program.finish() for program in programs]
    assert [end.code for end in ends] == [0] * len(ends), [end.err for end in ends]
    return made


@pytest.fixture(scope="session")
def campaign(campaigns: dict[float, Campaign]) -> Campaign:
    return campaigns[1.0]


@pytest.fixture(scope="session")
def context() -> ForkServerContext:
    return fork_server()


@pytest.fixture
def domain() -> Iterator[int]:
    number = new_domain()
    with in_domain(number, uuid.uuid4().hex):
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        try:
            yield number
        finally:
            rclpy.try_shutdown()


@pytest.fixture
def small_lesson(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Cars are learned by this process from fewer episodes than by default, which changes nothing of how; where to."""
    monkeypatch.setattr(learning, "kept_models", lambda: tmp_path / "models")  # the cache has the kernels, too
    monkeypatch.setattr(learning, "PROBES", 60)
    monkeypatch.setattr(learning, "TRIALS", 6)
    monkeypatch.setattr(learning, "SAFE", 2)
    monkeypatch.setattr(learning, "WAITING_TRIALS", 2)
    return tmp_path / "models"


@pytest.fixture(scope="session")
def plan(safe: Path) -> Plan:
    return Plan(load_scenario("crossing"), safe=str(safe), safe_count=1, simulations=SIMULATIONS)


@pytest.fixture(scope="session")
def episode(plan: Plan) -> EpisodeSpec:
    return single_episode(plan, Mode.KAMIKAZE, 0, safe_trajectories(plan, InProcessRunner(1))[0])


@pytest.fixture(scope="session")
def replay(plan: Plan) -> EpisodeSpec:
    return single_episode(plan, Mode.REPLAY, 0, safe_trajectories(plan, InProcessRunner(1))[0])


@pytest.fixture(scope="session")
def expected(episode: EpisodeSpec) -> EpisodeLog:
    return run_episode(episode)
