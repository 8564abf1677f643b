"""A rating made anew from episodes.npz, so that every figure of assessment.json that follows from it can be compared.

Nothing that the file names is imported: a result may say that its controller is any module. What a car is called, how
much was searched and what was asked for stay what assessment.json says of them; docs/files.md has the list.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, cast

import numpy as np
from skd_sim.choices.objective import Objective
from skd_sim.encounter.scenario import Scenario, scenario_from_dict
from skd_sim.episode.episode import Episode, EpisodeLog, Mode, Outcome
from skd_sim.geometry.trajectory import Trajectory

from skd_evaluator.arrays import FARTHEST
from skd_evaluator.campaign.judge.assessment import CONFIDENCE
from skd_evaluator.campaign.judge.figure_table import AT_THE_TOP, NEWER, Told
from skd_evaluator.campaign.judge.rating import Rating, judge_all
from skd_evaluator.campaign.plan.plan import KamikazeSet, Plan, kamikaze_set, split_episode_id
from skd_evaluator.campaign.store.result_file import ASSESSMENT
from skd_evaluator.campaign.store.stored_episodes import StoredEpisodes
from skd_evaluator.campaign.store.stored_failures import with_failures
from skd_evaluator.measure.distances.least_way import LeastWay
from skd_evaluator.measure.equivalent_multiplier import EquivalentMultiplier, equivalent_entries
from skd_evaluator.measure.margins import Margins
from skd_evaluator.measure.risks import Risks, ScaleRisk, Subsets, Touch

NEEDED = ("clipped", "reason", "safe_name", "objectives", "plans_deformation", "eta_max", "maximum_distance", "seed")
"""Arrays without which a file of an older version does not say enough."""
BUDGETS, BEHAVIOUR = "vulnerability_curve.budgets", "risk.behaviour"
_AGREE = 1e-7
"""Relative to a figure, or to 1: what another machine's rounding may come to in an interval, which is searched for."""


@dataclass(frozen=True)
class _StoredPlan(Plan):
    """A plan of which the file says what its objectives plan for, so that none of them has to be loaded."""

    plans: Mapping[str, bool] = field(default_factory=dict)

    def __post_init__(self) -> None:
        pass  # its scenario is as it was run, and its car is nobody's

    @property
    def limits_deformation(self) -> bool:
        return self.plans[str(self.objective)]


@dataclass(frozen=True)
class Contradiction:
    """A figure that does not follow from the episodes beside it.

    Attributes:
        name: of the figure.
        said: what assessment.json has.
        found: what follows.
        missing: whether assessment.json has no such entry.
    """

    name: str
    said: Any
    found: Any
    missing: bool = False

    @property
    def is_of_numbers(self) -> bool:
        """Whether it is of two numbers, of which neither is missing."""
        return _is_number(self.said) and _is_number(self.found)

    def __str__(self) -> str:
        return f"{self.name} is {_shown(self.said)}, its episodes give {_shown(self.found)}"


@dataclass(frozen=True)
class Recomputed:
    """The figures of a result held against what follows from its episodes.

    Attributes:
        agree: names of those that follow.
        contradict: those that do not.
        unknown: names of those of which the folder does not say enough.
        rating: what its episodes give.
        figures: the content of assessment.json that they give.
    """

    agree: tuple[str, ...]
    contradict: tuple[Contradiction, ...]
    unknown: tuple[str, ...]
    rating: Rating
    figures: Mapping[str, Any]


def can_be_rebuilt(stored: StoredEpisodes) -> bool:
    """Return whether a file has all that figures follow from, which those of older versions need not have."""
    needed = NEEDED if stored.margins is None else (*NEEDED, "margin_gap", "margin_safe_index")
    return all(name in stored.further for name in needed)


def rebuilt(figures: Mapping[str, Any], stored: StoredEpisodes) -> Rating:
    """Return the rating that episodes give.

    Args:
        figures: content of assessment.json, of which scenario, confidence and how the margin was searched are taken.
        stored: the episodes, of which `can_be_rebuilt` is true.

    Raises:
        ValueError, LookupError: they do not go together.
    """
    further = stored.further
    scenario = scenario_from_dict(figures["scenario"], f"scenario in {ASSESSMENT}")
    names, objectives = further["safe_name"].tolist(), further["objectives"].tolist()
    limit = float(further["maximum_distance"])
    plan = _StoredPlan(
        scenario,
        safe_count=len(stored.safe),
        seed=int(further["seed"]),
        maximum_distance=None if math.isnan(limit) else limit,
        plans=dict(zip(objectives, further["plans_deformation"].tolist(), strict=True)),
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
    gaps = stored.further["margin_gap"]
    order = np.argsort(stored.further["margin_safe_index"], kind="stable").tolist()
    starts = np.cumsum([0, *map(len, stored.margins)]).tolist()
    ways: list[tuple[LeastWay | None, ...]] = []
    for index, distances in enumerate(stored.margins):
        found: list[LeastWay | None] = [None] * len(distances)
        for way in stored.margin_ways[index]:
            gap = float(gaps[order[starts[index] + way.attempt]])
            trajectory = Trajectory(way.positions, stored.time_step, "")
            found[way.attempt] = LeastWay(way.distance, trajectory, way.duration, way.impact_speed, gap)
        ways.append(tuple(found))
    budget, converged = figures["margin_budget"], figures["margin_converged"]
    return Margins(tuple(ways), scenario.eta_max, budget, bool(converged), confidence, figures["margin_how"] or "")


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
    # Older files do not say when somebody is hit.
    ticks = further["risk_tick"].astype(np.int64).reshape(touches.shape) if "risk_tick" in further else None
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
        ended = None if ticks is None else ticks[row]
        found.append(ScaleRisk(scale, touches[row], phis, subsets, confidence, ended, lost[row]))
    return Risks(figures["risk"]["behaviour"], found)


def recompute(figures: Mapping[str, Any], stored: StoredEpisodes) -> Recomputed:
    """Hold the figures of a result against what its episodes give.

    Raises:
        ValueError, LookupError: the episodes do not go together with what is said of them.
    """
    # What is compared is what would have been written.
    rating = rebuilt(figures, stored)
    written = json.loads(json.dumps(rating.as_dict()))
    found = dict(entries_of(written))
    told = dict(entries_of(json.loads(json.dumps(_equivalent(figures, rating.margins)))))
    found |= told
    said = dict(entries_of(figures))
    scenario = rating.plan.scenario
    settings = {
        "eta_max": (float(stored.further["eta_max"]), said.get("eta_max")),
        "scenario.eta_max": (float(stored.further["eta_max"]), scenario.eta_max),
        "scenario.time_step": (stored.time_step, scenario.time_step),
        "scenario.collision.hit_speed": (stored.hit_speed, scenario.collision.hit_speed),
    }
    tree, branches = _branches(found), _branches(said)
    agree, contradict, unknown = [], [], []
    for name, value in said.items():
        if _is_asked(name) and name not in told:
            if name not in settings:
                unknown.append(name)
        elif name in found and _alike(value, found[name]):
            agree.append(name)
        elif name in found or name in tree or any(one in found for one in _above(name)):
            contradict.append(Contradiction(name, value, found.get(name, "something")))
        else:
            unknown.append(name)
    for name, value in found.items():
        if name in said or _is_asked(name) or _is_of_an_unknown_measure(name, branches):
            continue
        if value is None and "." in name:  # what is not there says as much: what an older version did not look for
            continue
        if not _is_of_a_newer_version(name, said, branches):
            contradict.append(Contradiction(name, None, value, missing=True))
    for name, (has, is_said) in settings.items():
        if not _alike(is_said, has):
            contradict.append(Contradiction(name, is_said, has))
        elif name not in agree:
            agree.append(name)
    contradict += _margins_that_cannot_be(rating, stored)
    return Recomputed(tuple(agree), tuple(contradict), tuple(unknown), rating, written)


def _margins_that_cannot_be(rating: Rating, stored: StoredEpisodes) -> Iterator[Contradiction]:
    """Yield which margins are greater than what a kamikaze needed in the same attempt, are of no hit, or not there.

    What was searched begins with the ways of kamikazes that hit, and what is exact is no further above the least than
    it says. A car that was walked in another way need not do in the search what it did in an episode.
    """
    margins = rating.margins
    if margins is None:
        return
    if margins.exact and not margins.converged:
        yield Contradiction("margin_converged", False, True)  # those of basic cars are computed, not searched for
    for index, ways in enumerate(margins.ways):
        for attempt, way in enumerate(ways):
            if way is not None and not stored.hit_speed - _AGREE <= way.impact_speed <= FARTHEST:
                name = f"impact speed of the margin of attempt {attempt} of safe trajectory {index}"
                yield Contradiction(name, way.impact_speed, f"hits from {stored.hit_speed:g} m/s on")
    if margins.how:
        return
    successes = [one.successes_by_phi for one in rating.assessments]
    for index, ways in enumerate(margins.ways):  # of each attempt that was wanted, of which no more can have succeeded
        reached = max(counts[index] for counts in successes)
        if len(ways) < reached:
            yield Contradiction(f"number of margins of safe trajectory {index}", len(ways), f"at least {reached}")
    for number in np.flatnonzero(stored.hit & (stored.mode == Mode.KAMIKAZE)).tolist():
        _, index, attempt = split_episode_id(int(stored.episode_id[number]))
        if attempt >= len(margins.ways[index]):
            continue
        way, needed = margins.ways[index][attempt], float(min(stored.deformation[number], margins.eta_max))
        least = margins.eta_max if way is None else way.distance
        if least - (way.gap if way is not None and margins.exact else 0.0) > needed + _AGREE:
            yield Contradiction(f"margin of attempt {attempt} of safe trajectory {index}", least, needed)


def _equivalent(figures: Mapping[str, Any], margins: Margins | None) -> dict[str, Any]:
    """Return what is known of the equivalent multiplier: of a basic car all of it, of others what their numbers read.

    Exact margins are those of a basic car, whose equivalent is itself.
    """
    own = figures["multiplier"]
    if margins is not None and margins.exact and own is not None:
        return equivalent_entries(EquivalentMultiplier(own, (own, own), (own, own), own, own))
    found: dict[str, Any] = {}
    for end in ("", "_ci95", "_ci95_these_phi"):
        value = figures.get(f"equivalent_multiplier{end}")
        ends = value if isinstance(value, list) else [value]
        if None not in ends:  # beyond what was compared there is no number
            texts = ", ".join(f"{one:.3f}" for one in ends)
            found[f"equivalent_multiplier{end}_text"] = f"[{texts}]" if end else texts
    return found


def _is_asked(name: str) -> bool:
    """Return whether an entry says something that no episode tells."""
    row = AT_THE_TOP.get(name.partition(".")[0])
    return (row is not None and row.told is not Told.EPISODES) or name.startswith((BUDGETS, f"{BEHAVIOUR}."))


def _above(name: str) -> list[str]:
    """Return the names of all that an entry is inside of, the nearest first."""
    parts = name.split(".")
    return [".".join(parts[:count]) for count in range(len(parts) - 1, 0, -1)]


def _branches(leaves: Mapping[str, Any]) -> set[str]:
    """Return the names of all that has something inside."""
    found: set[str] = set()
    for name in leaves:
        above = name.rpartition(".")[0]
        while above and above not in found:  # of one that is there all above it are
            found.add(above)
            above = above.rpartition(".")[0]
    return found


def _is_of_an_unknown_measure(name: str, branches: set[str]) -> bool:
    """Return whether an entry that is missing is of a measure that was not installed where the result was made."""
    nearest = next((one for one in _above(name) if one in branches), "")
    return nearest.rpartition(".")[2] == "measures"


def _is_of_a_newer_version(name: str, said: Mapping[str, Any], branches: set[str]) -> bool:
    """Return whether an entry that is missing is one, or inside of one, that an older version did not have at all."""
    newer = [one for one in (name, *_above(name)) if one.rpartition(".")[2] in NEWER]
    return any(one not in said and one not in branches for one in newer)


def entries_of(value: Any, where: str = "") -> Iterator[tuple[str, Any]]:
    """Yield (name, value) of all that has nothing inside, names as `figure_names` has them."""
    inside = value.items() if isinstance(value, Mapping) else enumerate(value) if isinstance(value, list) else None
    if inside is None or (where and not value):
        yield where, value
        return
    for key, one in inside:
        yield from entries_of(one, f"{where}.{key}" if where else str(key))


def _alike(said: Any, found: Any) -> bool:
    if _is_number(said) and _is_number(found):
        return bool(abs(said - found) <= _AGREE * max(1.0, abs(said), abs(found)))
    same = bool(said == found)
    return same and isinstance(said, bool) == isinstance(found, bool)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _shown(value: Any) -> str:
    if value is None:
        return "nothing"
    return f"{value:.6g}" if isinstance(value, float) else f"{value!r:.60}"
