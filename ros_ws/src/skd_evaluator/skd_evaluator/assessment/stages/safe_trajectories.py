"""Safe trajectories φ: recorded, or made by people who cross before the reference car without being hit."""

from __future__ import annotations

import contextlib
from dataclasses import replace

import numpy as np
from skd_adversary.crossing.objectives import REFERENCE_MULTIPLIER
from skd_adversary.safe_trajectories.sources import load_safe_trajectories
from skd_sim.errors import AssessmentError, UsageError
from skd_sim.scenario.scenario import Scenario, check_trajectory
from skd_sim.world.episode import EpisodeSpec, Mode, Outcome, Role, generator
from skd_sim.world.state import Trajectory

from skd_evaluator.assessment.assessment import Assessment
from skd_evaluator.assessment.context import Context, Progress, Runner, run_episodes, silent, stage
from skd_evaluator.assessment.options import GENERATED, OWN, WALKERS
from skd_evaluator.assessment.plan import EpisodeGroup, Plan, episode_id
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.metrics.behaviour.model import load_behaviour, normals_of, walked

TRIALS_PER_REQUESTED = 20
"""Cap on episodes per requested φ."""
SIMULATIONS = 2000


@stage(30)
def run(context: Context, assessment: Assessment) -> Assessment:
    """Return the assessment with its φ, unless they are known already."""
    if assessment.safe:
        return assessment
    plan = assessment.plan
    # All but those of source `own` are of the reference car, which no graph runs.
    runner = context.runner if plan.safe == OWN else context.workers
    return replace(assessment, safe=tuple(safe_trajectories(plan, runner, context.progress)))


def safe_trajectories(plan: Plan, runner: Runner, progress: Progress = silent) -> list[Trajectory]:
    """Return Φ: recorded, or generated, by the safe POMDP or a behaviour model, before the reference or the plan's car.

    Raises:
        UsageError: the source has too few, or too few generated episodes arrived.
        AssessmentError: most generated episodes were aborted.
    """
    if plan.safe not in GENERATED:
        return load_safe_trajectories(plan.safe, plan.scenario, plan.safe_count)
    found: list[Trajectory] = []
    trial = 0
    reasons: list[str] = []
    while len(found) < plan.safe_count:
        if trial >= TRIALS_PER_REQUESTED * plan.safe_count:
            if 2 * len(reasons) > trial:
                lost = f"{len(reasons)} of {trial} safe episodes were aborted"
                raise AssessmentError(f"{lost}, the last one so: {reasons[-1]}")
            found_few = f"only {len(found)} of {plan.safe_count} safe trajectories arrived in {trial} episodes"
            raise UsageError(f"{found_few}: is the destination of {plan.scenario.name} within its horizon?")
        missing = plan.safe_count - len(found)
        episodes = [_safe_episode(plan, episode_id(EpisodeGroup.SAFE, 0, trial + i)) for i in range(missing)]
        for log in run_episodes(runner, episodes, "safe trajectories", progress, len(found), plan.safe_count):
            if log.outcome == Outcome.ARRIVED and (plan.safe != WALKERS or _crosses(plan.scenario, log.trajectory)):
                found.append(replace(log.trajectory, name=f"{plan.safe}/{trial}"))
            elif log.outcome == Outcome.ABORTED:
                reasons.append(log.reason)
            trial += 1
    return found


def _safe_episode(plan: Plan, number: int) -> EpisodeSpec:
    """Return an episode, by its id, that makes a safe trajectory if it arrives unharmed."""
    # The reference car decides once a tick, whatever the car under test does: φ are the same for all cars.
    reference = EpisodeSpec(
        replace(plan.scenario, control_period=None),
        Mode.SAFE,
        plan.seed,
        number,
        multiplier=REFERENCE_MULTIPLIER,
        simulations=SIMULATIONS,
    )
    if plan.safe == WALKERS:
        return replace(reference, mode=Mode.REPLAY, safe_trajectory=_walker(plan.scenario, plan.seed, number))
    if plan.safe == OWN:
        return replace(
            reference,
            scenario=plan.scenario,
            controller=plan.controller,
            multiplier=plan.multiplier,
            car_model=plan.car_model,
            adversary_model=plan.adversary_model,
            simulator=plan.simulator,
        )
    return reference


def _walker(scenario: Scenario, seed: int, number: int) -> Trajectory:
    """Return how a person walks who means to go straight across, by the behaviour model, until arrival or horizon."""
    adversary, ticks, step = scenario.adversary, scenario.ticks, scenario.time_step
    along = step * np.arange(ticks + 1)[:, None] * np.array([scenario.end.crossing * adversary.speed, 0.0])
    normals = generator(seed, number, Role.WALKER).standard_normal(normals_of(ticks))
    intended = np.array([adversary.start_x, adversary.start_y]) + along
    track = walked(intended, load_behaviour(WALKERS).values, normals, 1.0, step)
    arrived = next((tick for tick, (x, y) in enumerate(track.tolist()) if scenario.end.arrived(x, y)), ticks)
    return Trajectory(track[: arrived + 1], step)


def _crosses(scenario: Scenario, track: Trajectory) -> bool:
    """Tell whether a way leads from elsewhere to the destination, and into no obstacle."""
    first, last = (scenario.end.arrived(*place) for place in track.positions[[0, -1]].tolist())
    with contextlib.suppress(UsageError):
        check_trajectory(scenario, track)
        return last and not first
    return False


def single_episode(
    plan: Plan, mode: Mode, trial: int, safe: Trajectory | None = None, safe_number: int = 0
) -> EpisodeSpec:
    """Return one episode of a plan, the same that a campaign would run.

    Args:
        plan: plan of the assessment.
        mode: what the adversary does.
        trial: number of the trial within its stage and φ.
        safe: φ, if it is known already; only modes kamikaze and replay need it.
        safe_number: number of φ among those of the plan, counted from 0; of no meaning in safe mode.
    """
    if mode == Mode.SAFE:
        return plan.episode(mode, 0, trial, None)
    if safe is None:
        safe = safe_trajectories(plan, InProcessRunner(1))[safe_number]
    return plan.episode(mode, safe_number, trial, safe)
