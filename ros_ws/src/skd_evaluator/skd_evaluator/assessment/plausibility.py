"""Whether an episode can have happened: complete, finite, plausible, and consistent with the world's step.

The world draws its noise from the episode's seed, so from the commands and the adversary's steps everything else
follows: the car's path, the touch, its time and its speed. Of the basic controller the commands do, too. A recording
that says otherwise is not of this world, of another episode, or damaged.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from skd_adversary.car_models.car_model_file import fitted_car
from skd_adversary.crossing.interfaces import path_velocities
from skd_adversary.crossing.model import choices
from skd_adversary.crossing.objectives import objective_named
from skd_adversary.crossing.road_users import road_user_named
from skd_sim.controllers.basic import BasicController
from skd_sim.kernels.compilation import kernel
from skd_sim.scenario.road import beyond, road_position
from skd_sim.scenario.road_user import Body
from skd_sim.world.contact import rectangle_distance, sweep, to_car_frame
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Mode, Outcome, Role, generator
from skd_sim.world.state import AdversaryState, FloatArray, on_grid
from skd_sim.world.world import World, make_world

ROUNDING = 1e-9
"""m, m/s, s: what another processor's rounding may change."""
_FARTHEST = 1e6
"""m, m/s, rad: no state is beyond; squares of what is 10¹⁴⁸ times as far are infinite."""
UNLIKE = 1.0
"""Deviation where something happened in one of the two and not in the other."""
_TURN = 0.05  # rad in a piece of a path between two states
_LOOKS = 20  # pieces of the last tick


class FirstTouch(NamedTuple):
    """First touch of an episode: its tick, the share of the tick, and the car's speed, m/s."""

    tick: int
    fraction: float
    speed: float


@dataclass
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

    def note(self, differences: FloatArray | float, what: str, first_tick: int | None = None) -> None:
        """Take differences (m, m/s or s) of some quantity, one a tick from `first_tick` on, or a single one."""
        values = np.atleast_1d(np.abs(differences))
        if values.size and not values.max() <= self.deviation:
            worst = int(np.argmax(values))
            self.deviation = float(values[worst])
            self.where = what if first_tick is None else f"{what} at tick {first_tick + worst}"


@kernel
def _touches(
    adversary: FloatArray,
    car: FloatArray,
    footprint: tuple[float, float, float],
    shape: tuple[float, float, float],
    first_heading: float,
    time_step: float,
    minimum_speed: float,
) -> tuple[int, float, float]:
    """Return tick, fraction and speed of the first touch that counts, of a car that drives uniformly; −1: none."""
    heading = first_heading
    for tick in range(adversary.shape[0] - 1):
        path = between(car[tick], car[tick + 1], 1)
        place, end = (adversary[tick, 0], adversary[tick, 1]), (adversary[tick + 1, 0], adversary[tick + 1, 1])
        velocity = ((end[0] - place[0]) / time_step, (end[1] - place[1]) / time_step)
        if shape[0] == 0.0 and (velocity[0] != 0.0 or velocity[1] != 0.0):
            heading = math.atan2(velocity[1], velocity[0])
        contact, speed = sweep(path, place, end, velocity, heading, footprint, shape, time_step, 0, 1)
        if contact <= 1.0 and speed >= minimum_speed:
            return tick, contact, speed
    return -1, math.inf, 0.0


@kernel
def between(before: FloatArray, after: FloatArray, pieces: int) -> FloatArray:
    """Return the car's path between two recorded states, along an arc, in at least so many pieces; see `sweep`."""
    dx, dy, turned = after[0] - before[0], after[1] - before[1], on_grid(after[2] - before[2])
    pieces = max(pieces, math.ceil(abs(turned) / _TURN))
    path = np.empty((pieces + 1, 4))
    for piece in range(pieces + 1):
        share = piece / pieces
        bulge = 0.5 * turned * share * (1.0 - share)
        path[piece] = before + share * (after - before) if piece < pieces else after
        path[piece, 0] += bulge * dy
        path[piece, 1] -= bulge * dx
        path[piece, 2] = before[2] + share * turned
    return path


def driven_paths(log: EpisodeLog) -> list[FloatArray]:
    """Return the car's path in parts of equal time, as the world drives it by the commands.

    Where they are not known, or another simulator drove otherwise, the parts are arcs between the states.
    """
    commands = [] if log.commands is None else log.commands.tolist()
    world, periods, paths = make_world(log.episode), log.episode.scenario.control_periods, list[FloatArray]()
    for number in range((len(log.car) - 1) * periods if commands else 0):
        held = commands[min(number, len(commands) - 1)]  # the last one from a contact on
        paths.append(world.advance(world.limits.possible((held[0], held[1]))))
    ends = [path[-1] for path in paths[periods - 1 :: periods]]
    if ends and np.abs(np.array(ends) - log.car[1:]).max() <= ROUNDING:
        return paths
    return [between(before, after, _LOOKS) for before, after in pairwise(log.car)]


def touches(log: EpisodeLog, *, margin: float = 0.0) -> list[FirstTouch | None]:
    """Return the first touch that counts with the adversary, then with each of the others, as if it were the only one.

    Args:
        log: what happened; its states must be finite.
        margin: by how much the car's footprint is made smaller on each side, m.
    """
    scenario = log.episode.scenario
    car = scenario.car
    seen = [scenario.others_at(tick) for tick in range(len(log.adversary))] if scenario.others else []
    bodies: list[tuple[Body, FloatArray]] = [(scenario.adversary, log.adversary)]
    bodies += [(other, np.array([at[i][:2] for at in seen])) for i, other in enumerate(scenario.others)]
    found: list[FirstTouch | None] = []
    for body, track in bodies:
        tick, fraction, speed = _touches(
            track,
            log.car,
            (car.front - margin, car.rear - margin, car.half_width - margin),
            body.shape,
            body.first_heading,
            scenario.time_step,
            scenario.collision.minimum_impact_speed,
        )
        found.append(FirstTouch(tick, fraction, speed) if tick >= 0 else None)
    return found


def recompute(log: EpisodeLog) -> Verdict:
    """Compare a log with what the world gives to its adversary's steps and its commands.

    Where the commands are not known, only the start and the adversary are compared.

    Args:
        log: what is said to have happened, with any outcome; its states must be finite.
    """
    found = Verdict()
    world = make_world(log.episode)
    found.note(log.adversary[0] - np.array(world.adversary[:2]), "the adversary's start")
    found.note(log.car[0] - np.array(world.car), "the car's start")
    if len(log.car) > 1:
        _adversary(log, found)
        if log.commands is not None:
            _car(log, log.commands, world, found)
    return found


def follows_phi(episode: EpisodeSpec) -> bool:
    """Whether the adversary can go as φ does: a replay, and a kamikaze that can choose to."""
    if episode.mode != Mode.KAMIKAZE:
        return episode.mode == Mode.REPLAY
    return objective_named(episode.objective).follows_phi


def _adversary(log: EpisodeLog, found: Verdict) -> None:
    """Compare each step of the adversary with those that it can choose.

    In real time a command is held until the next one comes, so one that follows φ may go as φ did in another tick.
    """
    episode, walked = log.episode, log.adversary
    scenario, ticks = episode.scenario, len(walked) - 1
    user = road_user_named(scenario.adversary.kind)
    path = walked[:1] if episode.safe_trajectory is None else episode.safe_trajectory.positions
    possible: list[FloatArray] = []
    as_phi = path_velocities(path, ticks, scenario.time_step)
    if episode.mode != Mode.REPLAY:
        chosen = choices(user, scenario, path, walked)[:, :, 0]
        possible, as_phi = [chosen[:, :-1]], chosen[:, -1]
    if follows_phi(episode):
        possible.append(np.broadcast_to(np.vstack([as_phi, np.zeros(2)]), (ticks, ticks + 1, 2)))
    reached = walked[:-1, None] + scenario.time_step * np.concatenate(possible, axis=1)
    found.note(np.abs(reached - walked[1:, None]).max(axis=-1).min(axis=1), "the adversary's position", 1)


def _car(log: EpisodeLog, commands: FloatArray, world: World, found: Verdict) -> None:
    """Drive the car again by its commands; compare its states, the impact, and what a basic car commands."""
    episode, steps = log.episode, np.diff(log.adversary, axis=0) / log.episode.scenario.time_step
    # φ is made before any car is looked at, and in real time a command may be that of an earlier tick.
    decides = episode.car.is_known and episode.mode != Mode.SAFE and not log.timing.delay > 0.0
    basic = BasicController(episode.multiplier if decides else 0.0)
    basic.reset(episode.public_scenario, generator(0, 0, Role.CONTROLLER))
    states, contact = [world.car], None
    for command in commands.tolist():
        if decides:
            expected = basic.command(world.car, world.adversary), 0.0
            found.note(np.subtract(command, expected), "the car's command", world.tick)
        contact = world.step(tuple(command), steps[world.tick].tolist())
        if world.period == 0:
            states.append(world.car)
        if contact is not None or len(states) == len(log.car):
            break
    driven = np.array(states)
    for column, what in enumerate(("x", "y", "heading", "speed")):
        off = driven[:, column] - log.car[: len(driven), column]
        found.note(np.angle(np.exp(1j * off)) if what == "heading" else off, f"the car's {what}", 0)
    if len(driven) < len(log.car) or (contact is not None) != (log.outcome == Outcome.COLLISION):
        if contact is not None or log.outcome != Outcome.ABORTED:
            found.note(UNLIKE, "the touch" if contact is not None or len(driven) == len(log.car) else "the commands")
    elif contact is not None:
        time = (len(driven) - 2 + contact.fraction) * episode.scenario.time_step
        found.note(log.impact_time - time, "the impact's time")
        found.note(log.impact_speed - contact.speed, "the impact's speed")


LARGEST_ACCELERATION = 20.0
"""m/s², of a car: twice what the best tyres do on a dry road; also the most that nodes take for a limit."""
LARGEST_SPEED = 100.0
"""m/s, of a car; scenarios allow 60 at the start."""
_PLACED = 5.0  # m from the start: the most that carla_bridge may be told to tolerate
_OFF = 1.0  # m from φ that the adversary of another simulator may stray
_SLACK = 0.05  # m


def examine(log: EpisodeLog) -> Verdict:
    """Recompute whatever can be recomputed of a log, and say what does not fit.

    A log is refused if no simulator can have given it: its states are not finite or too many, its geometry contradicts
    its outcome or impact, or a road user is faster than possible. If only SKD's own world would not have given it,
    `deviation` says by how much: logs of another simulator have one.
    """
    try:
        if log.episode.car_model:
            fitted_car(log.episode.car_model)
        if fault := _form(log):
            return Verdict(fault)
        if not np.isfinite(log.car).all():
            return Verdict()  # one that was aborted before there was anything to record
        return replace(recompute(log), fault=_outcome(log) or implausible(log))
    except ValueError as error:  # of the specification: no car model, or φ never enters the car's path
        return Verdict(str(error))


def _form(log: EpisodeLog) -> str:
    """Return what is wrong with a log before its numbers are looked at."""
    scenario, count = log.episode.scenario, len(log.adversary)
    if log.adversary.shape != (count, 2) or log.car.shape != (count, 4) or count == 0:
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
    if not all((np.abs(one) <= _FARTHEST).all() for one in (log.adversary, log.car)):
        return f"has a state that is not finite, or beyond ±{_FARTHEST:g}"
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
        # An episode that was over may count as aborted only with a stated reason.
        interrupted = log.outcome == Outcome.ABORTED and (stands == Outcome.RUNNING or bool(log.reason))
        if tick == last and stands != log.outcome and not interrupted:
            how = "is not over" if stands == Outcome.RUNNING else f"ends as {stands.name}"
            return f"has the outcome {log.outcome.name} after {last} ticks, but by its geometry {how}"
    return ""


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
    speed = driven[:, 3]
    if speed.min() < -1.0 or speed.max() > LARGEST_SPEED:
        worst = speed.min() if speed.min() < -1.0 else speed.max()
        return f"the car drives {worst:.3g} m/s"
    noise = log.episode.scenario.car
    change = np.abs(np.diff(speed))
    most = step * LARGEST_ACCELERATION * (1.0 + noise.acceleration_noise) + noise.speed_noise * np.abs(speed[:-1])
    hard = np.flatnonzero(change > most + 1e-9)
    if hard.size:
        return f"the car's speed changes by {change[hard[0]]:.3g} m/s in tick {hard[0]}"
    track = np.hypot(*np.diff(driven[:, :2], axis=0).T)
    should = 0.5 * step * np.abs(speed[:-1] + speed[1:])
    apart = track - should
    if log.outcome == Outcome.COLLISION:
        apart[-1:] = np.maximum(apart[-1:], 0.0)  # a simulator may end the tick at the contact
    far = np.flatnonzero(np.abs(apart) > 2.0 * play_of(step))
    if far.size:
        return f"the car goes {track[far[0]]:.3g} m in tick {far[0]}, its speeds say {should[far[0]]:.3g} m"
    return ""


def _touched(log: EpisodeLog) -> str:
    """Look whether it touches where it says so, and nowhere else."""
    scenario = log.episode.scenario
    ticks, step = len(log.adversary) - 1, scenario.time_step
    margin = min(play_of(step), 0.9 * min(scenario.car.half_width, scenario.car.front, scenario.car.rear))
    touch = min((one for one in touches(log, margin=margin) if one is not None), default=None)
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
    before, after = log.car[-2, 3], log.car[-1, 3]
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
    car, road = scenario.car, scenario.road
    outside = car.front + play_of(step), car.rear + play_of(step), car.half_width + play_of(step)
    if beyond(road.line, road.edges, outside, between(log.car[-2], log.car[-1], _LOOKS)) >= 0:
        return ""
    if gap > scenario.adversary.reach + play_of(step):
        return f"car and adversary are {gap:.3g} m apart at the impact"
    return ""


def _gap_at(log: EpisodeLog, place: FloatArray) -> float:
    """Return the distance (m) from a place to the ground that the car may cover in the last tick."""
    car, track = log.episode.scenario.car, between(log.car[-2], log.car[-1], _LOOKS)
    seen = [to_car_frame(float(place[0]), float(place[1]), *pose) for pose in track[:, :3].tolist()]
    return min(float(rectangle_distance(*here, car.front, car.rear, car.half_width)) for here in seen)
