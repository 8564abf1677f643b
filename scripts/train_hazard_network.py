"""Train the hazard network of the controller `cal`: the network that comes with SKD is what this writes.

    .venv/bin/python scripts/train_hazard_network.py --out DIR

Scenes are short episodes of the simulator with varied crossings, labelled by whether the adversary's course meets the
zone that the car needs to stand, with a margin. The optimiser is Adam on the logarithmic loss, written out as loops:
every sum has a fixed order, so the same seed gives the same weights whatever the machine's BLAS and number of cores.
"""

from __future__ import annotations

import argparse
import hashlib
import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from skd_sim.controllers.cal import (
    SCALE,
    WIDEST_WALKER,
    HazardNetwork,
    Perception,
    stopping_zone,
    time_to_stand,
)
from skd_sim.kernels.compilation import kernel
from skd_sim.scenario.road import HEADING_NORTH
from skd_sim.scenario.scenario import Obstacle, Scenario, load_scenario
from skd_sim.world.contact import first_contact, to_car_frame
from skd_sim.world.sensors import PlanarLaser
from skd_sim.world.state import AdversaryState
from skd_sim.world.world import World

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
Layers = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]
"""w1, b1, w2, b2, w3, b3, as in `HazardNetwork`."""

EPISODES, EPOCHS, HIDDEN, BATCH, LEARNING_RATE = 12_000, 90, 64, 64, 3e-3
HELD_OUT = 6_000_000  # number of the first held-out episode: none of them is ever trained on
WIDE_KEPT = 0.25  # share of wide objects trained on: parked cars are many and easy
WIDTH_COLUMN = 6
TICKS = 16
FASTEST_CAR = 10.0  # m/s
VISIBLE_BEAMS = 3  # that have to reach an adversary for it to count as visible
CLEARANCE = 0.5  # m between an adversary's centre and a parked car
MARGIN, MARGIN_TIME = 0.1, 0.08  # m around the zone, and s that the label follows the course for longer
MATCH = 0.7  # m from its centre, within which an object is the adversary

# --- the label


@kernel
def on_collision_course(
    ahead: float,
    left: float,
    velocity_ahead: float,
    velocity_left: float,
    speed: float,
    half_width: float,
    radius: float,
    deceleration: float,
    margin: float,
    margin_time: float,
) -> bool:
    """Return whether an adversary's course meets the stopping zone before the car would stand.

    Args:
        ahead: how far the adversary's centre is ahead of the front bumper, m.
        left: how far the adversary's centre is to the left of the car's axis, m.
        velocity_ahead: velocity of the adversary over ground, along the car's axis, m/s.
        velocity_left: velocity of the adversary over ground, to the left, m/s.
        speed: speed of the car, m/s.
        half_width: half width of the car, m.
        radius: radius of the adversary, m.
        deceleration: deceleration of the car at full brake, m/s² (> 0).
        margin: by how much the zone is widened, m; 0 for the collision course itself.
        margin_time: by how much longer the course is followed, s; 0 for the collision course itself.
    """
    horizon = time_to_stand(speed, deceleration) + margin_time
    reach = stopping_zone(speed, deceleration) + margin
    after = (ahead + horizon * velocity_ahead, left + horizon * velocity_left)
    contact = first_contact((ahead, left), after, (reach, 0.0, half_width + margin), radius)
    return contact <= 1.0


# --- scenes


@dataclass(frozen=True, eq=False)
class Scenes:
    """Objects seen, with their labels, and the moments that they come from.

    Attributes:
        features: n × FEATURES, one row per object seen.
        labels: n: 1 where the object is an adversary whose course meets the zone with its margin.
        moment: n: index of the scan that the object was seen in.
        course: m: whether the adversary is on a collision course within braking range (no margin).
        hazard: m: the same with the margin, which is what the network is taught.
        visible: m: whether enough beams reach it, in this scan and in the last: its velocity can be seen.
    """

    features: FloatArray
    labels: FloatArray
    moment: NDArray[np.int64]
    course: BoolArray
    hazard: BoolArray
    visible: BoolArray


def walk(x: float, rng: np.random.Generator) -> tuple[float, float]:
    """Draw a velocity, m/s: to stand, or to walk, mostly across the road from the side that x is on."""
    if rng.random() < 0.2:
        return 0.0, 0.0
    speed = rng.uniform(0.5, 3.0)
    across = math.pi if x > 0.0 else 0.0
    direction = across + rng.normal(0.0, 0.6) if rng.random() < 0.8 else rng.uniform(-math.pi, math.pi)
    return speed * math.cos(direction), speed * math.sin(direction)


def parked_cars(rng: np.random.Generator) -> tuple[Obstacle, ...]:
    """Draw up to three cars parked beside the lane; mostly none."""
    if rng.random() < 0.7:
        return ()
    cars = []
    for _ in range(rng.integers(1, 4)):
        side = -1.0 if rng.random() < 0.5 else 1.0
        cars.append(Obstacle(side * rng.uniform(2.6, 4.5), rng.uniform(-12.0, 8.0), HEADING_NORTH, 4.3, 1.8))
    return tuple(cars)


def is_clear(x: float, y: float, parked: tuple[Obstacle, ...]) -> bool:
    """Return whether an adversary at (x, y), m, keeps off the parked cars."""
    return all(
        abs(x - car.x) > 0.5 * car.width + CLEARANCE or abs(y - car.y) > 0.5 * car.length + CLEARANCE for car in parked
    )


def start_of(parked: tuple[Obstacle, ...], rng: np.random.Generator) -> tuple[float, float]:
    """Draw where the adversary starts."""
    while True:
        x, y = rng.uniform(-6.0, 6.0), rng.uniform(-4.0, 4.0)
        if is_clear(x, y, parked):
            return float(x), float(y)


def count_beams(laser: PlanarLaser, world: World) -> int:
    """Return how many beams of a perfect scanner end on the adversary."""
    seen = laser.true_ranges(world.car, world.adversary)
    without = laser.true_ranges(world.car, AdversaryState(1e6, 1e6, 0.0, 0.0))
    return int(np.count_nonzero(seen < without))


def label(scenario: Scenario, world: World, perception: Perception) -> tuple[FloatArray, bool, bool]:
    """Return the label of each object seen now, and whether the adversary is on course, and with the margin."""
    car, adversary = world.car, world.adversary
    ahead, left = to_car_frame(adversary.x, adversary.y, car.x, car.y, car.heading)
    va, vl = to_car_frame(adversary.vx, adversary.vy, 0.0, 0.0, car.heading)
    own = scenario.car
    state = (ahead - own.front, left, va, vl, car.speed, own.half_width, scenario.adversary.reach, own.deceleration)
    hazard = bool(on_collision_course(*state, MARGIN, MARGIN_TIME))
    objects = perception.objects
    distances = np.hypot(objects[:, 0] - state[0], objects[:, 1] - left)
    labels = np.zeros(len(objects))
    if len(distances) and distances.min() < MATCH:
        labels[int(distances.argmin())] = float(hazard)
    return labels, bool(on_collision_course(*state, 0.0, 0.0)), hazard


def generate_scenes(scenario: Scenario, episodes: range, seed: int) -> Scenes:
    """Run episodes of varied crossings and return what the scanner saw in them, labelled.

    Args:
        scenario: scenario from which footprints, sensor and time step are taken.
        episodes: numbers of the episodes, which with the seed determine all that is drawn.
        seed: seed of every random draw.
    """
    features, labels, moment = [], [], []
    course, hazard, visible = [], [], []
    for episode in episodes:
        rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(episode,))))
        parked = parked_cars(rng)
        car = replace(scenario.car, start_speed=float(rng.uniform(0.0, FASTEST_CAR)))
        varied = replace(scenario, car=car, obstacles=parked)
        start = start_of(parked, rng)
        world = World(varied, adversary_start=start, gap=float(rng.uniform(2.0, 30.0)), start_rng=rng, car_rng=rng)
        laser, perception = PlanarLaser(varied, seed, episode), Perception(varied)
        velocity, acceleration, seen_before = walk(start[0], rng), 0.0, False
        for tick in range(TICKS):
            perception.update(laser.scan(world.car, world.adversary, tick), world.car)
            seen = count_beams(laser, world) >= VISIBLE_BEAMS
            own, on_course, is_hazard = label(varied, world, perception)
            features.append(perception.features(world.car.speed))
            labels.append(own)
            moment += [len(course)] * len(own)
            course.append(on_course)
            hazard.append(is_hazard)
            visible.append(seen and (seen_before or tick == 0))
            seen_before = seen
            if rng.random() < 0.15:
                velocity = walk(world.adversary.x, rng)
            if rng.random() < 0.3:
                acceleration = float(rng.choice((-varied.car.deceleration, 0.0, 2.0)))
            if world.car.speed > FASTEST_CAR:
                acceleration = min(0.0, acceleration)
            behind = world.adversary.y < world.car.y + varied.car.front - 1.0
            touched = world.step(acceleration, velocity) is not None
            if touched or behind or not is_clear(world.adversary.x, world.adversary.y, parked):
                break
    whole = np.concatenate(features), np.concatenate(labels), np.array(moment, dtype=np.int64)
    return Scenes(*whole, np.array(course), np.array(hazard), np.array(visible))


# --- training


@kernel
def add_gradient(x: FloatArray, label: float, weights: Layers, gradient: Layers, work: FloatArray) -> None:
    """Add one sample's gradient of the logarithmic loss; `work` is 4 × hidden."""
    w1, b1, w2, b2, w3, b3 = weights
    g1, gb1, g2, gb2, g3, gb3 = gradient
    hidden = len(b1)
    first, second, back_first, back_second = work[0], work[1], work[2], work[3]
    first[:] = b1
    for i in range(len(x)):
        for j in range(hidden):
            first[j] += x[i] * w1[i, j]
    second[:] = b2
    for i in range(hidden):
        if first[i] > 0.0:
            for j in range(hidden):
                second[j] += first[i] * w2[i, j]
    logit = b3[0]
    for i in range(hidden):
        if second[i] > 0.0:
            logit += second[i] * w3[i, 0]
    error = 1.0 / (1.0 + math.exp(-logit)) - label
    gb3[0] += error
    for i in range(hidden):
        active = second[i] > 0.0
        back_second[i] = error * w3[i, 0] if active else 0.0
        if active:
            g3[i, 0] += error * second[i]
        gb2[i] += back_second[i]
    for i in range(hidden):
        back_first[i] = 0.0
        if first[i] > 0.0:
            for j in range(hidden):
                g2[i, j] += first[i] * back_second[j]
                back_first[i] += w2[i, j] * back_second[j]
        gb1[i] += back_first[i]
    for i in range(len(x)):
        for j in range(hidden):
            g1[i, j] += x[i] * back_first[j]


@kernel
def adam(
    weights: FloatArray, gradient: FloatArray, mean: FloatArray, square: FloatArray, rate: float, step: int
) -> None:
    """Move flat `weights` by one step of Adam (Kingma and Ba 2015, with its default constants); clear `gradient`."""
    decay_mean = 1.0 - 0.9**step
    decay_square = 1.0 - 0.999**step
    for i in range(len(weights)):
        mean[i] = 0.9 * mean[i] + 0.1 * gradient[i]
        square[i] = 0.999 * square[i] + 0.001 * gradient[i] * gradient[i]
        weights[i] -= rate * (mean[i] / decay_mean) / (math.sqrt(square[i] / decay_square) + 1e-8)
        gradient[i] = 0.0


@kernel
def train_epoch(
    features: FloatArray,
    labels: FloatArray,
    order: NDArray[np.int64],
    batch: int,
    rates: FloatArray,
    first_step: int,
    weights: Layers,
    gradient: Layers,
    flat: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
) -> None:
    """Pass once through the data in the given order; `flat` is (weights, gradient, mean, square), each flat."""
    work = np.empty((4, len(weights[1])))
    step = first_step
    for begin in range(0, len(order), batch):
        end = min(begin + batch, len(order))
        for index in order[begin:end]:
            add_gradient(features[index], labels[index], weights, gradient, work)
        flat[1][:] /= end - begin
        step += 1
        adam(flat[0], flat[1], flat[2], flat[3], rates[step - 1], step)


def views_of(flat: FloatArray, inputs: int, hidden: int) -> Layers:
    """Return the six weight arrays as views of one flat array."""
    views: list[FloatArray] = []
    at = 0
    for shape in ((inputs, hidden), (hidden,), (hidden, hidden), (hidden,), (hidden, 1), (1,)):
        size = math.prod(shape)
        views.append(flat[at : at + size].reshape(shape))
        at += size
    w1, b1, w2, b2, w3, b3 = views
    return w1, b1, w2, b2, w3, b3


def train(
    features: FloatArray, labels: FloatArray, hidden: int, epochs: int, rng: np.random.Generator
) -> HazardNetwork:
    """Return a network trained on labelled rows (n × FEATURES; n, 0 or 1); `rng` draws weights and the order."""
    inputs = features.shape[1]
    size = inputs * hidden + hidden + hidden * hidden + hidden + hidden + 1
    flat = (np.zeros(size), np.zeros(size), np.zeros(size), np.zeros(size))
    weights, gradient = views_of(flat[0], inputs, hidden), views_of(flat[1], inputs, hidden)
    for layer, fan_in in ((0, inputs), (2, hidden), (4, hidden)):
        # Uniform with He's variance 2/fan_in, which keeps the scale through rectified units.
        weights[layer][:] = math.sqrt(6.0 / fan_in) * (2.0 * rng.random(weights[layer].shape) - 1.0)
    per_epoch = -(-len(features) // BATCH)
    steps = per_epoch * epochs  # over which the rate falls to zero like half a cosine
    rates = np.array([0.5 * LEARNING_RATE * (1.0 + math.cos(math.pi * i / steps)) for i in range(steps)])
    for epoch in range(epochs):
        order = rng.permutation(len(features))
        train_epoch(features, labels, order, BATCH, rates, epoch * per_epoch, weights, gradient, flat)
    return HazardNetwork(*(part.copy() for part in weights))


def fit(scenario: Scenario, seed: int, episodes: int, *, hidden: int = HIDDEN, epochs: int = EPOCHS) -> HazardNetwork:
    """Return the network trained on scenes of a seed."""
    scenes = generate_scenes(scenario, range(episodes), seed)
    rng = np.random.Generator(np.random.PCG64(seed))
    wide = scenes.features[:, WIDTH_COLUMN] > SCALE * WIDEST_WALKER
    kept = ~wide | (rng.random(len(wide)) < WIDE_KEPT)
    return train(scenes.features[kept], scenes.labels[kept], hidden, epochs, rng)


def digest(network: HazardNetwork) -> str:
    """Return a SHA-256 of the weights."""
    return hashlib.sha256(b"".join(np.ascontiguousarray(part).tobytes() for part in network)).hexdigest()


def probabilities_of(network: HazardNetwork, scenes: Scenes) -> FloatArray:
    """Return the probability of a hazard at each moment, the greatest over the objects seen; 0 where none is."""
    greatest = np.zeros(len(scenes.course))
    np.maximum.at(greatest, scenes.moment, network.probability(scenes.features))
    return greatest


def main() -> None:
    """Train, say how good the network is on held-out scenes, and write it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="folder for hazard_network.npz")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--episodes", type=int, default=EPISODES)
    parser.add_argument("--epochs", type=int, default=EPOCHS)
    given = parser.parse_args()
    scenario = load_scenario("crossing")
    network = fit(scenario, given.seed, given.episodes, epochs=given.epochs)
    np.savez(given.out / "hazard_network.npz", **network._asdict())
    scenes = generate_scenes(scenario, range(HELD_OUT, HELD_OUT + given.episodes // 3), given.seed)
    alarm, course = probabilities_of(network, scenes) > 0.9, scenes.course & scenes.visible
    recall, precision = (alarm & course).sum() / course.sum(), (alarm & scenes.course).sum() / alarm.sum()
    print(f"sha256 {digest(network)}; on held-out scenes recall {recall:.4f}, precision {precision:.4f}")


if __name__ == "__main__":
    main()
