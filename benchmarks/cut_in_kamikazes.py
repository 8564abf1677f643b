"""Whether kamikazes that cut in hit cars that a straight cut-in misses, within what a driver can do.

In the scenario cut_in another car comes over from the next lane on a straight line, at a steady speed that is above
that of the car under test, and drives on ahead of it (φ; in five durations of the change). Against each of three brakes
of known order (cars/triggers.py), so often: first φ itself, then a kamikaze that takes the car for a basic one, of
each objective: `paper` hits as soon as it can, and to `deformation` a hit 5 m and more from φ is worth nothing. The
share of hits with its 95 % interval (Wilson's), and by how much the worst step of any of them was beyond the documented
limits of a car, by an oracle that shares nothing with its model (road_user_limits.py).

    .venv/bin/python benchmarks/cut_in_kamikazes.py --episodes 1000
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence

import numpy as np
from cars.triggers import TRIGGERS
from road_user_limits import beyond
from skd_evaluator.campaign.plan.plan import Plan
from skd_evaluator.campaign.run.runner import run_episode
from skd_evaluator.cli.arguments import whole_number
from skd_evaluator.measure.statistics.statistics import wilson_interval
from skd_sim.choices.knowledge import Knowledge
from skd_sim.choices.objective import Objective
from skd_sim.controllers import control_period_of, make_controller, with_control_period
from skd_sim.encounter.scenario import load_scenario
from skd_sim.episode.episode import Mode
from skd_sim.geometry.trajectory import Trajectory

DURATIONS = (2.1, 2.4, 3.0, 3.6, 4.2)  # s of the change of lane
PACE = 9.0  # m/s; the car drives at 8.3
_ROUNDING = 1e-6


def straight(duration: float) -> Trajectory:
    """Return who changes over on a straight line within so many seconds, and goes on in the middle of the lane."""
    scenario = load_scenario("cut_in")
    start, step = scenario.adversary, scenario.time_step
    times = step * np.arange(scenario.ticks + 1)
    aside = start.start_x / duration  # m/s
    x = start.start_x - aside * np.minimum(times, duration)
    forward = np.where(times[1:] <= duration + 1e-9, math.sqrt(PACE**2 - aside**2), PACE)
    y = start.start_y + np.concatenate([[0.0], np.cumsum(step * forward)])
    return Trajectory(np.column_stack([x, y]), step, f"{duration:g} s")


def row(name: str, objective: Objective, safe: Sequence[Trajectory], episodes: int, simulations: int) -> str:
    """Run one car; return its line."""
    controller = TRIGGERS[name]
    period = control_period_of(make_controller(controller, 1.0), controller)
    scenario = with_control_period(load_scenario("cut_in"), period, controller)
    plan = Plan(
        scenario, controller=controller, objective=objective, knowledge=Knowledge.NOTHING, simulations=simulations
    )
    along = hits = outside = 0
    worst = -math.inf
    for number in range(episodes):
        index, attempt = number % len(safe), number // len(safe)
        phi = safe[index]
        along += run_episode(plan.episode(Mode.REPLAY, index, attempt, phi)).hit
        log = run_episode(plan.episode(Mode.KAMIKAZE, index, attempt, phi))
        hits += log.hit
        excess = beyond("car", phi.positions, log.adversary, scenario.time_step, scenario.adversary.first_heading)
        outside += excess > _ROUNDING
        worst = max(worst, excess)
    interval = wilson_interval(hits, episodes)
    low, high = (math.nan, math.nan) if interval is None else interval
    told = f"[{100 * low:.1f}, {100 * high:.1f}] %"
    return f"{name:8}{objective:13}{along:>8}{hits / episodes:>16.1%}{told:>18}{outside:>16}{worst:>12.1e}"


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=whole_number(1), default=1000, metavar="N", help="of each car")
    parser.add_argument("--simulations", type=whole_number(1), default=300, metavar="N", help="for each decision")
    parser.add_argument("--objectives", nargs="+", default=["paper", "deformation"], choices=["paper", "deformation"])
    arguments = parser.parse_args()
    safe = [straight(duration) for duration in DURATIONS]
    print(f"{'car':8}{'objective':13}{'φ hit':>8}{'kamikazes hit':>16}{'95 %':>18}{'beyond limits':>16}{'worst':>12}")
    for objective in arguments.objectives:
        for name in TRIGGERS:
            print(row(name, Objective(objective), safe, arguments.episodes, arguments.simulations), flush=True)


if __name__ == "__main__":
    main()
