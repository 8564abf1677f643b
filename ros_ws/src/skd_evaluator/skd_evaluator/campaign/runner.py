"""The closed loop in process: car, pedestrian and world in one plain loop."""

from __future__ import annotations

import numpy as np
from skd_adversary.adversary import Adversary, make_adversary
from skd_sim.controllers import Controller, SensingController, make_controller, require_sensor
from skd_sim.episode import Episode, EpisodeLog, Outcome
from skd_sim.randomness import Role, generator
from skd_sim.sensors import make_laser
from skd_sim.world import make_world


def run_episode(
    episode: Episode, controller: Controller | None = None, adversary: Adversary | None = None
) -> EpisodeLog:
    """Run one episode to its end.

    Args:
        episode: what to run.
        controller: the car under test; made from the specification by default.
        adversary: the pedestrian; made from the specification by default.
    """
    world = make_world(episode)
    adversary = adversary or make_adversary(episode)
    car = controller or make_controller(episode.controller, episode.multiplier)
    require_sensor(car, episode.controller, episode.scenario)
    sensing = car if isinstance(car, SensingController) else None
    laser = make_laser(episode) if sensing else None
    car.reset(episode.scenario, generator(episode.seed, episode.episode_id, Role.CONTROLLER))
    walked = [world.pedestrian[:2]]
    driven = [(world.car.x, world.car.y, world.car.speed)]
    impact_time = impact_speed = float("nan")
    outcome = Outcome.RUNNING
    while outcome == Outcome.RUNNING:
        if sensing and laser:
            sensing.sense(laser.scan(world.car, world.pedestrian, world.tick))
        acceleration = car.command(world.car, world.pedestrian)
        velocity = adversary.act(world.car)
        contact = world.step(acceleration, velocity)
        walked.append(world.pedestrian[:2])
        driven.append((world.car.x, world.car.y, world.car.speed))
        if contact is not None:
            impact_time = (world.tick - 1 + contact.fraction) * episode.scenario.time_step
            impact_speed = contact.speed
        outcome = episode.outcome(world.tick, world.pedestrian, collided=contact is not None)
    return EpisodeLog(
        episode,
        outcome,
        np.array(walked),
        np.array(driven),
        impact_time,
        impact_speed,
        adversary.depletions,
        clipped=world.clipped,
    )
