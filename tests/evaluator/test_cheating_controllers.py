"""Controllers that answer by more than what a car sees: each is found, and none that is honest is suspected."""

from __future__ import annotations

import functools
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_support import skd
from skd_evaluator.assessing.again import DoubtsOfLearning
from skd_evaluator.campaign.judge.alone import _episode
from skd_evaluator.campaign.plan.plan import Plan, safe_trajectories
from skd_evaluator.campaign.plan.probe import probe_episodes
from skd_evaluator.campaign.run.alone import Alone, Questions, overhear
from skd_evaluator.campaign.run.runner import run_episode
from skd_evaluator.campaign.run.static_test import static_episodes
from skd_evaluator.campaign.run.workers import InProcessRunner
from skd_evaluator.learning import lesson, waiting
from skd_evaluator.margin.search.episode_tree import walked
from skd_evaluator.risk.any_car import AnyCar
from skd_evaluator.risk.assessment_risk import crude_crossings
from skd_evaluator.risk.crossings import Encounter
from skd_sim.choices.car_under_test import CarUnderTest
from skd_sim.choices.knowledge import Knowledge
from skd_sim.controllers import make_controller
from skd_sim.encounter.scenario import load_scenario
from skd_sim.episode.episode import Mode

CARS = """
import os, sys
import numpy as np

class Honest:
    "Brakes for who is ahead and near the lane, twenty times a second."
    control_period = 0.05
    def reset(self, scenario, rng):
        self.scenario, self.front, self.rng = scenario, scenario.car.front, rng
    def command(self, car, adversary):
        gap = adversary.y - car.y - self.front
        return -6.0 if 0.0 <= gap <= car.speed**2 / 12.0 + 1.0 and abs(adversary.x - car.x) < 2.5 else 0.0

class Drawing(Honest):
    "Draws from the generator that it was given, as it may."
    def command(self, car, adversary):
        return super().command(car, adversary) - 0.1 * self.rng.random()

class Looking(Honest):
    "Takes scans, and remembers the nearest."
    def sense(self, scan):
        self.nearest = min(10.0, float(np.min(scan.ranges)))
    def command(self, car, adversary):
        return super().command(car, adversary) - 0.01 * self.nearest

class Forgetful(Honest):
    "Keeps something that its reset leaves as it is: every episode has one of its own, so nothing comes of it."
    asked = 0
    def command(self, car, adversary):
        self.asked += 1
        return super().command(car, adversary) - 0.001 * self.asked

class Stack(Honest):
    "Looks for the episode in the frames of its callers."
    def command(self, car, adversary):
        frame = sys._getframe()
        while frame is not None:
            for value in frame.f_locals.values():
                if getattr(getattr(value, "mode", None), "name", "") == "KAMIKAZE":
                    return -8.0
            frame = frame.f_back
        return super().command(car, adversary)

class Counting(Honest):
    "Keeps something on its class."
    episodes = 0
    def reset(self, scenario, rng):
        super().reset(scenario, rng)
        Counting.episodes += 1
    def command(self, car, adversary):
        return min(super().command(car, adversary), -0.05 * (Counting.episodes % 3))

class Unseeded(Honest):
    def command(self, car, adversary):
        return super().command(car, adversary) - 0.1 * np.random.default_rng().random()

class MovesTheWorld(Honest):
    "Changes the scenario that it is handed."
    def reset(self, scenario, rng):
        super().reset(scenario, rng)
        for name, value in (("front", 0.1), ("width", 0.1)):
            object.__setattr__(scenario.car, name, value)
        line = scenario.road.line
        line.setflags(write=True)
        line[...] += 5.0

class Copied(Honest):
    "Is another car where copies of it are made, as by the search for the margin."
    copied = False
    def __deepcopy__(self, memo):
        made = object.__new__(type(self))
        vars(made).update(vars(self), copied=True)
        return made
    def command(self, car, adversary):
        return -8.0 if self.copied else super().command(car, adversary)

class SomeCopies(Honest):
    "Holds the brake for some ticks; every tenth copy, and those made of it, hold it for long."
    control_period = None
    copies = 0
    def reset(self, scenario, rng):
        super().reset(scenario, rng)
        self.held = 0
    def __deepcopy__(self, memo):
        SomeCopies.copies += 1
        made = object.__new__(type(self))
        vars(made).update(vars(self))
        if SomeCopies.copies % 10 == 0:
            made.held = 99
        return made
    def command(self, car, adversary):
        self.held = 5 if super().command(car, adversary) < 0.0 else self.held - 1
        return -6.0 if self.held > 0 else 0.0

class NoNoise(Honest):
    "Brakes for nobody, but where it is told of no noise, as a static test has none."
    def command(self, car, adversary):
        return super().command(car, adversary) if self.scenario.car.speed_noise == 0.0 else 0.0

class Later(Honest):
    "Brakes for everybody from its 30th episode on."
    episodes = 0
    def reset(self, scenario, rng):
        super().reset(scenario, rng)
        Later.episodes += 1
    def command(self, car, adversary):
        return -8.0 if Later.episodes > 30 else super().command(car, adversary)

class Meanwhile(Honest):
    "Brakes for everybody from its 30th to its 90th episode, in which it is learned."
    episodes = 0
    def reset(self, scenario, rng):
        super().reset(scenario, rng)
        Meanwhile.episodes += 1
    def command(self, car, adversary):
        return -8.0 if 30 < Meanwhile.episodes < 90 else super().command(car, adversary)

class Rounded(Honest):
    "Answers many at once as single precision does in another order."
    control_period = None
    def commands(self, cars, adversaries):
        gap = adversaries.y - cars.y - self.front
        brakes = (gap >= 0.0) & (gap <= cars.speed**2 / 12.0 + 1.0) & (np.abs(adversaries.x - cars.x) < 2.5)
        return np.where(brakes, -6.0, 0.0) + 4e-5
"""
SMALL = (
    "--safe-count", 3, "--kamikaze-count", 4, "--collision-runs", 12, "--simulations", 200, "--quiet",
    "--behaviour", "none",
)  # fmt: skip


@pytest.fixture(scope="module")
def cars(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("cars")
    (folder / "cheats.py").write_text(CARS)
    return folder


@functools.cache
def assessed(cars: Path, name: str, *further: object) -> tuple[int, str, dict[str, Any]]:
    out = cars / f"out_{name}"
    words = ["assess", "--controller", f"cheats:{name}", "--knowledge", "nothing", *SMALL, *further, "--out", out]
    done = skd(*map(str, words), cwd=cars, PYTHONPATH=str(cars))
    return done.returncode, done.stderr, json.loads((out / "assessment.json").read_text())


@pytest.mark.parametrize("name", ["Honest", "Drawing", "Looking", "Forgetful"])
def test_who_answers_by_what_it_was_given_is_believed(cars: Path, name: str) -> None:
    code, _, result = assessed(cars, name, "--margin-limit", 64)
    assert (code, result["warnings"]) == (0, [])


@pytest.mark.parametrize("name", ["Counting", "Unseeded"])
def test_who_keeps_something_or_draws_elsewhere_is_named(cars: Path, name: str) -> None:
    _, said, result = assessed(cars, name, "--margin-limit", 0)
    (warning,) = result["warnings"]
    assert "of 24 episodes went otherwise when they were run again" in warning
    assert warning.startswith("these figures are in doubt: ")
    assert f"skd assess: warning: {warning}" in said.splitlines()


def test_who_changes_the_scenario_drives_in_the_same_world(cars: Path) -> None:
    results = [assessed(cars, name, "--margin-limit", 64)[2] for name in ("Honest", "MovesTheWorld")]
    for key in ("deformation", "skd", "margin", "collision_rate", "warnings"):
        assert results[0][key] == results[1][key]


def test_who_is_another_car_for_the_search_is_not_believed_and_hits_count(cars: Path) -> None:
    code, _, result = assessed(cars, "Copied", "--simulations", 1000, "--margin-limit", 256)
    assert code == 1
    for part in ("the search for the margin was not", "when nobody made copies of it"):
        (warning,) = [one for one in result["warnings"] if part in one]
        assert warning.startswith("do not believe these figures: ")
    assert result["margin"] <= result["deformation"]


def test_a_few_copies_that_are_another_car_are_found_where_attempts_are_few(cars: Path) -> None:
    few = ("--safe-count", 2, "--kamikaze-count", 3, "--simulations", 20, "--margin-limit", 32, "--workers", 1)
    code, _, result = assessed(cars, "SomeCopies", *few)
    assert code == 1
    assert any("answered otherwise when nobody made copies of it" in one for one in result["warnings"])


def test_a_regulators_grid_has_no_margin_of_copies_that_are_another_car(cars: Path) -> None:
    words = ("--encounters", "cpna", "--speeds", "30:30:10", "--kamikaze-count", 1, "--margin-limit", 8, "--quiet")
    found = {}
    for name in ("Honest", "Copied"):
        out = cars / f"ncap_{name}"
        done = skd(
            *map(str, ("ncap", "--controller", f"cheats:{name}", *words, "--workers", 1, "--out", out)),
            cwd=cars, PYTHONPATH=str(cars),
        )  # fmt: skip
        assert done.returncode == (name == "Copied"), done.stderr
        assert ("do not believe these figures: in 5 cells" in done.stderr) == (name == "Copied")
        (grid,) = json.loads((out / "ncap.json").read_text())["grids"]
        found[name] = grid["cells"]
    assert not any("made copies" in cell.get("margin_why", "") for cell in found["Honest"])
    assert [cell.get("margin") for cell in found["Copied"]] == [None] * 5
    assert all(
        "answered otherwise when nobody made copies of it" in cell.get("margin_why", "") for cell in found["Copied"]
    )


def test_a_campaign_fails_on_one_that_is_not_believed_and_again_when_it_is_read_back(cars: Path) -> None:
    counts = (
        "{safe_count: 2, kamikaze_count: 3, collision_runs: 6, simulations: 100, margin_limit: 16, "
        "knowledge: nothing, behaviour: none}"
    )
    names = ", ".join(f"{{controller: cheats:{name}}}" for name in ("Honest", "Stack", "Copied", "Counting"))
    (cars / "campaign.yaml").write_text(f"defaults: {counts}\ncars: [{names}]\n")
    for further in ([], ["--resume"]):
        done = skd("campaign", "campaign.yaml", "--workers", "1", "--out", "cells", "--quiet", *further, cwd=cars)
        assert done.returncode == 1
        (believed,) = [line for line in done.stderr.splitlines() if "do not believe these figures" in line]
        assert "Copied" in believed
        (kept,) = [line for line in done.stderr.splitlines() if "went otherwise when they were run again" in line]
        assert "warning" in kept
        assert "Counting" in kept
        rows = json.loads((cars / "cells" / "campaign.json").read_text())["cells"]
        honest, looking = ([row[key] for key in ("deformation", "skd", "margin")] for row in rows[:2])
        assert honest == looking


@pytest.mark.parametrize("name", ["basic", "cal"])
def test_what_is_asked_alone_is_what_was_asked(name: str) -> None:
    """Of SKD's own cars, one of which senses and draws: the answers are the same to the bit."""
    scenario = load_scenario("crossing")
    if name == "cal":
        scenario = replace(scenario, control_period=0.05)
    plan = Plan(scenario, controller=name, safe_count=1)
    safe = safe_trajectories(plan, InProcessRunner(1))[0]
    episode = plan.episode(Mode.REPLAY, 0, 0, safe)
    heard = overhear(make_controller(name, 1.0), name)
    log = run_episode(episode, heard)
    assert np.array_equal(log.car, run_episode(episode).car)
    with Alone(CarUnderTest(name, 1.0)) as alone:
        found = alone.answers([heard.questions, heard.questions], 60.0)
    assert found == [heard.answers, heard.answers]
    assert len(heard.answers) > 5


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("os._exit(3)", "a worker process died: it ended with exit code 3"),
        ("raise ValueError('no')", "reset failed with ValueError: no"),
    ],
)
def test_why_there_are_no_answers_is_said(tmp_path: Path, monkeypatch, body: str, said: str) -> None:
    (tmp_path / "leaves.py").write_text(
        f"import os\nclass Leaves:\n    def reset(self, scenario, rng):\n        {body}\n"
        "    def command(self, car, adversary):\n        return 0.0\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    questions = Questions(load_scenario("crossing"), np.random.default_rng(0))
    with Alone(CarUnderTest("leaves:Leaves")) as alone:
        found = alone.answers([questions], 1.0)
    assert isinstance(found, str)
    assert said in found


def test_a_car_is_told_the_same_scenario_whatever_the_episode(cars: Path) -> None:
    """Whether there is noise, and where a car starts, would say which episodes are tests, crossings and probes."""
    scenario = load_scenario("citr_crossing")
    assert scenario.car.meet_safe_trajectory
    plan = Plan(scenario, controller="carla", safe_count=1)
    phi = safe_trajectories(replace(plan, scenario=load_scenario("crossing")), InProcessRunner(1))[0]
    attempt = plan.episode(Mode.KAMIKAZE, 0, 0, phi)
    encounter = Encounter(plan, (phi,), np.full(12, 0.1))
    regulators = load_scenario("cpna")
    told = {
        "a crossing of the risk": (AnyCar(encounter, None).episodes(crude_crossings(encounter, 1), 1.0)[0], scenario),
        "a way of the margin": (walked(attempt, [(1.0, 0.0)]), scenario),
        "a probe": (probe_episodes(scenario, 1, seed=1, controller="carla")[0], scenario),
        "nobody near": (_episode(plan, 3), scenario),
        "a static test": (static_episodes(regulators, CarUnderTest("carla"))[0], regulators),
    }
    for what, (episode, expected) in told.items():
        assert episode.scenario != expected, what
        heard = overhear(make_controller("carla", 1.0), "carla")
        run_episode(episode, heard)
        assert heard.questions.scenario == expected, what


def test_no_static_test_is_known_by_its_lack_of_noise(cars: Path) -> None:
    words = ("--encounters", "cpna", "--speeds", "40:40:10", "--kamikaze-count", 1, "--margin-limit", 0, "--quiet")
    out = cars / "ncap_NoNoise"
    skd(*map(str, ("ncap", "--controller", "cheats:NoNoise", *words, "--out", out)), cwd=cars, PYTHONPATH=str(cars))
    (grid,) = json.loads((out / "ncap.json").read_text())["grids"]
    assert [cell["touched"] for cell in grid["cells"]] == [True] * 5


def test_who_is_another_car_in_crossings_alone_is_named(cars: Path) -> None:
    """It counts its episodes: the crossings of the risk are the last."""
    few = ("--safe-count", 2, "--kamikaze-count", 3, "--simulations", 20, "--margin-limit", 0, "--workers", 1)
    words = ["assess", "--controller", "cheats:Later", "--knowledge", "nothing", *few, "--collision-runs", 12]
    out = cars / "out_Later"
    skd(*map(str, (*words, "--risk-runs", 100, "--quiet", "--out", out)), cwd=cars, PYTHONPATH=str(cars))
    warnings = json.loads((out / "assessment.json").read_text())["warnings"]
    (warning,) = [one for one in warnings if "episodes went otherwise when they were run again" in one]
    assert "a crossing of the risk, episode" in warning


def test_who_is_another_car_while_it_is_learned_is_named_and_its_model_is_not_kept(
    cars: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(cars)
    monkeypatch.setenv("PYTHONPATH", str(cars))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(lesson, "PROBES", 60)
    monkeypatch.setattr(lesson, "ATTEMPTS", 30)
    monkeypatch.setattr(waiting, "TRIALS", 1)
    for name, believed in (("Honest", True), ("Meanwhile", False)):
        car = CarUnderTest(f"cheats:{name}")
        plan = replace(
            Plan(replace(load_scenario("crossing"), control_period=0.05), controller=car.controller, simulations=10),
            knowledge=Knowledge.LEARNED,
        )
        doubts = DoubtsOfLearning(car, functools.partial(InProcessRunner, 1, isolated=True))
        said: list[str] = []
        with InProcessRunner(1, isolated=True) as runner:
            runner.start()
            lesson.learned(plan, runner, say=said.append, believed=doubts.believed)
        assert ("kept in" in said[0]) == believed
        assert (doubts.found == ()) == believed, doubts.found
    assert "of those by which the adversary learned the car, " in doubts.found[0]


def test_forms_that_differ_by_rounding_are_one_car(cars: Path) -> None:
    code, _, result = assessed(cars, "Rounded", "--margin-limit", 64)
    assert (code, result["warnings"]) == (0, [])
    assert result["margin"] is not None
