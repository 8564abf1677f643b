"""`skd ncap` of cars that are careful in some of what they do: by a count, or where nothing wobbles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from cli_support import skd
from skd_evaluator.campaign.run.static_test import static_episodes
from skd_evaluator.ncap.doubts import SHARES, Seen, doubts_of, has_noise, shaken
from skd_evaluator.ncap.result import read_ncap
from skd_sim.choices.car_under_test import CarUnderTest
from skd_sim.encounter.scenario import load_scenario
from skd_sim.episode.episode import EpisodeLog, Outcome

CARS = """
class Late:
    brakes, most = 6.0, 6.0
    def reset(self, scenario, rng):
        self.front = scenario.car.front
        self.careful = False
    def command(self, car, adversary):
        gap = adversary.y - car.y - self.front
        if self.careful:
            return -9.0 if -1.0 <= gap <= car.speed**2 / 8.0 + 3.0 and abs(adversary.x - car.x) < 4.0 else 0.0
        near = 0.0 <= gap <= car.speed**2 / (2.0 * self.brakes) + 1.0 and abs(adversary.x - car.x) < 2.0
        return -self.most if near else 0.0
class Later(Late):
    begun = 0
    def reset(self, scenario, rng):
        super().reset(scenario, rng)
        Later.begun += 1
        self.careful = Later.begun > 60
class Still(Late):
    def reset(self, scenario, rng):
        super().reset(scenario, rng)
        self.careful, self.speed = True, None
    def command(self, car, adversary):
        self.careful &= self.speed is None or abs(car.speed - self.speed) < 1e-9
        command = super().command(car, adversary)
        self.speed = car.speed if command == 0.0 else None
        return command
class Harder(Late):
    most = 1e300
"""


@pytest.fixture
def cars(here):
    (here / "doubtful_cars.py").write_text(CARS)
    return here


def judged(cars, car: str, *words: str):
    done = skd("ncap", "--controller", f"doubtful_cars:{car}", *words, "--out", car, cwd=cars)
    return done, read_ncap(cars / car).warnings


NO_MARGINS = ("--encounters", "cpna-50,cpfa-50", "--margin-limit", "0")


def test_a_car_that_counts_is_not_believed(cars):
    """Its margins had been 5 m in place of 0, without a word."""
    words = ("--encounters", "cpna", "--speeds", "20:40:10", "--kamikaze-count", "3", "--margin-limit", "128")
    done, warnings = judged(cars, "Later", *words, "--workers", "1", "--seed", "5")
    assert done.returncode == 1
    assert any(line.startswith("do not believe these figures: on ") for line in warnings)
    assert done.stdout.startswith("Not to be believed")
    checked = skd("verify", "Later", cwd=cars)
    assert warnings[0] in checked.stdout


def test_a_car_that_knows_tests_by_their_stillness_is_in_doubt(cars):
    done, (tiny, *_) = judged(cars, "Still", *NO_MARGINS)
    assert tiny.startswith("these figures are in doubt: in ")
    assert "if it moves with a millionth of its noise" in tiny
    assert done.stdout.startswith("In doubt")


def test_an_honest_car_is_believed_and_what_is_clipped_is_said(cars):
    done, warnings = judged(cars, "Late", *NO_MARGINS)
    assert (done.returncode, warnings, done.stderr) == (0, (), "")
    done, (clipped,) = judged(cars, "Harder", *NO_MARGINS)
    assert "asked more than this car can do; they were clipped to -11.5 … 11.5 m/s²" in clipped
    assert done.returncode == 0


SCENARIO = load_scenario("cpna-50")
(TEST,) = static_episodes(SCENARIO, CarUnderTest("a.b:C"))


@pytest.mark.parametrize("share", SHARES)
def test_a_shaken_test_has_a_share_of_the_noise_and_is_the_same_otherwise(share):
    found = shaken(TEST, share)
    assert found.scenario.car.speed_noise == pytest.approx(share * SCENARIO.car.speed_noise)
    assert found.scenario.car.acceleration_noise == pytest.approx(share * SCENARIO.car.acceleration_noise)
    still = replace(found.scenario.car, speed_noise=0.0, acceleration_noise=0.0)
    assert replace(found.scenario, car=still).as_dict() == TEST.scenario.as_dict()
    assert (found.mode, found.seed, found.episode_id) == (TEST.mode, TEST.seed, TEST.episode_id)
    assert found.safe_trajectory is TEST.safe_trajectory
    assert found.shown is TEST.shown
    assert has_noise(TEST)
    assert not has_noise(replace(TEST, shown=TEST.scenario))


def log(kmh: float | None) -> EpisodeLog:
    """A test with a hit at a speed, or without one."""
    outcome = Outcome.MISSED if kmh is None else Outcome.COLLISION
    return EpisodeLog(TEST, outcome, np.zeros((2, 2)), np.zeros((2, 4)), 0.1, 0.0 if kmh is None else kmh / 3.6)


@pytest.mark.parametrize(
    ("share", "worse", "better", "said"),
    [
        (1e-6, 3, 0, 1),
        (1e-6, 2, 0, 0),
        (1e-6, 4, 1, 1),
        (1e-6, 6, 4, 0),
        (0.3, 8, 0, 0),
        (0.3, 10, 0, 1),
        (0.3, 26, 15, 0),
    ],
)
def test_it_takes_more_that_go_worse_than_chance_brings(share, worse, better, said):
    """By chance 10 of 10 go worse once in 1,024 times, 8 of 8 four times as often."""
    pairs = [(log(None), log(20.0))] * worse + [(log(30.0), log(24.0))] * better + [(log(30.0), log(34.0))] * 9
    aborted = replace(log(None), outcome=Outcome.ABORTED)
    seen = Seen(shaken={share: [*pairs, (aborted, log(30.0)), (log(None), aborted)]})
    lines = list(doubts_of(CarUnderTest("a.b:C"), seen))
    assert len(lines) == said
    for line in lines:
        assert f"in {worse} of {len(pairs)} static tests a.b:C hits more than 5 km/h faster, and in {better}" in line


def test_it_takes_a_tenth_of_the_tests():
    pairs = [(log(None), log(20.0))] * 3
    for others, said in ((27, 1), (28, 0)):
        seen = Seen(shaken={1e-6: pairs + [(log(None), log(None))] * others})
        assert len(list(doubts_of(CarUnderTest("a.b:C"), seen))) == said
