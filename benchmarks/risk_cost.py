"""What the risk costs an assessment: wall-clock and processor time of R(1), R(2) and R(3), by car.

By default 20 synthetic φ and as many crossings as `skd assess` runs, once everything is compiled.

    PYTHONPATH=benchmarks python benchmarks/risk_cost.py [CONTROLLER ...] [--multiplier 1.5] [--workers 2]
"""

from __future__ import annotations

import argparse
import resource
import time
from dataclasses import replace

from skd_evaluator.campaign.judge.rating import rate
from skd_evaluator.campaign.plan.plan import Plan, safe_trajectories
from skd_evaluator.campaign.run.workers import InProcessRunner, available_workers, check_controller
from skd_evaluator.risk.asked import risk_asked
from skd_evaluator.risk.assessment_risk import warm_up_risk, with_risks
from skd_sim.choices.car_under_test import CarUnderTest
from skd_sim.choices.objective import Objective
from skd_sim.encounter.scenario import load_scenario


def processor_time() -> float:
    """Return that of this process and of those that it has waited for, s."""
    found = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in found)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("controller", nargs="*", default=["basic", "carla", "cal", "cars.idm:IntelligentDriver"])
    parser.add_argument("--multiplier", type=float, default=1.5)
    parser.add_argument("--workers", type=int, default=available_workers())
    arguments = parser.parse_args()
    plan = Plan(load_scenario("crossing"), safe_count=20, kamikaze_count=1, simulations=20)
    safe = safe_trajectories(plan, InProcessRunner(1))
    asked = risk_asked("walkers")
    for controller in arguments.controller:
        car = CarUnderTest(controller, arguments.multiplier if controller == "basic" else 1.0)
        scenario = check_controller(car, plan.scenario)
        mine = replace(plan, controller=controller, multiplier=car.multiplier, scenario=scenario, knowledge=None)
        warm_up_risk(mine)
        # Nobody plans: the risk needs the rating's φ alone.
        few = replace(mine, collision_runs=1)
        with InProcessRunner(arguments.workers, isolated=not car.is_own) as runner:
            runner.start()
            rating = rate(few, [Objective.PAPER], safe, runner, lambda *_told: None)
            rating = replace(rating, assessments=tuple(replace(one, plan=mine) for one in rating.assessments))
            list(runner.map(abs, range(arguments.workers)))
            wall, used = time.perf_counter(), processor_time()
            found = with_risks(rating, asked, runner, lambda *_told: None)
            wall = time.perf_counter() - wall
        used = processor_time() - used
        if found.risks is None:
            print(f"{controller}: {found.risk_note}")
            continue
        scales = "; ".join(f"R({one.scale:g}) = {one.value:.2g}, {one.episodes}" for one in found.risks.scales)
        print(f"{car.label}: {wall:.1f} s, {used:.1f} s of processor time; crossings: {scales}", flush=True)


if __name__ == "__main__":
    main()
