"""The margin found for any car: against brute force and the exact one, and for cars and roads that are hard to ask."""

from __future__ import annotations

import copy
import math
import threading
from dataclasses import replace

import numpy as np
import pytest
from search_support import CROSSING, bent, kamikaze_episode
from skd_evaluator.campaign.judge.rating import rate
from skd_evaluator.campaign.plan.plan import Plan
from skd_evaluator.campaign.run.runner import run_episode
from skd_evaluator.campaign.run.workers import InProcessRunner
from skd_evaluator.margin.assessment_margin import least_ways, with_margins
from skd_evaluator.margin.exact.exact import exact_margin
from skd_evaluator.margin.search.attempts import searched_margins
from skd_evaluator.margin.search.search import search_margin
from skd_evaluator.margin.ways.ways import velocities
from skd_evaluator.measure.distances.deformation import deformation
from skd_sim.choices.knowledge import Knowledge
from skd_sim.controllers import BasicController
from skd_sim.encounter.scenario import load_scenario
from skd_sim.episode.episode import Episode, Mode, Outcome
from skd_sim.episode.randomness import controller_generator, controller_seed
from skd_sim.geometry.trajectory import Trajectory
from skd_sim.simulation.branching import Branch
from skd_sim.simulation.world import make_world
from skd_sim.state import AdversaryState, CarState

POINTS = [(-3.5 + 0.75 * k, 0.3 * math.sin(k)) for k in range(8)]


class Delayed(BasicController):
    """Does in each tick what it wanted in the tick before, and brakes on for two more: it has a state."""

    def __init__(self) -> None:
        super().__init__(1.0)

    def reset(self, scenario, rng) -> None:
        super().reset(scenario, rng)
        self.wanted = [0.0, 0.0]
        self.noise = rng

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        self.wanted.append(super().command(car, adversary) * (0.8 + 0.2 * self.noise.random()))
        return min(self.wanted[-3:-1])


class Uncopyable(BasicController):
    """The basic controller with something in it of which no copy can be made."""

    def __init__(self) -> None:
        super().__init__(1.0)
        self.lock = threading.Lock()


_memory: list[float] = []


class Forgetful(BasicController):
    """Counts its decisions outside of itself, so that a copy of it is not the same car: it never brakes twice."""

    def __init__(self) -> None:
        super().__init__(1.15)

    def reset(self, scenario, rng) -> None:
        super().reset(scenario, rng)
        _memory.clear()

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        wanted = super().command(car, adversary)
        _memory.append(wanted)
        return wanted if sum(one < 0.0 for one in _memory) <= 1 else 0.0


def episodes(multiplier: float, count: int = 3) -> list[Episode]:
    return [kamikaze_episode(POINTS, 40, multiplier, number=number) for number in range(count)]


def short(number: int, ticks: int, control_period: float | None = None) -> Episode:
    """Return an episode of few ticks, in which the car is near from the start."""
    points = bent(np.random.default_rng(number), 6) + np.array([0.3, 0.0])
    episode = kamikaze_episode(points, ticks, number=number, gap=2.0)
    return replace(episode, scenario=replace(episode.scenario, control_period=control_period))


def brute_force(episode: Episode, make) -> float:
    """Return the least deformation of all sequences of ways; infinity: none within η_max."""
    phi = episode.safe_trajectory.positions
    least = math.inf

    def follow(world, controller, walked: list[tuple[float, float]]) -> None:
        nonlocal least
        tick = len(walked) - 1
        for velocity in velocities(episode.scenario, phi, tick, np.array(walked)):
            after, driver = copy.deepcopy((world, controller))
            contact = None
            while contact is None and after.tick == tick:
                contact = after.step(driver.command(after.car, after.adversary), tuple(velocity.tolist()))
            here = after.adversary
            if contact is not None:
                if contact.speed >= episode.scenario.collision.hit_speed:
                    x, y = walked[-1]
                    at = (x + contact.fraction * (here.x - x), y + contact.fraction * (here.y - y))
                    least = min(least, deformation(phi, np.array([*walked, at]), tick + contact.fraction))
            elif episode.outcome(tick + 1, here, collided=False) == Outcome.RUNNING:
                follow(after, driver, [*walked, (here.x, here.y)])

    controller = make()
    controller.reset(episode.scenario, controller_generator(controller_seed(episode.seed, episode.episode_id)))
    world = make_world(episode)
    follow(world, controller, [(world.adversary.x, world.adversary.y)])
    return least if least <= episode.scenario.eta_max else math.inf


def found(result) -> float:
    return math.inf if result.way is None else result.way.distance


@pytest.mark.parametrize(("ticks", "period", "count"), [(3, None, 4), (2, 0.1, 6)])
def test_of_a_car_with_a_state_it_is_what_brute_force_finds(ticks, period, count):
    margins = []
    for number in range(count):
        episode = short(number, ticks, period)
        result = search_margin(episode, 5000, controller=Delayed)
        assert found(result) == pytest.approx(brute_force(episode, Delayed), abs=1e-9)
        assert result.exhausted or found(result) == 0.0
        margins.append(found(result))
    assert len(set(margins)) > 2


@pytest.mark.parametrize("multiplier", [0.5, 1.0, 1.15])
def test_never_below_the_exact_margin_and_near_it(multiplier):
    reached, least = [], []
    crooked = [kamikaze_episode(bent(np.random.default_rng(seed), 9), 30, multiplier, seed) for seed in range(2)]
    for episode in [*episodes(multiplier), *crooked]:
        result, exact = search_margin(episode, 256), exact_margin(episode)
        assert exact is not None
        assert found(result) >= exact.distance - exact.gap - 1e-9
        assert result.way is None or result.way.gap > 0.0 or found(result) <= exact.distance + 1e-9
        reached.append(min(found(result), 5.0))
        least.append(exact.distance)
    assert np.mean(reached) <= 1.05 * np.mean(least) + 1e-9


def test_a_longer_budget_goes_on_and_the_same_one_finds_the_same():
    for episode in episodes(1.15):
        distances, long = [], search_margin(episode, 256)
        for power in range(9):
            result = search_margin(episode, 1 << power)
            assert result.simulated_ticks <= 1 << power
            assert np.array_equal(result.trace, long.trace[: power + 1])
            distances.append(found(result))
        assert distances == sorted(distances, reverse=True)
        again = search_margin(episode, 256)
        assert again.way is not None
        assert long.way is not None
        assert np.array_equal(again.way.trajectory.positions, long.way.trajectory.positions)
        assert np.array_equal(again.samples, long.samples)


def test_where_phi_itself_is_hit_nothing_else_is_tried():
    episode = kamikaze_episode(POINTS, 40, 0.0)
    along = run_episode(replace(episode, mode=Mode.REPLAY))
    assert along.outcome == Outcome.COLLISION
    result = search_margin(episode, 100)
    assert result.way is not None
    assert result.way.distance <= 1e-12
    assert result.way.gap == 0.0
    assert result.way.impact_speed == pytest.approx(along.impact_speed)
    assert result.simulated_ticks <= 40


def test_a_touch_that_is_too_slow_ends_the_way():
    walked_in = 0
    for number in range(8):
        episode = short(number, 2)
        slow = replace(
            episode, scenario=replace(episode.scenario, collision=replace(CROSSING.collision, hit_speed=7.5))
        )
        result = search_margin(slow, 5000, controller=Delayed)
        assert found(result) == pytest.approx(brute_force(slow, Delayed), abs=1e-9)
        assert result.way is None or result.way.impact_speed >= 7.5
        walked_in += found(result) > found(search_margin(episode, 5000, controller=Delayed)) + 1e-9
    assert walked_in


def test_never_above_the_way_it_begins_with():
    for episode in episodes(1.0):
        log = run_episode(replace(episode, simulations=50))
        if log.outcome != Outcome.COLLISION or log.impact_speed < CROSSING.collision.hit_speed:
            continue
        own = deformation(POINTS, log.trajectory.positions, log.impact_time / CROSSING.time_step)
        result = search_margin(episode, 30, [log.trajectory.positions])
        assert found(result) <= own + 1e-9
        again = search_margin(episode, 30, [result.way.trajectory.positions])
        assert found(again) <= found(result) + 1e-9


@pytest.mark.parametrize(
    ("controller", "scenario"),
    [("carla", "crossing"), ("cal", "crossing"), ("basic", "crossing_multi_body"), ("basic", "right_turn")],
)
def test_other_cars_and_roads_are_hit_as_the_search_says(controller, scenario):
    setting = Plan(load_scenario(scenario), controller=controller).scenario
    known = replace(kamikaze_episode(POINTS), knowledge=Knowledge.NOTHING)
    episode = replace(known, scenario=setting, controller=controller)
    result = search_margin(episode, 120)
    assert result.way is not None
    way = result.way
    assert way.distance == pytest.approx(deformation(POINTS, way.trajectory.positions, way.duration), abs=1e-12)
    assert way.impact_speed >= setting.collision.hit_speed


def test_a_cyclist_goes_its_own_ways():
    scenario = load_scenario("cyclist")
    points = np.column_stack([np.arange(-10.0, 4.0, 1.2), np.zeros(12)])
    episode = replace(kamikaze_episode(points), scenario=scenario)
    result = search_margin(episode, 300)
    assert result.way is not None
    walked = result.way.trajectory.positions
    for tick in range(len(walked) - 2):
        step = (walked[tick + 1] - walked[tick]) / scenario.time_step
        can = velocities(scenario, points, tick, walked[: tick + 1])
        assert np.abs(can - step).max(axis=1).min() <= 1e-9
    assert result.way.distance == pytest.approx(deformation(points, walked, result.way.duration), abs=1e-12)


def test_a_controller_that_cannot_be_copied_is_run_again_from_the_start():
    episode = episodes(1.0, 1)[0]
    assert not Branch(episode, Uncopyable).can_be_copied()
    again, copied = search_margin(episode, 80, controller=Uncopyable), search_margin(episode, 80)
    assert found(again) == found(copied) < math.inf


def test_what_a_controller_keeps_outside_of_itself_does_not_mislead():
    result = search_margin(episodes(1.15, 1)[0], 80, controller=Forgetful)
    assert result.way is not None  # its hit was seen in a run from the start


def test_none_where_nobody_can_be_hit():
    episode = kamikaze_episode([(-3.5, 0.0), (2.0, 0.0)], 8)
    fast = replace(episode, scenario=replace(episode.scenario, collision=replace(CROSSING.collision, hit_speed=30.0)))
    assert search_margin(fast, 200).way is None


def test_attempts_teach_each_other_and_go_on_until_the_mean_stands_still():
    told: list[tuple[str, int, int]] = []
    some = episodes(1.15, 20)
    with InProcessRunner(1) as one, InProcessRunner(2) as two:
        margins = searched_margins(some, [()] * 20, one, lambda *what: told.append(what), 16, 128)
        again = searched_margins(some, [()] * 20, two, lambda *_: None, 16, 128)
    assert [found(result) for result in margins.results] == [found(result) for result in again.results]
    assert margins.means == again.means
    assert told[19][1:] == (20, 20)
    means = [mean for _, mean in margins.means]
    assert means == sorted(means, reverse=True)
    assert means[-1] == pytest.approx(np.mean([min(found(one), 5.0) for one in margins.results]))
    before, after = means[-2:]
    assert margins.converged == (before - after <= 0.02 * before or all(one.exhausted for one in margins.results))
    assert margins.converged or margins.budget == 128


@pytest.mark.parametrize(("hit_speed", "missed"), [(30.0, 3), (0.556, 0)])
def test_a_mean_that_stands_still_because_hardly_anything_was_found_is_said(hit_speed, missed):
    """Where a hit would begin at 30 m/s there is none: the mean is η_max from the first tick on, and is to say so."""
    scenario = replace(CROSSING, collision=replace(CROSSING.collision, hit_speed=hit_speed))
    plan = Plan(
        scenario, controller="carla", knowledge=Knowledge.NOTHING, safe_count=1, kamikaze_count=3, collision_runs=1,
        simulations=1,
    )  # fmt: skip
    phi = Trajectory(np.array(POINTS), 0.3, "phi")
    with InProcessRunner(1) as runner:
        rating = rate(plan, [plan.objective], [phi], runner, lambda *_: None)
        found = with_margins(rating, runner, lambda *_: None, 64)
    assert found.margins is not None
    assert found.margins.beyond == missed
    said = [line for line in found.warnings if f"has found no hit in {missed} of 3 attempts" in line]
    assert len(said) == (1 if missed else 0)
    assert found.margins.converged or not missed


def test_bad_questions_are_refused():
    episode = episodes(1.0, 1)[0]
    with pytest.raises(ValueError, match="REPLAY"):
        search_margin(replace(episode, mode=Mode.REPLAY))
    with pytest.raises(ValueError, match="at least 1"):
        search_margin(episode, 0)
    with pytest.raises(ValueError, match="no mean"):
        searched_margins([], [], InProcessRunner(1), lambda *_: None)


def test_a_limit_below_the_usual_budget_is_kept():
    with InProcessRunner(1) as runner:
        found = least_ways([short(0, 9, 0.1), short(1, 9, 0.1)], lambda: [(), ()], runner, lambda *_: None, 8)
    assert found.budget == 8


def test_a_hit_from_beyond_eta_max_is_a_beginning_for_a_car_and_never_the_result():
    """φ stays on the lane beside, 3.5 m away, where no two cars touch: the way that is found is a hit within η_max."""
    phi = Trajectory(np.column_stack([np.full(16, -3.5), -8.0 + 2.7 * np.arange(16)]), 0.3)
    scenario = load_scenario("cut_in")
    found = []
    for number in range(4):
        episode = Episode(scenario, Mode.KAMIKAZE, 1, number, safe_trajectory=phi, multiplier=0.75)
        near = search_margin(replace(episode, scenario=replace(scenario, eta_max=2.0)), 512)
        if near.way is not None:
            found.append(near.way.distance)
        assert near.trace[np.isfinite(near.trace)].max(initial=0.0) <= 2.0
        assert near.simulated_ticks <= 512
    assert len(found) >= 2
    assert max(found) <= 2.0
    assert min(found) > 3.5 - 0.9 - math.hypot(2.25, 0.9)  # as far aside as a box reaches, at most


def least_of_one_action(episode: Episode) -> float:
    """Return the least deformation of all ways that leave φ at some tick for one action, and keep that up."""
    scenario, phi = episode.scenario, episode.safe_trajectory.positions
    least = scenario.eta_max
    for leaving in range(len(phi) - 1):
        for way in range(7):
            branch = Branch(episode)
            user, contact = branch.world.adversary, None
            walked = [user[:2]]
            while contact is None and len(walked) < min(len(phi), leaving + 9):
                tick = len(walked) - 1
                choices = velocities(scenario, phi, tick, np.array(walked))
                user, contact = branch.go_on(user, tuple(choices[way if tick >= leaving else -1].tolist()))
                walked.append(user[:2])
            if contact is not None and contact.speed >= scenario.collision.hit_speed:
                begin = np.array(walked[-2])
                at = begin + contact.fraction * (np.array(walked[-1]) - begin)
                least = min(least, deformation(phi, np.array([*walked[:-1], at]), len(walked) - 2 + contact.fraction))
    return least


def test_of_a_car_that_decides_often_a_driver_who_leaves_phi_once_is_found_with_few_ticks():
    """φ goes by on the lane beside. Walks up to the car from where it has passed found nothing in these two."""
    scenario = replace(load_scenario("oncoming_turn"), control_period=0.05)
    phi = Trajectory(np.column_stack([np.full(20, -3.5), 24.0 - 2.5 * np.arange(20)]), scenario.time_step)
    for number in range(1, 3):
        episode = Episode(scenario, Mode.KAMIKAZE, 1, number, safe_trajectory=phi, multiplier=0.5)
        least = least_of_one_action(episode)
        assert least < 1.5
        assert found(search_margin(episode, 192)) <= least + 1e-9
