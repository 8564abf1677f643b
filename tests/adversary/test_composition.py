"""A model is put together of parts; an objective of one's own is one file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from skd_adversary.crossing.cars import unknown_car
from skd_adversary.crossing.interfaces import ADVERSARY_X, ROW, STATE_DIM, ObjectiveModel, move, template, velocity
from skd_adversary.crossing.model import compose
from skd_adversary.crossing.objectives import objective_named
from skd_adversary.crossing.road_users import ACTION_COUNT, EAST, STAY
from skd_adversary.pomdp.belief import ParticleBelief
from skd_adversary.pomdp.planner import Planner, PlannerOptions
from skd_sim.arrays import FloatArray
from skd_sim.kernels.compilation import kernel
from skd_sim.options.adversary import OBJECTIVES
from skd_sim.scenario.scenario import Scenario, load_scenario

CROSSING = load_scenario("crossing")
# --- an objective of one's own: to stand on x = −2 and wait


@template
def _begin(parameters: Any, state: FloatArray) -> None:
    state[ROW] = 0.0


@template
def _step(parameters, state, action, next_state, rng):
    vx, vy = velocity(parameters, state, action)
    move(parameters, state, vx, vy, next_state, rng)
    next_state[ROW] = state[ROW] + 1.0
    return -abs(next_state[ADVERSARY_X] - parameters.wanted_x), next_state[ROW] >= 6.0


@kernel(inline=True)
def _go(parameters: Any, state: FloatArray, rng: np.random.Generator) -> int:
    return EAST if state[ADVERSARY_X] < parameters.wanted_x - 0.1 else STAY


def _numbers(scenario: Scenario, path: FloatArray) -> Mapping[str, float]:
    return {"wanted_x": -2.0}


def _one(points: int) -> int:
    return 1


WAIT = ObjectiveModel(
    "wait",
    1.0,
    PlannerOptions(simulations=1000, exploration=1.0, particles=300),
    _numbers,
    step=_step,
    rollout_action=_go,
    begin=_begin,
    own_dim=_one,
)


def test_an_objective_of_ones_own() -> None:
    model = compose(CROSSING, WAIT, unknown_car(), start=(-3.5, 0.0), gap=30.0)
    assert (model.state_dim, model.action_count) == (STATE_DIM + 1, ACTION_COUNT)
    rng = np.random.default_rng(0)
    belief, planner = ParticleBelief(model, 100, rng), Planner(model, replace(WAIT.options, simulations=4000), rng)
    x = []
    for _ in range(5):
        action = planner.plan(belief)
        belief.predict(action)
        assert (belief.particles[:, ADVERSARY_X] == belief.particles[0, ADVERSARY_X]).all()
        x.append(belief.particles[0, ADVERSARY_X])
    assert x == pytest.approx([-2.75, -2.0, -2.0, -2.0, -2.0])
    assert (belief.particles[:, STATE_DIM] == 5.0).all()


def test_two_parts_with_a_parameter_of_one_name_are_refused() -> None:
    twice = replace(WAIT, parameters=lambda scenario, path: {"radius": 1.0})
    with pytest.raises(ValueError, match="wait: two parts of the model have a parameter radius"):
        compose(CROSSING, twice, unknown_car(), start=(-3.5, 0.0), gap=30.0)


def test_objectives_are_found_by_name() -> None:
    for name in OBJECTIVES.own:
        assert objective_named(name).name == name
