"""The crossing with a fitted car: with the basic car's numbers it is the basic car's crossing."""

import dataclasses
import json
import math

import numpy as np
import pytest
from recorded_cars import a_car
from skd_adversary.car_models import car_model_file as files
from skd_adversary.crossing.cars import DECELERATION, DELAY, LearnedCar, known_basic_car
from skd_adversary.crossing.interfaces import CAR_S, CAR_SPEED, STATE_DIM, TRIGGER
from skd_adversary.crossing.model import compose
from skd_adversary.crossing.objectives import PAPER
from skd_adversary.crossing.road_users import ACTION_COUNT, STAY
from skd_adversary.pomdp.belief import ParticleBelief
from skd_sim import UsageError, load_scenario

SCENARIO = load_scenario("crossing")
PATH = np.array([(-3.5, 0.0), (2.0, 0.0)])
UNCERTAIN = {
    "trigger": files.ParameterPrior("uniform", 8.0, 10.0),
    "deceleration": files.ParameterPrior("normal", 4.0, 0.5),
}


def models(car: files.FittedCar):
    known = known_basic_car(9.0 / SCENARIO.car.safe_distance)
    how = {"start": (-3.5, 0.0), "gap": 13.0, "path": PATH}
    return [compose(SCENARIO, PAPER, one, **how) for one in (known, LearnedCar(car, known))]


def test_with_the_basic_cars_numbers_it_is_the_basic_car():
    basic, fitted = models(a_car())
    rng = np.random.default_rng(3)
    for seed in range(300):
        state = np.zeros(fitted.state_dim)
        state[:STATE_DIM] = (*rng.uniform([-2, -1, -15, 0], [2, 1, 0, 9]), 9.0)
        known = np.zeros(fitted.state_dim)
        fitted.initial(fitted.parameters, known, np.random.default_rng(0))
        state[STATE_DIM:] = known[STATE_DIM:]
        action = int(rng.integers(ACTION_COUNT))
        one, other = np.zeros(basic.state_dim), np.zeros(fitted.state_dim)
        before = state[: basic.state_dim].copy()
        expected = basic.step(basic.parameters, before, action, one, np.random.default_rng(seed))
        assert fitted.step(fitted.parameters, state, action, other, np.random.default_rng(seed)) == expected
        np.testing.assert_array_equal(other[: basic.state_dim], one)


def test_delayed_car_brakes_later():
    late, quiet = (files.ParameterPrior("point", value) for value in (0.6, 0.0))
    _, fitted = models(a_car(reaction_delay=late, speed_noise=quiet))
    rng = np.random.default_rng(0)
    state, after = np.zeros(fitted.state_dim), np.zeros(fitted.state_dim)
    fitted.initial(fitted.parameters, state, rng)
    assert state[DELAY] == 2.0
    state[CAR_S] = -SCENARIO.car.front - 8.5  # within the trigger from now on
    speeds = []
    for _ in range(4):
        fitted.step(fitted.parameters, state, STAY, after, rng)
        state, after = after, state
        speeds.append(float(state[CAR_SPEED]))
    assert np.diff([25 / 3, *speeds]) == pytest.approx([0.0, 0.0, -1.05, -1.05])


def test_what_is_uncertain_is_drawn_from_its_prior():
    _, fitted = models(a_car(**UNCERTAIN))
    belief = ParticleBelief(fitted, 4000, np.random.default_rng(5))
    triggers, decelerations = belief.particles[:, TRIGGER], belief.particles[:, DECELERATION]
    assert 8.0 <= triggers.min() < 8.05
    assert 9.95 < triggers.max() <= 10.0
    assert triggers.mean() == pytest.approx(9.0, abs=4 * (2 / math.sqrt(12)) / math.sqrt(4000))
    assert decelerations.mean() == pytest.approx(4.0, abs=4 * 0.5 / math.sqrt(4000))
    assert decelerations.std() == pytest.approx(0.5, rel=0.1)


def test_round_trip(tmp_path):
    car = a_car(**UNCERTAIN)
    unknown = files.ParameterPrior("uniform", 0.0, 1.0)
    car.parameters["cruise_gain"] = files.CarParameter(unknown, reason="not identifiable")
    car = dataclasses.replace(car, front=2.25, rear=2.0)
    files.write_car_model(tmp_path / "car_model.yaml", car)
    assert files.read_car_model(tmp_path) == files.read_car_model(tmp_path / "car_model.yaml") == car
    assert files.fitted_car(files.car_model_text(car)) == car


def _point(value: float) -> dict[str, object]:
    """Return what a file says of a parameter that is known."""
    prior = {"distribution": "point", "first": value}
    return {"estimate": value, "standard_error": 0.0, "interval": [value, value], "prior": prior}


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        (("measure",), "smell", "measure must be one of distance, time, got 'smell'"),
        (("parameters", "trigger", "prior", "first"), math.nan, "parameters.trigger.prior.first must be a number ≥ 0"),
        (("parameters", "trigger", "standard_error"), -0.5, "trigger.standard_error must be a number ≥ 0, got -0.5"),
        (("parameters", "deceleration"), _point(3500.0), "prior.first must be from 0 to 30 .m/s²., got 3500"),
        (("parameters", "reaction_delay"), _point(1.2), "reaction_delay.estimate must be at most 3 ticks of 0.3 s"),
    ],
)
def test_bad_model(tmp_path, key, value, message):
    data = json.loads(files.car_model_text(a_car()))
    part = data
    for name in key[:-1]:
        part = part[name]
    part[key[-1]] = value
    with pytest.raises(UsageError, match=f"^here: .*{message}"):
        files.car_model_from(data, "here")


def test_a_model_of_another_tick_or_another_car_is_refused():
    crossing, cart = load_scenario("crossing"), load_scenario("citr_crossing")
    size = {"front": crossing.car.front, "rear": crossing.car.rear}
    car = dataclasses.replace(a_car(), time_step=crossing.time_step, **size)
    files.check_scenario(car, crossing, "here")
    files.check_scenario(dataclasses.replace(car, front=None, rear=None), cart, "here")  # written without a footprint
    with pytest.raises(UsageError, match=r"^here: front is .* scenario citr_crossing"):
        files.check_scenario(car, cart, "here")
    with pytest.raises(UsageError, match=r"^here: time_step is 0\.1 s, that of scenario crossing 0\.3 s"):
        files.check_scenario(dataclasses.replace(car, time_step=0.1), crossing, "here")
