"""The adversary that knows the car itself, in closed loop: how near it comes, its limits, what it refuses."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from common import run_skd
from itself_support import (
    BENT,
    CROSSING,
    FAST,
    STRAIGHT,
    Brakes,
    Enclosed,
    Forgetful,
    Global,
    Latched,
    Locked,
    Moody,
    an_episode,
    headings,
    is_hit,
)
from skd_adversary.adversary import make_adversary
from skd_evaluator.campaign.run.runner import run_episode
from skd_evaluator.campaign.run.workers import InProcessRunner
from skd_evaluator.margin.exact.exact import exact_margin
from skd_evaluator.measure.distances.deformation import deformation
from skd_sim.choices.objective import Objective
from skd_sim.controllers import CalController
from skd_sim.encounter.scenario import load_scenario
from skd_sim.episode.episode import Outcome
from skd_sim.errors import UsageError


def _strayed(log) -> float:
    eta_max = log.episode.scenario.eta_max
    if not is_hit(log):
        return eta_max
    phi = log.episode.safe_trajectory.positions
    return min(eta_max, deformation(phi, log.trajectory.positions, log.impact_time / log.episode.scenario.time_step))


@pytest.mark.parametrize("multiplier", [0.75, 1.0])
def test_told_of_a_car_without_noise_it_comes_near_the_least_that_is_possible(multiplier):
    quiet = replace(CROSSING, car=replace(CROSSING.car, speed_noise=0.0, acceleration_noise=0.0))
    reached, least = [], []
    for number in range(6):
        episode = an_episode(STRAIGHT, number, quiet, multiplier=multiplier, controller_calls=40_000)
        floor = exact_margin(episode, half_speed=False)
        assert floor is not None
        reached.append(_strayed(run_episode(episode)))
        least.append(floor.distance)
        assert reached[-1] >= least[-1] - 1e-9
    assert np.mean(reached) <= 1.05 * np.mean(least) + 0.01


def test_by_the_sensor_it_hits_and_comes_not_much_less_near():
    logs = [run_episode(an_episode(number=number, told=False)) for number in range(8)]
    told = [run_episode(an_episode(number=number)) for number in range(8)]
    assert sum(map(is_hit, logs)) == 8
    assert np.mean([_strayed(log) for log in logs]) <= 1.6 * np.mean([_strayed(log) for log in told])
    assert [log.depletions for log in logs] == [0] * 8


def test_the_same_whoever_runs_it():
    episodes = [an_episode(number=number, told=bool(number % 2)) for number in range(4)]
    alone = [run_episode(episode) for episode in episodes]
    with InProcessRunner(2) as runner:
        together = list(runner.run(episodes[::-1]))[::-1]
    for one, other in zip(alone, together, strict=True):
        assert one.adversary.tobytes() == other.adversary.tobytes()
        assert one.car.tobytes() == other.car.tobytes()


def test_the_car_under_test_drives_as_if_nobody_had_looked():
    episode = an_episode(scenario=FAST, controller_calls=3000)
    watched = run_episode(episode, Moody())
    way = watched.adversary

    class Repeat:
        depletions = 0
        tick = 0

        def act(self, car):
            step = (way[self.tick + 1] - way[self.tick]) / FAST.time_step
            self.tick += 1
            return tuple(step.tolist())

    alone = run_episode(episode, Moody(), Repeat())
    np.testing.assert_allclose(alone.car, watched.car, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (Locked, "cannot be copied"),
        (Latched, "what one copy does changes what another does"),
        (Enclosed, "a copy answers otherwise than the original|what one copy does changes what another does"),
        (Forgetful, "a copy answers otherwise than the original"),
        (Global, "draws from a global random generator"),
    ],
)
def test_a_car_that_copies_do_not_stand_for_is_found(make, said):
    def some() -> None:
        for number in range(3):
            run_episode(an_episode(STRAIGHT, number, FAST, controller_calls=2000), make())

    with pytest.raises(UsageError, match=said) as raised:
        some()
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("objective", [Objective.PAPER, Objective.FRECHET])
def test_other_objectives_are_planned_for_too(objective):
    logs = [run_episode(an_episode(number=number, objective=objective)) for number in range(3)]
    assert all(log.outcome == Outcome.COLLISION for log in logs)


def test_a_cyclist_rides_as_a_cyclist_can():
    scenario = load_scenario("cyclist")
    phi = [(-10.0 + 1.5 * tick, 0.0) for tick in range(10)]
    hits = 0
    for number in range(4):
        log = run_episode(an_episode(phi, number, scenario))
        hits += is_hit(log)
        speeds, directions = headings(log)
        speeds, directions = [5.0, *speeds], [0.0, *directions]
        for tick in range(len(speeds) - 1):
            change = speeds[tick + 1] - speeds[tick]
            assert -3.0 * 0.3 - 1e-6 <= change <= 1.0 * 0.3 + 1e-6
            assert speeds[tick + 1] <= scenario.adversary.speed + 1e-9
            if speeds[tick + 1] > 1e-6 and speeds[tick] > 1e-6:
                turn = abs(math.remainder(directions[tick + 1] - directions[tick], math.tau))
                assert turn * speeds[tick + 1] <= 3.0 * 0.3 + 1e-6
    assert hits >= 3


def test_on_a_curve_and_with_phi_of_its_own_pace():
    curve = load_scenario("right_turn")
    assert sum(is_hit(run_episode(an_episode(STRAIGHT, number, curve))) for number in range(3)) >= 2
    recorded = load_scenario("citr_crossing")
    pace = [(-4.0 + 0.4 * tick, 0.02 * tick * tick) for tick in range(24)]
    logs = [run_episode(an_episode(pace, number, recorded)) for number in range(3)]
    assert sum(map(is_hit, logs)) >= 2


def test_a_car_that_takes_scans():
    scenario = replace(CROSSING, control_period=0.05, horizon=1.5)
    episode = an_episode(scenario=scenario, controller="cal", controller_calls=500)
    one, other = run_episode(episode, CalController()), run_episode(episode, CalController())
    assert one.outcome in (Outcome.COLLISION, Outcome.TIMEOUT)
    assert one.adversary.tobytes() == other.adversary.tobytes()


def test_multi_body_dynamics_are_copied_as_they_are():
    scenario = replace(load_scenario("crossing_multi_body"), control_period=0.1)
    logs = [run_episode(an_episode(BENT, number, scenario, controller_calls=1500), Brakes()) for number in range(2)]
    assert all(map(is_hit, logs))


def test_more_calls_are_not_made_than_asked_for(monkeypatch):
    from skd_adversary.itself import adversary

    seen = []
    act = adversary.ItselfAdversary.act
    monkeypatch.setattr(
        adversary.ItselfAdversary, "act", lambda self, car: (act(self, car), seen.append(self.calls))[0]
    )
    run_episode(an_episode(scenario=FAST, controller_calls=3000), Brakes())
    room = 40 * FAST.control_periods * 20  # what every decision begins with is tried in any case
    assert seen[-1] <= 3000 + room * len(seen)
    few = seen[-1]
    run_episode(an_episode(scenario=FAST, controller_calls=60_000), Brakes())
    assert seen[-1] > 2 * few


def test_it_needs_a_car_in_this_process_and_skds_own_world(capsys):
    with pytest.raises(UsageError, match="needs a car that runs in process"):
        make_adversary(an_episode())
    for arguments, said in (
        (("--knowledge", "itself", "--graph"), "needs a car that runs in process"),
        (("--told",), "--told goes with --knowledge itself"),
        (("--controller-calls", "500"), "--controller-calls goes with --knowledge itself"),
    ):
        assert run_skd("assess", "--safe-count", "1", "--kamikaze-count", "1", *arguments) == 2
        assert said in capsys.readouterr().err
