"""One log, looked at on its own."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from skd_adversary.car_model_file import fitted_car
from skd_adversary.model.road_users import road_user_named
from skd_sim.episode.aborts import AbortKind, kind_of
from skd_sim.episode.episode import Episode, EpisodeLog, Mode, Outcome
from skd_sim.state import AdversaryState

from skd_evaluator.arrays import FARTHEST, within_reach
from skd_evaluator.campaign.plan.plan import STAGES, Stage, split_episode_id, walks_a_way
from skd_evaluator.campaign.validation.plausibility import implausible
from skd_evaluator.campaign.validation.recomputation import ROUNDING, determined, first_touch, recompute

_WHILE_RUNNING = (
    AbortKind.NO_ANSWER, AbortKind.NOT_STARTED, AbortKind.NOT_FINITE, AbortKind.ENDED, AbortKind.STOPPED,
    AbortKind.FAILED,
)  # fmt: skip
"""Why an episode is aborted that goes on: once it is over, nobody has to answer."""
_FASTER = 0.5  # m/s that φ may be faster than its kind, for its places are rounded
_GRAZE = 0.05  # m that another simulator's touch may be off by
_LEARNT_FROM = {Mode.REPLAY: Stage.PROBE, Mode.KAMIKAZE: Stage.LEARNING}
"""Stages in which a car was learned, by what the adversary did."""


@dataclass(frozen=True)
class Verdict:
    """Whether a log can have happened.

    Attributes:
        fault: why it cannot have happened; empty: nothing contradicts it.
        deviation: greatest difference between its states and those that SKD's own world gives, m, m/s or s.
        where: the quantity and tick of the deviation.
        rounded: likewise of what states tell to the last bit; 0: none, not even in one bit.
        rounded_where: the quantity and tick of that.
        late: ticks in which a command was that of an earlier tick, as in real time.
        whole: whether all of it could be recomputed; that is not so for cars with dynamics or clocks of their own.
    """

    fault: str = ""
    deviation: float = 0.0
    where: str = ""
    rounded: float = 0.0
    rounded_where: str = ""
    late: int = 0
    whole: bool = True

    @property
    def ours(self) -> bool:
        """Whether SKD's own world gives this log."""
        return not self.fault and self.deviation <= ROUNDING


def examine(log: EpisodeLog, *, asked: bool = False) -> Verdict:
    """Recompute whatever can be recomputed of a log, and say what does not fit.

    A log is refused if no simulator can have given it: its states are not finite or too many, its geometry contradicts
    its outcome or impact, or a road user is faster than possible. If only SKD's own world would not have given it,
    `deviation` says by how much: logs of another simulator have one.

    Args:
        log: what is said to have happened, wherever it comes from.
        asked: whether whoever looks has asked for this very episode: then its specification is not looked at.
    """
    try:
        fault = ("" if asked else _specification(log.episode)) or _form(log)
        if fault:
            return Verdict(fault)
        if not np.isfinite(log.car).all():
            return Verdict()  # one that was aborted before there was anything to record
        fault = _outcome(log) or (_aborted(log) if log.outcome == Outcome.ABORTED else "") or implausible(log)
        found = recompute(log)
    except ValueError as error:  # of the specification: no car model, or φ never enters the car's path
        return Verdict(str(error))
    return Verdict(
        fault, found.deviation, found.where, found.rounded, found.rounded_where, found.late,
        determined(log.episode.scenario),
    )  # fmt: skip


def _specification(episode: Episode) -> str:
    """Return what in the specification no campaign would have asked for."""
    if not (math.isfinite(episode.multiplier) and episode.multiplier >= 0.0):
        return f"has the multiplier {episode.multiplier:g}"
    limit = episode.maximum_distance
    if limit is not None and not (math.isfinite(limit) and limit > 0.0):
        return f"has the maximum distance {limit:g} m"
    if not episode.car.exists:
        return f"has the controller {episode.controller[:40]!r}, which is none"
    if episode.simulations < 1:
        return "has no simulations"
    if episode.car_model:
        fitted_car(episode.car_model)
    stage = split_episode_id(episode.episode_id)[0]
    if stage not in (STAGES[episode.mode], _LEARNT_FROM.get(episode.mode)) and not walks_a_way(episode):
        return f"has the mode {episode.mode.name}, which its number does not belong to"
    phi, scenario = episode.safe_trajectory, episode.scenario
    if phi is not None and len(phi) > 1:
        with np.errstate(over="ignore"):
            pace = np.hypot(*np.diff(phi.positions, axis=0).T).max() / phi.time_step
        user = road_user_named(scenario.adversary.kind)
        if not pace <= user.fastest + _FASTER:
            return f"its safe trajectory goes {pace:.3g} m/s, faster than any {user.name}"
        if not math.isclose(phi.time_step, scenario.time_step, rel_tol=1e-9):
            return f"its safe trajectory has a time step of {phi.time_step:g} s, its scenario {scenario.time_step:g} s"
    return ""


def _form(log: EpisodeLog) -> str:
    """Return what is wrong with a log before its numbers are looked at."""
    scenario, count = log.episode.scenario, len(log.adversary)
    if log.adversary.shape != (count, 2) or log.car.shape != (count, 3) or count == 0:
        return f"has {len(log.car)} states of the car and {count} of the adversary"
    if count - 1 > scenario.ticks:
        return f"has {count - 1} ticks, its scenario at most {scenario.ticks}"
    if log.outcome == Outcome.RUNNING:
        return "has the outcome RUNNING, which no episode ends with"
    impact = (log.impact_time, log.impact_speed)
    if log.outcome == Outcome.COLLISION:
        if not np.isfinite(impact).all():
            return "is a collision without time and speed of the impact"
    elif not np.isnan(impact).all():
        return f"has an impact, but the outcome is {log.outcome.name}"
    if log.outcome == Outcome.ABORTED:
        if count == 1 and np.isnan(log.car).all() and np.isfinite(log.adversary).all():
            return ""
    elif count == 1:
        return "has no tick"
    if not within_reach(log.adversary, log.car):
        return f"has a state that is not finite, or beyond ±{FARTHEST:g}"
    return ""


def _outcome(log: EpisodeLog) -> str:
    """Return what contradicts the outcome in where the adversary was, tick by tick."""
    last = len(log.adversary) - 1
    for tick, (x, y) in enumerate(log.adversary.tolist()):
        if tick == 0:
            continue
        collided = tick == last and log.outcome == Outcome.COLLISION
        stands = log.episode.outcome(tick, AdversaryState(x, y, 0.0, 0.0), collided=collided)
        if tick < last and stands != Outcome.RUNNING:
            return f"ends by its geometry at tick {tick} ({stands.name}), but has {last} ticks"
        if tick == last and stands != log.outcome and not _interrupted(log, stands):
            how = "is not over" if stands == Outcome.RUNNING else f"ends as {stands.name}"
            return f"has the outcome {log.outcome.name} after {last} ticks, but by its geometry {how}"
    return ""


def is_over(log: EpisodeLog) -> bool:
    """Whether an episode that was aborted had come to its end by its states: a touch in its last tick, or another."""
    last = len(log.adversary) - 1
    if last < 1 or not (np.isfinite(log.car).all() and np.isfinite(log.adversary).all()):
        return False
    x, y = log.adversary[-1].tolist()
    if log.episode.outcome(last, AdversaryState(x, y, 0.0, 0.0), collided=False) != Outcome.RUNNING:
        return True
    return first_touch(log, margin=_GRAZE) is not None


def _aborted(log: EpisodeLog) -> str:
    """Return what contradicts that an episode was aborted while somebody had to answer, or before: it was over."""
    kind = kind_of(log.reason)
    if kind in _WHILE_RUNNING and is_over(log):
        return f"is said to have been aborted ({kind}), but by its states it had come to its end"
    return ""


def _interrupted(log: EpisodeLog, stands: Outcome) -> bool:
    """Whether an episode may count as aborted: one that was over may only with a stated reason."""
    return log.outcome == Outcome.ABORTED and (stands == Outcome.RUNNING or bool(log.reason))
