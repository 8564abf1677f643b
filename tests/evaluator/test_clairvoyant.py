"""The clairvoyant kamikaze against brute force through the real world, and against kamikazes that were run."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from clairvoyant_support import CROSSING, bent, kamikaze_episode, place, touching
from hypothesis import given, settings
from hypothesis import strategies as st
from skd_adversary.model.road_user.pedestrian import ACTION_COUNT, action_velocity
from skd_evaluator.campaign.run.runner import run_episode
from skd_evaluator.floor.clairvoyant import clairvoyant_floor
from skd_evaluator.measure.distances.frechet import discrete_frechet
from skd_sim.controllers import BasicController
from skd_sim.episode.episode import Episode, Mode, Outcome
from skd_sim.episode.randomness import Role, generator
from skd_sim.simulation.world import make_world
from skd_sim.state import AdversaryState, CarState


def brute_force(episode: Episode) -> float:
    """Return the least distance over all action sequences, each step made by the world itself; infinity: none."""
    world = make_world(episode)
    controller = BasicController(episode.multiplier)
    controller.reset(episode.scenario, np.random.default_rng(0))
    assert episode.safe_trajectory is not None
    phi = episode.safe_trajectory.positions
    draws = generator(episode.seed, episode.episode_id, Role.CAR)
    noise_before = []
    for _ in range(episode.scenario.ticks):
        noise_before.append(draws.bit_generator.state)
        draws.random(2)
    best = math.inf

    def visit(car: CarState, adversary: AdversaryState, tick: int, walked: list[tuple[float, float]]) -> None:
        nonlocal best
        acceleration = controller.command(car, adversary)
        for action in range(ACTION_COUNT):
            place(world, car, adversary, tick)
            world._rng.bit_generator.state = noise_before[tick]
            contact = world.step(acceleration, action_velocity(action, episode.scenario.adversary.speed))
            after = [*walked, world.adversary[:2]]
            outcome = episode.outcome(world.tick, world.adversary, collided=contact is not None)
            if outcome == Outcome.COLLISION:
                best = min(best, discrete_frechet(phi, touching(after, contact)))
            elif outcome == Outcome.RUNNING:
                visit(world.car, world.adversary, world.tick, after)

    visit(world.car, world.adversary, 0, [world.adversary[:2]])
    return best


def least_by_layers(episode: Episode, limit: float) -> float:
    """Return the least distance up to the limit by plain dynamic programming over the world's own steps.

    Sequences that meet at one place with the car in one state are merged: for each j, the least bottleneck counts.
    """
    world = make_world(episode)
    controller = BasicController(episode.multiplier)
    controller.reset(episode.scenario, np.random.default_rng(0))
    assert episode.safe_trajectory is not None
    phi = episode.safe_trajectory.positions.tolist()
    draws = generator(episode.seed, episode.episode_id, Role.CAR)

    def couple(before: list[float], point: tuple[float, float]) -> list[float]:
        after: list[float] = []
        for j, target in enumerate(phi):
            least = min([*before[max(0, j - 1) : j + 1], *after[-1:]])
            value = max(least, math.dist(point, target))
            after.append(value if value <= limit else math.inf)
        return after

    best = math.inf
    start = couple([0.0] + [math.inf] * (len(phi) - 1), world.adversary[:2])
    layer = {(world.adversary[:2], world.car): (world.car, world.adversary, start)}
    for tick in range(episode.scenario.ticks):
        noise = draws.bit_generator.state
        draws.random(2)
        following: dict[tuple[tuple[float, float], CarState], tuple[CarState, AdversaryState, list[float]]] = {}
        for car, adversary, reached in layer.values():
            acceleration = controller.command(car, adversary)
            for action in range(ACTION_COUNT):
                place(world, car, adversary, tick)
                world._rng.bit_generator.state = noise
                contact = world.step(acceleration, action_velocity(action, episode.scenario.adversary.speed))
                if contact is not None:
                    end = touching([adversary[:2], world.adversary[:2]], contact)[-1]
                    best = min(best, couple(reached, (float(end[0]), float(end[1])))[-1])
                    continue
                after = couple(reached, world.adversary[:2])
                if min(after) > limit or world.adversary.x > episode.scenario.path_edge:
                    continue
                key = ((round(world.adversary.x, 9), round(world.adversary.y, 9)), world.car)
                if key in following:
                    after = [min(pair) for pair in zip(after, following[key][2], strict=True)]
                following[key] = (world.car, world.adversary, after)
        layer = following
    return best


def check_witness(episode: Episode) -> float:
    """Run the floor's actions through the world by hand; return the floor, infinity without one."""
    found = clairvoyant_floor(episode)
    if found is None:
        return math.inf
    world = make_world(episode)
    controller = BasicController(episode.multiplier)
    controller.reset(episode.scenario, np.random.default_rng(0))
    walked = [world.adversary[:2]]
    outcome = Outcome.RUNNING
    for action in found.actions.tolist():
        assert outcome == Outcome.RUNNING
        velocity = action_velocity(action, episode.scenario.adversary.speed)
        contact = world.step(controller.command(world.car, world.adversary), velocity)
        walked.append(world.adversary[:2])
        outcome = episode.outcome(world.tick, world.adversary, collided=contact is not None)
    assert outcome == Outcome.COLLISION
    ended = touching(walked, contact)
    assert np.allclose(ended, found.trajectory.positions, rtol=0.0, atol=1e-12)
    assert episode.safe_trajectory is not None
    assert found.distance == pytest.approx(discrete_frechet(episode.safe_trajectory.positions, ended), abs=1e-12)
    return found.distance


@settings(max_examples=15)
@given(
    seed=st.integers(0, 1000),
    count=st.integers(2, 12) | st.sampled_from([64, 65, 130]),
    ticks=st.integers(2, 5),
    multiplier=st.sampled_from([0.0, 0.2, 0.5, 0.75, 1.0, 1.15]),
    gap=st.floats(0.5, 9.0),
    impact=st.sampled_from([0.0, 0.0, 3.0, 6.0]),
)
def test_equals_brute_force(seed, count, ticks, multiplier, gap, impact):
    points = bent(np.random.default_rng(seed), count)
    episode = kamikaze_episode(points, ticks, multiplier, seed, gap=gap, impact=impact)
    exact = brute_force(episode)
    assert check_witness(episode) == pytest.approx(exact, abs=1e-9)
    if math.isfinite(exact):
        near = clairvoyant_floor(episode, exact)
        far = clairvoyant_floor(episode, 2.0 * exact + 1.0)
        assert near is not None
        assert far is not None
        assert [near.distance, far.distance] == pytest.approx([exact, exact], abs=1e-9)
        assert clairvoyant_floor(episode, 0.99 * exact) is None


@pytest.mark.parametrize(
    ("ticks", "multiplier", "gap", "seed"), [(6, 0.5, 5.0, 1), (6, 1.0, 8.0, 2), (6, 1.15, 3.0, 3), (7, 0.75, 9.0, 4)]
)
def test_equals_brute_force_over_longer_horizons(ticks, multiplier, gap, seed):
    points = bent(np.random.default_rng(seed), 9)
    episode = kamikaze_episode(points, ticks, multiplier, seed, gap=gap)
    exact = brute_force(episode)
    assert math.isfinite(exact)
    assert check_witness(episode) == pytest.approx(exact, abs=1e-9)


@pytest.mark.parametrize(
    ("ticks", "multiplier", "seed", "offset"),
    [(15, 0.5, 1, 0.0), (18, 0.875, 2, 0.4), (18, 1.0, 3, 0.0), (16, 1.15, 4, 0.8)],
)
def test_equals_plain_dynamic_programming_over_long_horizons(ticks, multiplier, seed, offset):
    points = [(-3.5, 0.0), (-2.2, offset), (-0.5, -offset), (0.8, 0.2), (2.0, 0.3)]
    episode = kamikaze_episode(points, ticks, multiplier, seed)
    floor = check_witness(episode)
    assert least_by_layers(episode, floor + 1e-9) == pytest.approx(floor, abs=1e-9)


def test_equals_brute_force_beside_a_car_that_stands():
    # At 1.2 m/s it stands after one or two ticks; walking up to it is then the only way to touch it.
    points = [(-1.5, 0.5), (0.0, 0.5), (1.5, 0.0)]
    episode = kamikaze_episode(points, 6, 1.0, gap=0.5)
    slow = replace(episode.scenario.car, start_speed=1.2, start_gap_range=0.2)
    slower = replace(episode, scenario=replace(episode.scenario, car=slow), multiplier=30.0)
    exact = brute_force(slower)
    assert math.isfinite(exact)
    assert check_witness(slower) == pytest.approx(exact, abs=1e-9)


@pytest.mark.parametrize("multiplier", [0.5, 0.75, 1.0, 1.15])
@pytest.mark.parametrize("number", range(3))
def test_no_kamikaze_that_was_run_comes_closer(multiplier, number):
    points = [(-3.5 + 0.75 * k, 0.3 * math.sin(k)) for k in range(8)]
    episode = kamikaze_episode(points, multiplier=multiplier, number=number, simulations=100)
    log = run_episode(episode)
    assert log.outcome == Outcome.COLLISION
    own = discrete_frechet(points, log.trajectory.positions)
    with_bound = clairvoyant_floor(episode, own)
    assert with_bound is not None
    assert with_bound.distance <= own + 1e-9
    assert check_witness(episode) == pytest.approx(with_bound.distance, abs=1e-9)


@pytest.mark.parametrize("multiplier", [0.75, 1.15])
def test_a_longer_horizon_never_raises_the_floor(multiplier):
    points = [(-3.5 + 0.75 * k, 0.0) for k in range(8)]
    floors = [check_witness(kamikaze_episode(points, ticks, multiplier, seed=5)) for ticks in (3, 6, 8, 10, 14, 20)]
    assert floors[0] == math.inf  # the car's path is four steps away
    assert floors == sorted(floors, reverse=True)
    assert floors[-1] < floors[1]


def test_repeated_points_of_phi_change_nothing():
    points = np.array([(-3.5 + 0.75 * k, 0.2 * k % 0.7) for k in range(8)])
    short = check_witness(kamikaze_episode(points, 12))
    assert check_witness(kamikaze_episode(np.repeat(points, 10, axis=0), 12)) == short
    assert check_witness(kamikaze_episode(np.repeat(points, 8, axis=0), 12)) == short  # exactly one word


def test_an_impact_speed_that_the_car_never_has_leaves_no_floor():
    assert clairvoyant_floor(kamikaze_episode([(-3.5, 0.0), (2.0, 0.0)], 10, impact=30.0)) is None


def test_only_kamikaze_episodes_with_the_basic_controller_have_a_floor():
    episode = kamikaze_episode([(-3.5, 0.0), (2.0, 0.0)])
    with pytest.raises(ValueError, match="REPLAY"):
        clairvoyant_floor(replace(episode, mode=Mode.REPLAY))
    with pytest.raises(ValueError, match="my_module:Car"):
        clairvoyant_floor(replace(episode, controller="my_module:Car"))
    car = replace(CROSSING.car, dynamics="multi_body")
    with pytest.raises(ValueError, match="multi_body"):
        clairvoyant_floor(replace(episode, scenario=replace(CROSSING, car=car)))
