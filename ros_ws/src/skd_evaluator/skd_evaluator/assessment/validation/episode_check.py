"""Whether an episode can have happened: complete, finite, plausible, and what SKD's own world makes of it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from skd_adversary.car_models.car_model_file import fitted_car
from skd_adversary.crossing.road_users import road_user_named
from skd_sim.arrays import FloatArray
from skd_sim.scenario.road import HEADING_NORTH, road_position
from skd_sim.world.contact import rectangle_distance, to_car_frame
from skd_sim.world.episode import Episode, EpisodeLog, Mode, Outcome
from skd_sim.world.state import AdversaryState

from skd_evaluator.arrays import FARTHEST, within_reach
from skd_evaluator.assessment.plan.plan import STAGES, Stage, split_episode_id, walks_a_way
from skd_evaluator.assessment.validation.world_step import ROUNDING, driven, first_touch, follows_phi, recompute

LARGEST_ACCELERATION = 20.0
"""m/s², of a car: twice what the best tyres do on a dry road; also the most that nodes take for a limit."""
LARGEST_SPEED = 100.0
"""m/s, of a car; scenarios allow 60 at the start."""
_PLACED = 5.0  # m from the start: the most that carla_bridge may be told to tolerate
_OFF = 1.0  # m from φ that the adversary of another simulator may stray
_SLACK = 0.05  # m
_FASTER = 0.5  # m/s that φ may be faster than its kind, for its places are rounded
_LEARNT_FROM = {Mode.REPLAY: Stage.PROBE, Mode.KAMIKAZE: Stage.LEARNING}
"""Stages in which a car was learned, by what the adversary did."""


@dataclass(frozen=True)
class Verdict:
    """Whether a log can have happened.

    Attributes:
        fault: why it cannot have happened; empty: nothing contradicts it.
        deviation: greatest difference between its states and those that SKD's own world gives, m, m/s or s.
        where: the quantity and tick of the deviation.
    """

    fault: str = ""
    deviation: float = 0.0
    where: str = ""

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
        fault = _outcome(log) or implausible(log)
        found = recompute(log)
    except ValueError as error:  # of the specification: no car model, or φ never enters the car's path
        return Verdict(str(error))
    return Verdict(fault, found.deviation, found.where)


def _specification(episode: Episode) -> str:
    """Return what in the specification no campaign would have asked for."""
    for what, value in (("multiplier", episode.multiplier), ("maximum distance", episode.maximum_distance or 1.0)):
        if not 0.0 <= value < math.inf:
            return f"has the {what} {value:g}"
    if not episode.car.exists:
        return f"has the controller {episode.controller[:40]!r}, which is none"
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
    if not np.isfinite([*log.timing.ages, log.timing.delay]).all():
        return "has the age of a command that is not finite"
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


def _interrupted(log: EpisodeLog, stands: Outcome) -> bool:
    """Whether an episode may count as aborted: one that was over may only with a stated reason."""
    return log.outcome == Outcome.ABORTED and (stands == Outcome.RUNNING or bool(log.reason))


def play_of(time_step: float) -> float:
    """Return how far (m) within a tick a car may be from where it would be if it drove uniformly."""
    return LARGEST_ACCELERATION * time_step * time_step / 8.0 + _SLACK


def implausible(log: EpisodeLog) -> str:
    """Return what no simulator can have given, in a few words; empty: nothing.

    Contacts are looked for with a margin, for within a tick a car need not drive uniformly.

    Args:
        log: what is said to have happened; its states must be finite, and as many as its outcome needs.
    """
    return _placed(log) or _walked(log) or _driven(log) or _touched(log)


def _placed(log: EpisodeLog) -> str:
    episode = log.episode
    car = episode.scenario.car
    off = math.dist(log.adversary[0], episode.start)
    if off > _PLACED:
        return f"the adversary starts {off:.3g} m from where the specification has it"
    reference = -episode.start_gap - car.front
    low, high = reference - car.start_gap_range - _PLACED, reference + _PLACED
    along, left = road_position(episode.scenario.road.line, float(log.car[0, 0]), float(log.car[0, 1]))
    if not low <= along <= high or abs(left) > _PLACED:
        return "the car does not start where the specification has it"
    return ""


def _walked(log: EpisodeLog) -> str:
    episode, step = log.episode, log.episode.scenario.time_step
    phi = None if episode.safe_trajectory is None else episode.safe_trajectory.positions
    pace = episode.scenario.adversary.speed
    if follows_phi(episode) and phi is not None and len(phi) > 1:
        along = float(np.hypot(*np.diff(phi, axis=0).T).max()) / step
        pace = along if episode.mode == Mode.REPLAY else max(pace, along)
    steps = np.hypot(*np.diff(log.adversary, axis=0).T)
    fast = np.flatnonzero(steps > 1.5 * pace * step + _SLACK)
    if fast.size:
        return f"the adversary goes {steps[fast[0]] / step:.3g} m/s in tick {fast[0]}, of {pace:.3g} m/s at most"
    if episode.mode == Mode.REPLAY and phi is not None:
        from_phi = np.hypot(*(log.adversary[:, None] - phi).T).min(axis=0)
        if from_phi.max() > _OFF + pace * step:
            return f"the adversary is {from_phi.max():.3g} m off the safe trajectory that it follows"
    return ""


def _driven(log: EpisodeLog) -> str:
    step, driven = log.episode.scenario.time_step, log.car
    speed = driven[:, 2]
    if speed.min() < -1.0 or speed.max() > LARGEST_SPEED:
        worst = speed.min() if speed.min() < -1.0 else speed.max()
        return f"the car drives {worst:.3g} m/s"
    noise = log.episode.scenario.car
    change = np.abs(np.diff(speed))
    most = step * LARGEST_ACCELERATION * (1.0 + noise.acceleration_noise) + noise.speed_noise * np.abs(speed[:-1])
    hard = np.flatnonzero(change > most + 1e-9)
    if hard.size:
        return f"the car's speed changes by {change[hard[0]]:.3g} m/s in tick {hard[0]}"
    way = np.hypot(*np.diff(driven[:, :2], axis=0).T)
    should = 0.5 * step * np.abs(speed[:-1] + speed[1:])
    apart = way - should
    if log.outcome == Outcome.COLLISION:
        apart[-1:] = np.maximum(apart[-1:], 0.0)  # a simulator may end the tick at the contact
    far = np.flatnonzero(np.abs(apart) > 2.0 * play_of(step))
    if far.size:
        return f"the car goes {way[far[0]]:.3g} m in tick {far[0]}, its speeds say {should[far[0]]:.3g} m"
    return ""


def _touched(log: EpisodeLog) -> str:
    """Look whether it touches where it says so, and nowhere else."""
    scenario = log.episode.scenario
    ticks, step = len(log.adversary) - 1, scenario.time_step
    margin = min(play_of(step), 0.9 * min(scenario.car.half_width, scenario.car.front, scenario.car.rear))
    touch = first_touch(log, margin=margin)
    slow = touch is not None and (
        touch.speed < scenario.collision.minimum_impact_speed + LARGEST_ACCELERATION * step * 0.5
        and scenario.collision.minimum_impact_speed > 0.0
    )
    early = touch is not None and touch.tick < ticks - 1
    over = log.outcome == Outcome.COLLISION or (log.outcome == Outcome.ABORTED and bool(log.reason))
    if touch is not None and not slow and (early or not over):
        ends = "it is said to go on" if over else f"the outcome is {log.outcome.name}"
        return f"car and adversary touch in tick {touch.tick}, but {ends}"
    if log.outcome != Outcome.COLLISION:
        return ""
    fraction = log.impact_time / step - (ticks - 1)
    if not -1e-9 <= fraction <= 1.0 + 1e-9:
        return f"the impact is at {log.impact_time:.6g} s, which is not in the last of {ticks} ticks"
    before, after = log.car[-2, 2], log.car[-1, 2]
    play = 0.5 * LARGEST_ACCELERATION * step
    if not max(0.0, min(before, after) - play) <= log.impact_speed <= max(before, after) + play:
        return f"the impact is at {log.impact_speed:.6g} m/s, the car drives {before:.3g} to {after:.3g} m/s"
    if log.impact_speed < scenario.collision.minimum_impact_speed:
        return f"the impact is at {log.impact_speed:.6g} m/s, less than counts as a collision"
    gap = _gap_at(log, log.adversary[-2] + fraction * (log.adversary[-1] - log.adversary[-2]))
    passed = zip(scenario.others, scenario.others_at(ticks - 1), scenario.others_at(ticks), strict=True)
    for other, came, went in passed:
        place = came.moved(went, fraction * step)
        if _gap_at(log, np.array(place[:2])) <= other.reach + play_of(step):
            return ""
    if gap > scenario.adversary.reach + play_of(step):
        return f"car and adversary are {gap:.3g} m apart at the impact"
    return ""


def _gap_at(log: EpisodeLog, place: FloatArray) -> float:
    """Return the distance (m) from a place to the ground that the car may cover in the last tick."""
    car = log.episode.scenario.car
    line = log.episode.scenario.road.line
    if not log.episode.scenario.road.straight:
        way = driven(line, False, log.car[-2], log.car[-1])
        seen = [to_car_frame(float(place[0]), float(place[1]), *pose) for pose in way[:, :3].tolist()]
        return min(float(rectangle_distance(*here, car.front, car.rear, car.half_width)) for here in seen)
    x = 0.5 * (log.car[-2, 0] + log.car[-1, 0])
    ahead, left = to_car_frame(float(place[0]), float(place[1]), float(x), float(log.car[-2, 1]), HEADING_NORTH)
    ahead_by = float(log.car[-1, 1] - log.car[-2, 1])
    return rectangle_distance(ahead, left, car.front + max(0.0, ahead_by), car.rear, car.half_width)
