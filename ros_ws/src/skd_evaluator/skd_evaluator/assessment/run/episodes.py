"""The closed loop in process: car, adversary and simulator in one plain loop."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from skd_adversary.adversary import Adversary, BelievedCar, PlanningAdversary, make_adversary
from skd_sim.arrays import FloatArray
from skd_sim.controllers.loading import make_controller
from skd_sim.controllers.protocol import Controller, is_sensing, require_control_period, require_sensor, sight_of
from skd_sim.options.car_under_test import is_own_world
from skd_sim.simulators.simulator import NamedSimulator, Simulator, SimulatorError, require_others
from skd_sim.world.dynamics.basic import Command, as_pair
from skd_sim.world.episode import (
    AbortKind,
    EpisodeLog,
    EpisodeSpec,
    Mode,
    Outcome,
    abort_reason,
    controller_generator,
    controller_seed,
)
from skd_sim.world.sensors import make_laser

from skd_evaluator.assessment.plausibility import examine
from skd_evaluator.assessment.run.assembly import aborted


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
    car.reset(episode.public_scenario, controller_generator(controller_seed(episode.seed, episode.episode_id)))
    adversary = adversary or make_adversary(episode)
    frames, velocity = [frame], (0.0, 0.0)
    believer = adversary if episode.mode == Mode.KAMIKAZE and isinstance(adversary, PlanningAdversary) else None
    believed: list[BelievedCar] = []
    commands: list[Command] = []
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


def _belief(believed: Sequence[BelievedCar], states: int) -> FloatArray | None:
    """Return what was believed at each state, nan where none was decided; None where nothing was believed."""
    if not believed:
        return None
    unknown = (math.nan,) * len(believed[0])
    return np.array([*believed, *[unknown] * (states - len(believed))])
