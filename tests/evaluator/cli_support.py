"""What the tests of the command line share: a controller's file, a process of `skd`, and what an error looks like."""

import os
import re
import subprocess
import sys
from pathlib import Path

import yaml
from common import PATIENCE, run_program
from forked_skd import ForkedSkd
from skd_sim.scenario.scenario import load_scenario

SMALL = [
    *("--safe-count", "1", "--kamikaze-count", "2", "--collision-runs", "3", "--simulations", "20", "--workers", "1"),
    *("--margin-limit", "8", "--behaviour", "none"),
]
"""An assessment of hardly any episodes: those of the search for the margin and of the risk would be most of it."""
BRAKE = '''
class {name}:
    """Brakes for whoever will be in front of it within a time to collision."""

    limit = 1.4

    def reset(self, scenario, rng):
        pass

    def command(self, car, adversary):
        gap = adversary.y - car.y - 2.25
        if gap < 0.0 or car.speed <= 0.0:
            return 0.0
        time = gap / car.speed
        aside = adversary.x + adversary.vx * min(time, 1.4)
        return -7.0 if time < self.limit and abs(aside) < {side} else 0.0
'''
"""A car whose `name`, and the half width (m) that it looks at, are filled in."""
CROSSING = "t,x,y\n0,-3,0\n2,3,0\n"
CONTROLLERS = """
import os, sys, time

class _Car:
    def reset(self, scenario, rng):
        self.calls = 0
    def command(self, car, adversary):
        self.calls += 1
        return 0.0 if self.calls < 3 else self.late()

class Fine(_Car):
    def late(self): return 0.0
class Raises(_Car):
    def late(self): return 1 / 0
class Sleeps(_Car):
    def late(self): time.sleep(1000)
"""


def skd(*arguments: str | Path, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run `skd` in a process of its own, forked from one that has imported everything."""
    return started(*arguments, cwd=cwd, **environment).finish(PATIENCE)


def started(*arguments: str | Path, cwd: Path, **environment: str) -> ForkedSkd:
    variables = {**os.environ, "PYTHONPATH": str(cwd), **environment}
    return ForkedSkd([str(word) for word in arguments], cwd=cwd, environment=variables)


def skd_from_nothing(*arguments: str | Path, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run `skd` in a Python of its own, as a user does: for tests of what a start does."""
    words = (sys.executable, "-m", "skd_evaluator", *arguments)
    return run_program(*words, cwd=cwd, **{"PYTHONPATH": str(cwd), **environment})


def git(repository: Path, *words: str) -> str:
    identity = ("-c", "user.name=nobody", "-c", "user.email=nobody@example.org", "-c", "commit.gpgsign=false")
    done = subprocess.run(["git", *identity, *words], cwd=repository, check=True, capture_output=True, text=True)
    return done.stdout.strip()


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def one_line(done: subprocess.CompletedProcess[str], code: int, *parts: str) -> None:
    """What went wrong is one line; of how far it is, a command says something after five seconds, on a busy machine."""
    assert done.returncode == code, done
    lines = [line for line in done.stderr.splitlines() if not re.match(r"skd: (?!error)", line)]
    assert len(lines) == 1, done.stderr
    assert lines[0].startswith("skd"), lines
    for part in parts:
        assert part in lines[0]


def edited(**car_or_adversary: object) -> str:
    """The scenario `crossing` as YAML, with some values changed: `car__front=2.0`."""
    data = load_scenario("crossing").as_dict()
    for key, value in car_or_adversary.items():
        section, name = key.split("__")
        data[section][name] = value
    return yaml.safe_dump(data)
