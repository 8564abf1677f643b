"""A car that steers: closed forms, a simulation in steps of 1 ms, and the same states however it is run."""

import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from skd_adversary.adversary import ReplayAdversary
from skd_evaluator.assessment.episode_figures import ADVERSARY, ROAD_EDGE, collision_partner, lane_left
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.plausibility import ROUNDING, examine
from skd_evaluator.assessment.run.episodes import Replay, replayed, run_episode
from skd_evaluator.assessment.stages.kamikazes import with_steering
from skd_evaluator.metrics.contact_place import car_at_contact, outline_of
from skd_evaluator.metrics.deviation import hit_of
from skd_evaluator.metrics.price_of_caution import lanes_left
from skd_sim.controllers.controller import user_controller
from skd_sim.errors import NoNumberError, UsageError
from skd_sim.options.car_and_adversary import AdversaryModel
from skd_sim.scenario.scenario import Scenario, load_scenario, scenario_from_dict
from skd_sim.world.dynamics.basic import SIDE_GRIP, STEERING_LIMIT, STEERING_RATE, BasicCar, Noise, wheels
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Mode, Outcome
from skd_sim.world.state import AdversaryState, CarState, FloatArray, Trajectory

CROSSING = load_scenario("crossing")
WIDE = replace(CROSSING, road=replace(CROSSING.road, lane_width=20.0))
WHEELBASE, BEHIND = wheels(CROSSING.car)
NORTH = CarState(0.0, 0.0, math.pi / 2.0, 5.0)
QUIET = Noise(0.0, 0.0)


class Weaving:
    """Brakes and steers by the time and by where the pedestrian is; the same in both of its forms."""

    def __init__(self, period: float | None = 0.05) -> None:
        self.control_period = period

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Nothing is kept."""

    def command(self, car: CarState, adversary: AdversaryState) -> Any:
        (acceleration, steering), *_ = self.commands(CarState(*map(np.atleast_1d, car)), adversary).tolist()
        return acceleration, steering

    def commands(self, cars: Any, adversary: Any) -> Any:
        ahead = adversary.y - cars.y
        steering = 0.25 * np.sin(0.9 * cars.y) + 0.05 * (adversary.x - cars.x) * (ahead < 8.0)
        return np.column_stack([np.where(ahead < 6.0, -3.0, 0.5), steering])


class Constant:
    """Always commands the same."""

    def __init__(self, answer: Any, **attributes: Any) -> None:
        self._answer = answer
        vars(self).update(attributes)

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Nothing is kept."""

    def command(self, car: CarState, adversary: AdversaryState) -> Any:
        return self._answer


def episode(number: int = 0, *, period: float | None = 0.05, scenario: Scenario = WIDE) -> EpisodeSpec:
    """Return one in which somebody walks across, slower or faster by its number."""
    pace = 1.0 + 0.3 * (number % 6)
    x = -3.5 + 0.3 * pace * np.arange(30)
    phi = Trajectory(np.column_stack([x, 0.1 * (number % 5) * np.sin(x)]), 0.3)
    timed = replace(scenario, control_period=period)
    car, generic = f"{__file__}:Weaving", AdversaryModel.GENERIC
    return EpisodeSpec(timed, Mode.REPLAY, 5, number, phi, controller=car, adversary_model=generic)


def run(spec: EpisodeSpec, controller: Any) -> EpisodeLog:
    assert spec.safe_trajectory is not None
    return run_episode(spec, controller, ReplayAdversary(spec.safe_trajectory))


def same(one: EpisodeLog, other: EpisodeLog) -> bool:
    impacts = [(log.outcome, log.impact_time, log.impact_speed) for log in (one, other)]
    return repr(impacts[0]) == repr(impacts[1]) and all(
        getattr(one, name).tobytes() == getattr(other, name).tobytes() for name in ("car", "adversary")
    )


@pytest.mark.parametrize("name", ["crossing", "curve"])
def test_a_float_is_a_command_that_steers_by_0(name: str) -> None:
    data = CROSSING.as_dict()
    if name == "curve":
        data["road"] |= {"parts": [{"length": 30.0, "radius": 30.0, "turn": "left"}], "origin": 20.0}
    spec = episode(scenario=scenario_from_dict(data), period=None)
    assert same(run(spec, Constant(-1.5)), run(spec, Constant((-1.5, 0.0))))


@pytest.mark.parametrize("angle", [0.05, -0.2, 0.5])
def test_a_constant_angle_drives_a_circle(angle: float) -> None:
    car = BasicCar(CROSSING)
    car.reset(NORTH)
    for _ in range(20):  # until the wheels are turned
        car.advance((0.0, angle), 0.05, QUIET)
    points = np.concatenate([car.advance((0.0, angle), 0.3, QUIET)[1:] for _ in range(40)])
    x, y = points[:, 0], points[:, 1]
    solved = np.linalg.lstsq(np.column_stack([2 * x, 2 * y, np.ones_like(x)]), x * x + y * y, rcond=None)[0]
    radii = np.hypot(x - solved[0], y - solved[1])
    assert radii == pytest.approx(math.hypot(WHEELBASE / math.tan(angle), BEHIND), abs=1e-3)
    assert np.sign(points[1, 2] - points[0, 2]) == np.sign(angle)  # to the left where it is positive


def test_tyres_hold_braking_first() -> None:
    rng = np.random.default_rng(1)
    car = BasicCar(CROSSING)
    for _ in range(200):
        car.reset(NORTH._replace(speed=float(rng.uniform(1.0, 30.0))))
        for _ in range(10):
            command = float(rng.uniform(-9.0, 3.0)), float(rng.uniform(-1.0, 1.0)) * STEERING_LIMIT
            path = car.advance(command, 0.3, QUIET)
            for before, after in pairwise(path):
                turned = math.remainder(after[2] - before[2], math.tau)
                driven = 0.5 * (before[3] + after[3]) * 0.3 / (len(path) - 1)
                if driven > 0.0:
                    sideways = 0.25 * (before[3] + after[3]) ** 2 * abs(turned) / driven
                    allowed = math.sqrt(max(0.0, SIDE_GRIP**2 - command[0] ** 2))
                    assert sideways <= allowed * 1.001 + 0.002  # the arc of a piece beside the limit at its two ends


def simulated(log: EpisodeLog) -> FloatArray:
    """Return, by the bicycle's equations in steps of 1 ms, gaps between road user and car, m, times, s, and offsets, m.

    These are of the corner that is farthest from the middle of the lane.
    """
    scenario, step = log.episode.scenario, 1e-3
    x, y, heading, speed = log.car[0].tolist()
    draws = np.random.Generator(np.random.PCG64(np.random.SeedSequence(5, spawn_key=(log.episode.episode_id, 0))))
    angle, periods, commands, found = 0.0, scenario.control_periods, log.commands, []
    for number, (acceleration, steering) in enumerate(commands.tolist()):
        tick, period = divmod(number, periods)
        if period == 0:
            speed_noise = scenario.car.speed_noise * (2.0 * draws.random() - 1.0) / periods
            acceleration_noise = scenario.car.acceleration_noise * (2.0 * draws.random() - 1.0)
        applied = acceleration * (1.0 + acceleration_noise)
        rate = speed_noise * speed / scenario.control_duration + applied
        start = speed
        for _ in range(round(scenario.control_duration / step)):
            angle += float(np.clip(steering - angle, -STEERING_RATE * step, STEERING_RATE * step))
            most = math.atan(WHEELBASE * math.sqrt(max(0.0, SIDE_GRIP**2 - applied**2)) / max(speed, 1e-9) ** 2)
            angle = float(np.clip(angle, -most, most))
            slip = math.atan(BEHIND / WHEELBASE * math.tan(angle))
            turn = speed * math.cos(slip) * math.tan(angle) / WHEELBASE
            x += step * speed * math.cos(heading + 0.5 * step * turn + slip)
            y += step * speed * math.sin(heading + 0.5 * step * turn + slip)
            heading += step * turn
            speed = max(0.0, speed + step * rate)
            period += step / scenario.control_duration
            share = period / periods
            at = log.adversary[tick] + share * (log.adversary[tick + 1] - log.adversary[tick])
            cos, sin, dx, dy = math.cos(heading), math.sin(heading), at[0] - x, at[1] - y
            outside = abs(cos * dx + sin * dy) - scenario.car.front, abs(cos * dy - sin * dx) - scenario.car.half_width
            gap = math.hypot(*(max(0.0, one) for one in outside)) - (scenario.adversary.radius or 0.0)
            aside = abs(x + np.outer((2.25, -2.25), cos) + np.outer((0.9, -0.9), sin).T).max()
            found.append((gap, (tick + share) * scenario.time_step, aside))
        assert abs(speed - max(0.0, start + rate * scenario.control_duration)) < 1e-6
    return np.array(found).T


@pytest.mark.parametrize("period", [0.05, None])
def test_contacts_are_those_of_steps_of_a_millisecond(period: float | None) -> None:
    logs = [run(episode(number, period=period), Weaving(period)) for number in range(12)]
    hits = 0
    for log in logs:
        gaps, times, _ = simulated(log)
        if collision_partner(log) == ADVERSARY:
            hits += 1
            assert abs(np.interp(log.impact_time, times, gaps)) < 3e-3
            gaps = gaps[times < log.impact_time]
        assert gaps.min() > -3e-3
    assert hits >= 3


def test_one_by_one_at_once_and_whole_episodes_are_the_same() -> None:
    episodes = [episode(number) for number in range(4)]
    controller = user_controller(Weaving(), "weaving")
    whole = [run(one, controller) for one in episodes]
    assert any(np.ptp(log.car[:, 2]) > 0.1 for log in whole)
    assert all(same(Replay(one).run(one, controller), log) for one, log in zip(episodes, whole, strict=True))
    assert all(same(found, log) for found, log in zip(replayed(episodes), whole, strict=True))


def test_a_steered_log_follows_from_its_commands_and_an_altered_one_does_not() -> None:
    for number in range(10):
        for period in (0.05, None):
            log = run(episode(number, period=period), Weaving(period))
            verdict = examine(log)
            assert not verdict.fault
            assert verdict.deviation <= ROUNDING, verdict
            for column, by in ((0, 0.05), (2, 0.05)):
                altered = log.car.copy()
                altered[len(altered) // 2, column] += by
                assert examine(replace(log, car=altered)).deviation == pytest.approx(by)


def test_answers_are_two_finite_numbers_and_may_be_a_curvature() -> None:
    spec = episode(period=None)
    for wrong in ((0.0, math.nan), (0.0, 1.0, 2.0), ("a", 0.0), [0.0], (True, 0.0)):
        with pytest.raises(NoNumberError, match="or two"):
            run(spec, user_controller(Constant(wrong), "wrong"))
    with pytest.raises(UsageError, match="steers_by"):
        user_controller(Constant(0.0, steers_by="wheel"), "wrong")
    bent = user_controller(Constant(np.array([0.0, 0.1]), steers_by="curvature"), "bent")
    assert same(run(spec, bent), run(spec, Constant((0.0, math.atan(WHEELBASE * 0.1)))))


def test_what_a_car_cannot_steer_is_clipped() -> None:
    log = run(episode(period=None), Constant((0.0, 1.0)))
    assert log.clipped == len(log.car) - 1


def test_a_car_with_tyres_steers_and_leaves_the_road() -> None:
    scenario = load_scenario("crossing_multi_body")
    logs = [run(far_away(scenario), Constant((0.0, 0.1), control_period=0.05)) for _ in range(2)]
    assert same(*logs)
    assert collision_partner(logs[0]) == ROAD_EDGE
    assert not examine(logs[0]).fault


def two_lanes(**changes: Any) -> Scenario:
    """Return the crossing with an oncoming lane, and noise or others as given."""
    data = CROSSING.as_dict()
    data["road"] |= {"lanes": [{"number": -1, "direction": "oncoming"}]}
    data["car"] |= {"speed_noise": 0.0, "acceleration_noise": 0.0, "start_gap_range": 0.0}
    return scenario_from_dict(data | changes)


def far_away(scenario: Scenario) -> EpisodeSpec:
    phi = Trajectory(np.tile([-30.0, 0.0], (12, 1)), 0.3)
    return replace(episode(period=0.05, scenario=scenario), safe_trajectory=phi)


@pytest.mark.parametrize(("name", "edge"), [("crossing", -1.75), ("two lanes", -5.25)])
def test_to_leave_the_road_is_a_collision_with_its_edge(name: str, edge: float) -> None:
    spec = far_away(CROSSING if name == "crossing" else two_lanes())
    log = run(spec, Constant((0.0, 0.1), control_period=0.05))
    assert log.outcome == Outcome.COLLISION
    assert collision_partner(log) == ROAD_EDGE
    (x, _, heading), _ = car_at_contact(log)
    front_left = x + 2.25 * math.cos(heading) - 0.9 * math.sin(heading)
    assert front_left == pytest.approx(edge, abs=0.1)  # at the end of a piece of 10 ms
    assert examine(log).ours
    assert same(Replay(spec).run(spec, Constant((0.0, 0.1))), log)
    assert hit_of(spec.safe_trajectory.positions, log).distance == 0.0  # type: ignore[union-attr]


class LaneChange(Constant):
    """Steers as a function of the time since the start."""

    control_period = 0.05

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        self.calls = -1

    def command(self, car: CarState, adversary: AdversaryState) -> Any:
        self.calls += 1
        time = 0.05 * self.calls
        return 0.0, 0.15 * ((0.5 <= time < 1.0) - (1.0 <= time < 1.5))


class Winding(LaneChange):
    """Drives with one side on the line of its lane, and turns its wheels to either side 1.6 times a second."""

    def command(self, car: CarState, adversary: AdversaryState) -> Any:
        self.calls += 1
        return 0.0, 0.5 * (0.35 * (car.x + 0.85) + math.pi / 2.0 - car.heading) + 0.06 * math.sin(0.5 * self.calls)


@pytest.mark.parametrize("car", [LaneChange, Winding])
def test_the_time_out_of_the_lane_is_right_to_a_control_period(car: type[LaneChange]) -> None:
    spec = far_away(two_lanes())
    log = run(spec, car(0.0))
    offsets = simulated(log)[2]
    assert np.abs(outline_of(spec.scenario, log.car[-1, :3])[:, 0]).max() == pytest.approx(offsets[-1], abs=1e-3)
    out = 1e-3 * np.count_nonzero(offsets > 1.75)
    assert 0.5 < out < 5.0
    assert lane_left(log) == pytest.approx(out, abs=0.02)
    assert lanes_left([*map(lane_left, (log, run(spec, Constant(0.0))))]) == (0.5, pytest.approx(lane_left(log)))


def test_contact_with_another_vehicle_counts_where_it_happens() -> None:
    """A car that comes on the other lane, into which the ego changes, though the pedestrian stays away."""
    oncoming = {
        "kind": "car", "length": 4.5, "width": 1.8, "start_heading": -math.pi / 2.0,
        "way": [{"time": 0.0, "x": -3.5, "y": 25.0}, {"time": 6.0, "x": -3.5, "y": -25.0}],
    }  # fmt: skip
    free, occupied = (run(far_away(two_lanes(others=others)), LaneChange(0.0)) for others in ([], [oncoming]))
    assert free.outcome != Outcome.COLLISION
    assert collision_partner(occupied) == 0
    assert occupied.hit


def test_a_kamikaze_goes_on_as_far_as_a_car_that_steers_can() -> None:
    kamikaze = replace(episode(scenario=CROSSING), mode=Mode.KAMIKAZE)
    for steers, missed in ((False, 1.2), (True, 2.05)):
        spec = replace(kamikaze, steers=steers)
        ends = [spec.outcome(3, AdversaryState(missed + by, 0.0, 0.0, 0.0), collided=False) for by in (-0.1, 0.0)]
        assert ends == [Outcome.RUNNING, Outcome.MISSED]
    steered, straight = (run(episode(period=0.05), one) for one in (Weaving(), Constant(0.0, control_period=0.05)))
    plan = Plan(CROSSING, controller=kamikaze.controller, adversary_model=AdversaryModel.GENERIC)
    assert with_steering(plan, [straight, steered]).steers
    assert not with_steering(plan, [straight]).steers
