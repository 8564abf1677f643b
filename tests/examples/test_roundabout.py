"""The package of examples/roundabout beside SKD: its road, and its e-scooter, which rides by its own limits."""

import json
import math
import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
import road_user_limits
from common import run_program
from skd_sim.scenario.road import road_pose
from skd_sim.scenario.scenario import Scenario, load_scenario

PACKAGE = Path(__file__).resolve().parents[2] / "examples" / "roundabout"
LIMITS = (0.8, 3.5, 2.0, math.radians(30.0), 1.0)  # as the package's README has them
SPEED = 20.0 / 3.6
RIDE = """
import json, sys
from skd_sim.scenario.scenario_file import REGULATORY
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories
from skd_evaluator.assessment.run.episodes import run_episode
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_sim import Mode, load_scenario
plan = Plan(load_scenario("roundabout_exit"), safe=REGULATORY, safe_count=3, multiplier=1.0, simulations=60)
with InProcessRunner(1) as runner:
    safe = safe_trajectories(plan, runner)
logs = [run_episode(plan.episode(Mode.KAMIKAZE, i % 3, i // 3, safe[i % 3])) for i in range(9)]
json.dump([[l.episode.safe_trajectory.positions.tolist(), l.adversary.tolist(), l.hit] for l in logs], sys.stdout)
"""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the package as pip would put it there; what it adds is what its pyproject.toml says."""
    folder = tmp_path_factory.mktemp("site")
    project = tomllib.loads((PACKAGE / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    shutil.copytree(PACKAGE / "rental", folder / "rental", ignore=shutil.ignore_patterns("__pycache__"))
    about = folder / "skd_rental-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n")
    lines = [f"[{group}]\n" + "".join(f"{name} = {there}\n" for name, there in entries.items())
             for group, entries in project["entry-points"].items()]  # fmt: skip
    (about / "entry_points.txt").write_text("\n".join(lines))
    return folder


def python(program: str, site: Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join((str(site), os.environ.get("PYTHONPATH", "")))
    return run_program(sys.executable, "-c", program, cwd=cwd, PYTHONPATH=path)


@pytest.fixture
def scenario() -> Scenario:
    return load_scenario(str(PACKAGE / "rental" / "roundabout_exit.yaml"))


def test_the_road_goes_around_the_island_and_out(scenario: Scenario) -> None:
    """The exit's curve has its centre 12 m East of where it ends, and the island is 26 m from there, 50° round."""
    curve = np.array([12.0, -4.0])
    back = math.radians(180.0 + 50.0)
    island = curve + (12.0 + 14.0) * np.array([math.cos(back), math.sin(back)])
    out, around = 12.0 * math.radians(50.0), 14.0 * math.radians(95.0)
    for s in -4.0 - np.linspace(0.0, out, 9):
        x, y, _ = road_pose(scenario.road.line, float(s))
        assert math.hypot(*(np.array([x, y]) - curve)) == pytest.approx(12.0, abs=1e-9)
    for s in -4.0 - out - np.linspace(0.0, around, 9):
        x, y, _ = road_pose(scenario.road.line, float(s))
        assert math.hypot(*(np.array([x, y]) - island)) == pytest.approx(14.0, abs=1e-9)
    entry, leaving = (road_pose(scenario.road.line, s)[2] for s in (-70.0, 1.0))
    assert (entry, leaving) == pytest.approx((math.radians(90.0), math.radians(90.0)), abs=1e-9)  # from South to North


def test_its_scooter_rides_by_its_own_limits(site: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every kamikaze keeps to what the README says of it, and uses all of its brake or its motor somewhere."""
    done = python(RIDE, site, tmp_path)
    assert done.returncode == 0, done.stderr
    monkeypatch.setitem(road_user_limits.WHEELED, "rental_scooter", LIMITS)
    rides, changes, strayed = json.loads(done.stdout), [], 0
    for phi, way, _ in rides:
        path, ridden = np.array(phi), np.array(way)
        assert road_user_limits.beyond("rental_scooter", path, ridden, 0.3, math.pi) <= 1e-6
        speeds = np.hypot(*np.diff(ridden, axis=0).T) / 0.3
        assert speeds.max() <= SPEED + 1e-9
        changes += (np.diff(speeds) / 0.3).tolist()
        held = path[np.minimum(np.arange(len(ridden)), len(path) - 1)]
        strayed += bool(np.abs(ridden - held).max() > 0.05)
    assert strayed >= 3
    assert sum(hit for *_, hit in rides) >= 3
    assert min(changes) == pytest.approx(-3.5, abs=1e-6) or max(changes) == pytest.approx(0.8, abs=1e-6)
