"""Futures of copies: the world's own motion, no draw of the episode's, nothing shared that changes."""

from __future__ import annotations

import copy
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from itself_support import (
    BENT,
    CROSSING,
    FAST,
    STRAIGHT,
    Brakes,
    Moody,
    a_world,
    an_adversary,
    an_episode,
    coming,
    ready,
    velocities,
)
from skd_adversary.adversary import car_model_for
from skd_adversary.itself.costs import cost_of
from skd_adversary.itself.future import Course, Draws, Node
from skd_adversary.itself.moves import Moves
from skd_evaluator.measure.distances.deformation import deformation
from skd_evaluator.measure.distances.frechet import discrete_frechet
from skd_sim.choices.objective import Objective
from skd_sim.controllers import BasicController
from skd_sim.controllers.copying import Copier, drawing
from skd_sim.dynamics.interface import make_dynamics
from skd_sim.encounter.scenario import load_scenario
from skd_sim.simulation.world import World

_CYCLIST = [(-10.0 + 1.6 * tick, 0.05 * tick) for tick in range(10)]
_SCENARIOS = {
    "once a tick": (CROSSING, BENT),
    "20 Hz": (FAST, BENT),
    "multi-body": (replace(load_scenario("crossing_multi_body"), control_period=0.1), BENT),
    "curve": (load_scenario("right_turn"), STRAIGHT),
    "cyclist": (load_scenario("cyclist"), _CYCLIST),
}


def _course(episode):
    moves, cost = Moves(episode, car_model_for(episode.car)), cost_of(episode)
    return Course(episode, moves, cost, Copier(episode.scenario), Brakes()), moves, cost


@pytest.mark.parametrize("name", _SCENARIOS)
def test_a_future_is_what_the_world_does_with_the_same_draws(name):
    scenario, points = _SCENARIOS[name]
    contacts = 0
    for number in range(8):
        episode = an_episode(points, number, scenario)
        rng = np.random.default_rng(number)
        world = World(
            scenario,
            adversary_start=episode.start,
            gap=episode.start_gap,
            start_rng=rng,
            car_rng=np.random.default_rng(100 + number),
        )
        controller = ready(Brakes(), episode)
        course, moves, cost = _course(episode)
        dynamics = make_dynamics(scenario)
        dynamics.reset(world.car)
        start = world.adversary
        node = Node(
            0,
            world.car,
            dynamics,
            controller,
            start,
            moves.start,
            moves.velocities(moves.start, 0),
            cost.start(*start[:2]),
        )
        draws = Draws(episode, dynamics, np.random.default_rng(0), senses=False)
        noise = np.random.default_rng(100 + number)
        draws._noise = [dynamics.draw(noise) for _ in range(40)]
        itself = copy.deepcopy(controller)
        for _ in range(12):
            before = node.controller._hold
            action = course.towards(node) if rng.random() < 0.6 else int(rng.integers(len(node.velocities)))
            contact, tick = None, world.tick
            while world.tick == tick:
                contact = world.step(itself.command(world.car, world.adversary), node.velocities[action]) or contact
            parent, node = node, course.lead_on(node, action, draws, 0)
            assert parent.controller._hold == before  # a moment that was led on from stays as it was
            if contact is not None:
                assert node.contact == tuple(contact)
                contacts += 1
                break
            assert node.contact is None
            assert node.car == world.car
            assert node.place == world.adversary
            if not node.velocities or node.cost is not None:
                break
    assert contacts


def test_what_is_tried_twice_is_simulated_once():
    episode = an_episode(scenario=FAST)
    course, moves, _ = _course(episode)
    world = a_world(episode)
    dynamics = make_dynamics(FAST)
    dynamics.reset(world.car)
    velocity = moves.velocities(moves.start, 0)
    node = Node(0, world.car, dynamics, ready(Brakes(), episode), world.adversary, moves.start, velocity, 0.0)
    draws = Draws(episode, dynamics, np.random.default_rng(0), senses=False)
    first = course.lead_on(node, 2, draws, 0)
    assert course.calls == FAST.control_periods
    assert course.lead_on(node, 2, draws, 0) is first
    assert course.calls == FAST.control_periods


def test_who_is_told_the_state_does_not_foresee_the_cars_noise():
    episode = an_episode()
    cars = coming(episode)
    for make in (BasicController, Moody):
        ways = [
            velocities(an_adversary(episode, ready(make(), episode), a_world(episode, seed)), cars) for seed in (1, 2)
        ]
        assert ways[0] == ways[1]


def test_nobody_foresees_what_the_controller_will_draw():
    episode = an_episode()
    cars = coming(episode)
    ways = []
    for seed in (1, 2):
        controller = ready(Moody(), episode, seed)
        controller.distance = 8.0
        ways.append(velocities(an_adversary(episode, controller, a_world(episode)), cars))
    assert ways[0] == ways[1]


def test_by_the_sensor_what_the_controller_drew_at_its_reset_is_not_known_either():
    episode = an_episode(told=False)
    cars = coming(episode, 4)
    ways = [velocities(an_adversary(episode, ready(Moody(), episode, seed)), cars) for seed in (1, 2)]
    assert ways[0] == ways[1]


def test_draws_of_futures_and_those_of_the_episode_are_independent():
    episode = an_episode(scenario=FAST)
    world = a_world(episode)
    dynamics = make_dynamics(FAST)
    own = np.array([dynamics.draw(world._rng) for _ in range(400)])
    adversary = an_adversary(episode, ready(Moody(), episode), a_world(episode))
    found = [moment[1] for moment in adversary._moments(world.car)]
    for draws in found:
        noise = np.array([draws.noise(tick) for tick in range(400)])
        for column in range(2):  # three standard errors of a correlation of 400 independent pairs
            assert abs(np.corrcoef(own[:, column], noise[:, column])[0, 1]) < 3.0 / math.sqrt(400)
    assert len({draws.noise(0) for draws in found}) == len(found)


def test_lasers_of_futures_have_noise_of_their_own():
    episode = an_episode()
    draws = Draws(episode, make_dynamics(CROSSING), np.random.default_rng(5), senses=True)
    assert draws.laser is not None
    assert draws.laser._draw[0] != episode.seed


@given(
    st.recursive(
        st.integers() | st.text(max_size=3),
        lambda one: st.lists(one, max_size=3) | st.dictionaries(st.integers(), one, max_size=3) | st.tuples(one, one),
        max_leaves=12,
    )
)
def test_copies_are_equal_and_share_nothing_that_changes(value):
    made = Copier().copy(value)
    assert made == copy.deepcopy(value)
    if isinstance(value, (list, dict)):
        assert made is not value


def test_copies_keep_what_is_one_object_one():
    class Part:
        def __init__(self) -> None:
            self.rng = np.random.default_rng(1)
            self.numbers = np.arange(3.0)

    class Whole:
        def __init__(self) -> None:
            self.part = Part()
            self.same = [self.part, self.part.numbers]
            self.bound = self.part.numbers.sum
            self.me = self

    whole = Whole()
    made = Copier().copy(whole)
    assert made.me is made
    assert made.same[0] is made.part
    assert made.same[1] is made.part.numbers
    made.part.numbers[0] = 9.0
    assert whole.part.numbers[0] == 0.0
    assert made.part.rng.random() == np.random.default_rng(1).random()
    assert len(list(drawing(made))) == 1


def test_afresh_seeds_every_generator_wherever_it_is_kept():
    held = {"own": np.random.default_rng(1), "deep": [(np.random.RandomState(2),)]}
    one, two, again = (Copier().afresh(held, np.random.default_rng(seed)) for seed in (5, 6, 5))
    for take in (lambda it: it["own"].random(), lambda it: it["deep"][0][0].random_sample()):
        values = [take(it) for it in (one, two, held)]
        assert len(set(values)) == 3
        assert take(again) == values[0]


def test_costs_are_those_of_the_measures():
    rng = np.random.default_rng(4)
    for objective in (Objective.DEFORMATION, Objective.FRECHET, Objective.PAPER):
        episode = an_episode(objective=objective)
        cost = cost_of(episode)
        for _ in range(20):
            way = np.cumsum(rng.normal(0.1, 0.4, (6, 2)), axis=0) + BENT[0]
            share = float(rng.random())
            so_far = cost.start(*way[0])
            for tick in range(4):
                so_far = cost.step(so_far, tick, *way[tick + 1])
            contact = way[4] + share * (way[5] - way[4])
            found = cost.hit(so_far, 4, share, *contact, 5.0)
            psi = np.vstack([way[:5], contact])
            if objective == Objective.DEFORMATION:
                expected = deformation(BENT, psi, 4 + share) + 0.003 * (4 + share)
            elif objective == Objective.FRECHET:
                expected = discrete_frechet(np.array(BENT), psi) + 0.003 * (4 + share)
            else:
                expected = 100.0 * (1.0 - 0.95**4)
                expected += sum(0.95**tick * _from_line(psi[tick + 1]) for tick in range(5))
            assert found == pytest.approx(min(found, expected) if found == 5.0 else expected, abs=1e-9)
            assert cost.least(so_far, 4) <= found + 1e-9 or found == 5.0
    slow = cost_of(an_episode())
    assert slow.hit(slow.start(*BENT[0]), 0, 0.5, -3.4, 0.0, 0.3) == CROSSING.eta_max  # walked into, not hit


def _from_line(point: np.ndarray) -> float:
    from shapely.geometry import LineString, Point

    return float(LineString(BENT).distance(Point(point)))
