"""Cars that decide more often than the adversary: the closed loop by all its pacings, its recordings."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from common import refused
from search_support import CROSSING, kamikaze_episode
from skd_evaluator.assessment.plan import Plan, probe_episodes
from skd_evaluator.assessment.run.episodes import run_episode
from skd_evaluator.assessment.run.workers import check_controller
from skd_sim import AdversaryState, CarState, EpisodeSpec, Frame, Mode, Outcome, Scenario, UsageError, WorldSimulator
from skd_sim.controllers.controller import user_controller
from skd_sim.options.car_and_adversary import CarUnderTest, Objective

POINTS = [(-3.5 + 0.75 * k, 0.1 * k) for k in range(8)]
OFTEN = replace(CROSSING, control_period=0.1)


def episode_of(name: str, number: int = 0, mode: Mode = Mode.KAMIKAZE) -> EpisodeSpec:
    """An episode against the basic car that decides every 0.1 s, or against CAL."""
    base = kamikaze_episode(POINTS, 60, 1.0, number=number, simulations=60)
    plan = Plan(OFTEN if name == "basic" else CROSSING, controller=name)
    car = {"controller": name, "adversary_model": plan.resolved_adversary_model}
    return replace(base, scenario=plan.scenario, mode=mode, objective=Objective.DEVIATION, **car)


class Watching:
    """Counts what it is asked, and sees."""

    def __init__(self) -> None:
        self.asked: list[tuple[CarState, AdversaryState]] = []

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        pass

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        self.asked.append((car, adversary))
        return 0.05 * len(self.asked) - 1.0


def test_the_car_decides_on_true_states_every_control_period_and_the_adversary_every_tick() -> None:
    class Counting(WorldSimulator):
        frames: list[Frame] = []  # noqa: RUF012
        told: list[tuple[float, tuple[float, float]]] = []  # noqa: RUF012

        def step(self, acceleration: float, velocity: tuple[float, float]) -> Frame:
            self.told.append((acceleration, velocity))
            self.frames.append(super().step(acceleration, velocity))
            return self.frames[-1]

    controller, simulator = Watching(), Counting()
    log = run_episode(episode_of("basic", mode=Mode.REPLAY), controller, simulator=simulator)
    periods = len(simulator.told)
    assert len(controller.asked) == periods
    assert 3 * (len(log.adversary) - 2) < periods <= 3 * (len(log.adversary) - 1)  # a contact ends a tick
    assert controller.asked[1:] == [(frame.car, frame.adversary) for frame in simulator.frames[:-1]]
    velocities = [velocity for _, velocity in simulator.told]
    assert velocities == [velocities[3 * (index // 3)] for index in range(periods)]
    assert len({command for command, _ in simulator.told}) == periods


class TenTimesASecond(Watching):
    control_period = 0.1


class Never(Watching):
    control_period = 0.0


class Wordy(Watching):
    control_period = "often"


class Odd(Watching):
    control_period = 0.07


HERE = Path(__file__).stem


def test_what_it_declares_goes_into_the_scenario() -> None:
    assert check_controller(CarUnderTest(f"{HERE}:TenTimesASecond"), CROSSING) == replace(CROSSING, control_period=0.1)
    assert check_controller(CarUnderTest(f"{HERE}:Watching"), OFTEN) == OFTEN
    assert check_controller(CarUnderTest("cal"), OFTEN).control_period == 0.05
    assert check_controller(CarUnderTest(), OFTEN) == OFTEN
    assert Plan(CROSSING, controller="cal").scenario == replace(CROSSING, control_period=0.05)
    assert Plan(CROSSING).scenario == CROSSING
    assert probe_episodes(CROSSING, 1, seed=0, controller="cal")[0].scenario.control_periods == 6


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("Wordy", "control_period must be a number from 0.001 to 2 (s), got 'often'"),
        ("Never", "control_period must be a number from 0.001 to 2 (s), got 0"),
        ("Odd", "in scenario crossing: control_period 0.07 s must divide time_step 0.3 s; 0.075 s does"),
    ],
)
def test_what_is_no_control_period_is_refused(name: str, said: str) -> None:
    with refused(said, f"controller {HERE}:{name}"):
        check_controller(CarUnderTest(f"{HERE}:{name}"), CROSSING)


def test_it_is_not_run_at_other_times_than_it_declares() -> None:
    controller = TenTimesASecond()
    for one in (controller, user_controller(controller, "mine:Own")):
        with pytest.raises(UsageError, match=r"every 0\.1 s, but in scenario crossing a car does so every 0\.3 s"):
            run_episode(replace(episode_of("basic", mode=Mode.REPLAY), scenario=CROSSING), one)
        assert run_episode(episode_of("basic", mode=Mode.REPLAY), one).outcome != Outcome.ABORTED
