"""What a recording says and its own states contradict: refused by name, or left out and counted."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from bag_forge import ADVERSARY, CAR, EPISODE, RESULT, Sent, campaign_messages, forged
from skd_sim.world.episode import EpisodeLog, Outcome


def place(episode: Sequence[Sent], topic: str, nth: int = 0) -> int:
    """Where in an episode the nth message of a topic is; from the end, where it is negative."""
    return [number for number, one in enumerate(episode) if one.topic == topic][nth]


def index_of(logs: Sequence[EpisodeLog], outcome: Outcome) -> int:
    return next(index for index, log in enumerate(logs) if log.outcome == outcome)


def with_forged(
    episodes: Sequence[Sequence[Sent]], index: int, topic: str, field: str, value: Any, nth: int = 0
) -> list[Sequence[Sent]]:
    one = forged(episodes[index], place(episodes[index], topic, nth), field, value)
    return [*episodes[:index], one, *episodes[index + 1 :]]


def test_what_is_right_counts(logs, sent, recorded, replay) -> None:
    done = replay(recorded(sent))
    assert (done.code, done.err) == (0, "")
    assert (done.result["left_out"], done.result["warnings"]) == ([], [])
    assert done.result["pairs"] == 6
    assert done.result["kamikaze_trials"] == len(logs) - 4
    assert done.result["contact_rate"] == sum(log.outcome == Outcome.COLLISION for log in logs[-4:]) / 4


@pytest.mark.parametrize("said", [0, 2, 3, 5, 7])
def test_an_outcome_that_the_states_contradict(logs, sent, recorded, refused, said: int) -> None:
    hit = index_of(logs, Outcome.COLLISION)
    episodes = with_forged(sent, hit, RESULT, "outcome", said)
    if said in (2, 3, 4):  # with the impact taken away, so that only geometry can tell
        for field in ("impact_time", "impact_speed"):
            episodes = with_forged(episodes, hit, RESULT, field, math.nan)
    line = refused(recorded(episodes))
    assert "x.mcap" in line
    assert str(logs[hit].episode.episode_id) in line or "is not valid" in line


@pytest.mark.parametrize("field", ["impact_time", "impact_speed"])
@pytest.mark.parametrize("value", [-1.0, 0.0, 1e6, math.nan, math.inf, None])
def test_an_impact_that_the_states_contradict(logs, sent, recorded, refused, field: str, value: float | None) -> None:
    """None: off by a tenth of a per mille."""
    hit = index_of(logs, Outcome.COLLISION)
    said = getattr(logs[hit], field) * (1.0 + 1e-4) if value is None else value
    assert "impact" in refused(recorded(with_forged(sent, hit, RESULT, field, said)))


STATES = [(topic, f"pose.pose.position.{axis}") for topic in (CAR, ADVERSARY) for axis in "xy"]
STATES.append((CAR, "twist.twist.linear.x"))


@pytest.mark.parametrize(("topic", "field"), STATES)
@pytest.mark.parametrize(("value", "nth"), [(-1e9, 0), (math.nan, -1)])
def test_a_state_that_cannot_be(logs, sent, recorded, refused, topic: str, field: str, value: float, nth: int) -> None:
    for outcome in (Outcome.COLLISION, Outcome.ARRIVED):
        episodes = with_forged(sent, index_of(logs, outcome), topic, field, value, nth)
        assert "episode" in refused(recorded(episodes))


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("mode", 0),
        ("mode", 9),
        ("multiplier", math.nan),
        ("maximum_distance", math.inf),
        ("objective", "fun"),
        ("car_model", "{"),
        ("scenario", "[" * 100_000),
        ("scenario", "{}"),
        ("safe_trajectory", []),
    ],
)
def test_a_specification_that_cannot_be(logs, recorded, refused, field: str, value: Any) -> None:
    """Of the only episode, so that no other contradicts it."""
    (episode,) = campaign_messages([logs[index_of(logs, Outcome.COLLISION)]])
    assert "episode" in refused(recorded([forged(episode, 0, field, value)]))


@pytest.mark.parametrize(
    ("field", "value"), [("command_ages", np.array([0.01, np.nan], np.float32)), ("greatest_delay", np.inf)]
)
def test_command_ages_that_are_not_finite(sent, recorded, refused, field: str, value: Any) -> None:
    assert "age of a command that is not finite" in refused(recorded(with_forged(sent, 0, RESULT, field, value)))


@pytest.mark.parametrize("topic", [EPISODE, RESULT])
def test_two_things_said_of_one_episode(logs, sent, recorded, refused, topic: str) -> None:
    """The last used to count."""
    hit = index_of(logs, Outcome.COLLISION)
    number, (field, value) = place(sent[hit], topic), ("impact_speed", 1.0) if topic == RESULT else ("multiplier", 0.5)
    other = forged(sent[hit], number, field, value)[number]
    for both in ([other, *sent[hit]], [*sent[hit], other]):
        line = refused(recorded([*sent[:hit], both, *sent[hit + 1 :]]))
        assert "two different messages" in line
        assert topic in line


def test_an_episode_that_was_run_twice_counts_once(logs, sent, recorded, replay) -> None:
    done = replay(recorded(campaign_messages([*logs, logs[0]])))
    assert done.episodes == replay(recorded(sent)).episodes
    assert any("run 2 times" in line for line in done.result["warnings"])


def test_a_trial_that_is_missing_is_named(logs, sent, recorded, replay) -> None:
    """A failed one, without which the success rate looks better than it was."""
    missed = index_of(logs, Outcome.MISSED)
    number = logs[missed].episode.episode_id & 0xFFFF
    done = replay(recorded([*sent[:missed], *sent[missed + 1 :]]))
    assert done.code == 0
    assert any(f"no recording has kamikaze trials {number} of" in line for line in done.result["warnings"])
    assert done.err.count("warning: ") == 1


def test_what_the_end_of_a_campaign_lacks_is_named(logs, sent, recorded, replay) -> None:
    last = max(index for index, log in enumerate(logs) if log.episode.mode == 1)
    done = replay(recorded([*sent[:last], *sent[last + 1 :]]))
    assert any("last kamikaze trials of safe trajectory 1" in line for line in done.result["warnings"])
    done = replay(recorded([one for one, log in zip(sent, logs, strict=True) if log.episode.episode_id != 2 << 48 | 1]))
    assert any("last runs along φ were not recorded" in line for line in done.result["warnings"])
    second = [one for one, log in zip(sent, logs, strict=True) if log.episode.episode_id >> 32 & 0xFFFF == 1]
    assert any("episode of safe trajectory 0" in line for line in replay(recorded(second)).result["warnings"])


def test_what_is_left_out_is_counted(logs, sent, recorded, refused, replay) -> None:
    hit = index_of(logs, Outcome.COLLISION)
    file = recorded(with_forged(sent, hit, RESULT, "impact_time", -1.0))
    assert refused(file).endswith("--skip-damaged leaves it out")
    done = replay(file, "--skip-damaged")
    without = replay(recorded([*sent[:hit], *sent[hit + 1 :]]))
    assert done.episodes == without.episodes
    (line,) = done.result["left_out"]
    assert f"episode {logs[hit].episode.episode_id}" in line
    assert line in done.err
