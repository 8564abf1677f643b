"""Risks of two cars, and touches that count."""

import math
from collections import Counter
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from skd_evaluator import Plan, run_episode
from skd_evaluator.assessment.compare.comparison import INCONCLUSIVE, LESS_SAFE, SAFER, Comparison, compare
from skd_evaluator.assessment.context import RiskRequest
from skd_evaluator.assessment.episode_figures import closing_speed, collision_partner, surrogates_of
from skd_evaluator.assessment.files.results import StoredResult, read_result, write_assessment
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages.risk import crude_crossings
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories
from skd_evaluator.metrics.behaviour.model import Parameter, load_behaviour
from skd_evaluator.metrics.contact_place import car_at_contact, car_until_contact, last_car_position
from skd_evaluator.metrics.difference import Difference
from skd_evaluator.metrics.risks import Touch
from skd_evaluator.metrics.surrogate_measures import fatality_risk, greater_delta_v
from skd_evaluator.risk.crossings import AnyCar, CrossingPlan, end_of
from skd_sim import Controller, EpisodeLog, EpisodeSpec, Frame, Outcome, Scenario, WorldSimulator, load_scenario
from skd_sim.options.car_and_adversary import Objective
from skd_sim.scenario.road import right_and_along
from skd_sim.scenario.road_user import Other, Waypoint
from stages import rate, with_margins, with_risks

PLAN = Plan(load_scenario("crossing"), safe_count=4, kamikaze_count=2, collision_runs=4, seed=5, simulations=20)
WALKERS = load_behaviour("walkers")
OTHERS = replace(WALKERS, name="others", parameters={**WALKERS.parameters, "pace": Parameter(0.3, "assumed")})


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> dict[str, StoredResult]:
    found = {}
    with InProcessRunner(1) as runner:
        safe = safe_trajectories(PLAN, runner)
        for name, multiplier, behaviour in (("A", 0.6, WALKERS), ("B", 1.4, WALKERS), ("C", 1.4, OTHERS)):
            rating = rate(replace(PLAN, multiplier=multiplier), [Objective.DEVIATION], safe, runner)
            rating = with_margins(rating, runner, 50)
            rating = with_risks(rating, RiskRequest(behaviour, runs=400), runner)
            folder = tmp_path_factory.mktemp("risks") / name
            folder.mkdir()
            write_assessment(folder, rating)
            found[name] = read_result(folder)
    return found


@pytest.mark.parametrize("name", ["risk_1", "risk_2", "risk_3"])
def test_a_car_is_as_safe_as_itself_with_fewer_crossings(results, name):
    one = results["A"]
    fewer = tuple(group[: len(group) // 3] for group in one.groups[name])
    found = compare(one, replace(one, groups={**one.groups, name: fewer})).differences[name]
    assert found.interval == (0.0, 0.0)


def test_margin_and_risk_agree(results):
    found = compare(results["A"], results["B"])
    assert found.verdict == SAFER
    assert found.votes == {"margin": 1, "risk_1": 1, "risk_2": 1, "risk_3": 1}
    assert compare(results["B"], results["A"]).verdict == LESS_SAFE
    risk = found.differences["risk_1"]
    assert risk.paired
    assert risk.value == pytest.approx(results["B"].figures["risk_1"] - results["A"].figures["risk_1"])
    assert risk.confidence == pytest.approx(1.0 - 0.05 / 3)


def test_risks_of_unlike_behaviour_models_are_not_compared(results):
    found = compare(results["A"], results["C"])
    assert list(found.votes) == ["margin"]
    assert any("their behaviour models are walkers and others" in line for line in found.lines())


def leant(results: dict[str, StoredResult], sign: float, **figures: tuple[float, int]) -> Comparison:
    """Return a comparison in which each figure is so many standard errors of 0.1 off, and tells apart or does not."""
    differences = {}
    for name, (off, told_apart) in figures.items():
        value = sign * 0.1 * off
        half = 0.5 * abs(value) if told_apart else 2.0 * abs(value) + 0.1
        differences[name] = Difference(value, (value - half, value + half), 0.95, 0.1, 0.1, 9.0, 1.0, True)
    pair = (results["A"], results["B"]) if sign > 0.0 else (results["B"], results["A"])
    return Comparison(*pair, differences, (4, 4), (), "", ())


def test_one_line_says_that_a_bound_withholds_the_verdict(results):
    """No other says that the margins do not differ, or that the risk tells more."""
    first, second = results["A"], results["B"]
    second = replace(second, figures={**second.figures, "margin_converged": False, "margin_budget": 512})
    found = compare(first, second)
    assert (found.verdict, found.reason) == (INCONCLUSIVE, "upper bound")
    assert [line for line in found.lines() if "may be less" in line or "differ" in line] == [found.lines()[0]]
    assert f"the margin of {second.folder} is at most" in found.lines()[0]
    assert compare(second, first).verdict == INCONCLUSIVE


@pytest.mark.parametrize(
    ("figures", "verdict", "opposed"),
    [
        ({"margin": (3.0, 1), "risk_2": (-1.0, 0)}, SAFER, ()),
        ({"margin": (0.0, 0), "risk_1": (0.0, 0), "risk_2": (-3.0, 1)}, SAFER, ()),
        ({"margin": (0.0, 0), "risk_1": (0.0, 0), "risk_2": (0.0, 0)}, INCONCLUSIVE, ()),
        ({"margin": (-3.0, 1), "risk_1": (3.0, 1)}, LESS_SAFE, ()),
        ({"margin": (0.0, 0), "risk_1": (3.0, 1), "risk_2": (-3.0, 1)}, INCONCLUSIVE, ()),
        ({"margin": (3.0, 1), "risk_2": (0.6, 0)}, INCONCLUSIVE, ("risk_2",)),
        ({"margin": (3.0, 1), "risk_2": (0.4, 0)}, SAFER, ()),
        ({"margin": (3.0, 1), "risk_1": (0.0, 0), "risk_2": (0.0, 0)}, SAFER, ()),
        ({"margin": (-0.1, 0), "risk_1": (-3.0, 1), "risk_2": (-1.0, 0)}, SAFER, ()),
        ({"margin": (-0.7, 0), "risk_1": (-3.0, 1), "risk_2": (1.0, 0)}, INCONCLUSIVE, ("margin", "risk_2")),
        ({"margin": (0.7, 0), "risk_1": (3.0, 1)}, INCONCLUSIVE, ("margin",)),
        ({"margin": (3.0, 1), "risk_1": (2.0, 0), "risk_3": (2.0, 0)}, SAFER, ()),
        ({"margin": (3.0, 1), "risk_1": (2.0, 1)}, INCONCLUSIVE, ()),
        ({"margin": (-0.7, 0), "risk_1": (0.6, 0)}, INCONCLUSIVE, ()),
        ({"margin": (-3.0, 1), "risk_1": (-3.0, 1), "risk_2": (0.6, 0)}, INCONCLUSIVE, ()),
    ],
)
def test_an_estimate_that_points_the_other_way_withholds_the_verdict(figures, verdict, opposed, results):
    """More margin is safer, more risk is not; half a standard error is a tie, as no hit beside no hit is.

    Risks at other scales than that which ranks cars oppose where they are sure.
    """
    found = leant(results, 1.0, **figures)
    assert (found.verdict, found.opposed) == (verdict, opposed)


@given(
    figures=st.dictionaries(
        st.sampled_from(["margin", "risk_1", "risk_2", "risk_3"]),
        st.tuples(st.floats(-4.0, 4.0), st.integers(0, 1)),
        min_size=1,
    )
)
def test_no_car_is_safer_from_both_sides(figures, results):
    there, back = (leant(results, sign, **figures) for sign in (1.0, -1.0))
    mirrored = {SAFER: LESS_SAFE, LESS_SAFE: SAFER}
    assert back.verdict == mirrored.get(there.verdict, there.verdict)
    assert back.opposed == there.opposed
    better = {name: off if name == "margin" else -off for name, (off, _) in figures.items()}
    if there.verdict == SAFER:
        assert min(better.get("margin", 0.0), better.get("risk_2", 0.0)) >= -0.5
        assert any(told_apart and better[name] > 0.0 for name, (_, told_apart) in figures.items())


@pytest.mark.parametrize(
    ("figures", "behind"),
    [
        ({"margin": (-3.0, 1), "risk_2": (-1.0, 0)}, "margin"),
        ({"margin": (0.7, 0), "risk_1": (3.0, 1)}, "risk_1"),
        ({"margin": (-3.0, 1), "risk_1": (-3.0, 1)}, None),
        ({"margin": (3.0, 1), "risk_2": (1.0, 0)}, None),
        ({"margin": (-3.0, 0), "risk_2": (1.0, 0)}, None),
    ],
)
def test_a_gate_does_not_wait_until_all_estimates_point_one_way(figures, behind, results):
    """Who surely has less margin does not pass because a risk points the other way and is not sure."""
    assert leant(results, 1.0, **figures).behind_by == behind


# --- Touches that count, by a brute force that shares nothing with the contact test: where the car was every few
# milliseconds, after a contact, too, and who was touched first, where and how fast, moment by moment.

STEP = 5e-4  # s between the moments that are looked at
UNSURE = 2e-3  # m to the corner's beginning within which it is not said which side touches


class Seen(NamedTuple):
    """What the car and whom it touched did: who (−1: the adversary), when (s), the car's pose and speed, which side."""

    who: int
    time: float
    car: tuple[float, float, float, float]
    touch: Touch | None  # None: it is too near to the corner's beginning to say


class Driven:
    """A car's dynamics that write down where the car was."""

    def __init__(self, dynamics) -> None:
        self.dynamics = dynamics
        self.times, self.states = [0.0], []

    def advance(self, acceleration, duration, noise):
        path = self.dynamics.advance(acceleration, duration, noise)
        if not self.states:
            self.states.append(path[0])
        for part in range(1, len(path)):
            self.times.append(self.times[0] + duration * part / (len(path) - 1))
            self.states.append(path[part])
        self.times[0] = self.times[-1]
        return path

    def __getattr__(self, name):
        return getattr(self.dynamics, name)


class WatchedWorld(WorldSimulator):
    """SKD's own world, whose car is watched within the ticks."""

    def reset(self, episode: EpisodeSpec) -> Frame:
        frame = super().reset(episode)
        self.driven = Driven(self.world.dynamics)
        self.world.dynamics = self.driven
        return frame

    def course(self) -> tuple[np.ndarray, np.ndarray]:
        """Moments, s, and x, y, heading and speed then."""
        states = np.array(self.driven.states)
        states[:, 2] = np.unwrap(states[:, 2])
        return np.array([0.0, *self.driven.times[1:]]), states


def watched(episode: EpisodeSpec, controller: Controller | None = None) -> tuple[EpisodeLog, Seen | None]:
    """Run an episode, and return its log and what was seen: None where nobody was touched."""
    world = WatchedWorld()
    log = run_episode(episode, controller, simulator=world)
    return log, seen(log, *world.course())


def seen(log: EpisodeLog, times: np.ndarray, states: np.ndarray) -> Seen | None:
    """Return the first touch in an episode of discs in which the car was in these states at these times."""
    scenario = log.episode.scenario
    walked = np.arange(len(log.adversary)) * scenario.time_step
    bodies = [(log.adversary, scenario.adversary.reach)]
    for number, other in enumerate(scenario.others):
        places = [scenario.others_at(tick)[number] for tick in range(len(walked))]
        bodies.append((np.array([(one.x, one.y) for one in places]), other.reach))

    def at(moments, course, columns):
        return np.column_stack([np.interp(moments, course, column) for column in columns.T])

    def apart(moments):
        poses = at(moments, times, states)
        return np.array([distances(poses, at(moments, walked, body), scenario) - reach for body, reach in bodies])

    moments = np.append(np.arange(0.0, walked[-1], STEP), walked[-1])
    touched = (apart(moments) <= 0.0).any(axis=0)
    if not touched.any():
        return None
    first = int(np.argmax(touched))
    low, high = moments[max(0, first - 1)], moments[first]
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if (apart(np.array([middle])) <= 0.0).any() else (middle, high)
    end = np.array([high])
    who = int(np.argmin(apart(end)[:, 0])) - 1
    (pose,) = at(end, times, states)
    touch = Touch.NONE if who >= 0 else side(pose, at(end, walked, log.adversary), scenario)
    return Seen(who, float(high), tuple(pose.tolist()), touch)


def in_frame(poses: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return how far ahead and to the left of the car places are."""
    ahead = np.column_stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])])
    off = places - poses[:, :2]
    return (off * ahead).sum(axis=1), off[:, 1] * ahead[:, 0] - off[:, 0] * ahead[:, 1]


def distances(poses: np.ndarray, places: np.ndarray, scenario: Scenario) -> np.ndarray:
    """Return how far places are from the nearest point of the car's rectangle."""
    ahead, left = in_frame(poses, places)
    car = scenario.car
    return np.hypot(ahead - np.clip(ahead, -car.rear, car.front), left - np.clip(left, -car.half_width, car.half_width))


def side(pose: np.ndarray, body: np.ndarray, scenario: Scenario) -> Touch | None:
    """Return which side of the car a disc touches: the one that holds the nearest point of the rectangle."""
    ahead, left = (float(one[0]) for one in in_frame(pose[None], body))
    car, speed = scenario.car, pose[3]
    if abs(speed - scenario.collision.hit_speed) < 1e-6:
        return None
    if speed < scenario.collision.hit_speed:
        return Touch.STANDING
    if abs(left) > car.half_width and abs(ahead - car.front) < UNSURE:
        return None
    assert math.isfinite(ahead)
    return Touch.FRONT if ahead > car.front else Touch.FLANK


CROSSING = load_scenario("crossing")


class Brakes:
    """Brakes hard for whoever is just before it, and decides often."""

    def __init__(self, control_period: float, deceleration: float, reach: float) -> None:
        self.control_period, self._deceleration, self._reach = control_period, deceleration, reach

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        self._front = scenario.car.front

    def command(self, car, adversary) -> float:
        dx, dy, cos, sin = adversary.x - car.x, adversary.y - car.y, math.cos(car.heading), math.sin(car.heading)
        ahead, left = cos * dx + sin * dy - self._front, cos * dy - sin * dx
        return -self._deceleration if 0.0 <= ahead <= self._reach and abs(left) < 2.5 else 0.0


def in_the_curve(scenario: Scenario) -> Scenario:
    """Who crosses is met in the middle of the curve."""
    return replace(scenario, road=replace(scenario.road, origin=68.0))


def in_the_way(scenario: Scenario) -> Scenario:
    """Somebody else crosses, whom the car touches in some crossings and not in others."""
    way = Waypoint(0.0, 3.1, -1.0), Waypoint(12.0, -8.9, -1.0)
    return replace(scenario, others=(Other(kind="pedestrian", radius=0.25, way=way),))


@cache
def crossings(case: str, scale: float = 1.0, runs: int = 100) -> list[tuple[EpisodeLog, Seen | None]]:
    """Crossings of a risk, each with what was seen in it."""
    scenario, make, multiplier = CASES[case]
    period = make().control_period if make else None  # type: ignore[attr-defined]
    plan = Plan(
        replace(scenario, control_period=period), safe_count=3, kamikaze_count=2, collision_runs=8, seed=5,
        simulations=20, multiplier=multiplier,
    )  # fmt: skip
    runner = InProcessRunner(1)
    here = CrossingPlan(plan, tuple(safe_trajectories(plan, runner)), WALKERS.values)
    episodes = AnyCar(here, runner).episodes(crude_crossings(here, runs), scale)
    return [watched(one, make and make()) for one in episodes]


CASES = {
    "basic": (CROSSING, None, 1.0),
    "twenty times a second": (CROSSING, lambda: Brakes(0.05, 8.0, 3.0), 1.0),
    "a hundred times a second": (CROSSING, lambda: Brakes(0.01, 9.0, 4.0), 1.0),
    "at the last moment": (CROSSING, lambda: Brakes(0.1, 9.8, 1.0), 1.0),
    "tyres": (load_scenario("crossing_multi_body"), None, 0.5),
    "tyres, often": (load_scenario("crossing_multi_body"), lambda: Brakes(0.05, 8.0, 3.0), 1.0),
    "curve": (in_the_curve(load_scenario("right_turn")), None, 1.0),
    "curve, often": (in_the_curve(load_scenario("right_turn")), lambda: Brakes(0.05, 8.0, 1.5), 1.0),
    "bystander": (in_the_way(CROSSING), None, 0.5),
    "bystander, often": (in_the_way(CROSSING), lambda: Brakes(0.05, 6.0, 5.0), 1.0),
}


@pytest.mark.parametrize("case", CASES)
def test_every_hit_that_the_world_reports_is_counted_and_no_other(case):
    found = Counter()
    for log, seen in crossings(case, 2.0, 150):
        assert (seen is not None) == (log.outcome == Outcome.COLLISION)
        touch, missed = end_of(log)
        assert (missed == 0.0) == (touch == Touch.FRONT)
        assert collision_partner(log) == (None if seen is None else seen.who)
        wanted = Touch.NONE if seen is None else seen.touch
        assert wanted in (touch, None), (log.episode.episode_id, seen)
        found["others" if seen is not None and seen.who >= 0 else touch] += 1
    assert found[Touch.FRONT] >= 15, found
    assert found[Touch.FLANK] >= 2, found
    assert ("others" in found) == ("bystander" in case), found


@pytest.mark.parametrize("case", CASES)
def test_the_car_is_found_where_it_was_at_the_contact(case):
    scenario, most = CASES[case][0], 0.008 if "tyres" in case else 0.004
    for log, seen in crossings(case):
        if seen is None:
            continue
        (x, y, heading), share = car_at_contact(log)
        assert math.dist((x, y), seen.car[:2]) < most
        assert abs(math.remainder(heading - seen.car[2], math.tau)) < 0.001
        assert abs(seen.time - log.impact_time) * max(seen.car[3], 0.5) < 3e-3  # m; less but in a curve
        body = log.trajectory.positions[-1]
        whole = car_until_contact(log.episode.scenario, log.car, len(log.car) - 2 + share, log.impact_speed, body)
        assert np.array_equal(whole[:-1], log.car[:-1])
        assert whole[-1, 3] == pytest.approx(log.impact_speed, abs=1e-9)
        assert math.dist(whole[-1, :2], seen.car[:2]) < (most if seen.who < 0 else 0.05)
        if seen.touch == Touch.FRONT:
            apart = distances(np.array([[*whole[-1, :2], heading]]), body[None], scenario)
            assert apart == pytest.approx(scenario.adversary.reach, abs=1e-9 if scenario.road.straight else 1e-4)
        assert last_car_position(log) == pytest.approx(right_and_along(scenario.road.line, np.array([[x, y]]))[0, 1])


@pytest.mark.parametrize("case", ["twenty times a second", "at the last moment", "tyres", "tyres, often"])
def test_closing_speed_delta_v_and_fatality_are_those_at_the_contact(case):
    pairs = [(log, seen) for log, seen in crossings(case) if seen is not None]
    logs = [log for log, _ in pairs]
    values = surrogates_of(logs[0].episode.scenario, [(log, "") for log in logs]).values
    for row, (log, seen) in enumerate(pairs):
        walks = (log.adversary[-1] - log.adversary[-2]) / log.episode.scenario.time_step
        speed, heading = seen.car[3], seen.car[2]
        comes = math.hypot(speed * math.cos(heading) - walks[0], speed * math.sin(heading) - walks[1])
        assert values["closing_speed"][row] == pytest.approx(comes, abs=5e-3)
        assert closing_speed(log) == pytest.approx(comes, abs=5e-3)
        assert values["delta_v"][row] == pytest.approx(greater_delta_v(comes, "pedestrian"), abs=5e-3)
        assert values["fatality_risk"][row] == pytest.approx(fatality_risk(comes), rel=0.01)
