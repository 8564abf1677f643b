"""Recordings of when the adversary was still called pedestrian: its topic, and the scenario in the specification."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from bag_forge import EPISODE, Sent
from common import scenario_of_before
from skd_evaluator.bags.reader import read_episodes
from skd_sim.episode.episode import EpisodeLog
from skd_sim.former_names import TOPICS

Write = Callable[..., Path]
THEN = {today: name for name, today in TOPICS.items()}


def of_before(message: Sent, namespace: str = "") -> Sent:
    """A message as it was recorded then."""
    content = message.content
    if message.topic == EPISODE:
        content = replace(content, scenario=json.dumps(scenario_of_before(json.loads(content.scenario))))
    return replace(message, topic=namespace + THEN.get(message.topic, message.topic), content=content)


@pytest.mark.parametrize("namespace", ["", "/car_7"])
def test_they_give_what_those_of_today_give(
    logs: list[EpisodeLog], sent: list[list[Sent]], recorded: Write, replay: Callable[..., Any], namespace: str
) -> None:
    before = recorded([[of_before(message, namespace) for message in one] for one in sent], "before")
    assert b"/pedestrian/odometry" in before.read_bytes()
    assert b"/adversary/odometry" not in before.read_bytes()
    found = [one.log for one in read_episodes([before])]
    assert [log.episode.episode_id for log in found] == sorted(log.episode.episode_id for log in logs)
    today = replay(recorded(sent))
    done = replay(before)
    assert (done.code, done.err) == (today.code, today.err)
    assert done.episodes == today.episodes
    alike = today.result.keys() - {"provenance", "seconds", "safe"}
    assert {name: done.result[name] for name in alike} == {name: today.result[name] for name in alike}
    assert "pedestrian" not in done.result["scenario"]


def test_a_campaign_may_lie_in_recordings_of_both_times(
    sent: list[list[Sent]], recorded: Write, replay: Callable[..., Any]
) -> None:
    half = len(sent) // 2
    first = recorded([[of_before(message) for message in one] for one in sent[:half]], "first")
    done = replay(first, recorded(sent[half:], "second"))
    assert done.episodes == replay(recorded(sent)).episodes


def test_what_the_topics_of_both_times_say_at_one_moment_must_agree(
    sent: list[list[Sent]], recorded: Write, refused: Callable[..., str]
) -> None:
    (state,) = [one for one in sent[0] if one.topic in THEN][2:3]
    pose = state.content.pose.pose
    moved = replace(pose, position=replace(pose.position, y=pose.position.y + 1.0))
    other = replace(state.content, pose=replace(state.content.pose, pose=moved))
    both = [*sent[0], replace(state, topic=THEN[state.topic], content=other)]
    assert "two different" in refused(recorded([both, *sent[1:]]))
