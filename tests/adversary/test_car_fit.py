"""Cars whose parameters are known are learned from their logs."""

import math

import numpy as np
import pytest
from recorded_cars import KAPPA, SCENARIO, LateCar, LimitedCar, MoodyCar, TimeToCollisionCar, logs_of
from scipy import stats
from skd_adversary.car_models.car_model_file import OPTIONAL, PARAMETERS, FittedCar
from skd_adversary.car_models.fit import fit_with_law
from skd_adversary.car_models.identifiability import half_width_estimate
from skd_adversary.car_models.laws import Family, Law, integral_transform, kolmogorov_smirnov
from skd_adversary.car_models.observations import RecordedEpisode, observe
from skd_adversary.car_models.speed_change import SpeedChange, trapezoid_density, trapezoid_distribution
from skd_sim.controllers.basic import BasicController
from skd_sim.errors import UsageError


def estimate(car: FittedCar, name: str) -> float:
    value = car.parameters[name].estimate
    assert value is not None, car.parameters[name].reason
    return value


@pytest.mark.parametrize(("a", "b"), [(0.4, 0.1), (0.1, 0.4), (0.2, 0.2), (0.3, 1e-4)])
def test_sum_of_two_uniforms_is_scipys_trapezoid(a, b):
    z = np.linspace(-0.6, 0.6, 401)
    ramp = min(a, b) / (a + b)
    reference = stats.trapezoid(ramp, 1.0 - ramp, loc=-(a + b), scale=2.0 * (a + b))
    np.testing.assert_allclose(trapezoid_density(z, a, b), reference.pdf(z), atol=1e-8)
    np.testing.assert_allclose(trapezoid_distribution(z, a, b), reference.cdf(z), atol=1e-8)


def test_half_width_interval_is_exact():
    rng = np.random.default_rng(1)
    runs, draws = 4000, 12
    largest = np.abs(rng.uniform(-0.3, 0.3, (runs, draws))).max(axis=1)
    covered = sum((e := half_width_estimate(float(x), draws)).low <= 0.3 <= e.high for x in largest)
    low, high = stats.binom.ppf([1e-4, 1.0 - 1e-4], runs, 0.95)
    assert low <= covered <= high


@pytest.mark.parametrize("multiplier", [0.5, 1.0])
def test_basic_car(multiplier):
    car = fit_with_law(logs_of(BasicController(multiplier), 250, seed=3))[0]
    assert car.chosen == "distance"
    assert estimate(car, "trigger") == pytest.approx(multiplier * KAPPA, rel=0.03)
    assert estimate(car, "deceleration") == pytest.approx(3.5, rel=0.03)
    assert estimate(car, "speed_noise") == pytest.approx(0.05, rel=0.1)
    # At C = 0.5 the car is past, or has hit, before it is slow enough to show this well: 10 % take 1,000 episodes.
    assert estimate(car, "deceleration_noise") == pytest.approx(0.1, rel=0.2 if multiplier < 1.0 else 0.1)
    assert estimate(car, "reaction_delay") == 0.0
    assert estimate(car, "cruise_speed") == pytest.approx(SCENARIO.car.start_speed)
    assert set(car.parameters) == set(PARAMETERS) - set(OPTIONAL)
    assert car.calibration.p_value > 1e-3
    best = max(car.families, key=lambda row: -math.inf if row.held_out is None else row.held_out)
    row = next(row for row in car.families if row.name == "distance")
    assert row.held_out > best.held_out - 20.0
    assert row.aic == pytest.approx(2 * row.parameters - 2 * row.log_likelihood)


def test_time_to_collision_car():
    car = fit_with_law(logs_of(TimeToCollisionCar(), 250, seed=5))[0]
    assert (car.measure, car.gate, car.spread) == ("time", "predicted", "sharp")
    assert estimate(car, "trigger") == pytest.approx(1.2, rel=0.01)
    assert estimate(car, "path_half_width") == pytest.approx(1.4, rel=0.02)
    assert estimate(car, "deceleration") == pytest.approx(5.0, rel=0.03)
    assert car.unit("trigger") == "s"


def test_reaction_delay():
    car = fit_with_law(logs_of(LateCar(1.0), 150, seed=6))[0]
    assert car.chosen == "distance, 2 ticks late"
    assert estimate(car, "reaction_delay") == pytest.approx(0.6)
    assert estimate(car, "trigger") == pytest.approx(KAPPA, rel=0.03)


def test_trigger_that_differs_per_episode():
    car = fit_with_law(logs_of(MoodyCar(1.0), 250, seed=7))[0]
    assert car.spread == "episode"
    trigger, spread = car.parameters["trigger"], car.parameters["trigger_spread"]
    assert trigger.interval is not None
    assert spread.interval is not None
    assert estimate(car, "trigger") == pytest.approx(9.0, abs=4.0 / math.sqrt(250))
    assert estimate(car, "trigger_spread") == pytest.approx(1.0, abs=4.0 / math.sqrt(500))
    assert trigger.prior.distribution == "normal"


def test_speeding_up_is_limited():
    car = fit_with_law(logs_of(LimitedCar(1.0), 250, seed=11))[0]
    assert car.chosen == "distance"
    assert estimate(car, "cruise_acceleration") == pytest.approx(1.5, rel=0.05)
    assert estimate(car, "cruise_gain") == pytest.approx(0.8, rel=0.25)
    assert estimate(car, "cruise_speed") == pytest.approx(7.0, rel=0.03)
    assert estimate(car, "deceleration") == pytest.approx(2.0, rel=0.03)
    assert estimate(car, "trigger") == pytest.approx(KAPPA, rel=0.03)


def test_integral_transform_tells_a_right_model_from_wrong_ones():
    data = logs_of(BasicController(1.0), 80, seed=9)
    change = SpeedChange(0.05, 3.5, 0.1)
    law = Law(Family(), KAPPA, math.inf, 0.0, 0.0, 0.0)

    def p_value(change: SpeedChange, law: Law) -> float:
        return kolmogorov_smirnov(integral_transform(change, law, data, np.random.default_rng(0)))[1]

    assert p_value(change, law) > 1e-3
    assert p_value(change._replace(deceleration=3.8), law) < 1e-6
    assert p_value(change._replace(speed_noise=0.07), law) < 1e-6


def test_kolmogorov_smirnov_is_scipys():
    values = np.random.default_rng(2).random(500) ** 1.1
    statistic, p_value = kolmogorov_smirnov(values)
    reference = stats.kstest(values, "uniform")
    assert statistic == pytest.approx(reference.statistic)
    assert p_value == pytest.approx(reference.pvalue, rel=0.05)


@pytest.mark.parametrize(
    ("multiplier", "count", "unknown", "reason"),
    [
        (
            0.0,
            40,
            ("trigger", "trigger_spread", "deceleration", "deceleration_noise", "reaction_delay"),
            "never brakes",
        ),
        (1.0, 1, tuple(set(PARAMETERS) - set(OPTIONAL)), "only 1 logs"),
        (1.0, 3, tuple(set(PARAMETERS) - set(OPTIONAL)), "only 3 logs"),
    ],
)
def test_not_identifiable(multiplier, count, unknown, reason):
    car = fit_with_law(logs_of(BasicController(multiplier), count, seed=4))[0]
    for name in unknown:
        parameter = car.parameters[name]
        assert parameter.reason.startswith("not identifiable: "), name
        assert reason in parameter.reason
        assert parameter.estimate is None
        assert parameter.interval is None
        assert parameter.prior.distribution == "uniform"
    assert car.parameters["trigger"].prior.first <= 0.5 * KAPPA
    assert car.parameters["trigger"].prior.second >= 1.15 * KAPPA


def test_logs_that_cannot_be_one_car():
    def recording(step: float, speed: float = 5.0) -> RecordedEpisode:
        car = np.array([[0.0, 0.0, np.pi / 2, speed], [0.0, 1.5, np.pi / 2, speed]])
        return RecordedEpisode(np.zeros((2, 2)), car, step, 2.25, 2.25)

    with pytest.raises(UsageError, match="no episode with a tick"):
        observe([])
    with pytest.raises(UsageError, match=r"differ in time_step: 0\.3 s and 0\.1 s"):
        observe([recording(0.3), recording(0.1)])
    with pytest.raises(UsageError, match="not finite"):
        observe([recording(0.3, math.nan)])
