"""The margin found by whole episodes, of a car that cannot be copied: against the exact one, and by what happened."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pytest
from search_support import CROSSING, bent, kamikaze_episode
from skd_evaluator.campaign.plan.plan import Stage, episode_id, walks_a_way
from skd_evaluator.campaign.run.runner import run_episode
from skd_evaluator.margin.exact.exact import exact_margin
from skd_evaluator.margin.search.episode_search import walked_margins, why_not_walked
from skd_evaluator.margin.search.episode_tree import EpisodeTree, walked
from skd_evaluator.margin.search.picture import Picture
from skd_evaluator.measure.distances.deformation import deformation
from skd_evaluator.ros.evaluator import refuted
from skd_sim.controllers import BasicController, Controller
from skd_sim.encounter.scenario import load_scenario
from skd_sim.episode.episode import Episode, EpisodeLog, Mode
from skd_sim.episode.randomness import Role, generator
from skd_sim.state import AdversaryState, CarState


class Drive:
    """Runs episodes one after another with controllers of one kind, as a graph does."""

    def __init__(self, make) -> None:
        self.make, self.logs = make, []

    def run(self, episodes: Sequence[Episode]) -> Iterator[EpisodeLog]:
        for episode in episodes:
            self.logs.append(run_episode(episode, controller=self.make()))
            yield self.logs[-1]


class Moody(Controller):
    """A basic car that brakes a little differently in every episode."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._basic, self._share = BasicController(1.0), rng.uniform(0.6, 1.0)

    def reset(self, scenario, rng) -> None:
        self._basic.reset(scenario, rng)

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        return self._share * self._basic.command(car, adversary)


def attempts(count: int) -> list[Episode]:
    """Return attempts on bent φ of the crossing, with the ids of kamikazes."""
    rng = np.random.default_rng(8)
    episodes = []
    for number in range(count):
        episode = kamikaze_episode(bent(rng, 9), 30, number=number, gap=10.0)
        episodes.append(replace(episode, episode_id=episode_id(Stage.KAMIKAZE, 0, number)))
    return episodes


def silent(_label: str, _done: int, _total: int) -> None:
    pass


def test_whole_episodes_come_to_the_exact_margin_of_a_car_that_is_not_known_to_them():
    episodes = attempts(12)
    drive = Drive(lambda: BasicController(1.0))
    found = walked_margins(episodes, {}, drive, silent)
    exact = [exact_margin(episode) for episode in episodes]
    eta_max = CROSSING.eta_max
    ours = [eta_max if way is None else way.distance for way in found.ways]
    least = [eta_max if way is None else way.distance for way in exact]
    gaps = [0.0 if way is None else way.gap for way in exact]
    assert all(mine >= its - gap - 1e-9 for mine, its, gap in zip(ours, least, gaps, strict=True))
    assert np.mean(ours) <= 1.03 * np.mean(least)
    assert (found.repeated, found.apart, found.aborted) == (found.hits, 0.0, 0)
    for episode, way in zip(episodes, found.ways, strict=True):
        if way is not None:
            phi = episode.safe_trajectory.positions
            assert way.distance == pytest.approx(deformation(phi, way.trajectory.positions, way.duration), abs=1e-9)
            assert way.impact_speed >= CROSSING.collision.hit_speed


def test_a_walk_has_the_draws_of_its_attempt_and_is_no_episode_of_an_assessment():
    episode = attempts(1)[0]
    phi = episode.safe_trajectory.positions
    velocities = [tuple(step) for step in (np.diff(phi, axis=0) / episode.scenario.time_step).tolist()]
    walk = walked(episode, velocities)
    assert walk.mode == Mode.REPLAY
    assert walks_a_way(walk)
    assert not walks_a_way(episode)
    log = run_episode(walk, controller=BasicController(1.0))
    assert refuted(log, own_world=True) is None
    tree = EpisodeTree(episode, Picture(None, False))
    assert tree.learn(log) == len(log.adversary) - 1
    node = tree.root
    rng = generator(episode.seed, episode.episode_id, Role.START)
    start = episode.start_gap + CROSSING.car.start_gap_range * rng.random()
    assert node.along == pytest.approx(-start - CROSSING.car.front)
    for tick in range(1, len(log.adversary)):
        (node,) = node.children.values()
        assert (node.along, node.speed) == (log.car[tick, 1], log.car[tick, 2])


def test_a_start_that_depends_on_phi_stays_that_of_the_attempt():
    scenario = replace(CROSSING, car=replace(CROSSING.car, meet_safe_trajectory=True))
    episode = replace(attempts(1)[0], scenario=scenario)
    walk = walked(episode, [(2.5, 0.0)] * 3)
    assert walk.start_gap == episode.start_gap


def test_a_car_that_does_not_repeat_itself_is_said_to():
    rng = np.random.default_rng(3)
    found = walked_margins(attempts(8), {}, Drive(lambda: Moody(rng)), silent)
    assert found.apart > 0.01
    assert "elsewhere" in found.text
    for way in found.ways:
        assert way is None or way.impact_speed >= CROSSING.collision.hit_speed


def test_what_kamikazes_did_is_begun_with():
    episode = attempts(1)[0]
    least = exact_margin(episode)
    steps = np.diff(least.trajectory.positions, axis=0) / episode.scenario.time_step
    last = steps[-1] / (least.duration - (len(steps) - 1))  # its last tick ends at the contact
    way = [*map(tuple, steps[:-1].tolist()), tuple(last.tolist())]
    log = run_episode(walked(episode, way), controller=BasicController(1.0))
    assert log.hit
    found = walked_margins([episode], {episode.episode_id: [log]}, Drive(lambda: BasicController(1.0)), silent, 2, 2)
    assert found.ways[0].distance <= least.distance + 1e-9


@pytest.mark.parametrize(("scenario", "said"), [("right_turn", "straight roads"), ("cyclist", "a pedestrian only")])
def test_encounters_in_which_ways_are_not_planned_are_said(scenario, said):
    episode = replace(attempts(1)[0], scenario=load_scenario(scenario))
    assert said in why_not_walked(episode)
    assert why_not_walked(attempts(1)[0]) == ""
