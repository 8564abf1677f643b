"""Logs of a small campaign, recorded in process; `skd` on recordings of them."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from common import run_skd
from skd_evaluator.campaign import Plan
from skd_evaluator.runner import run_episode
from skd_sim.episode import EpisodeLog, Mode, Outcome
from skd_sim.scenario import load_scenario
from skd_sim.trajectory import Trajectory

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

from bag_forge import Sent, campaign_messages, write_mcap

MOST_MEMORY = 500 * 10**6
MOST_TIME = 20.0


def crossing(pace: float, ticks: int, name: str) -> Trajectory:
    """Straight across, in steps of `pace` m."""
    return Trajectory(np.array([(-3.5 + pace * tick, 0.1) for tick in range(ticks)]), 0.3, name)


def attempts(plan: Plan, safe: Sequence[Trajectory], wanted: int, runs: int) -> list[EpisodeLog]:
    """Every episode of a campaign, failed attempts too, in the order of their ids."""
    logs = []
    for index, phi in enumerate(safe):
        hits = attempt = 0
        while hits < wanted:
            log = run_episode(plan.episode(Mode.KAMIKAZE, index, attempt, phi))
            hits += log.outcome == Outcome.COLLISION
            attempt += 1
            logs.append(log)
    for run in range(runs):
        index, attempt = run % len(safe), run // len(safe)
        logs.append(run_episode(plan.episode(Mode.REPLAY, index, attempt, safe[index])))
    return logs


@pytest.fixture(scope="session")
def logs() -> list[EpisodeLog]:
    """Of a careful car and an adversary that hardly thinks, so that an attempt fails."""
    plan = Plan(load_scenario("crossing"), multiplier=1.1, simulations=3, seed=2)
    found = attempts(plan, [crossing(0.75, 10, "brisk"), crossing(0.6, 13, "slow")], 3, 4)
    assert {log.outcome for log in found} >= {Outcome.COLLISION, Outcome.MISSED, Outcome.ARRIVED}
    return found


@pytest.fixture
def sent(logs: list[EpisodeLog]) -> list[list[Sent]]:
    """What the graph would have said, by episode."""
    return campaign_messages(logs)


@dataclass
class Replayed:
    """`skd replay`, at its end."""

    code: int
    err: str
    result: dict[str, Any]
    episodes: bytes
    path: Path

    @property
    def lines(self) -> list[str]:
        return self.err.splitlines()


@pytest.fixture
def replay(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., Replayed]:
    """Run `skd replay` in this process."""
    count = iter(range(1000))

    def run(*arguments: object) -> Replayed:
        out = tmp_path / f"out-{next(count)}"
        capsys.readouterr()
        code = run_skd("replay", *arguments, "--out", out)
        err = capsys.readouterr().err
        if code:
            assert not out.exists()
            return Replayed(code, err, {}, b"", out)
        result = json.loads((out / "assessment.json").read_text())
        return Replayed(code, err, result, (out / "episodes.npz").read_bytes(), out)

    return run


@pytest.fixture
def refused(replay: Callable[..., Replayed]) -> Callable[..., str]:
    """`skd replay` refuses a recording, in one line that is returned."""

    def check(*arguments: object) -> str:
        done = replay(*arguments)
        assert done.code == 2, done
        assert len(done.lines) == 1, done.err
        assert done.lines[0].startswith("skd replay: error: ")
        return done.lines[0]

    return check


@pytest.fixture
def recorded(tmp_path: Path) -> Callable[..., Path]:
    """Write messages of episodes as one recording."""

    def write(episodes: Sequence[Sequence[Sent]], name: str = "x", **options: Any) -> Path:
        return write_mcap(tmp_path / f"{name}.mcap", [message for one in episodes for message in one], **options)

    return write
