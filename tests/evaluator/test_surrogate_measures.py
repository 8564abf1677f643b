"""Surrogate safety measures against closed forms, another library's geometry, and dense sampling."""

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from skd_evaluator.metrics import surrogate_measures as measures
from skd_evaluator.metrics.contact_place import deceleration_at_entry
from skd_evaluator.metrics.surrogate_scenes import EpisodeMotion, Interaction, Interactions, scene_of, velocities
from skd_sim import EpisodeLog, EpisodeSpec, Mode, Outcome, Trajectory, load_scenario
from skd_sim.scenario.road_user import ROAD_USERS

NORTH = math.pi / 2.0
FOOTPRINT = 2.25, 1.75, 0.9
SCENES = 200


def scene_at(rng: np.random.Generator, shape: tuple[float, float, float], rows: int = 2) -> Interaction:
    """A scene in which both move uniformly, as between two ticks."""
    car_speed, heading = rng.uniform(0.0, 15.0), rng.uniform(-math.pi, math.pi)
    place, velocity = rng.uniform(-15.0, 15.0, 2), rng.uniform(-4.0, 4.0, 2)
    times = np.linspace(0.0, 0.3 * (rows - 1), rows)
    ahead = np.array([math.cos(heading), math.sin(heading)])
    car = np.column_stack([times[:, None] * car_speed * ahead, np.full(rows, heading), np.full(rows, car_speed)])
    other = place + times[:, None] * velocity
    turned = np.full(rows, math.atan2(velocity[1], velocity[0]))
    return Interaction(times, car, other, np.tile(velocity, (rows, 1)), turned, FOOTPRINT, shape)


def rectangles(places: np.ndarray, turned: np.ndarray, front: float, rear: float, half: float) -> np.ndarray:
    corners = np.array([(front, half), (-rear, half), (-rear, -half), (front, -half)])
    cos, sin = np.cos(turned), np.sin(turned)
    turns = np.stack([np.stack([cos, sin], axis=1), np.stack([-sin, cos], axis=1)], axis=1)
    return np.asarray(shapely.polygons(corners @ turns + places[:, None]))


def distances(scene: Interaction) -> np.ndarray:
    """By shapely; a disc by its centre, exactly."""
    car = rectangles(scene.car[:, :2], scene.car[:, 2], *scene.footprint)
    radius, length, width = scene.shape
    if radius:
        return np.maximum(0.0, shapely.distance(car, shapely.points(scene.other)) - radius)
    return np.asarray(shapely.distance(car, rectangles(scene.other, scene.turned, length, length, width)))


@pytest.mark.parametrize("shape", [(0.25, 0.0, 0.0), (0.0, 0.9, 0.3), (0.0, 2.2, 0.9)])
def test_clearances_are_distances_of_polygons(shape):
    rng = np.random.default_rng(1)
    for _ in range(SCENES):
        scene = scene_at(rng, shape)
        assert measures.clearances(scene) == pytest.approx(distances(scene), abs=1e-9)


@pytest.mark.parametrize("shape", [(0.25, 0.0, 0.0), (0.0, 0.9, 0.3)])
def test_the_least_clearance_lies_between_moments_too(shape):
    rng = np.random.default_rng(2)
    between = 0
    for _ in range(SCENES // 2):
        scene = scene_at(rng, shape, rows=5)
        dense = Interactions.of(scene).every(0.002).whole
        expected = distances(dense).min()
        found = measures.least_clearance(scene)
        assert expected - 0.02 <= found <= expected + 1e-6  # at 15 m/s, 2 ms are 30 mm, half of which to the nearer one
        between += found < measures.clearances(scene).min() - 1e-6
    assert between > 10


@pytest.mark.parametrize("shape", [(0.25, 0.0, 0.0), (0.0, 0.9, 0.3)])
def test_after_the_time_to_collision_the_outlines_touch_and_not_before(shape):
    rng = np.random.default_rng(3)
    met = 0
    for _ in range(3 * SCENES):
        scene = scene_at(rng, shape)
        time = measures.collision_times(scene)[0]
        moving = np.array([math.cos(scene.car[0, 2]), math.sin(scene.car[0, 2])]) * scene.car[0, 3]
        if math.isinf(time) or measures.clearances(scene)[0] == 0.0:
            assert time in (0.0, math.inf)
            continue
        met += 1
        for moment in (time - 1e-3, time):
            car = scene.car[:1] + np.array([*(moment * moving), 0.0, 0.0])
            other = scene.other[:1] + moment * scene.velocity[:1]
            then = Interaction(scene.times[:1], car, other, scene.velocity[:1], scene.turned[:1], FOOTPRINT, shape)
            assert (distances(then)[0] < 1e-6) == (moment == time)
    assert met > 25


def following(gap: float, speed: float, ahead: float) -> Interaction:
    """A car behind a disc that moves the same way."""
    car = np.array([[0.0, 0.0, 0.0, speed]])
    other = np.array([[FOOTPRINT[0] + gap + 0.25, 0.0]])
    return Interaction(np.array([0.0]), car, other, np.array([[ahead, 0.0]]), np.zeros(1), FOOTPRINT, (0.25, 0.0, 0.0))


def test_closed_forms_of_following():
    rng = np.random.default_rng(4)
    for _ in range(SCENES):
        gap, speed, ahead = rng.uniform(0.5, 30.0), rng.uniform(0.5, 15.0), rng.uniform(0.0, 5.0)
        scene, closing = following(gap, speed, ahead), speed - ahead
        comes = closing > 0.0 and gap / closing <= 20.0
        needed = closing**2 / (2.0 * gap) if comes else 0.0
        assert measures.collision_times(scene)[0] == pytest.approx(gap / closing if comes else math.inf, abs=1e-6)
        assert measures.required_decelerations(scene)[0] == pytest.approx(needed, abs=1e-6)
        assert measures.greatest_required_deceleration(scene) == pytest.approx(min(measures.MOST, needed), abs=1e-6)
        assert measures.brake_threat_numbers(scene, 8.0)[0] == pytest.approx(needed / 8.0, abs=1e-6)
        assert measures.headways(scene)[0] == pytest.approx(gap / speed, abs=1e-6)


def test_somebody_who_will_have_passed_needs_no_braking():
    scene = following(10.0, 8.0, 0.0)
    aside = replace(scene, other=scene.other + np.array([0.0, 2.0]), velocity=np.array([[0.0, 3.0]]))
    assert np.isinf(measures.collision_times(aside)).all()
    assert measures.greatest_required_deceleration(aside) == 0.0
    assert math.isinf(measures.headways(aside)[0])


def test_an_episode_is_a_scene_on_its_lane():
    scenario = load_scenario("crossing")
    times = np.array([0.0, 0.3, 0.6])
    adversary = np.array([[-3.5, 0.0], [-2.9, 0.0], [-2.3, 0.1]])
    car = np.array([[0.0, y, NORTH, 8.0] for y in (-15.25, -12.85, -10.45)])
    scene = scene_of(scenario, times, adversary, car)
    assert scene.gap == pytest.approx([12.75, 10.35, 8.05])
    assert scene.seen[0] == pytest.approx([15.25, 3.5])  # ahead, and to the left: in the West of who drives North
    assert scene.velocity == pytest.approx(velocities(times, adversary, np.array([0, 3])))
    assert scene.closing == pytest.approx([8.0, 8.0 - 1 / 3, 8.0 - 1 / 3])
    finer = Interactions.of(scene).every(0.1).whole
    assert finer.times == pytest.approx(np.arange(7) * 0.1)
    assert finer.car[1, 1] == pytest.approx(-14.45)


def crossing_at(rng: np.random.Generator) -> tuple[Interaction, float]:
    """Two ways that cross at a right angle, and the post-encroachment time by its four moments."""
    speed, walks, radius = rng.uniform(2.0, 12.0), rng.uniform(0.8, 3.0), 0.25
    gap, aside = rng.uniform(3.0, 40.0), rng.uniform(2.0, 8.0)
    front, rear, half = FOOTPRINT
    times = np.linspace(0.0, 60.0, 7)
    car = np.column_stack([speed * times, np.zeros(7), np.zeros(7), np.full(7, speed)])
    other = np.column_stack([np.full(7, gap + front), -aside + walks * times])
    scene = Interaction(times, car, other, np.tile([0.0, walks], (7, 1)), np.zeros(7), FOOTPRINT, (radius, 0.0, 0.0))
    enters, leaves = (aside - half - radius) / walks, (aside + half + radius) / walks
    arrives, gone = (gap - radius) / speed, (gap + front + rear + radius) / speed
    return scene, max(0.0, arrives - leaves, enters - gone)


def encroachment(scene: Interaction) -> float:
    return float(measures.post_encroachment_times(Interactions.of(scene))[0])


def test_post_encroachment_times_are_those_of_the_four_moments():
    rng = np.random.default_rng(6)
    kinds = set()
    for _ in range(SCENES):
        scene, expected = crossing_at(rng)
        assert encroachment(scene) == pytest.approx(expected, abs=1e-6)
        kinds.add(expected > 0.0)
    assert kinds == {True, False}


def test_a_car_that_stops_before_has_no_post_encroachment_time():
    scene, _ = crossing_at(np.random.default_rng(7))
    stands = replace(scene, car=np.tile(scene.car[:1], (7, 1)))
    assert math.isnan(encroachment(stands))
    turns = replace(scene, car=scene.car + np.linspace(0, 1, 7)[:, None])
    assert math.isnan(encroachment(turns))


def test_what_a_contact_does():
    rng = np.random.default_rng(8)
    for _ in range(SCENES):
        scene = scene_at(rng, (0.25, 0.0, 0.0))
        own = scene.car[1, 3] * np.array([math.cos(scene.car[1, 2]), math.sin(scene.car[1, 2])])
        assert measures.closing_speeds(scene)[-1] == pytest.approx(math.dist(own, scene.velocity[1]), abs=1e-6)
        closing, mass, other = rng.uniform(0.0, 30.0), rng.uniform(800.0, 2500.0), rng.uniform(20.0, 120.0)
        # Momentum before and after; both go on together.
        together = mass * closing / (mass + other)
        assert measures.delta_v(closing, mass, other) == pytest.approx(closing - together, abs=1e-6)
        assert measures.delta_v(closing, other, mass) == pytest.approx(together, abs=1e-6)


@pytest.mark.parametrize(("kmh", "published"), [(30, 0.05), (37, 0.10), (59, 0.50), (69, 0.75), (80, 0.90)])
def test_the_risk_is_the_published_one(kmh, published):
    """Of the paper's summary, rounded to percents there."""
    risk = measures.fatality_risk(kmh / 3.6)
    assert risk == pytest.approx(published, abs=0.015)
    low, high = sorted(measures.fatality_risk(kmh / 3.6, odds) for odds in measures.ODDS_INTERVAL)
    assert low <= risk <= high
    odds = [one / (1 - one) for one in (risk, measures.fatality_risk((kmh + 1) / 3.6))]
    assert odds[1] / odds[0] == pytest.approx(1.11)


def test_the_measures_of_an_episode():
    scenario = load_scenario("crossing")
    times = 0.3 * np.arange(9)
    phi = np.column_stack([-3.5 + 1.4 * times, np.zeros(9)])
    car = np.column_stack([np.zeros(9), -20.0 + 6.0 * times, np.full(9, NORTH), np.full(9, 6.0)])
    found = measures.episode_measures(scenario, EpisodeMotion(times, phi, car), collided=False)
    scene = scene_of(scenario, times, phi, car)
    assert found["clearance"] == measures.least_clearance(scene)
    over = found["over_time"]
    assert len(over["time"]) == len(over["time_to_collision"]) == len(over["headway"])
    assert found["fatality_risk"] is None
    hit = measures.episode_measures(scenario, EpisodeMotion(times, phi, car), collided=True)
    assert hit["closing_speed"] == pytest.approx(math.hypot(6.0, 1.4))
    assert hit["fatality_risk_interval"][0] < hit["fatality_risk"] < hit["fatality_risk_interval"][1]


@pytest.mark.parametrize("name", ["crossing", "cut_in"])
def test_episodes_together_are_what_they_are_alone(name):
    rng = np.random.default_rng(10)
    scenario = load_scenario(name)
    courses, collided = [], rng.random(SCENES // 4) < 0.3
    for _ in range(SCENES // 4):
        count = int(rng.integers(2, 9))
        times = np.cumsum(rng.uniform(0.1, 0.4, count))
        adversary = np.cumsum(rng.uniform(-0.6, 0.6, (count, 2)), axis=0) + rng.uniform(-4.0, 4.0, 2)
        along, speeds = np.cumsum(rng.uniform(0.0, 2.0, count)) - 8.0, rng.uniform(0, 9, count)
        car = np.column_stack([np.zeros(count), along, np.full(count, NORTH), speeds])
        courses.append(EpisodeMotion(times, adversary, car))
    together = measures.surrogate_measures(scenario, courses, collided)
    for number, one in enumerate(courses):
        alone = measures.surrogate_measures(scenario, [one], collided[number : number + 1])
        assert {key: values[0] for key, values in alone.items()} == pytest.approx(
            {key: values[number] for key, values in together.items()}, abs=1e-12, nan_ok=True
        )
        dense = Interactions.of(scene_of(scenario, *one)).every(0.05).whole
        least = together["clearance"][number]
        assert least <= distances(dense).min() + 1e-9
        assert not collided[number] or (least, together["post_encroachment_time"][number]) == (0.0, 0.0)
    assert np.isnan(together["closing_speed"]).tolist() == (~collided).tolist()


def test_of_a_contact_the_lighter_one_changes_more():
    car = measures.CAR_MASS
    for kind, mass in (("pedestrian", 78.0), ("child", 23.0), ("cyclist", 95.0), ("car", car), ("van", 2500.0)):
        share = max(mass, car) / (mass + car)
        assert measures.greater_delta_v(7.0, kind) == pytest.approx(7.0 * share)
    for kind in ROAD_USERS.own:
        assert 0.5 <= measures.greater_delta_v(1.0, kind) < 1.0
    assert math.isnan(measures.greater_delta_v(7.0, "hovercraft"))


CROSSING = load_scenario("crossing")
STEP = CROSSING.time_step
EDGE = 0.9 + 0.25  # half of the car, and the disc


def crosses(speed: float, y: float, velocity: float = 2.0, drift: float = 0.0) -> EpisodeLog:
    """Somebody crosses at y + drift·t, and a car at constant speed comes from −20 m."""
    times = STEP * np.arange(9)
    adversary = np.column_stack([-3.5 + velocity * times, y + drift * times])
    car = np.column_stack([np.zeros(9), -20.0 + speed * times, np.zeros(9), np.full(9, speed)])
    episode = EpisodeSpec(CROSSING, Mode.KAMIKAZE, 0, 0, safe_trajectory=Trajectory(adversary, STEP))
    return EpisodeLog(episode, Outcome.COLLISION, adversary, car, 8 * STEP - 0.01, 5.0)


@pytest.mark.parametrize("drift", [0.0, 1.5, -1.5])
def test_a_car_that_brakes_so_hard_just_does_not_touch(drift: float) -> None:
    """By the closed form of uniform motion: the gap at which both are equally fast is zero."""
    log = crosses(6.0, 5.0, drift=drift)
    tick = math.ceil((3.5 - EDGE) / 2.0 / STEP)  # the first at which −3.5 + 2t ≥ −EDGE
    gap = (5.0 + drift * tick * STEP - 0.25) - (-20.0 + 6.0 * tick * STEP + 2.25)
    found = deceleration_at_entry(log)
    closing = 6.0 - drift
    time = closing / found
    assert gap - closing * time + 0.5 * found * time**2 == pytest.approx(0.0, abs=1e-9)
