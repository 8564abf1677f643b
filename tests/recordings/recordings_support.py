"""What the tests of recordings share: safe trajectories, campaigns, and how `skd replay` ended."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from skd_evaluator.assessment.plan import TRIALS_PER_REQUESTED, Plan
from skd_evaluator.assessment.run.episodes import run_episode
from skd_sim import EpisodeLog, Mode, Trajectory


def crossing(pace: float, ticks: int, name: str) -> Trajectory:
    """Straight across, in steps of `pace` m."""
    return Trajectory(np.array([(-3.5 + pace * tick, 0.1) for tick in range(ticks)]), 0.3, name)


def trials(plan: Plan, safe: Sequence[Trajectory], wanted: int, runs: int) -> list[EpisodeLog]:
    """Every episode of a campaign, failed trials too, in the order of their ids."""
    logs = []
    for index, phi in enumerate(safe):
        hits = trial = 0
        while hits < wanted and trial < TRIALS_PER_REQUESTED * wanted:
            log = run_episode(plan.episode(Mode.KAMIKAZE, index, trial, phi))
            hits += plan.succeeds(log)
            trial += 1
            logs.append(log)
    for run in range(runs):
        index, trial = run % len(safe), run // len(safe)
        logs.append(run_episode(plan.episode(Mode.REPLAY, index, trial, safe[index])))
    return logs


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
