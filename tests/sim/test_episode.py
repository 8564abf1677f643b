"""States, commands and the record of an episode."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from skd_sim import AdversaryState, EpisodeLog, EpisodeSpec, Mode, Outcome, Scenario, Trajectory, load_scenario
from skd_sim.ros.commands import follow_speed
from skd_sim.world.dynamics.basic import CommandLimits
from skd_sim.world.episode import CommandAges, Schedule
from skd_sim.world.state import braking_distance, heading_of, next_speed, on_grid, travelled

CROSSING = load_scenario("crossing")  # path edge 1.15 m
MEETING = load_scenario("citr_crossing")  # path edge 0.85 m


def _along(*x: float, time_step: float = 0.3) -> Trajectory:
    return Trajectory(np.column_stack([x, np.zeros(len(x))]), time_step, "walk")


@pytest.mark.parametrize(
    ("x", "expected"),
    [
        ((-3.15, -2.15, -1.15, 0.0), 2.0),
        ((-3.15, -0.15), 2.0 / 3.0),
        ((3.15, 0.15), 2.0 / 3.0),
        ((-1.0, 0.0, 2.0), 0.0),
        ((-5.0, 5.0), 3.85 / 10.0),
        ((5.0, -5.0), 3.85 / 10.0),
        ((-5.0, -3.0, -5.0, -3.0, 1.0), 3.0 + 1.85 / 4.0),
    ],
)
def test_entry_time_in_steps(x: tuple[float, ...], expected: float) -> None:
    assert CROSSING.end.entry_time(_along(*x)) == pytest.approx(0.3 * expected, abs=1e-12)


def _episode(mode: Mode, scenario: Scenario = CROSSING, phi: Trajectory | None = None) -> EpisodeSpec:
    return EpisodeSpec(scenario, mode, seed=0, episode_id=0, safe_trajectory=phi)


def test_start_and_gap() -> None:
    adversary, car = CROSSING.adversary, CROSSING.car
    assert _episode(Mode.SAFE).start == (adversary.start_x, adversary.start_y)
    phi = Trajectory(np.array([[-4.0, 1.0], [1.0, 1.0]]), 0.3)
    assert _episode(Mode.REPLAY, CROSSING, phi).start == (-4.0, 1.0)
    assert _episode(Mode.REPLAY, CROSSING, phi).start_gap == car.start_gap
    expected = MEETING.car.start_speed * 0.3 * (4.0 - 0.85) / 5.0
    assert _episode(Mode.REPLAY, MEETING, phi).start_gap == pytest.approx(expected)
    assert _episode(Mode.SAFE, MEETING).start_gap == MEETING.car.start_gap


PHI = _along(-3.0, -1.0, 1.0, 3.0)
LAST = CROSSING.ticks


@pytest.mark.parametrize(
    ("mode", "tick", "x", "collided", "expected"),
    [
        (Mode.SAFE, 1, -3.5, False, Outcome.RUNNING),
        (Mode.SAFE, 9, 1.99, False, Outcome.RUNNING),
        (Mode.SAFE, 9, 2.0, False, Outcome.ARRIVED),
        (Mode.SAFE, 9, 2.0, True, Outcome.COLLISION),
        (Mode.SAFE, LAST - 1, 0.0, False, Outcome.RUNNING),
        (Mode.SAFE, LAST, 0.0, False, Outcome.TIMEOUT),
        (Mode.SAFE, LAST, 2.0, False, Outcome.ARRIVED),
        (Mode.KAMIKAZE, 5, 1.15, False, Outcome.RUNNING),
        (Mode.KAMIKAZE, 5, 1.16, False, Outcome.MISSED),
        (Mode.KAMIKAZE, 5, 1.16, True, Outcome.COLLISION),
        (Mode.KAMIKAZE, LAST, 0.0, False, Outcome.TIMEOUT),
        (Mode.REPLAY, 2, 1.0, False, Outcome.RUNNING),
        (Mode.REPLAY, 3, 3.0, False, Outcome.ARRIVED),
        (Mode.REPLAY, 3, 3.0, True, Outcome.COLLISION),
    ],
)
def test_outcomes(mode: Mode, tick: int, x: float, collided: bool, expected: Outcome) -> None:
    episode = _episode(mode, CROSSING, None if mode == Mode.SAFE else PHI)
    assert episode.outcome(tick, AdversaryState(x, 0.0, 0.0, 0.0), collided=collided) == expected


def test_the_adversary_is_at_the_end_where_the_two_touch() -> None:
    """Contact after half of the second tick: half way between its ends."""
    car = np.array([[0.0, y, math.pi / 2, 8.0] for y in (-16.0, -14.0, -11.0)])
    walk = np.array([[-2.0, 0.0], [-1.0, 0.0], [0.0, -1.0]])
    log = EpisodeLog(_episode(Mode.SAFE), Outcome.COLLISION, walk, car, 1.5 * CROSSING.time_step, 8.0)
    np.testing.assert_allclose(log.trajectory.positions[-1], [-0.5, -0.5])


SPEED = 25.0 / 3.0  # m/s, 30 km/h
STEP = 0.3  # s


@pytest.mark.parametrize("deceleration", [1.0, 3.5, 7.0])
def test_stopping_distance_of_the_noiseless_car(deceleration: float) -> None:
    """The trapezoid is exact for uniform braking; only the step in which the car stops is not uniform."""
    speed, distance, steps = SPEED, 0.0, 0
    while speed > 0.0:
        after = next_speed(speed, -deceleration, 0.0, STEP)
        distance += travelled(speed, after, STEP)
        speed = after
        steps += 1
    full = math.floor(SPEED / (deceleration * STEP))  # whole steps of uniform braking
    rest = SPEED - full * deceleration * STEP  # speed at the start of the last one
    uniform = (SPEED**2 - rest**2) / (2.0 * deceleration)
    assert steps == math.ceil(SPEED / (deceleration * STEP))
    assert distance == pytest.approx(uniform + 0.5 * STEP * rest, rel=1e-12)
    # The last step stretches the last rest²/2a to rest·Δt/2.
    assert 0.0 <= distance - braking_distance(SPEED, deceleration) <= 0.5 * STEP * rest


@given(
    speed=st.floats(0.0, 60.0),
    acceleration=st.floats(-50.0, 50.0),
    noise=st.floats(-0.5, 0.5),
    step=st.floats(0.01, 2.0),
)
def test_the_car_never_reverses(speed: float, acceleration: float, noise: float, step: float) -> None:
    after = next_speed(speed, acceleration, noise, step)
    assert after >= 0.0
    assert travelled(speed, after, step) >= 0.0
    assert after == pytest.approx(max(0.0, speed * (1.0 + noise) + step * acceleration), abs=1e-9)


@given(st.floats(-100.0, 100.0))
def test_a_heading_of_the_grid_survives_the_quaternion_to_the_last_bit(heading: float) -> None:
    kept = float(on_grid(heading))
    assert heading_of(math.sin(0.5 * kept), math.cos(0.5 * kept)) == kept
    assert -math.pi < kept <= math.pi
    assert abs(math.remainder(kept - heading, math.tau)) < 2e-12
    assert on_grid(kept) == kept


STEP_COMMANDS = 100  # ns of simulation time between states


def test_a_command_is_as_old_as_the_state_that_it_names() -> None:
    ages = CommandAges(waited_for=False)
    for tick in range(3):
        ages.publish(tick * STEP_COMMANDS, 10.0 + tick)
    ages.come(STEP_COMMANDS, 12.1)
    ages.use(12.5)
    ages.come(2 * STEP_COMMANDS - 1, 12.6)  # between two states: it knows the earlier one
    ages.use(13.5)
    ages.use(14.5)  # no other has come
    ages.come(None, 15.4)  # it does not say, so it is as old as its arrival
    ages.use(15.5)
    ages.come(10**18, 16.3)  # of another clock
    ages.use(16.5)
    ages.come(-1, 17.2)  # of before the episode
    ages.use(17.5)
    assert ages.ages == pytest.approx([1.5, 2.5, 3.5, 0.1, 0.2, 0.3])
    assert ages.held == 1
    ages.begin()
    assert (ages.ages, ages.held) == ([], 0)


def test_who_waits_sees_how_long_the_answer_takes() -> None:
    """However long the other side needs then; a repeated state counts from its repetition on."""
    ages = CommandAges(waited_for=True)
    ages.publish(0, 1.0)
    ages.publish(0, 1.2)
    ages.come(0, 1.25)
    ages.use(9.0)
    ages.publish(STEP_COMMANDS, 9.0)
    ages.come(None, 9.4)
    ages.use(9.5)
    ages.publish(2 * STEP_COMMANDS, 9.5)
    ages.use(9.7)  # the quiet time is over
    assert ages.ages == pytest.approx([0.05, 0.4, 0.7])
    assert ages.held == 1


def test_a_schedule_goes_on_from_where_it_is() -> None:
    """Timers leave out what they have missed: 3.5 periods late at once is late once."""
    schedule = Schedule(0.0, 1.0)
    assert schedule.late(1.0) == 0.0
    assert schedule.late(5.5) == 3.5
    assert schedule.late(6.0) == 0.0
    assert schedule.late(6.9) == pytest.approx(-0.1)  # a timer may wake early
    assert schedule.worst == 3.5
    assert math.isfinite(schedule.late(8.0))


BOUNDS = CommandLimits(-8.0, 3.0)
SPEEDS = st.floats(0.0, 40.0)


@given(target=SPEEDS, speed=SPEEDS, duration=st.floats(0.01, 1.0), limit=st.floats(0.0, 20.0))
def test_a_speed_target_is_reached_as_soon_as_all_limits_allow(target, speed, duration, limit):
    """Its own limit is a magnitude, of decelerations too, and none where it is zero."""
    acceleration = follow_speed(target, speed, duration, BOUNDS, limit)
    greatest = min(3.0, limit or 3.0) if target > speed else min(8.0, limit or 8.0)
    after = speed + acceleration * duration
    assert abs(acceleration) <= greatest
    if abs(target - speed) <= greatest * duration:
        assert abs(after - target) <= 1e-9 * max(1.0, target, speed)
    else:
        assert abs(acceleration) == greatest
        assert (acceleration > 0.0) == (target > speed)
