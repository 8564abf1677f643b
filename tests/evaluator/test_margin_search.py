"""The margin that the search finds: against brute force, the exact margin, and for cars and roads of all kinds."""

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from search_support import CROSSING, TIME_STEP, bent, kamikaze_episode
from skd_evaluator import AssessmentError, Plan, assess, deviation, run_episode
from skd_evaluator.assessment.plan import EpisodeGroup, episode_id
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages.margin import minimal_deviations
from skd_evaluator.margin.actions import velocities
from skd_evaluator.margin.exact.exact import exact_margin
from skd_evaluator.margin.search.detours import detour
from skd_evaluator.margin.search.group import Group, search
from skd_evaluator.margin.search.rounds import confirmed, in_processes
from skd_evaluator.margin.search.search import IN_PROCESS, WARM_START, Earlier, Effort, SearchedMargins, search_margins
from skd_evaluator.margin.search.trial import prescribed
from skd_sim import AdversaryState, CarState, Controller, Trajectory, UsageError, load_scenario
from skd_sim.controllers.basic import BasicController
from skd_sim.controllers.controller import make_controller
from skd_sim.options.car_and_adversary import AdversaryModel
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Mode, Outcome, controller_generator, controller_seed
from skd_sim.world.world import make_world

POINTS = [(-3.5 + 0.75 * k, 0.3 * math.sin(k)) for k in range(8)]
LITTLE = Effort(16, 64)
LONG = Effort(64, 128)


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


class Moody(Controller):
    """A basic car that brakes a little differently in every episode, whatever reset hands it."""

    def __init__(self) -> None:
        self._basic, self._rng = BasicController(1.0), np.random.default_rng(3)

    def reset(self, scenario, rng) -> None:
        self._basic.reset(scenario, rng)
        self._share = self._rng.uniform(0.6, 1.0)

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        return self._share * self._basic.command(car, adversary)


class Driver:
    """Drives all candidates with one controller, and runs episodes with it as a runner does."""

    def __init__(self, controller: Controller) -> None:
        self.controller, self.driven = controller, list[EpisodeSpec]()

    def run(self, episodes: Sequence[EpisodeSpec]) -> list[EpisodeLog]:
        self.driven += episodes
        return [run_episode(episode, self.controller) for episode in episodes]

    def rounds(self, groups: Sequence[Group], _what: str) -> list[Group]:
        search(groups, self.run)
        return list(groups)


def searched(
    episodes: Sequence[EpisodeSpec], effort: Effort = LONG, make: Callable[[], Controller] | None = None
) -> SearchedMargins:
    first = episodes[0]
    controller = make_controller(first.controller, first.multiplier) if make is None else make()
    return search_margins(episodes, {}, Driver(controller).rounds, effort)


def found(margins: SearchedMargins) -> float:
    (hit,) = margins.hits
    return math.inf if hit is None else hit.distance


def episodes(multiplier: float, count: int = 3) -> list[EpisodeSpec]:
    first = kamikaze_episode(POINTS, 40, multiplier)
    return [replace(first, episode_id=episode_id(EpisodeGroup.KAMIKAZE, 0, number)) for number in range(count)]


def short(number: int, ticks: int, control_period: float | None = None) -> EpisodeSpec:
    """Return an episode of few ticks, in which the car is near from the start."""
    points = bent(np.random.default_rng(number), 6) + np.array([0.3, 0.0])
    episode = kamikaze_episode(points, ticks, number=number, gap=2.0)
    return replace(episode, scenario=replace(episode.scenario, control_period=control_period))


def brute_force(episode: EpisodeSpec, make) -> float:
    """Return the least deviation of all sequences of actions; infinity: none within η_max."""
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
                    least = min(least, deviation(phi, np.array([*walked, at]), tick + contact.fraction))
            elif episode.outcome(tick + 1, here, collided=False) == Outcome.RUNNING:
                follow(after, driver, [*walked, (here.x, here.y)])

    controller = make()
    controller.reset(episode.scenario, controller_generator(controller_seed(episode.seed, episode.episode_id)))
    world = make_world(episode)
    follow(world, controller, [(world.adversary.x, world.adversary.y)])
    return least if least <= episode.scenario.eta_max else math.inf


@pytest.mark.parametrize(("ticks", "period", "count"), [(3, None, 3), (2, 0.1, 3)])
def test_of_a_car_with_a_state_it_is_what_brute_force_finds(ticks, period, count):
    margins = []
    for number in range(count):
        episode = short(number, ticks, period)
        margins.append(found(searched([episode], make=Delayed)))
        assert margins[-1] == pytest.approx(brute_force(episode, Delayed), abs=1e-9)
    assert len(set(margins)) > 2


def test_a_touch_that_is_too_slow_ends_the_episode():
    walked_in = 0
    for number in (0, 6):  # of which the sixth is touched too slowly
        episode = short(number, 2)
        too_slow = replace(CROSSING.collision, hit_speed=7.5)
        slow = replace(episode, scenario=replace(episode.scenario, collision=too_slow))
        margin = found(searched([slow], make=Delayed))
        assert margin == pytest.approx(brute_force(slow, Delayed), abs=1e-9)
        walked_in += margin > found(searched([episode], make=Delayed)) + 1e-9
    assert walked_in


def test_after_a_drive_the_hit_that_another_action_gives_in_its_own_tick_is_found():
    found = 0
    for number in range(20):
        episode = kamikaze_episode(bent(np.random.default_rng(number), 6), 12, 0.3, number, gap=2.5)
        controller, group = BasicController(0.3), Group([episode], 0)
        space, phi = group.space, episode.safe_trajectory.positions
        least = math.inf
        driven = space.candidate(np.full(space.ticks, space.as_phi)).last_tick(episode.scenario.eta_max)
        for tick in range(driven + 1):
            for action in range(space.action_count):
                actions = np.full(space.ticks, space.as_phi)
                actions[tick] = action
                log = run_episode(prescribed(episode, space.candidate(actions).positions), controller)
                if log.hit and len(log.adversary) - 2 == tick:
                    least = min(least, deviation(phi, log.trajectory.positions, log.impact_time / TIME_STEP))
        search([group], Driver(controller).run)
        assert group.trials[0].least <= least + 1e-9
        found += 1e-9 < least < math.inf
    assert found


@pytest.mark.parametrize("scenario", ["crossing", "cut_in"])
def test_a_detour_of_some_ticks_is_the_least_that_is_hit_if_the_car_drives_on(scenario):
    """On the lane beside, a car turns out of it for some ticks, and its state decides where that leads."""
    beside = np.column_stack([np.full(16, -3.5), -8.0 + 2.0 * np.arange(16)])
    phi = {"crossing": bent(np.random.default_rng(4), 9), "cut_in": beside}[scenario]
    episode = EpisodeSpec(load_scenario(scenario), Mode.KAMIKAZE, 1, 0, Trajectory(phi, TIME_STEP), multiplier=0.0)
    space = Group([episode], 0).space
    as_phi = np.full(space.ticks, space.as_phi)
    drive, least = BasicController(0.0), math.inf
    along = run_episode(prescribed(episode, space.positions(as_phi[None])[0]), drive)
    for tick in range(len(along.adversary) - 1):
        for action in range(space.action_count):
            actions = as_phi.copy()
            actions[tick : tick + 6] = action
            log = run_episode(prescribed(episode, space.candidate(actions).positions), drive)
            if log.hit and tick <= len(log.adversary) - 2 < tick + 6:
                least = min(least, deviation(phi, log.trajectory.positions, log.impact_time / TIME_STEP))
    assert least < math.inf
    found, _ = detour(space, as_phi, along.adversary, along.car, math.inf, 6)
    assert found == pytest.approx(least, abs=1e-9)


@pytest.mark.parametrize("multiplier", [0.5, 1.15])
def test_never_below_the_exact_margin_and_near_it(multiplier):
    reached, least = [], []
    crooked = [kamikaze_episode(bent(np.random.default_rng(seed), 9), 30, multiplier, seed) for seed in range(2)]
    for trials in (episodes(multiplier), crooked[:1], crooked[1:]):
        for episode, hit in zip(trials, searched(trials, Effort(32, 256)).hits, strict=True):
            exact = exact_margin(episode)
            assert hit.distance >= exact.distance - exact.gap - 1e-9
            reached.append(hit.distance)
            least.append(exact.distance)
    assert np.mean(reached) <= 1.02 * np.mean(least) + 1e-9


def test_the_same_whoever_searches_and_never_more_with_more_effort():
    trials = [replace(one, safe_trajectory=one.safe_trajectory) for one in episodes(1.15, 12)]
    with InProcessRunner(1) as one, InProcessRunner(2) as two:
        margins = [search_margins(trials, {}, in_processes(runner, lambda *_: None), LITTLE) for runner in (one, two)]
    first, again = ([hit.distance for hit in one.hits if hit is not None] for one in margins)
    assert first == again
    assert margins[0].means == margins[1].means
    means = [mean for _, mean in margins[0].means]
    assert means == sorted(means, reverse=True)
    assert np.mean([hit.distance for hit in margins[0].hits if hit is not None]) <= means[-1] + 1e-12


def test_where_phi_itself_is_hit_nothing_else_is_tried():
    episode = kamikaze_episode(POINTS, 40, 0.0)
    along = run_episode(replace(episode, mode=Mode.REPLAY))
    assert along.outcome == Outcome.COLLISION
    driver = Driver(BasicController(0.0))
    (hit,) = search_margins([episode], {}, driver.rounds, LITTLE).hits
    assert hit.distance <= 1e-12
    assert hit.gap == 0.0
    assert hit.impact_speed == pytest.approx(along.impact_speed)
    assert len(driver.driven) == 1


def test_what_kamikazes_did_is_begun_with():
    (episode,) = episodes(1.0, 1)
    exact = exact_margin(episode)
    positions = exact.trajectory.positions.copy()
    positions[-1] = positions[-2] + (positions[-1] - positions[-2]) / (exact.duration - (len(positions) - 2))
    log = run_episode(prescribed(episode, positions), controller=BasicController(1.0))
    assert log.hit
    driver = Driver(BasicController(1.0))
    (hit,) = search_margins([episode], {episode.episode_id: [log]}, driver.rounds, Effort(1, 1)).hits
    assert hit.distance <= exact.distance + 1e-9


@pytest.mark.parametrize(
    ("controller", "scenario"),
    [("carla", "crossing"), ("cal", "crossing"), ("basic", "crossing_multi_body"), ("basic", "right_turn")],
)
def test_other_cars_and_roads_are_hit_as_the_search_says(controller, scenario):
    setting = Plan(load_scenario(scenario), controller=controller).scenario
    known = replace(kamikaze_episode(POINTS), adversary_model=AdversaryModel.GENERIC)
    episode = replace(known, scenario=setting, controller=controller)
    (hit,) = searched([episode], Effort(4, 16)).hits
    assert hit.distance == pytest.approx(deviation(POINTS, hit.trajectory.positions, hit.duration), abs=1e-12)
    assert hit.impact_speed >= setting.collision.hit_speed


def test_a_cyclist_takes_its_own_actions():
    scenario = load_scenario("cyclist")
    points = np.column_stack([np.arange(-10.0, 4.0, 1.2), np.zeros(12)])
    (hit,) = searched([replace(kamikaze_episode(points), scenario=scenario)], LITTLE).hits
    positions = hit.trajectory.positions
    for tick in range(len(positions) - 2):
        step = (positions[tick + 1] - positions[tick]) / scenario.time_step
        can = velocities(scenario, points, tick, positions[: tick + 1])
        assert np.abs(can - step).max(axis=1).min() <= 1e-9


def test_where_nobody_can_be_hit_there_is_no_hit_and_the_mean_is_the_greatest():
    scenario = replace(CROSSING, collision=replace(CROSSING.collision, hit_speed=30.0))
    margins = searched([replace(one, scenario=scenario) for one in episodes(1.0)], LITTLE)
    assert margins.hits.count(None) == 3
    assert margins.means[-1][1] == scenario.eta_max


def test_of_few_trials_what_the_last_doubling_brought_may_be_missing():
    margins = searched(episodes(1.15, 8), Effort(2, 8, excursions=0))
    assert margins.search.excess.trials == 8
    assert margins.search.excess.mean == pytest.approx(margins.means[-2][1] - margins.means[-1][1])
    assert not margins.search.converged


def test_a_car_that_does_not_repeat_itself_is_noticed():
    driver = Driver(Moody())
    margins = search_margins(episodes(1.0, 4), {}, driver.rounds, LITTLE)
    assert confirmed(episodes(1.0, 4), margins, driver).count(None) > margins.hits.count(None)
    calm = Driver(BasicController(1.0))
    margins = search_margins(episodes(1.0, 4), {}, calm.rounds, LITTLE)
    again = [hit.distance for hit in confirmed(episodes(1.0, 4), margins, calm) if hit]
    assert again == pytest.approx([hit.distance for hit in margins.hits if hit], abs=1e-12)


def test_a_search_all_of_whose_episodes_are_aborted_is_an_error():
    def abort(groups: Sequence[Group], _what: str) -> list[Group]:
        def lost(some: Sequence[EpisodeSpec]) -> list[EpisodeLog]:
            return [replace(run_episode(one), outcome=Outcome.ABORTED, reason="no answer") for one in some]

        search(groups, lost)
        return list(groups)

    with pytest.raises(AssessmentError, match="no answer"):
        search_margins(episodes(1.0, 2), {}, abort, LITTLE)


def test_a_search_that_can_drive_nothing_is_an_error():
    with pytest.raises(AssessmentError, match="no trajectory could be driven"):
        search_margins(episodes(1.0, 2), {}, lambda groups, _what: list(groups), LITTLE)


def test_a_limit_below_the_usual_effort_is_kept():
    with InProcessRunner(1) as runner:
        _, search = minimal_deviations([short(0, 9, 0.1), short(1, 9, 0.1)], {}, runner, lambda *_: None, 8)
    assert search.budget == 8


def test_no_hit_beyond_eta_max_counts():
    """φ stays on the lane beside, 3.5 m away, where no two cars touch."""
    phi = Trajectory(np.column_stack([np.full(16, -3.5), -8.0 + 2.7 * np.arange(16)]), 0.3)
    scenario = replace(load_scenario("cut_in"), eta_max=2.0)
    found = []
    for number in range(4):
        episode = EpisodeSpec(scenario, Mode.KAMIKAZE, 1, number, safe_trajectory=phi, multiplier=0.75)
        (hit,) = searched([episode], Effort(32, 64)).hits
        if hit is not None:
            found.append(hit.distance)
        if len(found) == 2:
            break
    assert len(found) == 2
    assert max(found) <= 2.0
    assert min(found) > 3.5 - 0.9 - math.hypot(2.25, 0.9)  # as far aside as a box reaches, at most


def test_along_the_lane_the_search_finds_the_exact_margin():
    """Where nobody crosses; the same law as a user's class is searched, not predictable."""
    few = {"scenario": "cpla", "safe": "regulatory", "safe_count": 2, "kamikaze_count": 2, "collision_runs": 2}
    few |= {"simulations": 20, "adversary_model": "generic", "behaviour": "none", "margin_limit": 256}
    known, margins = (assess(car, **few).as_dict() for car in ("basic", "skd_sim.controllers.basic:BasicController"))
    assert known["margin_budget"] is None  # it is exact
    assert margins["margin_budget"] > 0
    assert known["margin"] > 0.05
    assert known["margin"] - 1e-9 <= margins["margin"] <= 1.02 * known["margin"]


def test_from_the_hits_of_an_earlier_version_the_same_margin_takes_a_quarter():
    trials, car = episodes(1.0, 6), Driver(Delayed())
    whole = search_margins(trials, {}, car.rounds, IN_PROCESS._replace(limit=256))
    hits = [prescribed(one, hit.safe_trajectory.positions) for one, hit in zip(trials, whole.episodes, strict=True)]
    logs = {log.episode.episode_id: log for log in car.run(hits)}
    mean = whole.means[-1][1]
    again = search_margins(trials, {}, car.rounds, WARM_START, Earlier(logs, mean))
    assert 0.98 * mean <= again.means[-1][1] <= mean
    assert 4 * again.driven < whole.driven
    changed = search_margins(trials, {}, car.rounds, WARM_START._replace(limit=64), Earlier(logs, 2 * mean))
    assert changed.search.budget >= 64  # another margin than the earlier one is no reason to stop early


def test_a_search_cannot_begin_with_a_result_on_other_phi(sweep):
    small = {"safe_count": 1, "kamikaze_count": 2, "collision_runs": 1, "margin_limit": 8, "behaviour": "none"}
    with pytest.raises(UsageError, match="has no margin on these φ with this seed"):
        assess("carla", warm_start=str(sweep / "synthetic" / "C_1"), seed=1, **small)
