"""Episodes and steps of the world that tests of both searches for the margin share."""

from dataclasses import replace

import numpy as np
from skd_evaluator.assessment.plan import EpisodeGroup, episode_id
from skd_evaluator.margin.search.rounds import one_by_one
from skd_evaluator.margin.search.search import Effort, search_margins
from skd_evaluator.metrics.deviation import Hit
from skd_sim import AdversaryState, CarState, EpisodeSpec, Mode, Trajectory, load_scenario
from skd_sim.world.world import Contact, World

CROSSING = load_scenario("crossing")
TIME_STEP = CROSSING.time_step


def kamikaze_episode(
    points, ticks=40, multiplier=1.0, seed=0, number=0, gap=None, impact=0.0, simulations=1000
) -> EpisodeSpec:
    car = CROSSING.car if gap is None else replace(CROSSING.car, start_gap=gap)
    collision = replace(CROSSING.collision, minimum_impact_speed=impact)
    scenario = replace(CROSSING, horizon=ticks * TIME_STEP, car=car, collision=collision)
    path, own = Trajectory(np.array(points, dtype=float), TIME_STEP), episode_id(EpisodeGroup.KAMIKAZE, 0, number)
    how = {"multiplier": multiplier, "simulations": simulations}
    return EpisodeSpec(scenario, Mode.KAMIKAZE, seed, own, path, **how)


def search_margin(episode: EpisodeSpec, budget: int) -> Hit | None:
    """Return the hit of least deviation that the search finds in one trial."""
    return search_margins([episode], {}, one_by_one, Effort(min(32, budget), budget)).hits[0]


def bent(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return a crooked crossing of `count` points over about five metres."""
    start = [rng.uniform(-3.0, -1.3), rng.uniform(-1.0, 1.0)]
    steps = np.column_stack([rng.uniform(-0.1, 0.6, count - 1), rng.normal(0.0, 0.3, count - 1)]) * 10.0 / count
    return np.cumsum(np.vstack([start, steps]), axis=0)


def any_touch(episode: EpisodeSpec) -> EpisodeSpec:
    """Return the episode with every collision a hit, as the distances of planned kamikazes count them."""
    collision = replace(episode.scenario.collision, hit_speed=episode.scenario.collision.minimum_impact_speed)
    return replace(episode, scenario=replace(episode.scenario, collision=collision, eta_max=100.0))


def touching(walked: list[tuple[float, float]], contact: Contact | None) -> np.ndarray:
    """Return the hit up to the place of a contact in its last tick."""
    before, after = walked[-2:]
    (x, y), (x_to, y_to) = before, after
    return np.array([*walked[:-1], (x + contact.fraction * (x_to - x), y + contact.fraction * (y_to - y))])


def place(world: World, car: CarState, adversary: AdversaryState, tick: int) -> None:
    world.car, world.adversary, world.tick = car, adversary, tick
    world.dynamics.reset(car)
