"""A rating computed again from episodes.npz, by the functions that computed it first.

Nothing that the file names is imported: a result may say that its controller is any module. What a car is called, how
much was searched and what was asked for stay what assessment.json says of them; docs/files.md has the list.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, cast

import numpy as np
from skd_sim.options.objective import Objective
from skd_sim.scenario.scenario import Scenario, scenario_from_dict
from skd_sim.world.episode import Episode, EpisodeLog, Mode, Outcome
from skd_sim.world.trajectory import Trajectory

from skd_evaluator.assessment.judge.assessment import CONFIDENCE
from skd_evaluator.assessment.judge.rating import Rating, judge_all
from skd_evaluator.assessment.plan.plan import KamikazeSet, Plan, kamikaze_set
from skd_evaluator.assessment.store.result_file import ASSESSMENT
from skd_evaluator.assessment.store.stored_episodes import EPISODES, StoredEpisodes
from skd_evaluator.assessment.store.stored_failures import with_failures
from skd_evaluator.metrics.distances.least_way import LeastWay
from skd_evaluator.metrics.margins import Excess, Margins
from skd_evaluator.metrics.risks import Risks, ScaleRisk, Subsets, Touch


@dataclass(frozen=True)
class _StoredPlan(Plan):
    """A plan of which the file says what its objectives plan for, so that none of them has to be loaded."""

    plans: Mapping[str, bool] = field(default_factory=dict)

    def __post_init__(self) -> None:
        pass  # its scenario is as it was run, and its car is nobody's

    @property
    def limits_deviation(self) -> bool:
        return self.plans[str(self.objective)]


def rating_of(figures: Mapping[str, Any], stored: StoredEpisodes) -> Rating:
    """Return the rating that stored episodes give.

    Args:
        figures: content of assessment.json, of which scenario, confidence and how the margin was searched are taken.
        stored: the episodes.

    Raises:
        ValueError, LookupError: they do not go together.
    """
    further = stored.further
    scenario = scenario_from_dict(figures["scenario"], f"scenario in {ASSESSMENT}")
    names, objectives = further["safe_name"].tolist(), further["objectives"].tolist()
    for name, here, there in (
        ("η_max", float(further["eta_max"]), scenario.eta_max),
        ("time step", stored.time_step, scenario.time_step),
        ("hit speed", stored.hit_speed, scenario.collision.hit_speed),
    ):
        if here != there:
            raise ValueError(f"{EPISODES} is of a scenario whose {name} is {here:g}, and not {there:g}")
    limit = float(further["maximum_distance"])
    plan = _StoredPlan(
        scenario,
        safe_count=len(stored.safe),
        seed=int(further["seed"]),
        maximum_distance=None if math.isnan(limit) else limit,
        plans=dict(zip(objectives, further["plans_deviation"].tolist(), strict=True)),
    )
    safe = [Trajectory(one, stored.time_step, name) for one, name in zip(stored.safe, names, strict=True)]
    logs = [_log(stored, number, scenario, safe) for number in range(len(stored))]
    replays = [log for log in logs if log.episode.mode == Mode.REPLAY]
    sets: dict[Objective, list[KamikazeSet]] = {}
    for name in objectives:
        of_it = (stored.mode == Mode.KAMIKAZE) & (stored.objective == name)
        rows = [np.flatnonzero(of_it & (stored.safe_index == index)).tolist() for index in range(len(safe))]
        # A registered objective is not looked up: of a name alone all that is wanted is the name.
        sets[cast(Objective, name)] = [
            kamikaze_set(phi, sorted((logs[row] for row in mine), key=lambda log: log.episode.episode_id))
            for phi, mine in zip(safe, rows, strict=True)
        ]
    confidence = _confidence(figures)
    rating = judge_all(plan, safe, sets, replays, float(figures["seconds"]), confidence)
    margins = _margins(figures, stored, scenario, confidence)
    risks = stored_risks(figures, stored, confidence)
    return replace(rating, margins=margins, risks=risks and with_failures(risks, stored, scenario))


def _confidence(figures: Mapping[str, Any]) -> float:
    """Return the confidence of the intervals by φ: that of each look, where there were several."""
    until = figures.get("until_width")
    found = CONFIDENCE if until is None else float(until["confidence"])
    if not CONFIDENCE <= found < 1.0:
        raise ValueError(f"until_width.confidence must be from {CONFIDENCE:g} to below 1, got {found:g}")
    return found


def _log(stored: StoredEpisodes, number: int, scenario: Scenario, safe: list[Trajectory]) -> EpisodeLog:
    episode = Episode(
        scenario,
        Mode(int(stored.mode[number])),
        int(stored.further["seed"]),
        int(stored.episode_id[number]),
        safe_trajectory=safe[int(stored.safe_index[number])],
    )
    return EpisodeLog(
        episode,
        Outcome(int(stored.outcome[number])),
        stored.adversary[number],
        stored.car[number],
        float(stored.impact_time[number]),
        float(stored.impact_speed[number]),
        reason=str(stored.further["reason"][number]),
        clipped=int(stored.further["clipped"][number]),
        own_contact=float(stored.further["own_contact"][number]) if "own_contact" in stored.further else None,
    )


def _margins(
    figures: Mapping[str, Any], stored: StoredEpisodes, scenario: Scenario, confidence: float
) -> Margins | None:
    if stored.margins is None or not sum(map(len, stored.margins)):
        return None
    ways: list[tuple[LeastWay | None, ...]] = []
    for distances, known in zip(stored.margins, stored.margin_ways, strict=True):
        found: list[LeastWay | None] = [None] * len(distances)
        for way in known:
            trajectory = Trajectory(way.positions, stored.time_step, "")
            found[way.attempt] = LeastWay(way.distance, trajectory, way.duration, way.impact_speed, way.gap)
        ways.append(tuple(found))
    budget, converged = figures["margin_budget"], figures["margin_converged"]
    excess = None if figures["margin_excess"] is None else Excess(**figures["margin_excess"])
    how = figures["margin_how"] or ""
    return Margins(tuple(ways), scenario.eta_max, budget, bool(converged), excess, confidence, how)


def stored_risks(figures: Mapping[str, Any], stored: StoredEpisodes, confidence: float = CONFIDENCE) -> Risks | None:
    """Return the risk that the stored ends of its crossings give; None where the file has none.

    Raises:
        ValueError, LookupError: its arrays do not go together.
    """
    further, phis = stored.further, len(stored.safe)
    if "risk_touch" not in further:
        return None
    scales = further["risk_scale"].tolist()
    touches = further["risk_touch"].astype(np.int64).reshape(len(scales), -1)
    ticks = further["risk_tick"].astype(np.int64).reshape(touches.shape)
    lost = further["risk_lost"].tolist() if "risk_lost" in further else [0] * len(scales)
    levels = further["risk_levels"].reshape(len(scales), -1)
    shares = further["risk_share"].reshape(len(scales), -1, phis)
    if not np.isin(touches, [*map(int, Touch)]).all():
        raise ValueError("risk_touch has a value that this version does not know")
    found = []
    for row, scale in enumerate(scales):
        per_level, subsets = int(further["risk_per_level"][row]), None
        if per_level:
            subsets = Subsets(shares[row], levels[row], per_level, int(further["risk_open"][row]))
        found.append(ScaleRisk(scale, touches[row], phis, subsets, confidence, ticks[row], lost[row]))
    return Risks(figures["risk"]["behaviour"], found)
