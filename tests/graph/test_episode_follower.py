"""Which episode a state belongs to, in whatever order topics deliver."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from skd_sim.encounter.scenario import load_scenario
from skd_sim.episode import Episode, Mode
from skd_sim.nodes.episode_follower import EpisodeFollower
from skd_sim.nodes.to_messages import episode_to_message
from skd_sim.stamps import NANOSECONDS, tick_stamp

START = NANOSECONDS
SCENARIO = load_scenario("crossing")


class Node:
    """Stands for a node: delivers episodes, and notes what the follower hands over."""

    def __init__(self) -> None:
        self.begun: list[int] = []
        self.ticks: list[tuple[int, int]] = []
        self.follower = EpisodeFollower(self, self._begin, lambda tick, _, item: self.ticks.append((tick, item)))  # type: ignore[arg-type]

    def create_subscription(self, _kind: Any, _topic: str, callback: Any, _qos: Any) -> None:
        self._on_episode = callback

    def get_logger(self) -> SimpleNamespace:
        return SimpleNamespace(error=pytest.fail)

    def _begin(self, episode: Episode) -> None:
        self.begun.append(episode.seed)

    def episode(self, seed: int, start: int = START) -> None:
        self._on_episode(episode_to_message(Episode(SCENARIO, Mode.SAFE, seed, 0), f"campaign-{seed}", start))

    def state(self, tick: int, item: int, start: int = START) -> None:
        self.follower.deliver(tick_stamp(start, tick, SCENARIO.time_step), item)


def test_states_follow_their_episode() -> None:
    node = Node()
    node.episode(1)
    for tick, item in ((0, 10), (0, 10), (1, 11), (2, 12)):
        node.state(tick, item)
    assert node.ticks == [(0, 10), (0, 10), (1, 11), (2, 12)]


def test_a_state_before_its_episode_is_kept() -> None:
    node = Node()
    node.state(0, 10)
    assert node.ticks == []
    node.episode(1)
    assert node.ticks == [(0, 10)]


def test_another_evaluator_begins_with_the_stamps_of_the_last_episode() -> None:
    """Its first state, when it comes before its episode, must not be answered as a tick of the old one."""
    node = Node()
    node.episode(1)
    node.state(0, 10)
    node.state(1, 11)
    node.ticks.clear()
    node.state(0, 20)
    node.state(0, 20)
    assert node.ticks == []
    node.episode(2)
    assert node.begun == [1, 2]
    assert set(node.ticks) == {(0, 20)}


def test_an_episode_said_again_changes_nothing() -> None:
    node = Node()
    node.episode(1)
    node.state(0, 10)
    node.episode(1)
    node.state(1, 11)
    assert node.begun == [1]
    assert node.ticks == [(0, 10), (1, 11)]
