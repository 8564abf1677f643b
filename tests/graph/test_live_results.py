"""Results count only where the states of car and adversary confirm them."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest
from graph_nodes import evaluator
from skd_evaluator.assessment.run.episodes import run_episode
from skd_evaluator.errors import AssessmentError
from skd_evaluator.ros.evaluator import refuted
from skd_sim.world.episode import EpisodeSpec
from skd_sim.world.state import CarState


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


def test_another_simulator_is_not_held_to_the_laws_of_this_world(replay: EpisodeSpec) -> None:
    """SKD has started either: what follows from the seed is what the simulator that was asked for gives."""
    log = run_episode(replay)
    car = log.car.copy()
    car[2, 3] += 0.2
    other = dataclasses.replace(log, car=car)
    said = refuted(other, own_world=True)
    assert said is not None
    assert "the car's speed at tick 2" in said
    elsewhere = dataclasses.replace(replay, simulator="metadrive")
    assert refuted(dataclasses.replace(other, episode=elsewhere), own_world=True) is None
