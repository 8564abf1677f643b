"""Whether kamikazes that cut in hit cars that a straight cut-in misses, within what a driver can do.

In the scenario cut_in another car comes over from the next lane on a straight line, at a steady speed that is above
that of the car under test, and drives on ahead of it (φ; in five durations of the change). Against each of three brakes
of known order (cars/triggers.py), so often: first φ itself, then a kamikaze that takes the car for a basic one, of
each objective: `paper` hits as soon as it can, and to `deformation` a hit η_max and more from φ is worth nothing. The
share of hits with its 95 % interval (Wilson's), the mean deformation, misses and hits from farther away counting as
η_max, and by how much the worst step of any of them was beyond the documented limits of a car, by an oracle that shares
nothing with its model (road_user_limits.py).

Of the first attempts also what the search against the car itself finds, which knows its draws and answers: in what
share of them there is a hit within η_max at all, and their mean margin.

    .venv/bin/python benchmarks/cut_in_kamikazes.py --episodes 1000
    .venv/bin/python benchmarks/cut_in_kamikazes.py --episodes 1000 --objectives deformation --eta-max 15
"""

from __future__ import annotations

import argparse
import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from cars.triggers import TRIGGERS
from road_user_limits import beyond
from skd_evaluator.campaign.plan.plan import Plan
from skd_evaluator.campaign.run.runner import run_episode
from skd_evaluator.campaign.run.workers import InProcessRunner
from skd_evaluator.cli.arguments import whole_number
from skd_evaluator.margin.search.attempts import searched_margins
from skd_evaluator.measure.distances.deformation import deformation
from skd_evaluator.measure.statistics.statistics import wilson_interval
from skd_sim.choices.knowledge import Knowledge
from skd_sim.choices.objective import Objective
from skd_sim.controllers import control_period_of, make_controller, with_control_period
from skd_sim.encounter.scenario import Scenario, load_scenario
from skd_sim.episode.episode import EpisodeLog, Mode
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


def strayed(log: EpisodeLog) -> float:
    """Return the deformation of an attempt, m; infinity without a hit."""
    if not log.hit or log.episode.safe_trajectory is None:
        return math.inf
    ticks = log.impact_time / log.episode.scenario.time_step
    return deformation(log.episode.safe_trajectory.positions, log.trajectory.positions, ticks)


def row(
    name: str, objective: Objective, encounter: Scenario, safe: Sequence[Trajectory], arguments: argparse.Namespace
) -> str:
    """Run one car; return its line."""
    controller, episodes = TRIGGERS[name], arguments.episodes
    period = control_period_of(make_controller(controller, 1.0), controller)
    scenario = with_control_period(encounter, period, controller)
    plan = Plan(
        scenario,
        controller=controller,
        objective=objective,
        knowledge=Knowledge.NOTHING,
        simulations=arguments.simulations,
    )
    along = hits = outside = 0
    worst, needed = -math.inf, np.empty(episodes)
    planned = [plan.episode(Mode.KAMIKAZE, n % len(safe), n // len(safe), safe[n % len(safe)]) for n in range(episodes)]
    for number, episode in enumerate(planned):
        index, attempt = number % len(safe), number // len(safe)
        phi = safe[index]
        along += run_episode(plan.episode(Mode.REPLAY, index, attempt, phi)).hit
        log = run_episode(episode)
        hits += log.hit
        needed[number] = strayed(log)
        excess = beyond("car", phi.positions, log.adversary, scenario.time_step, scenario.adversary.first_heading)
        outside += excess > _ROUNDING
        worst = max(worst, excess)
    interval = wilson_interval(hits, episodes)
    low, high = (math.nan, math.nan) if interval is None else interval
    told = f"[{100 * low:.1f}, {100 * high:.1f}] %"
    mean = float(np.minimum(needed, scenario.eta_max).mean())
    said = f"{name:8}{objective:13}{along:>8}{hits / episodes:>16.1%}{told:>18}{mean:>12.3f}{outside:>16}{worst:>12.1e}"
    some = planned[: arguments.margins]
    if not some:
        return said
    with InProcessRunner(1) as runner:
        found = searched_margins(some, [[] for _ in some], runner, lambda *_told: None, limit=arguments.margin_limit)
    margins = np.array([math.inf if one.way is None else one.way.distance for one in found.results])
    first, least = np.minimum(needed[: len(some)], scenario.eta_max), np.minimum(margins, scenario.eta_max)
    possible = f"{np.isfinite(margins).mean():.0%} of {len(some)}"
    return f"{said}{possible:>16}{float(least.mean()):>10.3f}{float(first.mean()):>17.3f}"


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=whole_number(1), default=1000, metavar="N", help="of each car")
    parser.add_argument("--simulations", type=whole_number(1), default=300, metavar="N", help="for each decision")
    parser.add_argument("--objectives", nargs="+", default=["paper", "deformation"], choices=["paper", "deformation"])
    parser.add_argument("--cars", nargs="+", default=list(TRIGGERS), choices=list(TRIGGERS))
    parser.add_argument("--eta-max", type=float, metavar="M", help="η_max, m, in place of that of the encounter")
    parser.add_argument("--margins", type=whole_number(0), default=50, metavar="N", help="attempts with a margin")
    parser.add_argument("--margin-limit", type=whole_number(1), default=512, metavar="N", help="ticks for each of them")
    arguments = parser.parse_args()
    encounter = load_scenario("cut_in")
    if arguments.eta_max is not None:
        encounter = dataclasses.replace(encounter, eta_max=arguments.eta_max)
    safe = [straight(duration) for duration in DURATIONS]
    print(
        f"{'car':8}{'objective':13}{'φ hit':>8}{'kamikazes hit':>16}{'95 %':>18}{'mean (m)':>12}{'beyond limits':>16}"
        f"{'worst':>12}{'can be hit':>16}{'margin':>10}{'planned in them':>17}"
    )
    for objective in arguments.objectives:
        for name in arguments.cars:
            print(row(name, Objective(objective), encounter, safe, arguments), flush=True)


if __name__ == "__main__":
    main()
