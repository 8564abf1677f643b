"""Logs of a small campaign, recorded in process; `skd` on recordings of them."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
from bag_forge import Sent, campaign_messages, write_mcap
from common import run_skd
from recordings_support import Replayed, crossing, trials
from skd_evaluator.assessment.plan import Plan
from skd_sim import EpisodeLog, Outcome, load_scenario


@pytest.fixture(scope="session")
def logs() -> list[EpisodeLog]:
    """Of a careful car and an adversary that hardly thinks, so that a trial fails."""
    plan = Plan(load_scenario("crossing"), multiplier=1.1, simulations=3, seed=2)
    found = trials(plan, [crossing(0.75, 10, "brisk"), crossing(0.6, 13, "slow")], 3, 4)
    assert {log.outcome for log in found} >= {Outcome.COLLISION, Outcome.MISSED, Outcome.ARRIVED}
    return found


@pytest.fixture
def sent(logs: list[EpisodeLog]) -> list[list[Sent]]:
    """What the graph would have said, by episode."""
    return campaign_messages(logs)


@pytest.fixture
def replay(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., Replayed]:
    """Run `skd replay` in this process; margins follow from what the recordings say of the car, not from its states."""
    count = iter(range(1000))

    def run(*arguments: object) -> Replayed:
        out = tmp_path / f"out-{next(count)}"
        capsys.readouterr()
        code = run_skd("replay", "--margin-limit", 0, *arguments, "--out", out)
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
    def write(episodes: Sequence[Sequence[Sent]], name: str = "x", **options: Any) -> Path:
        return write_mcap(tmp_path / f"{name}.mcap", [message for one in episodes for message in one], **options)

    return write
