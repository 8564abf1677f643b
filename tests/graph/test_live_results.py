"""One evaluator and one simulator in a domain; results count only where car and adversary confirm them."""

from __future__ import annotations

import dataclasses
from multiprocessing.context import ForkServerContext
from pathlib import Path

import pytest
from graph_nodes import ADVERSARY, CONTROLLER, SIMULATOR, evaluator, running, start_node
from skd_evaluator.assessment.run.runner import run_episode
from skd_evaluator.errors import AssessmentError
from skd_evaluator.ros.evaluator import refuted
from skd_sim.world.episode import Episode, EpisodeLog
from skd_sim.world.state import CarState


def run(
    context: ForkServerContext,
    domain: int,
    folder: Path,
    episode: Episode,
    *others: tuple[str, str],
    count: int = 2,
) -> list[EpisodeLog]:
    """Run a campaign of episodes, until it ends, with some nodes beside controller and adversary."""
    modules = [*others, (CONTROLLER, ""), (ADVERSARY, "")]
    nodes = [
        start_node(context, module, folder / f"{number}", domain, *filter(None, [kind]))
        for number, (module, kind) in enumerate(modules)
    ]
    wanted = [dataclasses.replace(episode, episode_id=episode.episode_id + number) for number in range(count)]
    with running(*nodes), evaluator(folder / "bags", own_world=True) as node:
        return list(node.run(wanted))


def test_states_of_a_node_that_is_gone(domain: int, tmp_path: Path) -> None:
    """Who publishes them is not listed any more; the line spoke of recordings, of which there is none."""
    with evaluator(tmp_path / "bags", own_world=True) as node:
        node._add_car(600_000_000, CarState(0.0, 1.0, 1.5, 8.0))
        node._add_car(600_000_000, CarState(0.0, 1.0, 1.5, 8.0))
        with pytest.raises(AssessmentError) as error:
            node._add_car(600_000_000, CarState(0.0, 1.0, 1.5, 0.0))
    assert str(error.value) == (
        "two different states of the car came for 0.600 s of the episode: another node, which is gone, has published "
        "/ego/odometry, or the simulator contradicts itself"
    )


def test_two_simulators(context: ForkServerContext, domain: int, tmp_path: Path, replay: Episode) -> None:
    both = (SIMULATOR, ""), ("hostile_nodes", "second_simulator")
    with pytest.raises(AssessmentError) as error:
        run(context, domain, tmp_path, replay, *both, count=5000)  # the second may come after some that were right
    assert str(error.value) == (
        "2 nodes publish /ego/odometry, one may: /hostile_second_simulator and /vehicle_simulator; end all but one"
    )


def test_two_evaluators(context: ForkServerContext, domain: int, tmp_path: Path, episode: Episode) -> None:
    both = (SIMULATOR, ""), ("hostile_nodes", "second_evaluator")
    with pytest.raises(AssessmentError) as error:
        run(context, domain, tmp_path, episode, *both, count=200)  # it may come after some that were right
    assert str(error.value) == (
        "2 nodes publish /skd/episode, one may: /evaluator and /hostile_second_evaluator; end all but one"
    )


def test_another_simulator_is_not_held_to_the_laws_of_this_world(replay: Episode) -> None:
    """SKD has started either: what follows from the seed is what the simulator that was asked for gives."""
    log = run_episode(replay)
    car = log.car.copy()
    car[2, 2] += 0.2
    other = dataclasses.replace(log, car=car)
    said = refuted(other, own_world=True)
    assert said is not None
    assert "the car's speed at tick 2" in said
    elsewhere = dataclasses.replace(replay, simulator="metadrive")
    assert refuted(dataclasses.replace(other, episode=elsewhere), own_world=True) is None
