"""Which episode a state belongs to, in whatever order topics deliver."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
from skd_sim.ros.from_messages import message_to_episode
from skd_sim.ros.support import EpisodeFollower
from skd_sim.ros.to_messages import episode_to_message
from skd_sim.scenario.scenario import Scenario, load_scenario
from skd_sim.world.episode import EpisodeSpec, Mode
from skd_sim.world.timing import NANOSECONDS, period_stamp

START = NANOSECONDS
SCENARIO = load_scenario("crossing")


class Node:
    """Stands for a node: delivers episodes, and notes what the follower hands over."""

    def __init__(self, scenario: Scenario = SCENARIO) -> None:
        self.begun: list[int] = []
        self.frames: list[tuple[int, int, int]] = []
        self._scenario = scenario
        self.follower = EpisodeFollower(self, message_to_episode, self._begin, self._note)  # type: ignore[arg-type]

    def _note(self, tick: int, period: int, _stamp: int, item: int) -> None:
        self.frames.append((tick, period, item))

    @property
    def ticks(self) -> list[tuple[int, int]]:
        return [(tick, item) for tick, period, item in self.frames if period == 0]

    def create_subscription(self, _kind: Any, _topic: str, callback: Any, _qos: Any) -> None:
        self._on_episode = callback

    def get_logger(self) -> SimpleNamespace:
        return SimpleNamespace(error=pytest.fail)

    def _begin(self, episode: EpisodeSpec) -> None:
        self.begun.append(episode.seed)

    def episode(self, seed: int, start: int = START) -> None:
        self._on_episode(episode_to_message(EpisodeSpec(self._scenario, Mode.SAFE, seed, 0), f"campaign-{seed}", start))

    def state(self, tick: int, item: int, start: int = START, *, period: int = 0) -> None:
        periods = self._scenario.control_periods
        self.follower.deliver(period_stamp(start, tick, period, periods, SCENARIO.time_step), item)


def test_states_follow_their_episode() -> None:
    node = Node()
    node.episode(1)
    for tick, item in ((0, 10), (0, 10), (1, 11), (2, 12)):
        node.state(tick, item)
    assert node.ticks == [(0, 10), (0, 10), (1, 11), (2, 12)]


def test_another_evaluator_begins_with_the_stamps_of_the_last_episode() -> None:
    """Its first state, when it comes before its episode, must not be answered as a tick of the old one."""
    node = Node()
    node.episode(1)
    node.state(0, 10)
    node.state(1, 11)
    node.frames.clear()
    node.state(0, 20)
    node.state(0, 20)
    assert node.ticks == []
    node.episode(2)
    assert node.begun == [1, 2]
    assert set(node.ticks) == {(0, 20)}


def test_states_between_ticks_have_their_control_period() -> None:
    """In the order of time; one of an earlier moment belongs to another episode."""
    node = Node(replace(SCENARIO, control_period=0.1))
    node.episode(1)
    for moment in range(5):
        node.state(moment // 3, moment, period=moment % 3)
    assert node.frames == [(0, 0, 0), (0, 1, 1), (0, 2, 2), (1, 0, 3), (1, 1, 4)]
    assert node.ticks == [(0, 0), (1, 3)]
    node.frames.clear()
    node.state(1, 30)
    assert node.frames == []
