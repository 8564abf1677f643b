"""What nodes say that they run is held against what the evaluator handed out, in whatever order it comes."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from skd_evaluator.campaign.run.assembly import aborted
from skd_evaluator.errors import AssessmentError
from skd_evaluator.ros.readiness import receipts
from skd_evaluator.ros.readiness.failures import Failures
from skd_msgs.msg import EpisodeReceipt
from skd_sim.choices.knowledge import Knowledge
from skd_sim.choices.objective import Objective
from skd_sim.encounter.known_scenarios import SCENARIOS
from skd_sim.encounter.scenario import load_scenario
from skd_sim.episode.digest import episode_digest
from skd_sim.episode.episode import Episode, Mode
from skd_sim.geometry.trajectory import Trajectory
from skd_sim.messages.from_messages import message_to_episode
from skd_sim.messages.seal import Seal
from skd_sim.messages.to_messages import episode_to_message
from skd_sim.program.sources import software

PHI = Trajectory(np.array([(-3.5 + 0.7 * tick, 0.1 / 3.0) for tick in range(9)]), 0.3, "φ")
EPISODE = Episode(load_scenario("crossing"), Mode.KAMIKAZE, 5, (1 << 48) + 3, safe_trajectory=PHI)
CHANGES: dict[str, dict[str, Any]] = {
    "simulations": {"simulations": 1},
    "particles": {"particles": 7},
    "objective": {"objective": Objective.DEFORMATION},
    "knowledge": {"knowledge": Knowledge.NOTHING},
    "multiplier": {"multiplier": 1.0 + 1e-15},
    "maximum_distance": {"maximum_distance": 3.0},
    "seed": {"seed": 6},
    "episode_id": {"episode_id": (1 << 48) + 4},
    "mode": {"mode": Mode.REPLAY},
    "φ": {"safe_trajectory": replace(PHI, positions=PHI.positions + np.array([0.0, 1e-12]))},
    "scenario": {"scenario": load_scenario("citr_crossing")},
}


@pytest.mark.parametrize("what", CHANGES)
def test_whatever_is_changed_has_another_digest(what: str) -> None:
    assert episode_digest(replace(EPISODE, **CHANGES[what]), "c", 1) != episode_digest(EPISODE, "c", 1)


def test_it_is_of_a_campaign_and_a_time() -> None:
    assert len({episode_digest(EPISODE, *one) for one in (("c", 1), ("d", 1), ("c", 2))}) == 3


@pytest.mark.parametrize("name", sorted(SCENARIOS))
def test_a_node_understands_what_was_handed_out(name: str) -> None:
    """Of every scenario, and every option that can be given: who reads the message has the digest of who wrote it."""
    scenario = load_scenario(name)
    bare = Episode(scenario, Mode.SAFE, 5, 3)
    for episode in (bare, *(replace(EPISODE, **{"scenario": scenario, **one}) for one in CHANGES.values())):
        message = episode_to_message(episode, "c", 10**9)
        assert episode_digest(message_to_episode(message), "c", 10**9) == episode_digest(episode, "c", 10**9)


class Listener:
    """Stands for an evaluator: hears receipts, and notes what is refused."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *publishers: str) -> None:
        self.refused: list[str] = []
        self.publishers = list(publishers)
        self.kinds: dict[str, str] = {}
        monkeypatch.setattr(
            receipts,
            "living_publishers",
            lambda *_: [SimpleNamespace(name=n, kind=self.kinds.get(n, receipts._KIND)) for n in self.publishers],
        )
        self.received = receipts.ReceivedReceipts(self, ("adversary",), self.refused.append, Seal())  # type: ignore[arg-type]

    def create_subscription(self, _kind: Any, _topic: str, callback: Any, _qos: Any) -> SimpleNamespace:
        self._on_receipt = callback
        return SimpleNamespace(get_publisher_count=lambda: len(self.publishers))

    def begin(self, episode: Episode, start: int = 1) -> None:
        self.received.begin(episode, "c", start)

    def hear(self, node: str, episode: Episode, campaign: str = "c", start: int = 1, code: str = "") -> None:
        said = EpisodeReceipt(node=node, campaign=campaign, episode_id=episode.episode_id)
        said.specification = episode_digest(episode, campaign, start)
        said.software = code or software(("skd_sim", "skd_adversary"))
        self._on_receipt(said)


@pytest.fixture
def listener(monkeypatch: pytest.MonkeyPatch) -> Listener:
    found = Listener(monkeypatch, "/adversary", "/vehicle_simulator")
    found.begin(EPISODE)
    return found


def test_who_runs_what_was_handed_out(listener: Listener) -> None:
    assert listener.received.awaited() == ["adversary"]
    listener.hear("/adversary", EPISODE)
    assert listener.received.awaited() == ["/vehicle_simulator"]
    listener.hear("/vehicle_simulator", EPISODE)
    assert listener.received.awaited() == []
    following = replace(EPISODE, episode_id=EPISODE.episode_id + 1)
    listener.begin(following, 2)
    listener.hear("/vehicle_simulator", EPISODE)  # it comes late
    listener.hear("/vehicle_simulator", following, start=2)
    assert listener.received.awaited() == ["adversary"]
    assert listener.refused == []


@pytest.mark.parametrize("what", CHANGES)
def test_who_runs_something_else(listener: Listener, what: str) -> None:
    listener.hear("/adversary", replace(EPISODE, **CHANGES[what]))
    (reason,) = listener.refused
    assert reason.startswith("not as asked: /adversary took the episode for another than was handed out")


def test_who_goes_on_to_what_another_campaign_says(listener: Listener) -> None:
    """Of somebody who announced it and is gone nothing else is seen: the last that a node was told counts there."""
    listener.hear("/adversary", EPISODE, campaign="of before")  # and what it was told before does not
    listener.hear("/adversary", EPISODE)
    assert listener.refused == []
    listener.hear("/adversary", replace(EPISODE, simulations=1), campaign="another")
    (reason,) = listener.refused
    assert reason.startswith("not as asked: /adversary went on to another episode, of campaign 'another'")


def test_who_goes_back_to_an_earlier_episode(listener: Listener) -> None:
    following = replace(EPISODE, episode_id=EPISODE.episode_id + 1)
    listener.begin(following, 2)
    listener.hear("/adversary", following, start=2)
    listener.hear("/adversary", EPISODE)
    assert len(listener.refused) == 1


def test_who_runs_other_code(listener: Listener) -> None:
    listener.hear("/adversary", EPISODE, code=f"skd_adversary:0123456789ab {software(('skd_sim',))}")
    (reason,) = listener.refused
    assert reason.startswith("not as asked: /adversary runs another version of skd_adversary:")


def test_who_publishes_something_else_on_the_topic_is_not_waited_for(listener: Listener) -> None:
    listener.publishers.append("/stranger")
    listener.kinds["/stranger"] = "std_msgs/msg/String"
    for name in ("/adversary", "/vehicle_simulator"):
        listener.hear(name, EPISODE)
    assert listener.received.awaited() == []
    listener.kinds.clear()
    assert listener.received.awaited() == ["/stranger"]


def test_episodes_that_nobody_runs_as_asked_end_the_campaign() -> None:
    """Each is waited for: an assessment of a thousand took hours, and said nothing of the car."""
    said: list[str] = []
    failures = Failures(said.append)
    unasked = aborted(EPISODE, "not as asked: /stranger did not say what it took the episode for")
    whole = replace(unasked, adversary=np.zeros((5, 2)))
    for one in (whole, whole, aborted(EPISODE, "refuted: by its states"), whole, whole):
        failures.note(one)
    with pytest.raises(AssessmentError, match="3 episodes in a row were not as asked: /stranger did not say"):
        failures.note(whole)
    assert len(said) == 2
