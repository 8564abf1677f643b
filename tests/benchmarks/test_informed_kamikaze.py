"""The kamikaze that is told the car's state: its model against the world, its attempts against the floor."""

from __future__ import annotations

import math

import numpy as np
import pytest
from informed_kamikaze import ROW, InformedAdversary, informed_pomdp
from skd_adversary.model.car.basic import WAITING_REWARD
from skd_adversary.model.crossing import CAR_S, CAR_SPEED
from skd_adversary.model.road_user.pedestrian import action_velocity
from skd_evaluator.campaign.run.runner import run_episode
from skd_evaluator.margin.exact.exact import exact_margin
from skd_evaluator.measure.distances.deformation import deformation
from skd_sim.choices.objective import Objective
from skd_sim.controllers import make_controller
from skd_sim.encounter.scenario import load_scenario
from skd_sim.episode.episode import Episode, Mode
from skd_sim.episode.randomness import Role, generator
from skd_sim.geometry.trajectory import Trajectory
from skd_sim.simulation.world import make_world

CROSSING = load_scenario("crossing")
STRAIGHT = Trajectory(np.column_stack([np.arange(-3.5, 3.0, 0.75), np.zeros(9)]), CROSSING.time_step)


def a_kamikaze(number: int, multiplier: float) -> Episode:
    return Episode(
        CROSSING,
        Mode.KAMIKAZE,
        5,
        number,
        multiplier=multiplier,
        safe_trajectory=STRAIGHT,
        objective=Objective.DEFORMATION,
    )


@pytest.mark.parametrize("multiplier", [0.5, 1.0, 1.15])
def test_its_model_of_the_car_is_the_world_given_the_same_draws(multiplier: float) -> None:
    actions = np.random.default_rng(3)
    contacts = 0
    for number in range(40):
        episode = a_kamikaze(number, multiplier)
        model, world = informed_pomdp(episode), make_world(episode)
        car = make_controller("basic", multiplier)
        car.reset(CROSSING, generator(episode.seed, number, Role.CONTROLLER))
        draws = generator(episode.seed, number, Role.CAR)
        trigger = multiplier * CROSSING.car.safe_distance
        start = [*episode.start, world.car.y, world.car.speed, trigger, 0.0, 0.0, 0.0]
        state, moved = np.array(start), np.empty(model.state_dim)
        for tick in range(12):
            action = int(actions.choice([2, 2, 2, 1, 4, 5]))
            velocity = action_velocity(action, CROSSING.adversary.speed)
            reward, _ = model.step(model.parameters, state, action, moved, draws)
            contact = world.step(car.command(world.car, world.adversary), velocity)
            assert (moved[CAR_S], moved[CAR_SPEED]) == pytest.approx((world.car.y, world.car.speed), abs=1e-12)
            hit = contact is not None and CROSSING.collision.is_hit(contact.speed)
            worth = CROSSING.eta_max - math.sqrt(moved[ROW]) if hit else 0.0
            late = WAITING_REWARD if tick + 1 >= len(STRAIGHT.positions) else 0.0
            assert reward == pytest.approx(worth + late)
            if contact is not None:
                contacts += 1
                break
            state, moved = moved, state
    assert contacts >= 5


@pytest.mark.parametrize("multiplier", [0.5, 1.0, 1.15])
def test_it_knows_where_it_is_and_comes_no_nearer_than_the_margin(multiplier: float) -> None:
    for number in range(8):
        episode = a_kamikaze(number, multiplier)
        adversary = InformedAdversary(episode, 200)
        log = run_episode(episode, adversary=adversary)
        assert adversary.position == pytest.approx(log.adversary[-1])
        if not log.hit:
            continue
        ticks = log.impact_time / CROSSING.time_step
        reached = deformation(STRAIGHT.positions, log.trajectory.positions, ticks)
        floor = exact_margin(episode)
        assert floor is not None
        assert reached >= floor.distance - 1e-9
        again = run_episode(episode, adversary=InformedAdversary(episode, 200))
        assert np.array_equal(again.adversary, log.adversary)
