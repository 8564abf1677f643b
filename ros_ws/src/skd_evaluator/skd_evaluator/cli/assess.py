"""`skd assess`: the Safe-Kamikaze Distance of one car."""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

from skd_adversary.safe_trajectories import is_citr
from skd_sim.controllers import make_controller
from skd_sim.episode import Episode, Mode
from skd_sim.scenario import Scenario, load_scenario
from skd_sim.trajectory import Trajectory

from skd_evaluator.assessment import Assessment, assess
from skd_evaluator.campaign import SYNTHETIC, Plan, safe_trajectories
from skd_evaluator.cli.arguments import output_path
from skd_evaluator.report.terminal import assessment_table, print_table, progress_bar
from skd_evaluator.results import ResultFolder, write_assessment
from skd_evaluator.workers import InProcessRunner, available_workers


def scenario_for(name: str | None, safe: str) -> Scenario:
    """Return the scenario asked for, or the one that goes with the safe trajectories."""
    if name is not None:
        return load_scenario(name)
    return load_scenario("citr_crossing" if safe != SYNTHETIC and is_citr(safe) else "crossing")


def plan_from(
    arguments: argparse.Namespace,
    *,
    scenario: Scenario,
    safe: str,
    multiplier: float,
    controller: str = "basic",
) -> Plan:
    """Return the plan that a command's campaign arguments ask for."""
    return Plan(
        scenario=scenario,
        controller=controller,
        multiplier=multiplier,
        safe=safe,
        safe_count=arguments.safe_count,
        kamikaze_count=arguments.kamikaze_count,
        collision_runs=arguments.collision_runs,
        seed=arguments.seed,
        simulations=arguments.simulations,
        maximum_distance=arguments.max_distance,
    )


def warm_up(plan: Plan, safe: Trajectory | None = None) -> list[Episode]:
    """Return short episodes that make every kernel of the plan compile, or load from its cache, once."""
    trajectory = safe or Trajectory([[-2.0, 0.0], [2.0, 0.0]], plan.scenario.time_step)  # type: ignore[arg-type]
    kamikaze = Episode(
        plan.scenario,
        Mode.KAMIKAZE,
        0,
        0,
        multiplier=plan.multiplier,
        safe_trajectory=trajectory,
        simulations=10,
    )
    return [Episode(plan.scenario, Mode.SAFE, 0, 0, multiplier=1.0, simulations=10), kamikaze]


def fill(folder: Path, assessment: Assessment) -> None:
    """Write everything that an assessment leaves on disk."""
    from skd_evaluator.report.pictures import save_trajectories  # slow to import, and needed only now

    write_assessment(folder, assessment)
    save_trajectories(folder / "trajectories.png", assessment)


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    begin = time.perf_counter()
    plan = plan_from(
        arguments,
        scenario=scenario_for(arguments.scenario, arguments.safe),
        safe=arguments.safe,
        multiplier=arguments.multiplier,
        controller=arguments.controller,
    )
    make_controller(plan.controller, plan.multiplier)  # so that a wrong name is said before any work
    out = ResultFolder(output_path(arguments), overwrite=arguments.overwrite)
    with InProcessRunner(arguments.workers or available_workers()) as runner:
        runner.start(warm_up(plan))
        with progress_bar() as progress:
            safe = safe_trajectories(plan, runner, progress)
            assessment = assess(plan, safe, runner, progress)
    out.write(lambda folder: fill(folder, assessment))
    result = assessment.as_dict()
    if arguments.json:
        print(json.dumps(result, indent=2, ensure_ascii=False))
    else:
        print_table(assessment_table(result))
        print(f"{time.perf_counter() - begin:.1f} s; results in {out.path}")
    if result["skd"] is None:
        print("skd assess: no kamikaze trajectory was found; SKD is not defined", file=sys.stderr)
        return 1
    return 0
