"""Many episodes at once, in all of which the adversary follows a trajectory: a policy is asked for all together.

The worlds are compiled, and the same to the bit as those of whole episodes. When all is over, the single form of the
policy is asked as well: in every control period of some episodes, by a controller of each one's own, and in one control
period of each of the others. Where `command` answers otherwise than `commands` did, they are not the same car, and
nothing is made of either.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from skd_adversary.crossing.path import path_velocities
from skd_sim.arrays import BoolArray, FloatArray, IntArray
from skd_sim.controllers import control_period_of, make_controller, takes_batches
from skd_sim.controllers.isolated import isolated
from skd_sim.controllers.loading import UserController
from skd_sim.kernels.compilation import kernel
from skd_sim.options.car_under_test import DYNAMICS, CarUnderTest, is_own_world
from skd_sim.scenario.road import is_straight_north
from skd_sim.world.contact import sweep
from skd_sim.world.dynamics.basic import command_limits, drive_straight
from skd_sim.world.episode import Episode, Mode, Role, controller_generator, controller_seed, generator
from skd_sim.world.state import AdversaryState, CarState, Scene
from skd_sim.world.world import first_car_state

from skd_evaluator.errors import AssessmentError

ONE_IN: Final = 50
"""Of so many episodes side by side one is asked by the single form from its beginning to its end."""
TOLERANCE: Final = 1e-4
"""m/s² by which both forms may differ: what sums of single precision in another order come to."""


class Replayed(NamedTuple):
    """What happened in n episodes of at most t ticks.

    Attributes:
        users: places of the adversary at ticks, n × (t + 1) × 2, m.
        cars: places (m) and speeds (m/s) of the car at ticks, n × (t + 1) × 3.
        ticks: how many ticks each had.
        shares: share of the last tick at the contact; infinity without one.
        impacts: speed of the car at the contact, m/s.
    """

    users: FloatArray
    cars: FloatArray
    ticks: IntArray
    shares: FloatArray
    impacts: FloatArray


class _Asked(NamedTuple):
    """What `commands` was asked in a control period of a tick, and answered.

    Attributes:
        tick: number of the tick.
        rows: which episodes go on, m.
        states: of their cars and adversaries, 9 × m, as `UserController.commands` has them.
        commands: accelerations, m, m/s².
    """

    tick: int
    rows: IntArray
    states: FloatArray
    commands: FloatArray


class _Numbers(NamedTuple):
    """A scenario in numbers."""

    front: float
    rear: float
    half_width: float
    radius: float
    time_step: float
    periods: int
    least_command: float
    greatest_command: float
    minimum_impact_speed: float


def why_not_side_by_side(episode: Episode) -> str:
    """Return why episodes like this one are run one by one, in a few words; empty where they need not be."""
    scenario = episode.scenario
    if not is_own_world(episode.simulator):
        return "it is not SKD's own world"
    if not DYNAMICS[scenario.car.dynamics].known:
        return f"car.dynamics is {scenario.car.dynamics}"
    if not is_straight_north(scenario.road.line):
        return "the road has curves"
    if scenario.adversary.is_box or scenario.others:
        return "the adversary is a box, or there are others"
    return ""


@kernel
def _advance(
    numbers: _Numbers,
    tick: int,
    period: int,
    rows: IntArray,
    commands: FloatArray,
    velocities: FloatArray,
    noise: FloatArray,
    cars: FloatArray,
    users: FloatArray,
    origins: FloatArray,
    shares: FloatArray,
    impacts: FloatArray,
    over: BoolArray,
) -> None:
    """Advance some of the episodes by a control period; one with a contact to the end of its tick."""
    footprint, shape = (numbers.front, numbers.rear, numbers.half_width), (numbers.radius, 0.0, 0.0)
    step, periods = numbers.time_step, numbers.periods
    path = np.empty((2, 4))
    for at in range(rows.shape[0]):
        row = rows[at]
        if over[row]:
            continue
        command = min(numbers.greatest_command, max(numbers.least_command, commands[at]))
        vx, vy = velocities[row, tick, 0], velocities[row, tick, 1]
        if period == 0:
            origins[row, 0], origins[row, 1] = users[row, 0], users[row, 1]
        x, y = origins[row, 0], origins[row, 1]
        speed_draw, duration = noise[row, tick, 0] / periods, step / periods
        drive_straight(
            cars[row, 0], cars[row, 1], cars[row, 2], cars[row, 3], command, speed_draw, noise[row, tick, 1],
            duration, path,
        )  # fmt: skip
        cars[row, 0], cars[row, 1], cars[row, 3] = path[1, 0], path[1, 1], path[1, 3]
        end = (x + step * vx, y + step * vy)
        share, impact = sweep(path, (x, y), end, (vx, vy), 0.0, footprint, shape, step, period, periods)
        contact = share <= 1.0 and impact >= numbers.minimum_impact_speed
        users[row, 2], users[row, 3] = vx, vy
        if contact or period == periods - 1:
            users[row, 0], users[row, 1] = end
        else:
            passed = step * (period + 1) / periods
            users[row, 0], users[row, 1] = x + passed * vx, y + passed * vy
        if contact:
            shares[row], impacts[row], over[row] = share, impact, True
            for _ in range(period + 1, periods):  # nobody decides after the contact
                drive_straight(
                    cars[row, 0], cars[row, 1], cars[row, 2], cars[row, 3], command, speed_draw, noise[row, tick, 1],
                    duration, path,
                )  # fmt: skip
                cars[row, 0], cars[row, 1], cars[row, 3] = path[1, 0], path[1, 1], path[1, 3]


def answers_batches(car: CarUnderTest) -> bool:
    """Tell whether a user's controller answers many episodes at once.

    Raises:
        UsageError: it cannot be loaded.
    """
    return isolated(car.user_code, _answers_batches, car)


def _answers_batches(car: CarUnderTest) -> bool:
    return takes_batches(make_controller(car.controller))


def replayed(episodes: Sequence[Episode]) -> Replayed:
    """Run episodes in which the adversary follows a way, all of one car, side by side.

    Args:
        episodes: replays, of scenarios that differ in the start distance alone; see `why_not_side_by_side`. One
            controller, which takes batches, answers all of them: it is reset once, as the first of them has it.

    Raises:
        AssessmentError: the controller fails, or its two forms differ.
    """
    first = episodes[0]
    assert first.mode == Mode.REPLAY, first.mode
    assert not why_not_side_by_side(first), why_not_side_by_side(first)
    policy = _made(first)
    asked_of_all: list[_Asked] = []
    numbers, scenario, count = _numbers(first), first.scenario, len(episodes)
    limit = scenario.ticks
    ends = np.array([min(limit, len(one.safe_trajectory or ()) - 1) for one in episodes], np.int64)
    most = int(ends.max())
    velocities, noise = np.zeros((count, most, 2)), np.zeros((count, most, 2))
    cars, users = np.empty((count, 4)), np.empty((count, 5))
    scales = scenario.car.speed_noise, scenario.car.acceleration_noise
    for row, one in enumerate(episodes):
        assert one.safe_trajectory is not None
        velocities[row] = path_velocities(one.safe_trajectory.positions, most, scenario.time_step)
        cars[row] = first_car_state(one.scenario, one.start_gap, generator(one.seed, one.episode_id, Role.START))
        users[row] = scenario.adversary.first_state(*one.start)
        draws = generator(one.seed, one.episode_id, Role.CAR).random((most, 2))
        noise[row] = np.multiply(scales, 2.0 * draws - 1.0)
    found = Replayed(
        np.empty((count, most + 1, 2)), np.empty((count, most + 1, 3)), ends.copy(), np.full(count, np.inf),
        np.full(count, np.nan),
    )  # fmt: skip
    over, origins = np.zeros(count, bool), users[:, :2].copy()
    found.users[:, 0], found.cars[:, 0] = users[:, :2], cars[:, [0, 1, 3]]
    for tick in range(most):
        rows = np.flatnonzero(~over & (ends > tick))
        if not rows.size:
            break
        for period in range(numbers.periods):
            asked = rows if period == 0 else rows[~over[rows]]
            if not asked.size:
                break
            states = np.concatenate([cars[asked].T, users[asked].T])
            commands = policy.commands(states)
            asked_of_all.append(_Asked(tick, asked, states, commands))
            _advance(
                numbers, tick, period, asked, commands, velocities, noise, cars, users, origins, found.shares,
                found.impacts, over,
            )  # fmt: skip
        found.users[rows, tick + 1], found.cars[rows, tick + 1] = users[rows, :2], cars[rows][:, [0, 1, 3]]
        found.ticks[rows[over[rows]]] = tick + 1
    _confirm(episodes, asked_of_all)
    return found


def _numbers(episode: Episode) -> _Numbers:
    scenario = episode.scenario
    car, limits = scenario.car, command_limits(scenario)
    return _Numbers(
        car.front,
        car.rear,
        car.half_width,
        scenario.adversary.reach,
        scenario.time_step,
        scenario.control_periods,
        limits.least,
        limits.greatest,
        scenario.collision.minimum_impact_speed,
    )


def _made(episode: Episode) -> UserController:
    controller = make_controller(episode.controller)
    assert isinstance(controller, UserController)
    period = control_period_of(controller, episode.controller)
    assert period is None or abs(period - episode.scenario.control_duration) <= 1e-9
    controller.reset(episode.public_scenario, controller_generator(controller_seed(episode.seed, episode.episode_id)))
    return controller


def _confirm(episodes: Sequence[Episode], asked_of_all: Sequence[_Asked]) -> None:
    """Ask the single form what `commands` was asked: some episodes as a whole, and then each once.

    Raises:
        AssessmentError: it answers otherwise.
    """
    rng = generator(episodes[0].seed, episodes[0].episode_id, Role.ORDER, len(episodes))
    for row in sorted(rng.permutation(len(episodes))[: -(-len(episodes) // ONE_IN)].tolist()):
        single = _made(episodes[row])
        for asked in asked_of_all:
            for at in np.flatnonzero(asked.rows == row).tolist():
                _compare(single, episodes[row], asked, at)
    single = _made(episodes[0])
    moments = _moments(asked_of_all, len(episodes), rng)
    for row in rng.permutation(len(episodes)).tolist():
        number, at = moments[row].tolist()
        _compare(single, episodes[row], asked_of_all[number], at)


def _moments(asked_of_all: Sequence[_Asked], count: int, rng: np.random.Generator) -> IntArray:
    """Return a control period of each episode by lot, count × 2: its number, and the episode's place in it.

    They are drawn of those in which the car moves towards somebody ahead of it, where there are any: what it does there
    decides what becomes of the episode.
    """
    chosen, least = np.zeros((count, 2), np.int64), np.full(count, np.inf)
    for number, asked in enumerate(asked_of_all):
        moves_towards = (asked.states[3] > 0.0) & (asked.states[5] > asked.states[1])
        lots = rng.random(len(asked.rows)) + ~moves_towards
        better = np.flatnonzero(lots < least[asked.rows])
        rows = asked.rows[better]
        least[rows] = lots[better]
        chosen[rows, 0], chosen[rows, 1] = number, better
    return chosen


def _compare(single: UserController, episode: Episode, asked: _Asked, at: int) -> None:
    """Ask the single form in one state.

    Raises:
        AssessmentError: it answers otherwise than `commands` did.
    """
    numbers = asked.states[:, at].tolist()
    car, user = CarState(*numbers[:4]), AdversaryState(*numbers[4:])
    seen = Scene(car, user) if single.takes_scene else user
    alone, together = single.command(car, seen), float(asked.commands[at])  # type: ignore[arg-type]
    if not abs(alone - together) <= TOLERANCE:
        raise AssessmentError(
            f"controller {episode.controller}: commands answers {together:.6g} m/s² where command answers "
            f"{alone:.6g} m/s² (tick {asked.tick} of episode {episode.episode_id}): both have to be the same car, "
            "without a memory of its own; mend commands, or leave it out"
        )
