"""How often `skd bisect` finds a seeded regression, how often its test errs, and what a warm start saves.

    python benchmarks/regressions.py histories|null|warm [--count N]

A history has 64 commits of one of three controllers: 34 refactorings, a regression, and 29 changes by millimetres. In a
null history the good and the bad version change places at random in each trial. A warm start searches the margin of a
version that differs a little from the hits of the version before on.
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
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
from skd_evaluator.assessment.from_options import scenario_for
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.workers import InProcessRunner, check_controller
from skd_evaluator.assessment.stages.margin import warm_up_margins
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories
from skd_evaluator.margin.paired_test import ERROR, PairedTest, Version, e_values
from skd_evaluator.margin.search.rounds import in_processes
from skd_evaluator.margin.search.search import IN_PROCESS, WARM_START, Earlier, search_margins
from skd_evaluator.margin.search.trial import prescribed
from skd_evaluator.metrics.statistics import wilson_interval

COMMITS, REFACTORINGS = 64, 34
CONTROLLER = """
WIDTH = 1.500  # m
DECELERATION = 7.0  # m/s²
class Car:
    def reset(self, scenario, rng):
        self.latched, self.before, self.desired = 0, [], scenario.car.start_speed
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
"""
CONTROLLERS = {  # when somebody is near, and how long the brake stays on
    "time to collision": ("time < 1.4", 2),
    "required deceleration": ("car.speed**2 / (2.0 * max(gap, 0.1)) > 2.5", 2),
    "latched distance": ("gap < 12.0 + 0.5 * (car.speed - 8.0)", 0),
}
REGRESSIONS = {  # old text and new
    "threshold": ("abs(aside) < WIDTH", "abs(aside) < WIDTH - 0.5"),
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
SMALL = {
    "renamed": ("aside", "left"),
    "narrower by 5 mm": ("1.500", "1.495"),
    "wider by 5 mm": ("1.500", "1.505"),
    "brakes less, by 1 %": ("DECELERATION = 7.0", "DECELERATION = 6.93"),
    "brakes more, by 1 %": ("DECELERATION = 7.0", "DECELERATION = 7.07"),
    "nearer by 2 cm": ("- 2.25", "- 2.23"),
    "looks 10 ms further": ("min(time, 1.4)", "min(time, 1.41)"),
    "a regression": REGRESSIONS["threshold"],
}
Change = tuple[str, str]
RENAMED = ("gap", "time", "aside", "near")


def cases(changes: Mapping[str, Change], count: int) -> list[tuple[str, str, Change]]:
    """Return the first pairs of changes and controllers: names, good controllers and changes."""
    cars = [(name, CONTROLLER.format(near=near, latch=latch)) for name, (near, latch) in CONTROLLERS.items()]
    return [(f"{name}: {what}", car, change) for what, change in changes.items() for name, car in cars][:count]


def history(good: str, change: Change, rng: np.random.Generator) -> Iterator[tuple[str, str]]:
    """Yield what each commit says, and the file after it."""
    kinds = rng.permutation(["refactoring"] * REFACTORINGS + ["small"] * (COMMITS - REFACTORINGS - 1)).tolist()
    kinds.insert(int(rng.integers(1, COMMITS)), "regression")
    text, width, notes = good, 1.5, 0
    for kind in ["start", *kinds]:
        text = text.replace(*change) if kind == "regression" else text
        width += float(rng.choice([-0.002, 0.002])) if kind == "small" else 0.0
        notes += kind == "refactoring"
        written = text.replace("1.500", f"{width:.3f}")
        for place, name in enumerate(RENAMED):  # a refactoring renames a variable, and adds comments and functions
            written = re.sub(rf"\b{name}\b", f"{name}_{(notes + place) // len(RENAMED)}", written)
        yield kind, f"# version {notes}\n{written}" + "def helper(x):\n    return x\n" * (notes % 7)


def histories(count: int) -> None:
    """Print, of each history, which commit is found, and how long that takes."""
    kinds_found = []
    print("| regression | first bad commit | revisions tested | of these to the bit | s |\n|---|---|---|---|---|")
    for number, (case, good, change) in enumerate(cases(REGRESSIONS, count)):
        with tempfile.TemporaryDirectory() as name:

            def git(*words: str, folder: str = name) -> str:
                words = ("git", "-c", "user.name=nobody", "-c", "user.email=nobody@example.org", *words)
                return subprocess.run(words, cwd=folder, check=True, capture_output=True, text=True).stdout.strip()

            git("init", "-q")
            kinds = {}
            for kind, text in history(good, change, np.random.default_rng(number)):
                Path(name, "car.py").write_text(text, encoding="utf-8")
                git("add", "car.py")
                git("commit", "-qm", kind)
                kinds[git("rev-parse", "HEAD")] = kind
            begin = time.perf_counter()
            options = ["--json", "-q", "--", "--controller", "car.py:Car", "--seed", str(number)]
            command = [sys.executable, "-m", "skd_evaluator", "bisect", f"HEAD~{COMMITS}", "HEAD", *options]
            done = subprocess.run(command, cwd=name, capture_output=True, text=True)
            seconds = time.perf_counter() - begin
        found = json.loads(done.stdout or '{"first_bad": null, "tested": []}')
        kinds_found.append(kinds.get(found["first_bad"], "none"))
        same = sum("exactly" in one["why"] for one in found["tested"])
        print(f"| {case} | {kinds_found[-1]} | {len(found['tested'])} | {same} | {seconds:.0f} |", flush=True)
    right, blamed = kinds_found.count("regression"), kinds_found.count("refactoring")
    print(f"\nright {right} of {len(kinds_found)}, refactorings blamed {blamed}")


@contextmanager
def versions(cars: Sequence[str], count: int) -> Iterator[tuple[InProcessRunner, list[Version]]]:
    """Yield versions of a car, on so many φ, and what runs them."""
    with tempfile.TemporaryDirectory() as folder, InProcessRunner(2, isolated=True) as runner:
        runner.start(inherited=warm_up_margins)
        plan = Plan(scenario_for(None, "synthetic"), safe_count=count)
        safe, found = safe_trajectories(plan, runner), []
        for number, text in enumerate(cars):
            Path(folder, f"car_{number}.py").write_text(text, encoding="utf-8")
            one = replace(plan, controller=f"{folder}/car_{number}.py:Car")
            checked = replace(one, scenario=check_controller(one.car, one.scenario))
            found.append(Version(str(number), str(number), checked, safe))
        yield runner, found


def null(count: int) -> None:
    """Print how often versions that change places at random are told apart, at any of 128 stops."""
    rng, used, told = np.random.default_rng(0), cases(REGRESSIONS, 20), 0
    for _, car, change in used:
        with versions((car, car.replace(*change)), 128) as (runner, (good, bad)):
            differences = PairedTest(good, bad, runner, 1.0).differences()
        signs = rng.choice([-1.0, 1.0], (count // len(used), len(differences)))
        told += sum(e_values(one * differences).max() >= 1.0 / ERROR for one in signs)
    total = count // len(used) * len(used)
    low, high = wilson_interval(told, total) or (0.0, 1.0)
    print(f"told apart at 5 %: {told} of {total} null histories ({low:.1%} to {high:.1%})")


def warm(count: int) -> None:
    """Print margins and candidates of searches from nothing, and from the hits of the version before."""
    print("| change | margin (m) | from hits (m) | candidates | from hits | times fewer |\n|---|---|---|---|---|---|")
    ratios, above = [], []
    used = [(name, good, good.replace(*change)) for name, good, change in cases(SMALL, count)]
    texts = list(dict.fromkeys(text for _, *both in used for text in both))
    with versions(texts, 8) as (runner, made):
        rounds = in_processes(runner, lambda *_: None)
        trials = {text: one.plan.trials(one.safe, 4) for text, one in zip(texts, made, strict=True)}
        cold = {text: search_margins(some, {}, rounds, IN_PROCESS._replace(limit=512)) for text, some in trials.items()}
        for name, good, bad in used:
            pairs = zip(trials[bad], cold[good].episodes, strict=True)
            hits = [prescribed(one, hit.safe_trajectory.positions) for one, hit in pairs if hit is not None]
            earlier = Earlier({log.episode.episode_id: log for log in runner.run(hits)}, cold[good].means[-1][1])
            whole, found = cold[bad], search_margins(trials[bad], {}, rounds, WARM_START, earlier)
            before, after = whole.means[-1][1], found.means[-1][1]
            ratios.append(whole.driven / found.driven)
            above.append(after / before - 1.0)
            row = f"{before:.3f} | {after:.3f} | {whole.driven:,} | {found.driven:,} | {ratios[-1]:.1f}"
            print(f"| {name} | {row} |", flush=True)
    print(f"\ntimes fewer: median {np.median(ratios):.1f}, least {min(ratios):.1f}; ", end="")
    print(f"at most 1 % greater: {sum(one <= 0.01 for one in above)} of {len(above)}; greatest {max(above):.1%}")


def main() -> None:
    """Run one of the three."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("histories", "null", "warm"))
    parser.add_argument("--count", type=int, metavar="N", help="by default 30 histories, 1000 null ones, 24 versions")
    arguments = parser.parse_args()
    run, usual = {"histories": (histories, 30), "null": (null, 1000), "warm": (warm, 24)}[arguments.what]
    run(arguments.count or usual)


if __name__ == "__main__":
    main()
