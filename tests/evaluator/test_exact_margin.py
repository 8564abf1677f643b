"""The exact margin against a plain search through the real world."""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from search_support import CROSSING, TIME_STEP, any_touch, bent, kamikaze_episode, place, touching
from skd_adversary.crossing.road_users import action_velocity
from skd_evaluator.assessment.run.episodes import run_episode
from skd_evaluator.margin.exact import exact
from skd_evaluator.margin.exact.exact import exact_margin
from skd_evaluator.metrics.deviation import Hit, deviation
from skd_sim import AdversaryState, CarState, EpisodeSpec, Mode, Outcome, load_scenario
from skd_sim.controllers.basic import BasicController
from skd_sim.world.episode import Role, generator
from skd_sim.world.world import Contact, World, make_world

DIAGONAL = math.sqrt(0.5)
DIRECTIONS = ((0.0, 1.0), (0.0, -1.0), (1.0, 0.0), (DIAGONAL, DIAGONAL), (DIAGONAL, -DIAGONAL))
FULL_ONLY, BOTH = (1.0,), (1.0, 0.5)
Step = tuple[CarState, AdversaryState, float, Contact | None, Outcome]


def trial(points, ticks=40, multiplier=1.0, seed=0, gap=None, impact=0.0, hit=0.556, eta_max=5.0) -> EpisodeSpec:
    episode = kamikaze_episode(points, ticks, multiplier, seed, gap=gap, impact=impact)
    collision = replace(episode.scenario.collision, hit_speed=hit)
    return replace(episode, scenario=replace(episode.scenario, collision=collision, eta_max=eta_max))


class Steps:
    """The world of an episode, whose steps can be taken from anywhere; and the distance from φ, by its definition."""

    def __init__(self, episode: EpisodeSpec, paces: tuple[float, ...] = BOTH) -> None:
        self.episode, self.paces = episode, paces
        self.world: World = make_world(episode)
        self.controller = BasicController(episode.multiplier)
        self.controller.reset(episode.scenario, np.random.default_rng(0))
        self.phi = episode.safe_trajectory.positions
        draws = generator(episode.seed, episode.episode_id, Role.CAR)
        self.noise = []
        for _ in range(episode.scenario.ticks):
            self.noise.append(draws.bit_generator.state)
            draws.random(2)

    def along(self, time: float) -> np.ndarray:
        time = min(time, len(self.phi) - 1)
        before = min(int(time), max(0, len(self.phi) - 2))
        after = min(before + 1, len(self.phi) - 1)
        return self.phi[before] + (time - before) * (self.phi[after] - self.phi[before])

    def velocities(self, tick: int) -> list[tuple[float, float]]:
        """Return those of all moves: stay, as φ, five directions at each pace."""
        x, y = (self.along(tick + 1) - self.along(tick)) / TIME_STEP
        speed = self.episode.scenario.adversary.speed
        own = [(pace * speed * east, pace * speed * north) for pace in self.paces for east, north in DIRECTIONS]
        return [(0.0, 0.0), (float(x), float(y)), *own]

    def after(self, car: CarState, adversary: AdversaryState, tick: int) -> Iterator[Step]:
        """Yield (car, adversary, distance from φ at the end or at the contact, contact, outcome) of every way."""
        acceleration = self.controller.command(car, adversary)
        for velocity in self.velocities(tick):
            place(self.world, car, adversary, tick)
            self.world._rng.bit_generator.state = self.noise[tick]
            contact = self.world.step(acceleration, velocity)
            after = self.world.adversary
            end, time = np.array(after[:2]), tick + 1.0
            if contact is not None:
                end, time = touching([adversary[:2], after[:2]], contact)[-1], tick + contact.fraction
            away = float(np.linalg.norm(end - self.along(time)))
            outcome = self.episode.outcome(tick + 1, after, collided=contact is not None)
            yield self.world.car, after, away, contact, outcome


def plain_search(episode: EpisodeSpec, limit: float = math.inf, paces: tuple[float, ...] = BOTH) -> float:
    """Return the least deviation up to the limit, tick by tick, in a dictionary of all that can be reached.

    Every step is made by the world; infinity: there is none.
    """
    steps = Steps(episode, paces)
    best = math.inf
    layer = {0: (steps.world.car, steps.world.adversary, 0.0)}
    for tick in range(episode.scenario.ticks):
        following: dict[object, tuple[CarState, AdversaryState, float]] = {}
        for car, adversary, strayed in layer.values():
            for car_to, to, away, contact, outcome in steps.after(car, adversary, tick):
                total = max(strayed, away)
                if total > limit:
                    continue
                if contact is not None and contact.speed >= episode.scenario.collision.hit_speed:
                    best = min(best, total)
                elif outcome == Outcome.RUNNING:
                    key = (round(to.x, 9), round(to.y, 9), car_to)
                    if key not in following or total < following[key][2]:
                        following[key] = (car_to, to, total)
        layer = following
    return best


def checked(episode: EpisodeSpec, upper_bound: float | None = None) -> float:
    """Return the margin, infinity where there is none; look at the way that comes with it, step by step."""
    found = exact_margin(episode, upper_bound)
    if found is None:
        return math.inf
    check_way(episode, found)
    return found.distance


def check_way(episode: EpisodeSpec, found: Hit) -> None:
    """Walk a way in the world; every step has to be one of the moves, and the last one, and no other, a collision."""
    steps = Steps(episode)
    walked = found.trajectory.positions
    car, adversary = steps.world.car, steps.world.adversary
    assert tuple(walked[0]) == adversary[:2]
    last = len(walked) - 2
    assert last <= found.duration <= last + 1
    for tick in range(last + 1):
        share = found.duration - last if tick == last else 1.0
        for step in steps.after(car, adversary, tick):
            _, to, _, contact, outcome = step
            end = adversary[0] + share * (to.x - adversary.x), adversary[1] + share * (to.y - adversary.y)
            ends = contact is not None and abs(contact.fraction - share) < 1e-9
            if max(abs(end[0] - walked[tick + 1][0]), abs(end[1] - walked[tick + 1][1])) < 1e-9 and (
                ends if tick == last else outcome == Outcome.RUNNING
            ):
                break
        else:
            raise AssertionError(f"step {tick} is none of the moves")
        if tick == last:
            assert contact.speed == pytest.approx(found.impact_speed, abs=1e-9)
            assert contact.speed >= episode.scenario.collision.hit_speed
        car, adversary = step[:2]
    assert deviation(steps.phi, walked, found.duration) == found.distance


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
    ticks=st.integers(2, 4),
    multiplier=st.sampled_from([0.0, 0.2, 0.5, 0.75, 1.0, 1.15, 1.5]),
    gap=st.floats(0.5, 6.0),
    impact=st.sampled_from([0.0, 0.0, 3.0, 6.0]),
    hit=st.sampled_from([0.0, 0.556, 4.0, 7.0, 8.2]),
)
def test_equals_a_plain_search_of_few_ticks(seed, count, lattice, ticks, multiplier, gap, impact, hit):
    rng = np.random.default_rng(seed)
    points = lattice_path(rng, count) if lattice else bent(rng, count)
    episode = trial(points, ticks, multiplier, seed, gap=gap, impact=impact, hit=hit, eta_max=20.0)
    least = plain_search(episode)
    assert checked(episode) == pytest.approx(least, abs=1e-9)
    if math.isfinite(least):
        assert checked(episode, least) == pytest.approx(least, abs=1e-9)
        assert checked(episode, 2.0 * least + 1.0) == pytest.approx(least, abs=1e-9)
        if least > 1e-6:
            assert exact_margin(episode, 0.99 * least) is None


@pytest.mark.parametrize(("multiplier", "seed"), [(0.5, 1), (0.875, 2), (1.0, 3)])
def test_equals_a_plain_search_over_whole_episodes(multiplier, seed):
    episode = trial(lattice_path(np.random.default_rng(seed), 8), 40, multiplier, seed)
    found = exact_margin(episode)
    assert found.gap == 0.0
    assert plain_search(episode, found.distance + 1e-9) == pytest.approx(found.distance, abs=1e-9)


@pytest.mark.parametrize(("multiplier", "seed"), [(0.75, 1), (1.0, 2), (1.15, 3)])
def test_there_is_nothing_below_the_gap_where_every_step_of_phi_is_another(multiplier, seed):
    rng = np.random.default_rng(seed)
    steps = np.column_stack([rng.uniform(0.3, 0.45, 16), rng.normal(0.0, 0.05, 16)])
    episode = trial(np.cumsum(np.vstack([[-3.0, 0.0], steps]), axis=0), 30, multiplier, seed)
    found = exact_margin(episode)
    check_way(episode, found)
    assert found.gap <= 0.02 * found.distance
    # Without half speeds there are few enough places for a plain search, and a margin of less moves is no less.
    assert plain_search(episode, found.distance - found.gap - 1e-9, FULL_ONLY) == math.inf


@pytest.mark.parametrize("seed", range(6))
def test_without_room_for_all_the_gap_holds(monkeypatch, seed):
    episode = trial(lattice_path(np.random.default_rng(seed), 8), 40, (1.0, 1.15)[seed % 2], seed)
    known = exact_margin(episode)
    monkeypatch.setattr(exact, "_EFFORTS", ((1 << 10, 1 << 6, True),))
    found = exact_margin(episode)
    assert known.gap == 0.0
    check_way(episode, found)
    assert found.distance - found.gap - 1e-9 <= known.distance <= found.distance + 1e-9


def test_whoever_walks_into_a_car_that_stands_or_nearly_is_not_hit_by_it():
    points = [(-3.5 + 0.25 * k, 0.0) for k in range(23)]
    walked_into = 0
    for seed in range(12):
        episode = trial(points, multiplier=1.0, seed=seed)
        run = run_episode(replace(episode, mode=Mode.REPLAY))
        if run.outcome == Outcome.COLLISION and run.impact_speed < 0.556:
            walked_into += 1
            assert checked(any_touch(episode)) <= 1e-9
            assert checked(episode) > 0.05
    assert walked_into > 0


def test_a_car_that_nobody_can_be_hit_by_within_eta_max_has_no_way():
    points = [(-3.5 + 0.75 * k, 0.0) for k in range(8)]
    assert exact_margin(trial(points, 10, hit=30.0)) is None
    far = trial(points, multiplier=1.5, seed=2, eta_max=8.0)
    found = exact_margin(far)
    within = replace(far, scenario=replace(far.scenario, eta_max=0.999 * found.distance))
    assert exact_margin(within) is None
    assert checked(within, 1.001 * found.distance) == found.distance


def test_only_what_is_predictable_has_an_exact_margin():
    episode = kamikaze_episode([(-3.5, 0.0), (2.0, 0.0)])
    with pytest.raises(ValueError, match="my_module:Car"):
        exact_margin(replace(episode, controller="my_module:Car"))
    car = replace(CROSSING.car, dynamics="multi_body")
    with pytest.raises(ValueError, match="multi_body"):
        exact_margin(replace(episode, scenario=replace(CROSSING, car=car)))
    with pytest.raises(ValueError, match="cyclist"):
        exact_margin(replace(episode, scenario=load_scenario("cyclist")))
    with pytest.raises(ValueError, match="more often than once a tick"):
        exact_margin(replace(episode, scenario=replace(CROSSING, control_period=0.1)))
    with pytest.raises(ValueError, match="SAFE"):
        exact_margin(replace(episode, mode=Mode.SAFE))
