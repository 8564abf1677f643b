"""Commands that no number may rest on: of two senders, twice a tick, for other ticks, or on other topics."""

from __future__ import annotations

import dataclasses
from multiprocessing.context import ForkServerContext
from pathlib import Path

import pytest
from common import PATIENCE
from graph_nodes import ADVERSARY, CONTROLLER, SIMULATOR, evaluator, running, start_node
from skd_sim.world.episode import AbortKind, EpisodeLog, EpisodeSpec, Outcome, kind_of

COME_LATE = 5000  # episodes: some ten seconds, within which a node that has been started is there
LOST = {"lockstep": {}, "real_time": {"pacing": "real_time", "rate_factor": 2.0, "slip_limit": PATIENCE}}


def run(
    context: ForkServerContext,
    domain: int,
    folder: Path,
    episode: EpisodeSpec,
    *others: tuple[str, dict[str, object]],
    ours: tuple[str, ...] = (CONTROLLER, ADVERSARY),
    count: int = 2,
    **simulator: object,
) -> list[EpisodeLog]:
    """Run an episode, until one is aborted after the first, with our nodes and with hostile ones beside them."""
    settings = {"command_timeout": PATIENCE, "startup_timeout": PATIENCE, **simulator}
    nodes = [start_node(context, SIMULATOR, folder / "simulator", domain, **settings)]
    nodes += [start_node(context, name, folder / name, domain) for name in ours]
    nodes += [start_node(context, "hostile_nodes", folder / kind, domain, kind, **rest) for kind, rest in others]
    logs: list[EpisodeLog] = []
    with running(*nodes), evaluator() as node:
        while len(logs) < count and not (len(logs) > 1 and logs[-1].outcome == Outcome.ABORTED):
            logs.append(node.run_episode(dataclasses.replace(episode, episode_id=episode.episode_id + len(logs))))
    return logs


@pytest.mark.parametrize(
    ("module", "topic", "pacing"),
    [
        (CONTROLLER, "ego/acceleration_command", "lockstep"),
        (ADVERSARY, "adversary/velocity_command", "real_time"),
    ],
)
def test_two_senders(
    context: ForkServerContext, domain: int, tmp_path: Path, replay: EpisodeSpec, module: str, topic: str, pacing: str
) -> None:
    """Which of them would be heard depends on timing; the second one is refused though it says the same.

    It may come after some episodes that were right.
    """
    ours = (CONTROLLER, ADVERSARY, module)
    log = run(context, domain, tmp_path, replay, ours=ours, count=COME_LATE, **LOST[pacing])[-1]
    assert log.outcome == Outcome.ABORTED
    assert kind_of(log.reason) == AbortKind.SECOND_SENDER, log.reason
    assert topic in log.reason


@pytest.mark.parametrize(("kind", "how"), [("twice", "different commands"), ("echo", "the same command")])
def test_two_answers_a_tick(
    context: ForkServerContext, domain: int, tmp_path: Path, replay: EpisodeSpec, kind: str, how: str
) -> None:
    for log in run(context, domain, tmp_path, replay, (kind, {}), ours=(ADVERSARY,)):
        assert log.outcome == Outcome.ABORTED
        assert kind_of(log.reason) == AbortKind.SECOND_SENDER
        assert "answered the tick" in log.reason
        assert f"twice, with {how}" in log.reason


def test_answers_to_a_tick_that_is_repeated(
    context: ForkServerContext, domain: int, tmp_path: Path, replay: EpisodeSpec
) -> None:
    """A node without a state of its own answers each repetition of tick 0 again."""
    log = run(context, domain, tmp_path, replay, ("patient", {}), ours=(CONTROLLER,))[0]
    assert log.outcome != Outcome.ABORTED, log.reason


@pytest.mark.parametrize(
    ("kind", "told", "said"),
    [
        ("stamps", AbortKind.WRONG_STAMP, "its commands carry other stamps ("),
        ("nan", AbortKind.NOT_FINITE, "the car controller commanded nan"),
    ],
)
def test_the_reason_names_the_fault(
    context: ForkServerContext, domain: int, tmp_path: Path, replay: EpisodeSpec, kind: str, told: AbortKind, said: str
) -> None:
    log = run(context, domain, tmp_path, replay, (kind, {}), ours=(ADVERSARY,), startup_timeout=1.5)[1]
    assert log.outcome == Outcome.ABORTED
    assert kind_of(log.reason) == told, log.reason
    assert said in log.reason
    assert len(log.adversary) == 1
