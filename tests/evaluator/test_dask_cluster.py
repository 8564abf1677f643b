"""Campaigns on a Dask cluster: the same to the bit; what is unlike, dies or is out of reach is one line."""

import json
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import pytest
from common import wait_until
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run import dask_cluster
from skd_evaluator.assessment.run.dask_cluster import DaskRunner
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_sim import Mode, UsageError, load_scenario
from skd_sim.errors import AssessmentError, OutOfReachError
from stages import rate
from test_campaign import straight

NO_DASK = "Dask is not installed: python -m pip install '.[dask]'"
pytestmark = pytest.mark.skipif(find_spec("distributed") is None, reason=NO_DASK)  # which takes long to import
CAR = """
import os

class Careful:
    def reset(self, scenario, rng): self.rng = rng
    def command(self, car, adversary): return -2.0 * self.rng.random() if adversary.x > -6.0 else 0.0
class Wrong:
    def reset(self, scenario, rng): pass
    def command(self, car, adversary): return "fast"
class Leaves:
    def reset(self, scenario, rng): pass
    def command(self, car, adversary): os._exit(7) if adversary.x > -6.0 else None; return 0.0
class Needs:
    def __init__(self): import nowhere_to_be_found
"""


def dask(folder: Path, *words: str) -> subprocess.Popen[bytes]:
    """Start a program of Dask in a folder, so that nothing of the caller's is found by chance; its log goes there."""
    command = [sys.executable, "-m", "dask", *words]
    with (folder / "dask.log").open("ab") as log:
        return subprocess.Popen(command, cwd=folder, stdin=subprocess.DEVNULL, stdout=log, stderr=log)


def start_worker(address: str, folder: Path) -> subprocess.Popen[bytes]:
    options = ("--nworkers", "1", "--nthreads", "1", "--no-nanny", "--no-dashboard", "--host", "127.0.0.1")
    return dask(folder, "worker", address, *options, "--local-directory", str(folder))


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """A scheduler on a port that is free, and two workers, in processes of their own."""
    folder = tmp_path_factory.mktemp("dask")
    file, options = folder / "scheduler.json", ("--host", "127.0.0.1", "--port", "0", "--no-dashboard")
    scheduler, workers = dask(folder, "scheduler", *options, "--scheduler-file", file.name), []
    try:
        wait_until(lambda: scheduler.poll() is not None or (file.exists() and file.read_text()), "Dask's scheduler")
        assert scheduler.poll() is None, (folder / "dask.log").read_text()[-500:]
        address = json.loads(file.read_text())["address"]
        workers += [start_worker(address, folder) for _ in range(2)]
        yield SimpleNamespace(address=address, scheduler=scheduler, workers=workers)
    finally:
        for process in (*workers, scheduler):
            process.kill()
            process.wait()


@pytest.fixture
def cars(tmp_path, monkeypatch):
    (tmp_path / "cars_of_a_user.py").write_text(CAR)
    monkeypatch.syspath_prepend(str(tmp_path))
    yield "cars_of_a_user"
    sys.modules.pop("cars_of_a_user", None)


def replays(count, controller="basic"):
    plan, phi = Plan(load_scenario("crossing"), controller=controller), straight()
    return [plan.episode(Mode.REPLAY, 0, trial, phi) for trial in range(count)]


def bits(log):
    return log.outcome, log.reason, log.adversary.tobytes(), log.car.tobytes(), repr(log.impact_time), log.clipped


def test_one_process_two_workers_and_a_cluster_find_the_same_to_the_bit(cluster):
    plan = Plan(load_scenario("crossing"), safe_count=2, kamikaze_count=6, collision_runs=20, seed=3)
    phis = [straight(), straight(0.2, "beside")]
    found = []
    for runner in (InProcessRunner(1), InProcessRunner(2), DaskRunner(cluster.address)):
        with runner:
            found.append(rate(plan, [plan.objective], phis, runner))
    figures, *others = [{**one.results[0].figures(), "probability_bound": None} for one in found]
    assert all(other == figures for other in others)
    episodes, *others = [
        [bits(log) for group in one.results[0].kamikaze for log in group.episodes] + [*map(bits, one.nominal_runs)]
        for one in found
    ]
    assert all(other == episodes for other in others)
    assert len(episodes) >= 32


def test_a_users_file_is_sent_and_does_the_same_as_here(cluster, cars):
    episodes = replays(12, f"{cars}:Careful")
    with InProcessRunner(1, isolated=True) as here, DaskRunner(cluster.address) as there:
        assert [bits(log) for log in there.run(episodes)] == [bits(log) for log in here.run(episodes)]


@pytest.mark.parametrize(
    ("name", "error", "parts"),
    [
        ("Wrong", AssessmentError, "finite number.*fast"),
        ("Leaves", AssessmentError, "3 episodes in a row failed.*exit code 7"),
        ("Needs", UsageError, "cannot be loaded.*nowhere_to_be_found"),
    ],
)
def test_what_a_users_code_does_is_said_as_in_process(cluster, cars, name, error, parts):
    with DaskRunner(cluster.address) as runner, pytest.raises(error, match=parts):
        list(runner.run(replays(8, f"{cars}:{name}")))
    with DaskRunner(cluster.address) as runner:  # and the workers are still there
        assert len(list(runner.run(replays(4)))) == 4


def test_a_package_that_workers_do_not_have_is_one_line(cluster, tmp_path, monkeypatch):
    (tmp_path / "users_package").mkdir()
    (tmp_path / "users_package" / "__init__.py").touch()
    (tmp_path / "users_package" / "car.py").write_text(CAR)
    monkeypatch.syspath_prepend(str(tmp_path))
    with DaskRunner(cluster.address) as runner, pytest.raises(UsageError, match="does not have the controller"):
        list(runner.run(replays(2, "users_package.car:Careful")))


def test_workers_that_are_unlike_are_refused_at_the_start_and_later(cluster):
    with DaskRunner(cluster.address) as runner:
        runner.start()
        runner._description = {**runner._description, "numpy": "0.9"}
        with pytest.raises(UsageError, match=r"numpy .* instead of 0\.9: all need the same"):
            list(runner.run(replays(2)))
    runner = DaskRunner(cluster.address)
    runner._description = {**runner._description, "numpy": "0.9"}
    with runner, pytest.raises(UsageError, match=r"instead of 0\.9"):
        runner.start()


def test_a_killed_worker_costs_nothing(cluster, tmp_path):
    episodes = replays(400)
    with InProcessRunner(1) as runner:
        expected = [bits(log) for log in runner.run(episodes)]
    with DaskRunner(cluster.address) as runner:
        runner.start()
        found = runner.run(episodes)
        first = bits(next(found))
        cluster.workers[0].kill()
        cluster.workers[0].wait()
        cluster.workers[0] = start_worker(cluster.address, tmp_path)
        assert [first, *map(bits, found)] == expected


def test_a_scheduler_that_dies_or_was_never_there_is_one_line(cluster, monkeypatch):
    monkeypatch.setattr(dask_cluster, "CONNECT_LIMIT", 2.0)
    with DaskRunner(cluster.address) as runner:
        found = runner.run(replays(2000))
        next(found)
        cluster.scheduler.kill()  # the last test of this cluster
        with pytest.raises(OutOfReachError, match=f"the Dask scheduler {cluster.address} is gone"):
            list(found)
    wait_until(lambda: cluster.scheduler.poll() is not None)
    with DaskRunner(cluster.address) as runner, pytest.raises(OutOfReachError, match="no Dask scheduler answers"):
        runner.start()


@pytest.mark.parametrize("address", ["foo", "http://host:8786"])
def test_what_is_no_address_is_refused(address):
    with pytest.raises(UsageError, match="as tcp://host:8786"):
        DaskRunner(address)
