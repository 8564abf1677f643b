"""What each kind of road user can do, by the documented numbers alone."""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from skd_evaluator import Plan, run_episode
from skd_sim import EpisodeSpec, Mode, Outcome, Scenario, Trajectory
from skd_sim.options.car_and_adversary import Objective
from skd_sim.world.state import FloatArray

ON_FOOT = {"child": 2.0, "runner": 3.0}  # m/s², in any direction
WHEELED = {  # m/s² to speed up, to brake, to the side; rad in a tick; m of the tightest circle
    "cyclist": (1.0, 3.0, 3.0, math.radians(30.0), 0.0),
    "e_scooter": (1.2, 3.5, 2.5, math.radians(30.0), 0.0),
    "motorcycle": (4.0, 5.5, 4.0, math.radians(30.0), 2.5),
    "car": (2.5, 6.0, 4.0, math.radians(30.0), 5.5),
    "van": (2.0, 5.0, 3.5, math.radians(30.0), 6.5),
}
BODIES = {
    "child": {"radius": 0.25, "speed": 2.5},
    "runner": {"radius": 0.25, "speed": 3.5},
    "cyclist": {"length": 1.8, "width": 0.6, "speed": 6.0},
    "e_scooter": {"length": 1.2, "width": 0.6, "speed": 5.6},
    "motorcycle": {"length": 2.1, "width": 0.8, "speed": 14.0},
    "car": {"length": 4.5, "width": 1.8, "speed": 14.0},
    "van": {"length": 5.5, "width": 2.0, "speed": 14.0},
}
_ROUNDING = 1e-6


def beyond(kind: str, path: FloatArray, way: FloatArray, step: float, heading: float = 0.0) -> float:
    """Return by how much the worst step of a way is beyond the limits in docs/decisions.md (4), m/s² or rad."""
    velocities = np.vstack([path[1] - path[0], np.diff(way, axis=0)]) / step
    if kind in ON_FOOT:
        return float(np.hypot(*np.diff(velocities, axis=0).T).max() / step) - ON_FOOT[kind]
    up, down, aside, most, circle = WHEELED[kind]
    speed, worst = 0.0, -math.inf
    for index, (vx, vy) in enumerate(velocities.tolist()):
        after = math.hypot(vx, vy)
        if index:
            worst = max(worst, (after - speed) / step - up, (speed - after) / step - down)
        if after > 1e-9:
            turned = abs(math.remainder(math.atan2(vy, vx) - heading, math.tau))
            if index:
                worst = max(worst, turned - most, turned * after / step - aside)
                worst = max(worst, turned - after * step / circle) if circle else worst
            heading = math.atan2(vy, vx)
        speed = after
    return worst


def with_kind(scenario: Scenario, kind: str) -> Scenario:
    """Return a scenario in which the adversary is of another kind."""
    body = {"radius": None, "length": None, "width": None, **BODIES[kind]}
    return dataclasses.replace(scenario, adversary=dataclasses.replace(scenario.adversary, kind=kind, **body))


def straight(scenario: Scenario) -> list[Trajectory]:
    """Return crossings at three steady speeds that the body can go."""
    start, step = scenario.adversary.start_x, scenario.time_step
    found = []
    for share in (0.4, 0.6, 0.8):
        speed = share * scenario.adversary.speed
        x = start + speed * step * np.arange(2 + int((3.0 - start) / (speed * step)))
        found.append(Trajectory(np.column_stack([x, np.zeros_like(x)]), step, f"{speed:.1f} m/s"))
    return found


def tally(scenario: Scenario, safe: Sequence[Trajectory], count: int) -> tuple[int, int, float]:
    """Return how many of so many kamikazes are beyond their limits, how many hit, and by how much the worst is."""
    plan = Plan(scenario, objective=Objective.DEVIATION, multiplier=0.75, simulations=300)
    outside, hits, worst = 0, 0, -math.inf
    for number in range(count):
        phi = safe[number % len(safe)]
        episode: EpisodeSpec = plan.episode(Mode.KAMIKAZE, number % len(safe), number // len(safe), phi)
        log = run_episode(episode)
        excess = beyond(scenario.adversary.kind, phi.positions, log.adversary, scenario.time_step)
        outside += excess > _ROUNDING
        hits += log.outcome == Outcome.COLLISION
        worst = max(worst, excess)
    return outside, hits, worst
