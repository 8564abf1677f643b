"""The least deformation against brute force through the real world, a plain search, and kamikazes that were run."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from clairvoyant_support import CROSSING, TIME_STEP, bent, kamikaze_episode, place, touching
from hypothesis import given, settings
from hypothesis import strategies as st
from skd_adversary.model.road_user.pedestrian import ACTION_COUNT, AS_PHI, action_velocity
from skd_evaluator.campaign.runner import run_episode
from skd_evaluator.floor import clairvoyant_deformation
from skd_evaluator.floor.clairvoyant_deformation import deformation_floor
from skd_sim.controllers import BasicController
from skd_sim.episode import Episode, Mode, Outcome
from skd_sim.randomness import Role, generator
from skd_sim.state import CarState, PedestrianState
from skd_sim.world import World, make_world


class Steps:
    """The world of an episode, whose steps can be taken from anywhere; and the distance from φ, by its definition."""

    def __init__(self, episode: Episode) -> None:
        self.episode = episode
        self.world: World = make_world(episode)
        self.controller = BasicController(episode.multiplier)
        self.controller.reset(episode.scenario, np.random.default_rng(0))
        assert episode.safe_trajectory is not None
        self.phi = episode.safe_trajectory.positions
        draws = generator(episode.seed, episode.episode_id, Role.CAR)
        self.noise = []
        for _ in range(episode.scenario.ticks):
            self.noise.append(draws.bit_generator.state)
            draws.random(2)

    def along(self, time: float) -> np.ndarray:
        """Return φ at a time in ticks."""
        time = min(time, len(self.phi) - 1)
        before = min(int(time), max(0, len(self.phi) - 2))
        after = min(before + 1, len(self.phi) - 1)
        return self.phi[before] + (time - before) * (self.phi[after] - self.phi[before])

    def velocity(self, action: int, tick: int) -> tuple[float, float]:
        if action != AS_PHI:
            return action_velocity(action, self.episode.scenario.pedestrian.speed)
        vx, vy = (self.along(tick + 1) - self.along(tick)) / TIME_STEP
        return float(vx), float(vy)

    def after(
        self, car: CarState, pedestrian: PedestrianState, tick: int
    ) -> Iterator[tuple[int, CarState, PedestrianState, float, Outcome]]:
        """Yield (action, car, pedestrian, distance from φ at the end or at the contact, outcome) of every action."""
        acceleration = self.controller.command(car, pedestrian)
        for action in range(ACTION_COUNT + 1):
            place(self.world, car, pedestrian, tick)
            self.world._rng.bit_generator.state = self.noise[tick]
            contact = self.world.step(acceleration, self.velocity(action, tick))
            after = self.world.pedestrian
            end, time = np.array(after[:2]), tick + 1.0
            if contact is not None:
                end, time = touching([pedestrian[:2], after[:2]], contact)[-1], tick + contact.fraction
            away = float(np.linalg.norm(end - self.along(time)))
            outcome = self.episode.outcome(tick + 1, after, collided=contact is not None)
            yield action, self.world.car, after, away, outcome


def brute_force(episode: Episode) -> float:
    """Return the least deformation over all sequences of seven actions, every step made by the world; infinity: none.

    Only what has strayed more than a collision found before is not followed any further.
    """
    steps = Steps(episode)
    best = math.inf

    def visit(car: CarState, pedestrian: PedestrianState, tick: int, strayed: float) -> None:
        nonlocal best
        for _, car_to, to, away, outcome in list(steps.after(car, pedestrian, tick)):
            if max(strayed, away) < best:
                if outcome == Outcome.COLLISION:
                    best = max(strayed, away)
                elif outcome == Outcome.RUNNING:
                    visit(car_to, to, tick + 1, max(strayed, away))

    visit(steps.world.car, steps.world.pedestrian, 0, 0.0)
    return best


def least_by_layers(episode: Episode, limit: float) -> float:
    """Return the least deformation up to the limit, tick by tick, in a dictionary of all that can be reached."""
    steps = Steps(episode)
    best = math.inf
    layer = {0: (steps.world.car, steps.world.pedestrian, 0.0)}
    for tick in range(episode.scenario.ticks):
        following: dict[object, tuple[CarState, PedestrianState, float]] = {}
        for car, pedestrian, strayed in layer.values():
            for _, car_to, to, away, outcome in steps.after(car, pedestrian, tick):
                total = max(strayed, away)
                if total > limit:
                    continue
                if outcome == Outcome.COLLISION:
                    best = min(best, total)
                elif outcome == Outcome.RUNNING:
                    key = (round(to.x, 9), round(to.y, 9), car_to)
                    if key not in following or total < following[key][2]:
                        following[key] = (car_to, to, total)
        layer = following
    return best


def check_witness(episode: Episode, upper_bound: float | None = None) -> float:
    """Run the floor's actions through the world by hand; return the floor, infinity without one."""
    found = deformation_floor(episode, upper_bound)
    if found is None:
        return math.inf
    steps = Steps(episode)
    car, pedestrian, strayed, outcome = steps.world.car, steps.world.pedestrian, 0.0, Outcome.RUNNING
    for tick, chosen in enumerate(found.actions.tolist()):
        assert outcome == Outcome.RUNNING
        (step,) = [step for step in steps.after(car, pedestrian, tick) if step[0] == chosen]
        _, car, pedestrian, away, outcome = step
        strayed = max(strayed, away)
    assert outcome == Outcome.COLLISION
    assert found.distance == pytest.approx(strayed, abs=1e-9)
    assert len(found.trajectory) == len(found.actions) + 1
    assert len(found.actions) - 1 <= found.duration <= len(found.actions)
    return found.distance


def lattice_path(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return a crossing of `count` points whose steps are actions."""
    actions = rng.choice([2, 2, 3, 4, 5], count - 1)
    steps = [np.array(action_velocity(action, 2.5)) * TIME_STEP for action in actions.tolist()]
    return np.cumsum(np.vstack([[-2.4, 0.1], steps]), axis=0)


@settings(max_examples=25)
@given(
    seed=st.integers(0, 1000),
    count=st.integers(2, 9),
    lattice=st.booleans(),
    ticks=st.integers(2, 5),
    multiplier=st.sampled_from([0.0, 0.2, 0.5, 0.75, 1.0, 1.15, 1.5]),
    gap=st.floats(0.5, 9.0),
    impact=st.sampled_from([0.0, 0.0, 3.0, 6.0]),
)
def test_equals_brute_force(seed, count, lattice, ticks, multiplier, gap, impact):
    rng = np.random.default_rng(seed)
    points = lattice_path(rng, count) if lattice else bent(rng, count)
    episode = kamikaze_episode(points, ticks, multiplier, seed, gap=gap, impact=impact)
    exact = brute_force(episode)
    assert check_witness(episode) == pytest.approx(exact, abs=1e-9)
    if math.isfinite(exact):
        assert check_witness(episode, exact) == pytest.approx(exact, abs=1e-9)
        assert check_witness(episode, 2.0 * exact + 1.0) == pytest.approx(exact, abs=1e-9)
        if exact > 1e-6:
            assert deformation_floor(episode, 0.99 * exact) is None


@pytest.mark.parametrize(("cells", "tolerance"), [(8, 0.0), (24, 0.0), (16, 0.02)])
def test_the_chart_leaves_nothing_out(monkeypatch, cells, tolerance):
    monkeypatch.setattr(clairvoyant_deformation, "_EFFORTS", ((1 << 14, cells, tolerance, False),))
    for seed in range(8):
        points = bent(np.random.default_rng(seed), 7)
        episode = kamikaze_episode(points, 5, (0.5, 1.0, 1.5)[seed % 3], seed, gap=2.0 + seed)
        exact = brute_force(episode)
        found = check_witness(episode)
        assert exact - 1e-9 <= found <= exact + tolerance + 1e-9 or found == exact == math.inf


def test_without_room_something_is_found_whose_gap_holds(monkeypatch):
    gaps = []
    for seed in range(6):
        episode = kamikaze_episode(bent(np.random.default_rng(seed), 9), 20, 1.0, seed)
        monkeypatch.undo()
        known = deformation_floor(episode)
        monkeypatch.setattr(clairvoyant_deformation, "_EFFORTS", ((1 << 8, 16, 0.5, True),))
        found = deformation_floor(episode)
        assert known is not None
        assert found is not None
        assert found.distance - found.gap - 1e-9 <= known.distance <= found.distance + known.gap + 1e-9
        gaps.append(found.gap)
    assert max(gaps) > 0.0


@pytest.mark.parametrize(("multiplier", "gap", "seed"), [(0.5, 5.0, 1), (1.0, 8.0, 2), (1.15, 3.0, 3), (0.75, 9.0, 4)])
def test_equals_brute_force_over_six_ticks(multiplier, gap, seed):
    episode = kamikaze_episode(bent(np.random.default_rng(seed), 9), 6, multiplier, seed, gap=gap)
    exact = brute_force(episode)
    assert math.isfinite(exact)
    assert check_witness(episode) == pytest.approx(exact, abs=1e-9)


@pytest.mark.parametrize(("multiplier", "seed"), [(0.5, 1), (0.875, 2), (1.0, 3), (1.15, 4), (1.15, 5), (1.3, 6)])
def test_equals_a_plain_search_over_whole_episodes(multiplier, seed):
    episode = kamikaze_episode(lattice_path(np.random.default_rng(seed), 8), 40, multiplier, seed)
    floor = check_witness(episode)
    assert math.isfinite(floor)
    assert least_by_layers(episode, floor + 1e-9) == pytest.approx(floor, abs=1e-9)


@pytest.mark.parametrize(("multiplier", "seed"), [(0.75, 1), (1.0, 2), (1.15, 3)])
def test_a_plain_search_finds_nothing_below_the_gap_where_every_step_of_phi_is_another(multiplier, seed):
    rng = np.random.default_rng(seed)
    steps = np.column_stack([rng.uniform(0.3, 0.45, 16), rng.normal(0.0, 0.05, 16)])
    points = np.cumsum(np.vstack([[-3.0, 0.0], steps]), axis=0)
    episode = kamikaze_episode(points, 30, multiplier, seed)
    found = deformation_floor(episode)
    assert found is not None
    assert found.gap <= 0.01
    assert least_by_layers(episode, found.distance - found.gap - 1e-9) == math.inf


@pytest.mark.parametrize("multiplier", [0.5, 0.75, 1.0, 1.15])
def test_no_kamikaze_that_was_run_comes_closer(multiplier):
    points = [(-3.5 + 0.75 * k, 0.3 * math.sin(k)) for k in range(8)]
    episode = kamikaze_episode(points, multiplier=multiplier, simulations=100)
    steps = Steps(episode)
    log = run_episode(episode)
    assert log.outcome == Outcome.COLLISION
    times = [*range(len(log.pedestrian) - 1), log.impact_time / TIME_STEP]
    ends = log.trajectory.positions
    own = max(float(np.linalg.norm(end - steps.along(time))) for end, time in zip(ends, times, strict=True))
    assert check_witness(episode, own) <= own + 1e-9
    assert check_witness(episode, own) == check_witness(episode)


def test_whoever_is_hit_along_phi_need_not_stray():
    points = [(-3.5 + 0.75 * k, 0.0) for k in range(8)]
    hit = 0
    for number in range(12):
        episode = kamikaze_episode(points, multiplier=0.5, number=number)
        log = run_episode(replace(episode, mode=Mode.REPLAY))
        if log.outcome == Outcome.COLLISION:
            hit += 1
            assert check_witness(episode) <= 1e-9
        else:
            assert check_witness(episode) > 1e-9
    assert 0 < hit < 12


def test_an_impact_speed_that_the_car_never_has_leaves_no_floor():
    assert deformation_floor(kamikaze_episode([(-3.5, 0.0), (2.0, 0.0)], 10, impact=30.0)) is None


def test_only_kamikaze_episodes_with_the_basic_car_have_a_floor():
    episode = kamikaze_episode([(-3.5, 0.0), (2.0, 0.0)])
    with pytest.raises(ValueError, match="my_module:Car"):
        deformation_floor(replace(episode, controller="my_module:Car"))
    car = replace(CROSSING.car, dynamics="multi_body")
    with pytest.raises(ValueError, match="multi_body"):
        deformation_floor(replace(episode, scenario=replace(CROSSING, car=car)))
