"""The closed loop in process: car, adversary and simulator in one plain loop.

Replays, in which the adversary follows a trajectory, also run side by side: a policy answers for all together. The
worlds are compiled, and the same to the bit as those of whole episodes. When all is over, the single form of the
policy is asked as well: in every control period of some episodes, by a controller of each one's own, and in one control
period of each of the others. Where `command` answers otherwise than `commands` did, they are not the same car, and
nothing is made of either.

Stamped samples of a live graph or of a bag are put together to an episode's log here, too.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from skd_adversary.adversary import Adversary, BelievedCar, PlanningAdversary, make_adversary
from skd_adversary.crossing.interfaces import path_velocities
from skd_sim.controllers.controller import (
    Controller,
    UserController,
    control_period_of,
    is_sensing,
    make_controller,
    require_control_period,
    require_sensor,
    sight_of,
    takes_batches,
    takes_scene,
)
from skd_sim.controllers.isolated import isolated
from skd_sim.errors import AssessmentError, UsageError
from skd_sim.inputs.yaml_file import short
from skd_sim.kernels.compilation import kernel
from skd_sim.options.car_and_adversary import DYNAMICS, CarUnderTest, is_own_world
from skd_sim.scenario.road import HEADING_NORTH, beyond, is_straight_north
from skd_sim.simulators.simulator import NamedSimulator, Simulator, SimulatorError, require_others
from skd_sim.world.contact import sweep
from skd_sim.world.dynamics.basic import STEERING_LIMIT, Command, as_pair, command_limits, drive, wheels
from skd_sim.world.episode import (
    UNTIMED,
    AbortKind,
    EpisodeLog,
    EpisodeSpec,
    Mode,
    Outcome,
    Role,
    Timing,
    abort_reason,
    controller_generator,
    controller_seed,
    generator,
    tick_stamp,
)
from skd_sim.world.sensors import make_laser
from skd_sim.world.state import AdversaryState, CarState, FloatArray, IntArray, Scene
from skd_sim.world.world import first_car_state

from skd_evaluator.assessment.plan import EpisodeGroup, split_episode_id
from skd_evaluator.assessment.plausibility import examine


class EpisodeKey(NamedTuple):
    """Identity of an episode on the wire: campaign, id, and stamp of its tick 0 (ns)."""

    campaign: str
    episode_id: int
    start: int


@dataclass(frozen=True)
class EpisodeEnd:
    """How an episode ended, as the simulator says: see skd_msgs/EpisodeResult."""

    outcome: Outcome
    ticks: int
    impact_time: float
    impact_speed: float
    reason: str
    clipped: int = 0
    timing: Timing = UNTIMED
    commands: FloatArray | None = None


class Samples:
    """States by stamp (ns), in whatever order they come."""

    def __init__(self) -> None:
        """Start empty."""
        self.car: dict[int, CarState] = {}
        self.adversary: dict[int, tuple[float, float]] = {}

    def add(self, stamp: int, state: CarState | AdversaryState) -> None:
        """Add a state of the car, or of the adversary, of which the place is kept.

        Raises:
            UsageError: another one has the same stamp.
        """
        if isinstance(state, CarState):
            same, whose = self.car.setdefault(stamp, state) == state, "car"
        else:
            place = state.x, state.y
            same, whose = self.adversary.setdefault(stamp, place) == place, "adversary"
        if not same:
            when = f"simulation time {stamp / 1e9:.3f} s"
            raise UsageError(f"two different states of the {whose} at {when}: several recordings are mixed")

    def __len__(self) -> int:
        """Return how many states have come."""
        return len(self.car) + len(self.adversary)

    def missing(self, episode: EpisodeSpec, start: int, result: EpisodeEnd) -> int:
        """Return how many states of an episode have not come yet."""
        needed = stamps(episode, start, result)
        return sum((stamp not in self.car) + (stamp not in self.adversary) for stamp in needed)

    def log(self, episode: EpisodeSpec, start: int, result: EpisodeEnd) -> EpisodeLog:
        """Return the log of an episode that started at `start` (ns); its states must all have come."""
        needed = stamps(episode, start, result)
        adversary, car = (np.array([states[stamp] for stamp in needed]) for states in (self.adversary, self.car))
        said = {name: value for name, value in vars(result).items() if name != "ticks"}
        return EpisodeLog(episode, adversary=adversary, car=car, **said)

    def clear(self) -> None:
        """Forget everything."""
        self.car.clear()
        self.adversary.clear()


def result_from_message(message: Any) -> EpisodeEnd:
    """Return the result that an EpisodeResult message holds."""
    ages = tuple(float(age) for age in message.command_ages)
    timing = Timing(ages, int(message.commands_held), float(message.greatest_delay))
    return EpisodeEnd(
        Outcome(int(message.outcome)),
        int(message.ticks),
        float(message.impact_time),
        float(message.impact_speed),
        str(message.reason),
        int(message.commands_clipped),
        timing,
        np.array([(one.linear.x, one.angular.z) for one in message.commands]).reshape(-1, 2),
    )


def aborted(episode: EpisodeSpec, reason: str) -> EpisodeLog:
    """Return the log of an episode that could not be finished."""
    start, nowhere = np.array([episode.start]), np.full((1, 4), math.nan)
    return EpisodeLog(episode, Outcome.ABORTED, start, nowhere, reason=reason)


def stamps(episode: EpisodeSpec, start: int, result: EpisodeEnd) -> list[int]:
    """Return the stamps (ns) of an episode's ticks."""
    return [tick_stamp(start, tick, episode.scenario.time_step) for tick in range(result.ticks + 1)]


def run_episode(
    episode: EpisodeSpec,
    controller: Controller | None = None,
    adversary: Adversary | None = None,
    simulator: Simulator | None = None,
) -> EpisodeLog:
    """Run one episode to its end.

    Args:
        episode: specification of the episode.
        controller: controller of the car under test; by default made from the specification.
        adversary: decides how the adversary moves; by default made from the specification.
        simulator: moves both; by default the one that the specification names. If it fails, the episode is aborted; so
            it is if another one than SKD's own world is named, and says what cannot have happened.

    Raises:
        AssessmentError: the controller, or the simulator that is named, raises or answers what is no answer.
    """
    try:
        log = _run(episode, controller, adversary, NamedSimulator() if simulator is None else simulator)
    except SimulatorError as error:
        return aborted(episode, str(error))
    return log if simulator is not None or is_own_world(episode.simulator) else _examined(log)


def _examined(log: EpisodeLog) -> EpisodeLog:
    """Return the log of another simulator, or, where it cannot have happened, that of an episode that was aborted."""
    fault = examine(log).fault
    if not fault:
        return log
    said = f"simulator {log.episode.simulator} gave what cannot have happened: {fault}"
    return aborted(log.episode, abort_reason(AbortKind.REFUTED, said))


def _run(
    episode: EpisodeSpec, controller: Controller | None, adversary: Adversary | None, simulator: Simulator
) -> EpisodeLog:
    require_others(simulator, type(simulator).__name__, episode)
    frame = simulator.reset(episode)
    car = controller or make_controller(episode.controller, episode.multiplier)
    require_sensor(car, episode.controller, episode.scenario)
    require_control_period(car, episode.controller, episode.scenario)
    sensing = car if is_sensing(car) else None
    laser, sight = make_laser(episode) if sensing else None, sight_of(car, episode.scenario)
    frames, velocity = [frame], (0.0, 0.0)
    believed: list[BelievedCar] = []
    commands: list[Command] = []
    with _located(lambda: (episode, frame.tick, frame.period)):
        car.reset(episode.public_scenario, controller_generator(controller_seed(episode.seed, episode.episode_id)))
        adversary = adversary or make_adversary(episode)
        believer = adversary if episode.mode == Mode.KAMIKAZE and isinstance(adversary, PlanningAdversary) else None
        while frame.outcome == Outcome.RUNNING:
            if frame.period == 0:  # before the car, whose controller an adversary may look at
                velocity = adversary.act(frame.car)
                if believer:
                    believed.append(believer.believed_car)
            if sensing and laser:
                sensing.sense(laser.scan(frame.car, frame.adversary, frame.tick, frame.period))
            commands.append(car.command(frame.car, sight(frame.car, frame.adversary, frame.tick, frame.period)))
            frame = simulator.step(commands[-1], velocity)
            if frame.period == 0:
                frames.append(frame)
    impact_time, impact_speed = frame.impact(episode.scenario.time_step)
    return EpisodeLog(
        episode,
        frame.outcome,
        np.array([one.adversary[:2] for one in frames]),
        np.array([one.car for one in frames]),
        impact_time,
        impact_speed,
        adversary.depletions,
        clipped=simulator.clipped,
        belief=_belief(believed, len(frames)),
        own_contact=getattr(simulator, "own_contact", None),
        strayed=getattr(simulator, "strayed", 0.0),
        commands=np.array(list(map(as_pair, commands))),
    )


@contextmanager
def _located(place: Callable[[], tuple[EpisodeSpec, int, int]]) -> Iterator[None]:
    """Have errors say in which episode they came, in which tick and in which control period of it."""
    try:
        yield
    except AssessmentError as error:
        episode, tick, period = place()
        group, phi, trial = split_episode_id(episode.episode_id)
        path, scenario = episode.safe_trajectory, episode.scenario
        of_margin = group == EpisodeGroup.KAMIKAZE and episode.mode == Mode.REPLAY
        stage = "margin" if of_margin else "test" if phi == 0xFFFF else group.name.lower()
        name = path.name if path and (group == EpisodeGroup.PRICE or phi == 0xFFFF) else f"φ {phi}"
        name += f", trial {trial}" if trial < 1 << 31 else ""  # others are numbers within SKD
        time = scenario.time_step * (tick + period / scenario.control_periods)
        raise type(error)(f"{error}; in a {stage} run: {name}, t = {time:.2f} s") from None


def _belief(believed: Sequence[BelievedCar], states: int) -> FloatArray | None:
    """Return what was believed at each state, nan where none was decided; None where nothing was believed."""
    if not believed:
        return None
    unknown = (math.nan,) * len(believed[0])
    return np.array([*believed, *[unknown] * (states - len(believed))])


ONE_IN: Final = 50
"""Of so many episodes side by side one is asked by the single form from its beginning to its end."""
TOLERANCE: Final = 1e-4
"""m/s² or rad by which both forms may differ: what sums of single precision in another order come to."""


class _Request(NamedTuple):
    """What `commands` was asked in a control period of a tick, and answered.

    Attributes:
        tick: number of the tick.
        rows: which episodes go on, m.
        states: of their cars and adversaries, 9 × m, as `UserController.commands` has them.
        commands: accelerations (m/s²) and steering angles (rad), m × 2.
    """

    tick: int
    rows: IntArray
    states: FloatArray
    commands: FloatArray


def why_not_batched(episode: EpisodeSpec) -> str:
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


CAR, USER, ORIGIN, SHARE, IMPACT, ANGLE = slice(0, 4), slice(4, 9), slice(9, 11), 11, 12, 13
"""Where in the 14 numbers of an episode's state are: car and adversary (as `CarState` and `AdversaryState`), where the
adversary was when the tick began, share of the tick and speed at the contact (infinity and nan without one), and the
steering angle, rad."""


@kernel
def _advance(
    constants: FloatArray,
    line: FloatArray,
    tick: int,
    period: int,
    requested: float,
    angle: float,
    velocities: FloatArray,
    noise: FloatArray,
    state: FloatArray,
) -> bool:
    """Advance an episode by a control period, or, with a contact, to the end of the tick: none decides after it.

    Returns:
        Whether there was a contact.
    """
    footprint, shape = (constants[0], constants[1], constants[2]), (constants[3], 0.0, 0.0)
    step, periods, least, greatest = constants[4], int(constants[5]), constants[6], constants[7]
    axles, edges, minimum_impact_speed = (constants[8], constants[9]), (constants[10], constants[11]), constants[12]
    acceleration = min(greatest, max(least, requested))
    held = acceleration, min(STEERING_LIMIT, max(-STEERING_LIMIT, angle))
    vx, vy = velocities[tick, 0], velocities[tick, 1]
    if period == 0:
        state[9], state[10] = state[4], state[5]
    x, y = state[9], state[10]
    draws, duration = (noise[tick, 0] / periods, noise[tick, 1]), step / periods
    path, state[13] = drive((state[0], state[1], state[2], state[3]), state[13], held, draws, duration, axles)
    state[0:4] = path[-1]
    end = (x + step * vx, y + step * vy)
    share, impact = sweep(path, (x, y), end, (vx, vy), 0.0, footprint, shape, step, period, periods)
    contact = share <= 1.0 and impact >= minimum_impact_speed
    if path.shape[0] > 2 or path[0, 2] != HEADING_NORTH:
        row = beyond(line, edges, footprint, path)
        left = (period + row / (path.shape[0] - 1)) / periods
        if row >= 0 and path[row, 3] >= minimum_impact_speed and not (contact and share <= left):
            contact, share, impact = True, left, path[row, 3]
    state[6], state[7], state[8] = vx, vy, 0.0
    if contact or period == periods - 1:
        state[4], state[5] = end
    else:
        passed = step * (period + 1) / periods
        state[4], state[5] = x + passed * vx, y + passed * vy
    if contact:
        state[11], state[12] = share, impact
        for _ in range(period + 1, periods):
            car = state[0], state[1], state[2], state[3]
            path, state[13] = drive(car, state[13], held, draws, duration, axles)
            state[0:4] = path[-1]
    return contact


@kernel
def _advance_all(
    constants: FloatArray,
    line: FloatArray,
    tick: int,
    period: int,
    rows: IntArray,
    commands: FloatArray,
    velocities: FloatArray,
    noise: FloatArray,
    states: FloatArray,
) -> None:
    """Advance some of the episodes by a control period."""
    for at in range(rows.shape[0]):
        row = rows[at]
        held = commands[at]
        _advance(constants, line, tick, period, held[0], held[1], velocities[row], noise[row], states[row])


class Replay:
    """Runs replays of one trial one after the other: the logs are those of whole episodes, to the bit."""

    def __init__(self, episode: EpisodeSpec) -> None:
        """Draw what all of them have in common; see `why_not_batched`."""
        scenario = episode.scenario
        self._constants, self._noise = _constants(episode), _noise(episode, scenario.ticks)
        self._begin = _first_state(episode)
        self._seed = controller_seed(episode.seed, episode.episode_id)

    def run(self, episode: EpisodeSpec, controller: Controller) -> EpisodeLog:
        """Run one that differs from the first in its trajectory alone.

        Raises:
            AssessmentError: the controller fails.
        """
        scenario, path = episode.scenario, episode.safe_trajectory
        assert path is not None
        ticks, periods = min(scenario.ticks, len(path) - 1), scenario.control_periods
        velocities = path_velocities(path.positions, ticks, scenario.time_step)
        state, noise, constants, line = self._begin.copy(), self._noise, self._constants, scenario.road.line
        command, sees_scene = controller.command, takes_scene(controller)
        found = np.empty((ticks + 1, len(state)))
        found[0] = state
        tick = period = 0
        with _located(lambda: (episode, tick, period)):
            controller.reset(episode.public_scenario, controller_generator(self._seed))
            for tick, period in itertools.product(range(ticks), range(periods)):
                now = state.tolist()
                car, user = CarState(*now[CAR]), AdversaryState(*now[USER])
                seen: Any = Scene(car, user) if sees_scene else user
                acceleration, angle = as_pair(command(car, seen))
                contact = _advance(constants, line, tick, period, acceleration, angle, velocities, noise, state)
                found[tick + 1] = state
                if contact:
                    return _log(episode, found[: tick + 2])
        return _log(episode, found)


def _log(episode: EpisodeSpec, states: FloatArray) -> EpisodeLog:
    share, impact = states[-1, SHARE:ANGLE].tolist()
    collided = share <= 1.0
    time = (len(states) - 2 + share) * episode.scenario.time_step if collided else math.nan
    assert episode.safe_trajectory is not None
    arrived = len(states) >= len(episode.safe_trajectory)
    outcome = Outcome.COLLISION if collided else Outcome.ARRIVED if arrived else Outcome.TIMEOUT
    return EpisodeLog(episode, outcome, states[:, 4:6], states[:, CAR].copy(), time, impact)


def answers_batches(car: CarUnderTest) -> bool:
    """Tell whether a user's controller answers many episodes at once.

    Raises:
        UsageError: it cannot be loaded.
    """
    return isolated(car.user_code, _answers_batches, car)


def _answers_batches(car: CarUnderTest) -> bool:
    return takes_batches(make_controller(car.controller))


def replayed(episodes: Sequence[EpisodeSpec]) -> list[EpisodeLog]:
    """Return the logs of episodes in which the adversary follows a trajectory, all of one car, side by side.

    Args:
        episodes: replays, of scenarios that differ in the start distance alone; see `why_not_batched`. One
            controller, which takes batches, answers all of them: it is reset once, as the first of them has it.

    Raises:
        AssessmentError: the controller fails, or its two forms differ.
    """
    first = episodes[0]
    assert first.mode == Mode.REPLAY, first.mode
    assert not why_not_batched(first), why_not_batched(first)
    policy = _made(first)
    requests: list[_Request] = []
    constants, scenario, count = _constants(first), first.scenario, len(episodes)
    limit = scenario.ticks
    ends = np.array([min(limit, len(one.safe_trajectory or ()) - 1) for one in episodes], np.int64)
    most = int(ends.max())
    velocities, noise = np.zeros((count, most, 2)), np.zeros((count, most, 2))
    states = np.array([_first_state(one) for one in episodes])
    for row, one in enumerate(episodes):
        assert one.safe_trajectory is not None
        velocities[row] = path_velocities(one.safe_trajectory.positions, most, scenario.time_step)
        noise[row] = _noise(one, most)
    found = np.empty((count, most + 1, states.shape[1]))
    found[:, 0] = states
    last = ends.copy()
    for tick in range(most):
        rows = np.flatnonzero((states[:, SHARE] > 1.0) & (ends > tick))
        if not rows.size:
            break
        for period in range(scenario.control_periods):
            requested = rows if period == 0 else rows[states[rows, SHARE] > 1.0]
            if not requested.size:
                break
            seen = np.ascontiguousarray(states[requested, : USER.stop].T)
            with _located(lambda: (episodes[requested[0]], tick, period)):  # noqa: B023 - called within
                commands = policy.commands(seen)
            requests.append(_Request(tick, requested, seen, commands))
            _advance_all(constants, scenario.road.line, tick, period, requested, commands, velocities, noise, states)
        found[rows, tick + 1] = states[rows]
        last[rows[states[rows, SHARE] <= 1.0]] = tick + 1
    _confirm(episodes, requests)
    return [_log(one, found[row, : last[row] + 1]) for row, one in enumerate(episodes)]


def _first_state(episode: EpisodeSpec) -> FloatArray:
    start = generator(episode.seed, episode.episode_id, Role.START)
    car = first_car_state(episode.scenario, episode.start_gap, start)
    user = episode.scenario.adversary.first_state(*episode.start)
    return np.array([*car, *user, *user[:2], math.inf, math.nan, 0.0])


def _noise(episode: EpisodeSpec, ticks: int) -> FloatArray:
    """Return what the car's noise is, relative, of speed and acceleration, ticks × 2."""
    car = episode.scenario.car
    draws = generator(episode.seed, episode.episode_id, Role.CAR).random((ticks, 2))
    return np.multiply((car.speed_noise, car.acceleration_noise), 2.0 * draws - 1.0)


def _constants(episode: EpisodeSpec) -> FloatArray:
    """Return what `_advance` reads of a scenario, in its order; a kernel takes an array sooner than a tuple."""
    scenario = episode.scenario
    car, limits = scenario.car, command_limits(scenario)
    step, periods = scenario.time_step, scenario.control_periods
    tracks = *wheels(car), *scenario.road.edges, scenario.collision.minimum_impact_speed
    return np.array([*car.footprint, scenario.adversary.reach, step, periods, *limits, *tracks])


def _made(episode: EpisodeSpec) -> UserController:
    controller = make_controller(episode.controller)
    assert isinstance(controller, UserController)
    period = control_period_of(controller, episode.controller)
    assert period is None or abs(period - episode.scenario.control_duration) <= 1e-9
    controller.reset(episode.public_scenario, controller_generator(controller_seed(episode.seed, episode.episode_id)))
    return controller


def _confirm(episodes: Sequence[EpisodeSpec], requests: Sequence[_Request]) -> None:
    """Ask the single form what `commands` was asked: some episodes as a whole, and then each once.

    Raises:
        AssessmentError: it answers otherwise.
    """
    rng = generator(episodes[0].seed, episodes[0].episode_id, Role.ORDER, len(episodes))
    for row in sorted(rng.permutation(len(episodes))[: -(-len(episodes) // ONE_IN)].tolist()):
        single = _made(episodes[row])
        for requested in requests:
            for at in np.flatnonzero(requested.rows == row).tolist():
                _compare(single, episodes[row], requested, at)
    single = _made(episodes[0])
    moments = _moments(requests, len(episodes), rng)
    for row in rng.permutation(len(episodes)).tolist():
        number, at = moments[row].tolist()
        _compare(single, episodes[row], requests[number], at)


def _moments(requests: Sequence[_Request], count: int, rng: np.random.Generator) -> IntArray:
    """Return a control period of each episode by lot, count × 2: its number, and the episode's place in it.

    They are drawn of those in which the car moves towards a road user ahead of it, where there are any: what it does
    there decides what becomes of the episode.
    """
    chosen, least = np.zeros((count, 2), np.int64), np.full(count, np.inf)
    for number, requested in enumerate(requests):
        moves_towards = (requested.states[3] > 0.0) & (requested.states[5] > requested.states[1])
        draws = rng.random(len(requested.rows)) + ~moves_towards
        better = np.flatnonzero(draws < least[requested.rows])
        rows = requested.rows[better]
        least[rows] = draws[better]
        chosen[rows, 0], chosen[rows, 1] = number, better
    return chosen


def _compare(single: UserController, episode: EpisodeSpec, requested: _Request, at: int) -> None:
    """Ask the single form in one state.

    Raises:
        AssessmentError: it answers otherwise than `commands` did.
    """
    numbers = requested.states[:, at].tolist()
    car, user = CarState(*numbers[:4]), AdversaryState(*numbers[4:])
    seen = Scene(car, user) if single.takes_scene else user
    with _located(lambda: (episode, requested.tick, 0)):
        alone, together = as_pair(single.command(car, seen)), tuple(requested.commands[at].tolist())  # type: ignore[arg-type]
        if not math.dist(alone, together) <= TOLERANCE:
            said = f"commands answers {short(together)} where command answers {short(alone)}; both have to be one car"
            raise AssessmentError(f"controller {episode.car.short_controller}: {said}")
