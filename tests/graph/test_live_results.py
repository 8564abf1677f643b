"""Results are the simulator's alone, and count only where car and adversary confirm them."""

from __future__ import annotations

import dataclasses
from multiprocessing.context import ForkServerContext
from pathlib import Path

import pytest
from graph_nodes import ADVERSARY, CONTROLLER, SIMULATOR, evaluator, running, start_node
from graph_support import assert_same_log
from skd_evaluator.bags.reader import read_episodes
from skd_evaluator.campaign.run.runner import run_episode
from skd_evaluator.errors import AssessmentError
from skd_evaluator.ros.readiness.simulator_check import refuted
from skd_sim.episode.aborts import AbortKind, kind_of
from skd_sim.episode.episode import Episode, EpisodeLog, Outcome
from skd_sim.state import CarState


def run(
    context: ForkServerContext,
    domain: int,
    folder: Path,
    episode: Episode,
    *others: tuple[str, str],
    count: int = 2,
    adversary: tuple[str, str] = (ADVERSARY, ""),
) -> list[EpisodeLog]:
    """Run a campaign of episodes, until it ends, with some nodes beside controller and adversary."""
    modules = [*others, (CONTROLLER, ""), adversary]
    nodes = [
        start_node(context, module, folder / f"{number}", domain, *filter(None, [kind]))
        for number, (module, kind) in enumerate(modules)
    ]
    wanted = [dataclasses.replace(episode, episode_id=episode.episode_id + number) for number in range(count)]
    with running(*nodes), evaluator(folder / "bags", own_world=True) as node:
        return list(node.run(wanted))


def test_a_controller_that_says_how_it_did(
    context: ForkServerContext, domain: int, tmp_path: Path, replay: Episode
) -> None:
    logs = run(context, domain, tmp_path, replay, (SIMULATOR, ""), ("hostile_nodes", "forger"))
    for log in logs:
        assert log.outcome == Outcome.ABORTED
        assert kind_of(log.reason) in (AbortKind.SECOND_SENDER, AbortKind.REFUTED), log.reason
    assert logs[1].reason == (
        "second sender: 2 nodes publish /skd/episode_result, which is the simulator's alone: "
        "/hostile_forger and /vehicle_simulator"
    )


@pytest.mark.parametrize("lie", ["impact_speed", "impact_time", "outcome", "ticks", "many"])
def test_a_simulator_that_lies(
    context: ForkServerContext,
    domain: int,
    tmp_path: Path,
    episode: Episode,
    expected: EpisodeLog,
    lie: str,
) -> None:
    assert expected.outcome == Outcome.COLLISION
    log = run(context, domain, tmp_path, episode, ("hostile_nodes", f"liar:{lie}"))[0]
    assert log.outcome == Outcome.ABORTED
    assert kind_of(log.reason) == AbortKind.REFUTED, log.reason
    recorded = read_episodes([tmp_path / "bags"])[0].log
    assert recorded.reason == log.reason
    assert_same_log(recorded, log)


def test_states_of_a_node_that_is_gone(domain: int, tmp_path: Path) -> None:
    """Who publishes them is not listed any more; the line spoke of recordings, of which there is none."""
    with evaluator(tmp_path / "bags", own_world=True) as node:
        node._on_car(600_000_000, CarState(0.0, 1.0, 1.5, 8.0))
        node._on_car(600_000_000, CarState(0.0, 1.0, 1.5, 8.0))
        with pytest.raises(AssessmentError) as error:
            node._on_car(600_000_000, CarState(0.0, 1.0, 1.5, 0.0))
    assert str(error.value) == (
        "two different states of the car came for 0.600 s of the episode: another node, which is gone, has published "
        "/ego/odometry, or the simulator contradicts itself"
    )


def test_two_simulators(context: ForkServerContext, domain: int, tmp_path: Path, replay: Episode) -> None:
    both = (SIMULATOR, ""), ("hostile_nodes", "second_simulator")
    with pytest.raises(AssessmentError) as error:
        run(context, domain, tmp_path, replay, *both, count=5000)  # the second may come after some that were right
    assert str(error.value) == (
        "2 nodes publish /ego/odometry, which is the simulator's alone: /hostile_second_simulator and "
        "/vehicle_simulator; end all but one"
    )


def test_somebody_else_who_hands_out_episodes(
    context: ForkServerContext, domain: int, tmp_path: Path, episode: Episode
) -> None:
    """Whoever announces the next episode first would decide with how many simulations it is planned."""
    both = (SIMULATOR, ""), ("hostile_nodes", "announcer")
    with pytest.raises(AssessmentError) as error:
        run(context, domain, tmp_path, episode, *both, count=200)  # it may come after some that were right
    assert str(error.value) == (
        "2 nodes publish /skd/episode, which is the evaluator's alone: /evaluator and /hostile_announcer; "
        "end all but one"
    )


def test_an_adversary_that_plans_something_else(
    context: ForkServerContext, domain: int, tmp_path: Path, episode: Episode, expected: EpisodeLog
) -> None:
    """Whoever told it to: each of its steps is one that an adversary can choose, so its states say nothing of it."""
    frugal = run_episode(dataclasses.replace(episode, simulations=1))
    assert frugal.adversary.tobytes() != expected.adversary.tobytes()  # else there is nothing to find
    logs = run(context, domain, tmp_path, episode, (SIMULATOR, ""), adversary=("hostile_nodes", "frugal"))
    for log in logs:
        assert log.outcome == Outcome.ABORTED
        assert log.reason.startswith("not as asked: /adversary took the episode for another than was handed out")
        assert kind_of(log.reason) == AbortKind.UNASKED


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
