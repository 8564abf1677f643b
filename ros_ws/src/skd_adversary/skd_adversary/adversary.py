"""The adversary: decides, tick by tick, how it moves.

It senses the car, updates its belief (`pomdp.belief`) and searches (`pomdp.planner`). What a kamikaze wants, and its
default policy, are in `crossing.kamikaze`; `crossing.model` puts road, road user, car and sensor together with that.
Short episodes make every planner compile, or load from its cache, before it is timed or forked.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final, NamedTuple, Protocol

import numpy as np
from skd_sim.errors import UsageError
from skd_sim.options.car_and_adversary import BASIC, DEFAULT, DYNAMICS, AdversaryModel, Objective
from skd_sim.scenario.scenario import load_scenario
from skd_sim.world.episode import EpisodeSpec, Mode, Role, generator
from skd_sim.world.state import CarState, FloatArray, Pair, Trajectory

from skd_adversary.car_models.car_model_file import OPTIONAL, PARAMETERS, FittedCar, car_model_text, fitted_car
from skd_adversary.car_models.forest import TICK, gridded, pack
from skd_adversary.car_models.identifiability import Identification
from skd_adversary.crossing.cars import CarModel, LearnedCar, known_basic_car, unknown_car
from skd_adversary.crossing.interfaces import CAR_S, CAR_SPEED, CarPrediction, path_velocities
from skd_adversary.crossing.model import compose, road_user_parts
from skd_adversary.crossing.objectives import SAFE, objective_named
from skd_adversary.crossing.road_users import road_user_named
from skd_adversary.pomdp.belief import ParticleBelief
from skd_adversary.pomdp.planner import Planner


class BelievedCar(NamedTuple):
    """Mean and standard deviation of what is believed of the car.

    Attributes:
        position: mean place of its reference point along the road (`skd_sim.scenario.road`), m.
        position_deviation: standard deviation of the place, m.
        speed: mean speed, m/s.
        speed_deviation: standard deviation of the speed, m/s.
    """

    position: float
    position_deviation: float
    speed: float
    speed_deviation: float


class Adversary(Protocol):
    """Decides its own velocity from what it can see of the car; it knows its own position."""

    @property
    def depletions(self) -> int:
        """How often no particle explained what was seen."""

    def act(self, car: CarState) -> Pair:
        """Return the velocity (East, North), m/s, for the coming time step.

        Args:
            car: true state of the car; the adversary adds its sensor's noise to it.
        """


class PlanningAdversary:
    """Plans by a POMDP: senses the car through noise, updates its belief, searches.

    Attributes:
        belief: what it believes now.
    """

    def __init__(self, episode: EpisodeSpec) -> None:
        """Prepare for an episode, safe or kamikaze.

        Raises:
            UsageError: the car is to have been learned, and the episode carries no model of it.
        """
        scenario = self._scenario = episode.scenario
        if episode.mode == Mode.SAFE:
            objective, path = SAFE, None
            particles = objective.options.particles
        else:
            assert episode.safe_trajectory is not None
            objective, path = objective_named(episode.objective), episode.safe_trajectory.positions
            particles = episode.particles or objective.options.particles
        car, road_user = predicted_car(episode), road_user_named(scenario.adversary.kind)
        model = compose(
            scenario,
            objective,
            car,
            start=episode.start,
            gap=episode.start_gap,
            path=path,
            maximum_distance=episode.maximum_distance,
            road_user=road_user,
            end=episode.end,
        )
        self._sensor, self._road_user = car.sensor, road_user.kernels
        interfaces = road_user_parts(road_user.kernels, car.kernels)
        self._velocity, self._possible = interfaces["velocity"], interfaces["possible"]
        self._sensor_rng = generator(episode.seed, episode.episode_id, Role.SENSOR)
        self._position, self._tick = episode.start, 0
        self._parameters = model.parameters
        phi = model.parameters.path
        self._phi = path_velocities(phi, len(phi), scenario.time_step).tolist()  # the last: it stands at its end
        self._action: int | None = None
        rng = generator(episode.seed, episode.episode_id, Role.PLANNER)
        self.belief = ParticleBelief(model, particles, rng)
        options = replace(objective.options, simulations=episode.simulations, particles=particles)
        self._planner = Planner(model, options, rng)

    @property
    def depletions(self) -> int:
        """How often no particle explained what was seen."""
        return self.belief.depletions

    @property
    def believed_car(self) -> BelievedCar:
        """Where it believed the car to be, and how fast, when it decided last."""
        return BelievedCar(*self.belief.moments(CAR_S), *self.belief.moments(CAR_SPEED))

    def _sense(self, car: CarState) -> FloatArray:
        return self._sensor.sense(self._scenario, self._position, car, self._sensor_rng)

    def act(self, car: CarState) -> Pair:
        """Sense, update the belief, plan; see `Adversary.act`."""
        seen = self._sense(car)
        if self._action is not None:
            self.belief.predict(self._action)
            self._planner.advance(self._action, seen)
        self.belief.correct(self._road_user.rest if self._action is None else self._action, seen)
        self._action = self._planner.plan(self.belief)
        step, own = self._scenario.time_step, self.belief.particles[0]  # all of them have the road user's own state
        if self._action == self._road_user.action_count:  # as φ
            vx, vy = self._possible(self._parameters, own, *self._phi[min(self._tick, len(self._phi) - 1)])
        else:
            vx, vy = self._velocity(self._parameters, own, self._action)
        self._tick += 1
        self._position = (self._position[0] + step * vx, self._position[1] + step * vy)
        return vx, vy


class ReplayAdversary:
    """Follows a given trajectory and then stands still."""

    depletions: Final = 0

    def __init__(self, trajectory: Trajectory) -> None:
        """Follow `trajectory` from its first point."""
        self._velocities = path_velocities(trajectory.positions, len(trajectory), trajectory.time_step).tolist()
        self._tick = 0

    def act(self, car: CarState) -> Pair:
        """Return the velocity to the next point; see `Adversary.act`."""
        vx, vy = self._velocities[min(self._tick, len(self._velocities) - 1)]
        self._tick += 1
        return vx, vy


def predicted_car(episode: EpisodeSpec) -> CarPrediction:
    """Return the model of the car with which an episode's adversary plans: by the episode's adversary model and mode.

    Raises:
        UsageError: the car is to have been learned, and the episode carries no model of it.
    """
    basic = episode.car.is_known and episode.adversary_model != AdversaryModel.GENERIC
    known = known_basic_car(episode.car.multiplier) if basic else unknown_car()
    if episode.mode == Mode.SAFE and basic:  # C known, distance observed (paper, "Safe Trajectories")
        known = CarModel(episode.multiplier, episode.multiplier, observes_position=False)
    if episode.car_model:
        return LearnedCar(fitted_car(episode.car_model), known)
    if episode.mode == Mode.KAMIKAZE and episode.adversary_model == AdversaryModel.LEARNED:
        raise UsageError("adversary model learned needs a car model, and the episode carries none")
    return known


def make_adversary(episode: EpisodeSpec) -> Adversary:
    """Return the adversary of an episode, seeded from its specification.

    Raises:
        UsageError: it lacks what it is to know.
    """
    if episode.mode == Mode.REPLAY:
        assert episode.safe_trajectory is not None
        return ReplayAdversary(episode.safe_trajectory)
    return PlanningAdversary(episode)


def any_car_models() -> list[str]:
    """Return a model of each kind that a car can have, as an episode carries it, which says nothing of any car."""
    names = [name for name in PARAMETERS if name not in OPTIONAL]
    parameters = Identification(logs=0, start_speed=0.0).unknown("there are no logs", *names)
    step = load_scenario(DYNAMICS[BASIC].scenario).time_step
    law = FittedCar(measure="distance", gate="none", spread="sharp", lapse=0.0, parameters=parameters, time_step=step)
    one_leaf = pack(
        np.array([-1], dtype=np.int8),
        np.zeros(0, dtype=np.int16),
        np.ones(1, dtype=np.uint32),
        gridded(np.zeros((1, len(TICK)))),
        np.ones(1, dtype=np.uint16),
    )
    return [car_model_text(law), car_model_text(replace(law, forest=one_leaf))]


def warm_up_episodes(
    controller: str = DEFAULT, *, objective: Objective = Objective.PAPER, car_model: str = "", dynamics: str = BASIC
) -> list[EpisodeSpec]:
    """Return a safe and a kamikaze episode with a tiny budget.

    Args:
        controller: name of the car under test: what is known of it decides which planner is needed.
        objective: objective of the kamikaze, which decides as well.
        car_model: model of the car, as in `EpisodeSpec`, which decides as well.
        dynamics: dynamics of the car under test, which are compiled, too.
    """
    scenario = load_scenario(DYNAMICS[dynamics].scenario)
    across = Trajectory(np.array([(-2.0, 0.0), (2.0, 0.0)]), scenario.time_step)
    safe = EpisodeSpec(scenario, Mode.SAFE, 0, 0, simulations=10)
    chosen: dict[str, Any] = {"controller": controller, "objective": objective, "safe_trajectory": across}
    kamikaze = EpisodeSpec(scenario, Mode.KAMIKAZE, 0, 0, simulations=10, **chosen)
    if not car_model:
        return [safe, kamikaze]
    learned: dict[str, Any] = {"controller": controller, "car_model": car_model, "adversary_model": None}
    return [safe, replace(safe, **learned), replace(kamikaze, **learned)]
