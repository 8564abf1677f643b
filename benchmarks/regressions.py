"""How often `skd bisect` finds a seeded regression, how often its test errs, and what a warm start saves.

    python benchmarks/regressions.py histories [--count 30]
    python benchmarks/regressions.py null [--count 1000]
    python benchmarks/regressions.py warm [--count 20]

A history has 64 commits of one of three controllers: 34 refactorings, a regression and 29 changes of millimetres. A
null history is one of which the good and the bad version change places at random in each trial. A warm start searches
the margin of the regression from the hits of the good version on.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from skd_evaluator.assessment.from_options import scenario_for
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.workers import InProcessRunner, check_controller
from skd_evaluator.assessment.stages.margin import warm_up_margins
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories
from skd_evaluator.margin.paired_test import PairedTest, Version, e_values, level_of
from skd_evaluator.margin.search.rounds import in_processes
from skd_evaluator.margin.search.search import IN_PROCESS, WARM_START, Earlier, SearchedMargins, search_margins
from skd_evaluator.margin.search.trial import prescribed
from skd_evaluator.metrics.statistics import wilson_interval

COMMITS, REFACTORINGS = 64, 34
PHIS, EACH = 8, 4  # trials of a warm start
CONTROLLER = '''
WIDTH = 1.500  # m
DECELERATION = 7.0  # m/s²


class Car:
    """Brakes for whoever is, or will be, in front of it."""

    def reset(self, scenario, rng):
        self.latched = 0
        self.before = []
        self.desired = scenario.car.start_speed

    def command(self, car, adversary):
        gap = adversary.y - car.y - 2.25
        self.before.append((adversary.x, adversary.vx))
        x, vx = self.before[-1]
        if gap < 0.0 or car.speed <= 0.0:
            return 1.0 if car.speed < self.desired else 0.0
        time = gap / car.speed
        aside = x + vx * min(time, 1.4)
        near = {near}
        self.latched = 3 if near and abs(aside) < WIDTH else max(0, self.latched - 1)
        if self.latched > {latch}:
            return -DECELERATION
        return 1.0 if car.speed < self.desired else 0.0
'''
CONTROLLERS = {  # when somebody is near, and how long the brake stays on
    "time to collision": ("time < 1.4", "2"),
    "required deceleration": ("car.speed**2 / (2.0 * max(gap, 0.1)) > 2.5", "2"),
    "latched distance": ("gap < 12.0 + 0.5 * (car.speed - 8.0)", "0"),
}
REGRESSIONS = {  # old text and new
    "threshold of width": ("abs(aside) < WIDTH", "abs(aside) < WIDTH - 0.5"),
    "half the deceleration": ("return -DECELERATION", "return -0.5 * DECELERATION"),
    "delay of 3 ticks": ("self.before[-1]", "self.before[max(0, len(self.before) - 4)]"),
    "sign of the velocity": ("x + vx *", "x - vx *"),
    "km/h/s for m/s²": ("DECELERATION = 7.0", "DECELERATION = 7.0 / 3.6"),
    "lost state": ("self.before.append((adversary.x, adversary.vx))", "self.before[:] = [(adversary.x, 0.0)]"),
    "gap from the centre": ("adversary.y - car.y - 2.25", "adversary.y - car.y"),
    "left side only": ("abs(aside) < WIDTH", "-WIDTH < aside < 0.3"),
    "late by 6 m": ("near = ", "near = gap < 6.0 and "),
    "weak at speed": ("return -DECELERATION", "return -DECELERATION + 0.6 * car.speed"),
}
SMALL = {  # changes that a car may well have from one day to the next
    "renamed": ("aside", "left"),
    "narrower by 5 mm": ("1.500", "1.495"),
    "wider by 5 mm": ("1.500", "1.505"),
    "brakes less, by 1 %": ("DECELERATION = 7.0", "DECELERATION = 6.93"),
    "brakes more, by 1 %": ("DECELERATION = 7.0", "DECELERATION = 7.07"),
    "nearer by 2 cm": ("- 2.25", "- 2.23"),
    **dict(list(REGRESSIONS.items())[:1]),
}
RENAMED = ("gap", "time", "aside", "near")


class Case(NamedTuple):
    """A controller, before and after a regression."""

    name: str
    good: str
    bad: str
    change: tuple[str, str]


def cases(changes: Mapping[str, tuple[str, str]] = REGRESSIONS) -> list[Case]:
    """Return all pairs of controllers and changes."""
    found = []
    for what, change in changes.items():
        for name, (near, latch) in CONTROLLERS.items():
            good = CONTROLLER.replace("{near}", near).replace("{latch}", latch)
            found.append(Case(f"{name}: {what}", good, good.replace(*change), change))
    return found


def history(case: Case, rng: np.random.Generator) -> Iterator[tuple[str, str]]:
    """Yield what each commit says, and the file after it."""
    kinds = ["refactoring"] * REFACTORINGS + ["millimetres"] * (COMMITS - REFACTORINGS - 1)
    kinds = [str(kind) for kind in rng.permutation(kinds)]
    kinds.insert(int(rng.integers(1, COMMITS)), "regression")
    body, width, bad, notes = case.good, 1.5, False, 0
    for kind in kinds:
        bad |= kind == "regression"
        if kind == "millimetres":
            width += float(rng.choice([-0.002, 0.002]))
        notes += kind == "refactoring"
        text = (body.replace(*case.change) if bad else body).replace("1.500", f"{width:.3f}")
        for place, name in enumerate(RENAMED):  # a refactoring renames a variable, and adds comments and functions
            text = re.sub(rf"\b{name}\b", f"{name}_{(notes + place) // len(RENAMED)}", text)
        helpers = "".join(f"\n\ndef helper_{number}(x):\n    return x\n" for number in range(notes % 7))
        yield kind, f"# version {notes}\n{text}{helpers}"


def git(folder: Path, *words: str) -> str:
    """Return what git says."""
    return subprocess.run(["git", *words], cwd=folder, check=True, capture_output=True, text=True).stdout.strip()


def histories(count: int) -> None:
    """Print, of each history, whether the right commit is found, and how long that takes."""
    right = blamed = 0
    print("| regression | first bad commit | revisions tested | of these to the bit | s |\n|---|---|---|---|---|")
    for number, case in enumerate(cases()[:count]):
        with tempfile.TemporaryDirectory() as name:
            folder, kinds = Path(name), {}
            git(folder, "init", "-q")
            git(folder, "config", "user.email", "nobody@example.org")
            git(folder, "config", "user.name", "nobody")
            for kind, text in [("start", case.good), *history(case, np.random.default_rng(number))]:
                (folder / "car.py").write_text(text, encoding="utf-8")
                git(folder, "add", "car.py")
                git(folder, "commit", "-qm", kind)
                kinds[git(folder, "rev-parse", "HEAD")] = kind
            begin = time.perf_counter()
            words = ["bisect", f"HEAD~{COMMITS}", "HEAD", "--json", "-q", "--", "--controller", "car.py:Car"]
            command = [sys.executable, "-m", "skd_evaluator", *words, "--seed", str(number)]
            done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
            seconds = time.perf_counter() - begin
        found = json.loads(done.stdout or '{"first_bad": null, "tested": []}')
        kind = kinds.get(found["first_bad"], done.stderr.strip().splitlines()[-1] if done.stderr else "none")
        right, blamed = right + (kind == "regression"), blamed + (kind == "refactoring")
        same = sum("bit" in one["why"] for one in found["tested"])
        print(f"| {case.name} | {kind} | {len(found['tested'])} | {same} | {seconds:.0f} |", flush=True)
    print(f"\nright {right} of {min(count, len(cases()))}, refactorings blamed {blamed}")


def versions(cars: Sequence[str], folder: Path, count: int, runner: InProcessRunner) -> list[Version]:
    """Return versions of a car, on so many φ."""
    plan = Plan(scenario_for(None, "synthetic"), safe_count=count)
    safe = safe_trajectories(plan, runner)
    found = []
    for number, text in enumerate(cars):
        file = folder / f"car_{number}.py"
        file.write_text(text, encoding="utf-8")
        one = replace(plan, controller=f"{file}:Car")
        scenario = check_controller(one.car, one.scenario)
        found.append(Version(str(number), str(number), replace(one, scenario=scenario), safe))
    return found


def null(count: int) -> None:
    """Print how often versions that change places at random are told apart, at any of 128 stops."""
    rng, told, used = np.random.default_rng(0), 0, cases()[::3] + cases()[1::3]
    with tempfile.TemporaryDirectory() as name, InProcessRunner(2, isolated=True) as runner:
        runner.start(inherited=warm_up_margins)
        for number, case in enumerate(used):
            folder = Path(name, str(number))
            folder.mkdir()
            good, bad = versions((case.good, case.bad), folder, 128, runner)
            differences = PairedTest(good, bad, runner, 1.0).differences()
            for _ in range(count // len(used)):
                signs = rng.choice([-1.0, 1.0], len(differences))
                told += e_values(signs * differences).max() >= level_of(1) / 2
    total = count // len(used) * len(used)
    low, high = wilson_interval(told, total) or (0.0, 1.0)
    print(f"told apart at 5 %: {told} of {total} null histories ({low:.1%} to {high:.1%})")


def warm(count: int) -> None:
    """Print margins and candidates of searches from nothing and from the hits of the version before."""
    print("| change | margin (m) | from hits (m) | candidates | from hits | times fewer |\n|---|---|---|---|---|---|")
    ratios, errors = [], []
    with tempfile.TemporaryDirectory() as name, InProcessRunner(2, isolated=True) as runner:
        runner.start(inherited=warm_up_margins)
        texts = {text: None for case in cases(SMALL)[:count] for text in (case.good, case.bad)}
        cars = dict(zip(texts, versions(list(texts), Path(name), PHIS, runner), strict=True))
        cold: dict[str, SearchedMargins] = {}
        for case in cases(SMALL)[:count]:
            rounds = in_processes(runner, lambda *_: None)
            for text in (case.good, case.bad):
                if text not in cold:
                    cold[text] = search_margins(cars[text].plan.trials(cars[text].safe, EACH), {}, rounds, IN_PROCESS)
            trials = cars[case.bad].plan.trials(cars[case.bad].safe, EACH)
            pairs = zip(trials, cold[case.good].episodes, strict=True)
            first = [prescribed(one, hit.safe_trajectory.positions) for one, hit in pairs if hit is not None]
            earlier = Earlier({log.episode.episode_id: log for log in runner.run(first)}, cold[case.good].means[-1][1])
            found, whole = search_margins(trials, {}, rounds, WARM_START, earlier), cold[case.bad]
            before, after = whole.means[-1][1], found.means[-1][1]
            ratios.append(whole.driven / found.driven)
            errors.append(abs(after - before) / before)
            row = f"{before:.3f} | {after:.3f} | {whole.driven:,} | {found.driven:,} | {ratios[-1]:.1f}"
            print(f"| {case.name} | {row} |", flush=True)
    print(f"\ntimes fewer: median {np.median(ratios):.1f}, least {min(ratios):.1f}; ", end="")
    print(f"within 1 %: {sum(one <= 0.01 for one in errors)} of {len(errors)}")


def main() -> None:
    """Run one of the three."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("histories", "null", "warm"))
    parser.add_argument("--count", type=int, metavar="N")
    arguments = parser.parse_args()
    run, usual = {"histories": (histories, 30), "null": (null, 1000), "warm": (warm, 20)}[arguments.what]
    run(arguments.count or usual)


if __name__ == "__main__":
    main()
