"""MetaDrive as a simulator: how it brakes, how true the adversary is, how well it repeats itself, whose decisions.

    python benchmarks/metadrive_simulator.py [stops] [adversary] [repeats] [expert] [--episodes 100] [--json]

*stops*: full stops from 30 km/h at commanded decelerations, beside v²/2a. *adversary*: how far from where it was
commanded MetaDrive has the adversary, and contacts by MetaDrive's own shapes beside those by SKD's geometry.
*repeats*: the same episodes once more in another order, after another car, and in a new process. *expert*: each
decision of MetaDrive's expert in SKD's loop beside those in MetaDrive's own, `MetaDriveEnv` with `ExpertPolicy`, with
the same draws: on an empty road, and with a pedestrian who crosses. Needs the extra `metadrive`.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from skd_evaluator.campaign.judge.simulator_contacts import simulator_contacts
from skd_evaluator.campaign.run.runner import run_episode
from skd_sim.encounter.kinds import height_of
from skd_sim.encounter.scenario import Scenario, load_scenario
from skd_sim.episode.episode import Episode, EpisodeLog, Mode, Outcome
from skd_sim.episode.randomness import controller_generator, controller_seed
from skd_sim.errors import UsageError
from skd_sim.geometry.trajectory import Trajectory
from skd_sim.simulation.framed_simulator import FramedSimulator
from skd_sim.simulation.metadrive.expert import CONTROL_PERIOD, MetaDriveExpert
from skd_sim.simulation.metadrive.installed import METADRIVE, require_metadrive

CARS = {"basic": None, "cal": 0.05, "carla": None, "metadrive_expert": CONTROL_PERIOD}
_SPEED = 25.0 / 3.0
_DECELERATIONS = (2.0, 3.5, 6.0, 8.0, 10.0)
_FAR = -80.0  # m: beyond what the expert's lidar sees
_TICKS = 20


def episode(number: int, car: str, phi: Trajectory) -> Episode:
    """Return a run of a car along φ in MetaDrive."""
    scenario = replace(load_scenario("crossing"), control_period=CARS[car])
    return Episode(scenario, Mode.REPLAY, 0, number, controller=car, safe_trajectory=phi, simulator=METADRIVE)


def crossing(number: int) -> Trajectory:
    """Return a crossing at a drawn pace, begun at a drawn time; from either side."""
    rng = np.random.default_rng([7, number])
    side, pace, delay = rng.choice([-1.0, 1.0]), rng.uniform(1.0, 2.5), rng.uniform(0.0, 1.5)
    moved = pace * np.maximum(0.0, 0.3 * np.arange(_TICKS + 1) - delay)
    return Trajectory(np.column_stack([side * (np.minimum(moved, 6.0) - 3.5), np.zeros_like(moved)]), 0.3, "crossing")


def nobody() -> Trajectory:
    """Return the way of somebody who stands where no car comes and no lidar looks."""
    return Trajectory(np.tile((_FAR, 0.0), (_TICKS + 1, 1)), 0.3, "nobody")


def stop(scenario: Scenario, deceleration: float) -> dict[str, float]:
    """Return the way of a full stop (m) beside v²/2a, and how far the car creeps in the two seconds after it (m)."""
    from skd_sim.simulation.metadrive.frames import MetaDriveFrames

    simulator = FramedSimulator(MetaDriveFrames(scenario))
    frame = simulator.reset(Episode(replace(scenario, horizon=60.0), Mode.REPLAY, 0, 0, safe_trajectory=nobody()))
    begin, speed, ticks = frame.car.y, frame.car.speed, 0
    while frame.car.speed > 1e-2 and ticks < 100:
        frame, ticks = simulator.step(-deceleration, (0.0, 0.0)), ticks + 1
    way, stands = frame.car.y - begin, frame.car.y
    for _ in range(round(2.0 / scenario.time_step)):
        frame = simulator.step(-deceleration, (0.0, 0.0))
    closed = speed**2 / (2.0 * deceleration)
    return {
        "deceleration": deceleration,
        "way": way,
        "closed_form": closed,
        "ratio": way / closed,
        "creeps": frame.car.y - stands,
        "clipped": simulator.clipped,
    }


def stops() -> dict[str, Any]:
    """Return full stops of several vehicles."""
    crossing_car, wet = load_scenario("crossing"), load_scenario("crossing_multi_body")
    cart = load_scenario("citr_crossing")
    vehicles = {
        "crossing": crossing_car,
        "crossing, 20 decisions a second": replace(crossing_car, control_period=0.05),
        "crossing, mass 1800 kg": replace(crossing_car, car=replace(crossing_car.car, mass=1800.0)),
        "crossing_multi_body, friction 0.65": replace(wet, road=replace(wet.road, friction=0.65)),
        "citr_crossing": replace(cart, car=replace(cart.car, start_speed=_SPEED, meet_safe_trajectory=False)),
    }
    return {name: [stop(one, each) for each in _DECELERATIONS] for name, one in vehicles.items()}


def adversary(count: int) -> dict[str, Any]:
    """Return how far from its command MetaDrive had the adversary at most, m, and whose contacts there were."""
    from skd_sim.simulation.metadrive.simulator import MetaDriveSimulator

    simulator, apart, logs = MetaDriveSimulator(), 0.0, []
    for number in range(count):
        car = list(CARS)[number % len(CARS)]
        logs.append(run_episode(episode(number, car, crossing(number)), simulator=simulator))
        apart = max(apart, simulator.apart)
    aborted = sum(log.outcome == Outcome.ABORTED for log in logs)
    return {"episodes": count, "aborted": aborted, "apart": apart, **simulator_contacts(logs)}


def states(logs: list[EpisodeLog]) -> np.ndarray:
    """Return the states of the car in all episodes, one below the other."""
    return np.concatenate([log.car for log in logs])


def some_episodes(count: int) -> list[Episode]:
    """Return episodes of all four cars, with somebody who crosses and with nobody."""
    return [
        episode(number, car, phi)
        for number in range(max(1, count // (2 * len(CARS))))
        for car in CARS
        for phi in (crossing(number), nobody())
    ]


def repeats(count: int) -> dict[str, Any]:
    """Return by how much states of the same episodes differ at most (m, m/s)."""
    wanted = some_episodes(count)
    first = [run_episode(one) for one in wanted]
    order = np.random.default_rng(0).permutation(len(wanted)).tolist()
    again = {index: run_episode(wanted[index]) for index in order}
    other = replace(load_scenario("crossing"), car=replace(load_scenario("crossing").car, mass=2000.0))
    run_episode(Episode(other, Mode.REPLAY, 0, 0, safe_trajectory=nobody(), simulator=METADRIVE))
    rebuilt = [run_episode(one) for one in wanted]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "states.npy"
        subprocess.run([sys.executable, __file__, "--states", str(file), "--episodes", str(count)], check=True)
        new = np.load(file)
    return {
        "episodes": len(wanted),
        "contacts": sum(log.outcome == Outcome.COLLISION for log in first),
        "another_order": float(np.abs(states(first) - states([again[index] for index in range(len(wanted))])).max()),
        "after_another_car": float(np.abs(states(first) - states(rebuilt)).max()),
        "new_process": float(np.abs(states(first) - new).max()),
    }


class Overheard(MetaDriveExpert):
    """The expert, whose decisions are kept."""

    def __init__(self) -> None:
        """Hear nothing yet."""
        super().__init__()
        self.decisions: list[tuple[float, float]] = []

    def command(self, car: Any, adversary: Any) -> float:
        """Decide, and keep it."""
        found = super().command(car, adversary)
        assert self._stage.decided is not None
        self.decisions.append((self._stage.decided.steering, self._stage.decided.pedal))
        return found


def own_loop(scenario: Scenario) -> tuple[Any, Any]:
    """Return what runs an episode in MetaDrive's own loop, `MetaDriveEnv` with `ExpertPolicy`, and what ends it."""
    from metadrive.component.traffic_participants.pedestrian import Pedestrian
    from metadrive.examples.ppo_expert import numpy_expert
    from metadrive.manager.base_manager import BaseManager
    from metadrive.policy import expert_policy
    from skd_sim.simulation.metadrive import stage as stages

    stages.end()
    spec = stages.StageSpec.of(scenario)
    expert_policy.expert = numpy_expert.expert  # where PyTorch is installed, MetaDrive would compute by that
    config = {**stages.environment_config(spec), "agent_policy": expert_policy.ExpertPolicy}
    env = stages._Env(config)
    with stages.without_assets():
        env.reset(seed=0)
    stage = stages.Stage(spec, env)
    walker = type("Walker", (Pedestrian,), {"RADIUS": scenario.adversary.radius, "HEIGHT": height_of("pedestrian")})

    class Walk(BaseManager):
        """Moves the pedestrian before each step of the physics."""

        def step(self, *args: Any, **kwargs: Any) -> None:
            if self.body is not None:
                x, y = self.at
                self.at = x + stage.step * self.velocity[0], y + stage.step * self.velocity[1]
                self.body.set_position((self.ahead + self.at[1], stage.across - self.at[0]))

    walk = Walk()
    walk.body = None
    env.engine.register_manager("walk", walk)

    def run(log: EpisodeLog, decisions: int) -> list[tuple[float, float]]:
        rng = controller_generator(controller_seed(log.episode.seed, log.episode.episode_id))
        phi = log.episode.safe_trajectory
        assert phi is not None
        stage.place(_SPEED)
        walk.ahead = stages.START - float(log.car[0, 1])
        walk.at = (float(phi.positions[0, 0]), float(phi.positions[0, 1]))
        walk.body = env.engine.spawn_object(
            walker, position=(walk.ahead + walk.at[1], stage.across - walk.at[0]), heading_theta=0.0, force_spawn=True
        )
        walk.body.set_static(True)  # it goes where it is put, and does not fall on its way there
        stage.car.after_step()
        found = []
        with mock.patch.object(np.random, "normal", rng.normal):
            for number in range(decisions):
                tick = number * CONTROL_PERIOD / scenario.time_step
                here = min(int(tick + 1e-9), len(phi) - 2)
                walk.velocity = ((phi.positions[here + 1] - phi.positions[here]) / phi.time_step).tolist()
                env.step([0.0, 0.0])
                found.append(tuple(float(one) for one in stage.car.last_current_action[-1]))
        env.engine.clear_objects([walk.body.id], force_destroy=True)
        walk.body = None
        return found

    return run, stage.close


def expert(count: int) -> dict[str, Any]:
    """Return by how much decisions in SKD's loop and in MetaDrive's own differ at most, and how often it hit."""
    found: dict[str, Any] = {}
    kept = []
    for name, ways in (("undisturbed", [nobody()] * count), ("crossing", [crossing(one) for one in range(count)])):
        for number, phi in enumerate(ways):
            driver = Overheard()
            log = run_episode(episode(number, "metadrive_expert", phi), controller=driver)
            kept.append((name, log, driver.decisions))
    loop, close = own_loop(kept[0][1].episode.scenario)
    for name, log, decisions in kept:
        own = loop(log, len(decisions))
        row = found.setdefault(name, {"episodes": 0, "decisions": 0, "apart": 0.0, "collisions": 0, "hits": 0})
        row["episodes"] += 1
        row["decisions"] += len(decisions)
        row["apart"] = max(row["apart"], float(np.abs(np.array(own) - np.array(decisions)).max()))
        row["collisions"] += log.outcome == Outcome.COLLISION
        row["hits"] += log.hit
    close()
    return found


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="MetaDrive as a simulator of SKD, measured.")
    parser.add_argument("parts", nargs="*", help="stops, adversary, repeats, expert; by default all")
    parser.add_argument("--episodes", type=int, default=100, help="number of episodes of each kind")
    parser.add_argument("--states", help=argparse.SUPPRESS)
    parser.add_argument("--json", action="store_true", help="print plain data")
    arguments = parser.parse_args()
    try:
        require_metadrive()
    except UsageError as error:
        raise SystemExit(f"metadrive_simulator.py: {error}") from None
    if arguments.states:
        np.save(arguments.states, states([run_episode(one) for one in some_episodes(arguments.episodes)]))
        return
    measures = {"stops": stops, "adversary": adversary, "repeats": repeats, "expert": expert}
    unknown = set(arguments.parts) - set(measures)
    if unknown:
        raise SystemExit(f"metadrive_simulator.py: unknown part {min(unknown)}; known are {', '.join(measures)}")
    for name in arguments.parts or measures:
        found = measures[name]() if name == "stops" else measures[name](arguments.episodes)
        if arguments.json:
            print(json.dumps({name: found}), flush=True)
            continue
        print(name)
        for key, value in found.items():
            rows = value if isinstance(value, list) else [value]
            for row in rows:
                print(f"  {key}: {_shown(row)}")


def _shown(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key} {_shown(one)}" for key, one in value.items())
    return f"{value:.4g}" if isinstance(value, float) and math.isfinite(value) else str(value)


if __name__ == "__main__":
    main()
