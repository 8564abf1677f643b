"""Cars to be learned, and logs of them."""

import numpy as np
from skd_adversary.car_models.car_model_file import PARAMETERS, CarParameter, FittedCar, ParameterPrior
from skd_adversary.car_models.observations import Observations, observe
from skd_evaluator.assessment.plan import probe_episodes
from skd_evaluator.assessment.run.episodes import run_episode
from skd_evaluator.assessment.stages.car_model import recording_of
from skd_sim import AdversaryState, CarState, Controller, Scenario, load_scenario
from skd_sim.controllers.basic import BasicController
from skd_sim.controllers.controller import control_period_of, with_control_period

SCENARIO = load_scenario("crossing")
KAPPA = SCENARIO.car.safe_distance


def logs_of(controller: Controller, count: int, *, seed: int = 0) -> Observations:
    """Return the ticks of a probe of a car."""
    scenario = with_control_period(SCENARIO, control_period_of(controller, "under test"), "under test")
    episodes = probe_episodes(scenario, count, seed=seed, controller="under test")
    return observe([recording_of(run_episode(episode, controller)) for episode in episodes])


class TimeToCollisionCar:
    """The braking law of examples/vendor_controller, written anew."""

    time, half_path, deceleration = 1.2, 1.4, 5.0

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        pass

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        ahead, left = adversary.y - car.y, adversary.x - car.x
        closing = car.speed - adversary.vy
        if car.speed < 0.1 or closing <= 0.0 or ahead < -2.25:
            return 0.0
        begin, end = max(0.0, (ahead - 2.25) / closing), (ahead + 2.25) / closing
        first, last = sorted((left + adversary.vx * begin, left + adversary.vx * end))
        threatened = first <= self.half_path and last >= -self.half_path and begin <= self.time
        return -self.deceleration if threatened else 0.0


class LateCar(BasicController):
    """The basic car, two ticks late."""

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        super().reset(scenario, rng)
        self._waiting = [0.0, 0.0]

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        self._waiting.append(super().command(car, adversary))
        return self._waiting.pop(0)


class MoodyCar(BasicController):
    """The basic car with another trigger in each episode: normal, mean 9 m, deviation 1 m."""

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        super().reset(scenario, rng)
        self._trigger = 9.0 + rng.standard_normal()


class LimitedCar(BasicController):
    """Returns to 7 m/s where it is free; it brakes with 2 m/s² and speeds up with no more than 1.5 m/s²."""

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        braking = super().command(car, adversary)
        return (2.0 / 3.5) * braking if braking else min(1.5, 0.8 * (7.0 - car.speed))


NUMBERS = {"trigger": 9.0, "deceleration": 3.5, "cruise_speed": 25 / 3, "speed_noise": 0.05}


def a_car(**priors: ParameterPrior) -> FittedCar:
    """Return a fitted car with the basic car's numbers, and other priors of some."""
    parameters = {
        name: CarParameter(ParameterPrior("point", (value := NUMBERS.get(name, 0.0))), value, 0.0, (value, value))
        for name in PARAMETERS
    }
    for name, prior in priors.items():
        ends = (prior.first, max(prior.first, prior.second))
        parameters[name] = CarParameter(prior, prior.first, prior.second, ends)
    law = {"measure": "distance", "gate": "none", "spread": "sharp", "lapse": 0.0, "chosen": "distance"}
    return FittedCar(**law, parameters=parameters, logs=10, ticks=100, braking_ticks=20, time_step=0.3)
