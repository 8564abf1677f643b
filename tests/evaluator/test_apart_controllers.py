"""Controllers run in a process that holds nothing of the test: who looks finds nothing, who meddles changes nothing."""

from __future__ import annotations

import copy
import ctypes
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from common import PATIENCE, wait_until
from looking_cars import CARS
from skd_evaluator.campaign.plan.plan import Plan, safe_trajectories
from skd_evaluator.campaign.run.runner import run_episode
from skd_evaluator.campaign.run.workers import InProcessRunner
from skd_evaluator.errors import AssessmentError
from skd_evaluator.margin.search.search import search_margin
from skd_sim.apart.apart import apart, close_all, made_in, pids
from skd_sim.apart.car_process import ApartCar, Call
from skd_sim.apart.guard import guard
from skd_sim.choices.car_under_test import CarUnderTest
from skd_sim.controllers import make_controller
from skd_sim.encounter.scenario import load_scenario
from skd_sim.episode.episode import Episode, Mode
from skd_sim.episode.randomness import controller_generator, controller_seed
from skd_sim.errors import UsageError
from skd_sim.state import AdversaryState, CarState

LOOKING = (
    "Stack", "Objects", "Modules", "SeedSequence", "Arguments", "Environment", "Files",
)  # fmt: skip
SECLUDED = ("Ancestors", "Memory", "Everybody", "Tracer", "OtherMemory", "Children", "Kills")
MEDDLING = ("WritesTheRoad", "WritesTheScenario", "Patches", "Threads", "AtTheEnd")
CROSSING = load_scenario("crossing")


@pytest.fixture(autouse=True)
def cars(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    (tmp_path / "apart_cars.py").write_text(CARS)
    monkeypatch.syspath_prepend(tmp_path)
    sys.modules.pop("apart_cars", None)
    yield tmp_path
    close_all()
    sys.modules.pop("apart_cars", None)


def car_of(name: str) -> CarUnderTest:
    return CarUnderTest(f"apart_cars:{name}")


@cache
def episodes(name: str, period: float | None = None) -> tuple[Episode, ...]:
    """Two kamikazes and two runs along φ."""
    plan = Plan(CROSSING, controller=f"apart_cars:{name}", safe_count=1, simulations=20)
    safe = safe_trajectories(plan, InProcessRunner(1))[0]
    plan = replace(plan, scenario=replace(CROSSING, control_period=period))
    return tuple(plan.episode(mode, 0, number, safe) for mode in (Mode.KAMIKAZE, Mode.REPLAY) for number in (0, 1))


def driven(name: str, make: Callable[[], Any], period: float | None = None) -> list[np.ndarray]:
    """What becomes of the car in all episodes, and in the search for the margin of one."""
    all_of_them = episodes(name, period)
    found = [run_episode(one, make()).car for one in all_of_them]
    searched = search_margin(all_of_them[0], 24, (), make)
    return [*found, searched.trace, searched.samples]


def same(one: list[np.ndarray], other: list[np.ndarray]) -> bool:
    return all(np.array_equal(first, second) for first, second in zip(one, other, strict=True))


def here(name: str) -> list[np.ndarray]:
    """The same of a car of this process."""
    return driven(name, lambda: guard(make_controller(f"apart_cars:{name}"), name), _PERIODS.get(name))


_PERIODS = {"Twenty": 0.05}


@pytest.mark.parametrize("name", ["Honest", "Sensing", "Twenty", "Drawing", "Unpicklable"])
def test_apart_every_bit_is_as_in_this_process(name: str) -> None:
    assert same(driven(name, lambda: apart(car_of(name)), _PERIODS.get(name)), here(name))


@pytest.mark.parametrize("name", [*LOOKING, *MEDDLING])
def test_who_looks_for_the_test_finds_nothing_and_who_meddles_changes_nothing(name: str) -> None:
    assert same(driven(name, lambda: apart(car_of(name))), here("Honest"))


def test_those_that_look_would_find_something_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """So that they are cheats: in a process of which the arguments tell what it does their answers are others."""
    monkeypatch.setattr(sys, "argv", ["skd", "assess", "--controller", "apart_cars:Arguments"])
    honest = here("Honest")
    assert [name for name in ("Stack", "Objects", "Modules", "Arguments") if same(here(name), honest)] == []


def landlock() -> int:
    """Which version of Landlock there is, by its system call; 0 where there is none."""
    return max(0, ctypes.CDLL(None).syscall(444, None, 0, 1)) if sys.platform.startswith("linux") else 0


@pytest.mark.skipif(landlock() < 6, reason="takes Landlock as of Linux 6.12")  # or one of them ends this process
@pytest.mark.parametrize("name", SECLUDED)
def test_who_looks_into_other_processes_sees_none(name: str) -> None:
    assert same(driven(name, lambda: apart(car_of(name))), here("Honest"))


@pytest.mark.parametrize("name", ["Yes", "NumpyYes", "Nan", "Array"])
def test_only_a_finite_number_is_an_answer(name: str) -> None:
    with pytest.raises(AssessmentError, match=f"apart_cars:{name}: command must return a finite number"):
        run_episode(episodes(name)[0], apart(car_of(name)))


def test_an_answer_of_a_kind_of_its_own_is_a_plain_number() -> None:
    controller = apart(car_of("Numbers"))
    episode = episodes("Numbers")[2]
    controller.reset(episode.scenario, controller_generator(bytes(32)))
    assert type(controller.command(CarState(0.0, -20.0, 1.5, 8.0), AdversaryState(0.0, 0.0, 0.0, 0.0))) is float


def test_who_answers_on_another_way_is_named() -> None:
    with pytest.raises((AssessmentError, UsageError)):
        run_episode(episodes("Writes")[0], apart(car_of("Writes")))


@pytest.mark.parametrize("name", ["SaysText", "SaysNan", "SaysInfinity", "SaysNumbers"])
def test_what_a_process_says_behind_its_guard_is_no_acceleration(name: str) -> None:
    with pytest.raises(AssessmentError, match=f"apart_cars:{name}: its process answered with something else"):
        run_episode(episodes(name)[0], apart(car_of(name)))


def test_a_process_that_does_not_say_what_its_controller_is() -> None:
    """It says a number where the next controller is made."""
    controller = apart(car_of("SaysNumber"))
    controller.reset(CROSSING, controller_generator(bytes(32)))
    with pytest.raises(AssessmentError, match="apart_cars:SaysNumber: its process does not say what it is"):
        apart(car_of("SaysNumber"))


def test_copies_go_on_by_themselves_and_are_forgotten() -> None:
    controller = apart(car_of("Drawing"))
    controller.reset(CROSSING, controller_generator(bytes(32)))
    states = CarState(0.0, -20.0, 1.5, 8.0), AdversaryState(0.0, 0.0, 0.0, 0.0)
    again = copy.deepcopy(controller)
    answers = [controller.command(*states) for _ in range(3)]
    assert [again.command(*states) for _ in range(3)] == answers
    assert len(set(answers)) == 3
    third = copy.deepcopy(again)
    third.seed_anew(np.random.default_rng(0))
    assert third.command(*states) != again.command(*states)


def test_a_generator_says_nothing_of_seed_and_episode() -> None:
    """Its seed is no number that was given, but the same at each run."""
    first = controller_generator(controller_seed(7, 2**48))
    assert first.random() == controller_generator(controller_seed(7, 2**48)).random()
    assert first.bit_generator.seed_seq.spawn_key == ()
    assert first.bit_generator.seed_seq.entropy > 2**200
    assert len({controller_seed(seed, number) for seed in range(3) for number in range(3)}) == 9


def test_a_car_ends_with_its_pipe(tmp_path: Path) -> None:
    car = ApartCar(car_of("Honest"))
    made_in(car)
    assert Path(f"/proc/{car.pid}").exists()
    car.close()
    assert not Path(f"/proc/{car.pid}").exists()


def test_a_class_of_a_program_is_found_without_beginning_the_program(tmp_path: Path) -> None:
    program = tmp_path / "program.py"
    program.write_text(
        "from skd_sim.apart.apart import apart, close_all\nfrom skd_sim.choices.car_under_test import CarUnderTest\n"
        "BRAKES = -2.5\nclass Car:\n    control_period = 0.1\n    def reset(self, scenario, rng): pass\n"
        "    def command(self, car, adversary): return BRAKES\n"
        "if __name__ == '__main__':\n    car = apart(CarUnderTest('__main__:Car'))\n"
        "    print(car.control_period, car.command((0.0,) * 4, (0.0,) * 5))\n    close_all()\n"
    )
    done = subprocess.run([sys.executable, program], capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == ("0.1 -2.5\n", "")


def test_numba_is_imported_for_those_that_need_it(cars: Path) -> None:
    (cars / "lean.py").write_text(
        "import sys\nfrom skd_sim.controllers import BasicController\nclass Own:\n"
        "    def reset(self, scenario, rng): pass\n"
        "    def command(self, car, adversary): return float('numba' in sys.modules)\n"
        "class Derived(BasicController):\n    def __init__(self): super().__init__(1.0)\n"
    )
    states = CarState(0.0, 0.0, 1.5707963267948966, 8.0), AdversaryState(1.0, 6.0, 0.0, 1.0)
    answers = []
    for controller in (*(apart(CarUnderTest(f"lean:{name}")) for name in ("Own", "Derived")), make_controller("basic")):
        controller.reset(CROSSING, controller_generator(bytes(32)))
        answers.append(controller.command(*states))
    own, derived, basic = answers
    assert own == 0.0
    assert derived == basic < 0.0


def test_who_ends_its_process_is_named(cars: Path) -> None:
    (cars / "ends.py").write_text(
        "import os\nclass Car:\n    def reset(self, scenario, rng): os._exit(9)\n"
        "    def command(self, car, adversary): pass\n"
    )
    with pytest.raises(AssessmentError, match="ends:Car: its process ended with exit code 9"):
        apart(CarUnderTest("ends:Car")).reset(CROSSING, controller_generator(bytes(32)))


def test_who_fails_between_two_questions_is_named_in_a_line(cars: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (cars / "rings.py").write_text(
        "import signal\nclass Car:\n    def reset(self, scenario, rng):\n"
        "        signal.signal(signal.SIGALRM, lambda *_: 1 / 0)\n        signal.setitimer(signal.ITIMER_REAL, 0.02)\n"
        "    def command(self, car, adversary): return 0.0\n"
    )
    controller = apart(CarUnderTest("rings:Car"))
    controller.reset(CROSSING, controller_generator(bytes(32)))
    controller._car._process.wait(PATIENCE)
    with pytest.raises(AssessmentError, match="rings:Car: its process ended with exit code 1"):
        controller.command(CarState(0.0, 0.0, 0.0, 0.0), AdversaryState(0.0, 0.0, 0.0, 0.0))
    said = "rings:Car | its own code failed between two questions with ZeroDivisionError: division by zero"
    assert capfd.readouterr().err.splitlines() == [said]


def test_whose_attributes_fail_is_named(cars: Path) -> None:
    (cars / "shy.py").write_text(
        "class Car:\n    @property\n    def takes_scene(self): raise RuntimeError('no laser')\n"
        "    def reset(self, scenario, rng): pass\n    def command(self, car, adversary): return 0.0\n"
    )
    with pytest.raises(
        UsageError, match=r"controller shy:Car: cannot be asked which methods .* RuntimeError: no laser"
    ):
        apart(CarUnderTest("shy:Car"))


def test_a_call_that_takes_long_is_seen(cars: Path) -> None:
    (cars / "sleeps.py").write_text(
        "import time\nclass Car:\n    def reset(self, scenario, rng): time.sleep(0.5)\n"
        "    def command(self, car, adversary): pass\n"
    )
    controller = apart(CarUnderTest("sleeps:Car"))
    begin = time.monotonic()
    asking = threading.Thread(target=controller.reset, args=(CROSSING, controller_generator(bytes(32))))
    asking.start()
    wait_until(lambda: Call.since is not None, "the call")
    assert Call.since >= begin
    asking.join()
    assert Call.since is None
    assert os.getpid() not in pids()


def test_nothing_of_a_controllers_folder_runs_before_its_process_is_secluded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A sitecustomize.py on PYTHONPATH is what every Python begins with; what it opens then stays open."""
    (tmp_path / "sitecustomize.py").write_text(f"open({str(tmp_path / 'ran')!r}, 'w').close()\n")
    (tmp_path / "given.py").write_text(
        "import os, subprocess, sys\nclass Car:\n    def reset(self, scenario, rng): pass\n"
        "    def command(self, car, adversary):\n"
        f"        return float(os.environ['PYTHONPATH'] == {str(tmp_path)!r} and 'SKD_PYTHONPATH' not in os.environ)\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.syspath_prepend(tmp_path)
    controller = apart(CarUnderTest("given:Car"))
    controller.reset(CROSSING, controller_generator(bytes(32)))
    assert controller.command(CarState(0.0, 0.0, 1.5, 8.0), AdversaryState(1.0, 6.0, 0.0, 1.0)) == 1.0
    assert not (tmp_path / "ran").exists()
