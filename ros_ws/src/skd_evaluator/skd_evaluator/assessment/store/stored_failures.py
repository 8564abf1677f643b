"""The most likely failures of the risk in episodes.npz: what became of them, and whether it can have been so."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.episode import EpisodeLog, Mode, Outcome

from skd_evaluator.arrays import FARTHEST, within_reach
from skd_evaluator.assessment.judge.failures import Walkers, failures_of
from skd_evaluator.assessment.plan.plan import Stage, episode_id
from skd_evaluator.assessment.store.stored_episodes import StoredEpisodes
from skd_evaluator.metrics.behaviour.model import NAMES
from skd_evaluator.metrics.risks import Risks


def failure_columns(failing: Mapping[int, EpisodeLog]) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays of episodes.npz about the failures that are kept, in the order of their numbers."""
    logs = [failing[row] for row in sorted(failing)]
    return {
        "risk_failure": np.array(sorted(failing), np.int64),
        "risk_failure_positions": np.concatenate([np.empty((0, 2)), *(one.adversary for one in logs)]),
        "risk_failure_car": np.concatenate([np.empty((0, 3)), *(one.car for one in logs)]),
        "risk_failure_offsets": np.cumsum([0, *(len(one.adversary) for one in logs)], dtype=np.int64),
        "risk_failure_impact_time": np.array([one.impact_time for one in logs], np.float64),
        "risk_failure_impact_speed": np.array([one.impact_speed for one in logs], np.float64),
    }


def failing_episodes(stored: StoredEpisodes, order: Sequence[int] | None = None) -> StoredEpisodes:
    """Return the failures that a file keeps as episodes, none where it has none.

    Args:
        stored: the episodes of the file.
        order: numbers of crossings, in which order they come; None: that of their numbers.

    Raises:
        ValueError, LookupError: the arrays do not go together.
    """
    further, phis = stored.further, len(stored.safe)
    rows = further["risk_failure"].tolist() if "risk_failure" in further else []
    spans, positions, car = [], np.empty((0, 2)), np.empty((0, 3))
    times = speeds = np.empty(0)
    if rows:
        positions, car = further["risk_failure_positions"], further["risk_failure_car"]
        times, speeds = further["risk_failure_impact_time"], further["risk_failure_impact_speed"]
        ends = further["risk_failure_offsets"].tolist()
        spans = list(itertools.pairwise(ends))
        whole = ends[0] == 0 and ends[-1] == len(positions) == len(car) and all(b - a > 1 for a, b in spans)
        if not whole or not len(spans) == len(times) == len(speeds) == len(rows) or min(rows) < 0:
            raise ValueError("the arrays of the failures do not go together")
        if not within_reach(positions, car, times, speeds):
            raise ValueError(f"a place, time or speed of a failure is not finite, or beyond ±{FARTHEST:g}")
    if order is not None:
        places = [rows.index(row) for row in order]
        rows, spans, times, speeds = list(order), [spans[one] for one in places], times[places], speeds[places]
    return replace(
        stored,
        adversary=tuple(positions[low:high] for low, high in spans),
        car=tuple(car[low:high] for low, high in spans),
        mode=np.full(len(rows), int(Mode.REPLAY), np.int64),
        objective=np.array([""] * len(rows), "U16"),
        safe_index=np.array([row % phis for row in rows], np.int64),
        outcome=np.full(len(rows), int(Outcome.COLLISION), np.int64),
        episode_id=np.array([episode_id(Stage.RISK, row % phis, row // phis) for row in rows], np.int64),
        impact_time=times,
        impact_speed=speeds,
        belief=(),
        margins=None,
        margin_ways=(),
        further={},
    )


def with_failures(risks: Risks, stored: StoredEpisodes, scenario: Scenario) -> Risks:
    """Return the risks with the most likely failures, computed anew but for what the car did.

    Raises:
        ValueError, LookupError: those that are kept are others.
    """
    parameters = risks.behaviour["parameters"]
    values = np.array([float(parameters[name]["value"]) for name in NAMES])
    walkers = Walkers(scenario, stored.safe, int(stored.further["seed"]), values)
    found, failing = failures_of(risks.scales, walkers), failing_episodes(stored)
    rows = [] if found is None else sorted(one.row for one in found.nearest)
    if found is None:
        if len(failing):
            raise ValueError("failures are kept, and no crossing is one")
        return risks
    if rows != stored.further["risk_failure"].tolist():
        raise ValueError("the failures that are kept are not those nearest to how people walk")
    return replace(risks, failures=found.as_dict(dict(zip(rows, failing.impact_speed.tolist(), strict=True))))
