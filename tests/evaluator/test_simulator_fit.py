"""Calibration of the simulator: against least squares and jackknife done otherwise, and trials of a known car."""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from skd_evaluator.assessment.run.episodes import run_episode
from skd_evaluator.extensions.fusion.calibration import Recorded, calibrated, estimated, off_by, recorded
from skd_evaluator.metrics.surrogate_scenes import Interaction
from skd_sim import EpisodeSpec, Mode, Trajectory, UsageError, load_scenario
from skd_sim.options.car_and_adversary import CarUnderTest

START = {"delay": 0.1, "deceleration": 15.0, "friction": 1.0}
TIMES = np.linspace(0.0, 3.0, 11)


def trials_off(rng: np.random.Generator, count: int, delay: float, most: float) -> tuple[list[np.ndarray], list[float]]:
    """Recorded places of cars that brake from 8 m/s with 4 m/s², or the most that they can, after a delay."""
    delays = delay + 0.02 * rng.standard_normal(count)
    return [braked(one, most) + 0.01 * rng.standard_normal(TIMES.size) for one in delays], delays.tolist()


def braked(delay: float, most: float, asked: float = 4.0) -> np.ndarray:
    passed = np.clip(TIMES - 1.0 - delay, 0.0, 8.0 / min(most, asked))
    stopped = np.clip(TIMES - 1.0 - delay - 8.0 / min(most, asked), 0.0, None)
    return 8.0 * TIMES - 8.0 * stopped - 0.5 * min(most, asked) * passed**2


def off_of(places: list[np.ndarray]):
    def off(values: Mapping[str, float]) -> list[np.ndarray]:
        simulated = braked(values["delay"], min(values["deceleration"], 11.5 * values["friction"]))
        return [one - simulated for one in places]

    return off


def test_a_delay_is_the_mean_of_the_trials_delays_with_the_jackknife_s_error():
    places, delays = trials_off(np.random.default_rng(1), 10, 0.27, 15.0)
    found = estimated(off_of(places), START, ["delay"], list(range(10)))
    (one,) = found.identified
    assert one.value == pytest.approx(np.mean(delays), abs=0.004)
    # Each trial left out, and all of it estimated anew.
    again = [
        estimated(off_of(places[:index] + places[index + 1 :]), START, ["delay"], list(range(9))).identified[0].value
        for index in range(10)
    ]
    error = math.sqrt(0.9 * np.sum((np.array(again) - np.mean(again)) ** 2))
    assert one.error == pytest.approx(error, rel=0.1)
    assert one.interval[1] - one.interval[0] == pytest.approx(2.0 * stats.t.ppf(0.975, 9) * one.error, rel=1e-6)
    assert found.after < 0.1 < found.before


def test_a_limit_that_was_reached_is_told_and_one_that_was_not_is_not():
    places, _ = trials_off(np.random.default_rng(2), 12, 0.2, 2.9)
    found = estimated(off_of(places), START, list(START), list(range(12)))
    by_name = {one.parameter.name: one for one in found.estimates}
    assert by_name["deceleration"].value == pytest.approx(2.9, abs=0.1)
    assert by_name["delay"].interval[0] < 0.2 < by_name["delay"].interval[1]
    assert by_name["friction"].interval is None
    assert by_name["friction"].value == 1.0
    assert by_name["friction"].reason == "the trials do not tell it from the brake's greatest deceleration"
    plain, _ = trials_off(np.random.default_rng(3), 12, 0.2, 15.0)
    told = estimated(off_of(plain), START, list(START), list(range(12))).identified
    assert [one.parameter.name for one in told] == ["delay"]


def test_trials_of_one_phi_are_one_draw():
    places, _ = trials_off(np.random.default_rng(4), 8, 0.2, 15.0)
    once = estimated(off_of(places), START, ["delay"], list(range(8))).identified[0]
    thrice = off_of([one for one in places for _ in range(3)])
    (same,) = estimated(thrice, START, ["delay"], np.repeat(range(8), 3)).identified
    assert same.error == pytest.approx(once.error, rel=1e-6)
    with pytest.raises(ValueError, match="4 φ are too few"):
        estimated(off_of(places[:4]), START, ["delay"], list(range(4)))


def test_a_trial_that_was_played_goes_as_it_did_with_its_own_parameters():
    """The controller is shown the recording, so a drive by the same world is the recording."""
    world = calibrated(load_scenario("crossing_multi_body"), {"delay": 0.3, "friction": 0.28})
    still = {"acceleration_noise": 0.0, "speed_noise": 0.0, "start_gap_range": 0.0, "meet_safe_trajectory": False}
    collision = replace(world.collision, minimum_impact_speed=60.0)
    quiet = replace(world, car=replace(world.car, **still), collision=collision)
    other = np.column_stack([np.linspace(-3.5, 1.0, 11), np.zeros(11)])
    log = run_episode(EpisodeSpec(quiet, Mode.REPLAY, 0, 0, Trajectory(other, world.time_step, "walk")))
    assert (quiet.control_periods, log.car[-1, 3] < 0.9 * log.car[0, 3]) == (1, True)
    trial = Recorded("walk", log.adversary, log.car, "here")
    assert np.abs(off_by(quiet, CarUnderTest("basic", 1.0), trial)).max() < 1e-9
    slower = calibrated(quiet, {"delay": 0.1})
    assert off_by(slower, CarUnderTest("basic", 1.0), trial)[-1] > 0.5  # the recorded car braked later, and is ahead


def test_recordings_that_cannot_calibrate_are_refused():
    world = load_scenario("crossing_multi_body")
    times = np.arange(0.0, 3.0, 0.05)
    still = np.zeros((times.size, 2))

    def scene(speed: float, count: int) -> Interaction:
        car = np.column_stack([still, np.full(times.size, 0.5 * math.pi), np.full(times.size, speed)])
        columns = (one[:count] for one in (times, car, still, still, times))
        return Interaction(*columns, (2.0, 2.0, 0.9), (0.25, 0.0, 0.0))

    assert len(recorded(world, scene(8.3, 60), "walk", "here").car) == 10
    with pytest.raises(UsageError, match=r"begins at 6\.00 m/s, and in the simulation at 8\.33"):
        recorded(world, scene(6.0, 60), "walk", "here")
    with pytest.raises(UsageError, match="too short"):
        recorded(world, scene(8.3, 8), "walk", "here")
