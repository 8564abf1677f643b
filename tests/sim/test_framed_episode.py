"""An episode that is watched frame by frame means by a contact, a tick and an end what the world means by them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from skd_sim.encounter.scenario import Scenario, load_scenario
from skd_sim.episode import Episode, Mode, Outcome
from skd_sim.errors import UsageError
from skd_sim.framed_episode import FramedEpisode
from skd_sim.state import CarState, PedestrianState
from skd_sim.world import make_world

FRAME = 0.05


def _scenario(gap: float) -> Scenario:
    """The crossing with a car that drives on without noise."""
    base = load_scenario("crossing")
    return replace(base, car=replace(base.car, speed_noise=0.0, acceleration_noise=0.0, start_gap=gap))


def _watched(episode: Episode, velocity: tuple[float, float]) -> FramedEpisode:
    run = FramedEpisode(episode, FRAME)
    car, walker = run.start_car, run.start_pedestrian
    run.begin(car, walker)
    while run.outcome == Outcome.RUNNING:
        car = CarState(car.x, car.y + FRAME * car.speed, car.heading, car.speed)
        walker = PedestrianState(walker.x + FRAME * velocity[0], walker.y + FRAME * velocity[1], *velocity)
        run.frame(car, walker, velocity)
    return run


@pytest.mark.parametrize("episode_id", range(12))
def test_same_end_as_in_the_world(episode_id: int) -> None:
    rng = np.random.default_rng(episode_id)
    velocity = (rng.uniform(1.5, 2.5), rng.uniform(-0.5, 0.5))
    episode = Episode(_scenario(rng.uniform(8.0, 16.0)), Mode.SAFE, 7, episode_id)
    world, contact, outcome = make_world(episode), None, Outcome.RUNNING
    while outcome == Outcome.RUNNING:
        contact = world.step(0.0, velocity)
        outcome = episode.outcome(world.tick, world.pedestrian, collided=contact is not None)
    run = _watched(episode, velocity)
    assert run.outcome == outcome
    assert run.tick == world.tick
    assert run.pedestrian == pytest.approx(world.pedestrian, abs=1e-9)
    if contact is None:
        assert run.contact is None
        assert run.car == pytest.approx(world.car, abs=1e-9)
    else:
        assert run.contact == pytest.approx(contact, abs=1e-9)


def test_both_ends_occur() -> None:
    """What the comparison above rests on."""
    ends = {_watched(Episode(_scenario(gap), Mode.SAFE, 7, 0), (2.5, 0.0)).outcome for gap in (9.0, 30.0)}
    assert ends == {Outcome.COLLISION, Outcome.ARRIVED}


def test_slow_impacts_do_not_count() -> None:
    scenario = _scenario(9.0)
    fast = replace(scenario, collision=replace(scenario.collision, minimum_impact_speed=20.0))
    assert _watched(Episode(scenario, Mode.SAFE, 7, 0), (2.5, 0.0)).outcome == Outcome.COLLISION
    assert _watched(Episode(fast, Mode.SAFE, 7, 0), (2.5, 0.0)).outcome == Outcome.ARRIVED


@pytest.mark.parametrize("frame_step", [0.04, 0.07, 0.2, 0.7])
def test_a_tick_has_whole_frames(frame_step: float) -> None:
    with pytest.raises(UsageError, match=r"must divide the scenario's time_step 0\.3 s"):
        FramedEpisode(Episode(_scenario(13.0), Mode.SAFE, 0, 0), frame_step)
