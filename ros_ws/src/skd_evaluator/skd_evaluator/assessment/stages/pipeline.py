"""From a plan to an assessment, whoever runs the episodes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from skd_adversary.warm_up import any_car_models, warm_up_episodes
from skd_sim.options.adversary import DEFAULT_OBJECTIVES, Objective
from skd_sim.options.car_under_test import is_own_world
from skd_sim.options.options import options_of
from skd_sim.world.episode import Episode
from skd_sim.world.state import Trajectory

from skd_evaluator.assessment.assessment import Assessment, rate
from skd_evaluator.assessment.options import DEFAULT_MARGIN_LIMIT, GENERATED, OF_NO_RESULT, OWN, GraphOptions
from skd_evaluator.assessment.plan import Plan, Progress, Runner, safe_trajectories
from skd_evaluator.assessment.repeatability import (
    Fresh,
    driving,
    fresh_process,
    repeatability,
    standing,
    with_simulation,
)
from skd_evaluator.assessment.run.workers import InProcessRunner, Workers
from skd_evaluator.assessment.stages.bounded_kamikazes import with_budgets
from skd_evaluator.assessment.stages.learning import learned, needs_learning
from skd_evaluator.assessment.stages.sequential import rate_until_width
from skd_evaluator.assessment.stages.static_tests import with_static_tests
from skd_evaluator.margin.assessment_margin import margins_compiled_beside, with_margins
from skd_evaluator.report.presentation import aborted_lines
from skd_evaluator.risk.assessment_risk import NOTHING_ASKED, RiskAsked, warm_up_risk, with_risks


def compile_for_graph(plan: Plan, objectives: Sequence[Objective]) -> None:
    """Compile planners into the disk cache: in its first episode the adversary's node would be silent for too long.

    Those of a basic car whose C is known, by the default objectives, that node compiles itself at its start.
    """
    modelled = bool(plan.car_model) or needs_learning(plan)
    missing = [one for one in objectives if modelled or one not in DEFAULT_OBJECTIVES]
    if missing:
        InProcessRunner(1).start(planners_of(plan, missing))


def planners_of(plan: Plan, objectives: Sequence[Objective]) -> list[Episode]:
    """Return short episodes that make the planners of a plan compile, by each of some objectives."""
    models, wanted = [plan.car_model], list(objectives)
    if needs_learning(plan):  # of whatever kind its model will be, and by the kamikazes from which it learns
        models, wanted = any_car_models(), list(dict.fromkeys([*objectives, *DEFAULT_OBJECTIVES]))
    return [
        episode
        for objective in wanted
        for model in models
        for episode in warm_up_episodes(
            plan.controller,
            objective=objective,
            car_model=model,
            dynamics=plan.scenario.car.dynamics,
        )
    ]


def learned_plan(
    plan: Plan,
    runner: Runner,
    progress: Progress,
    say: Callable[[str], None],
    graph: GraphOptions | None = None,
) -> Plan:
    """Return the plan after its adversary has learned the car, if it has to, and say what it learned; see `learned`.

    Args:
        plan: what is to be rated.
        runner: runs the episodes; it has been started.
        progress: called with how far the work is.
        say: called with one line about what was done.
        graph: how the node graph is run; None: episodes run in process.
    """
    if graph is None:
        return learned(plan, runner, progress, say=say)
    how = {one.name: getattr(graph, one.name) for one in options_of(GraphOptions) if one.name not in OF_NO_RESULT}
    return learned(plan, runner, progress, say=say, command=graph.controller_command, graph=how)


@dataclass(frozen=True)
class Runners:
    """Who runs the episodes of an assessment and computes what follows from them.

    Attributes:
        rated: runs the kamikazes and the runs along φ from which the figures follow.
        others: runs all other episodes: for safe trajectories, and kamikazes that are held to a budget.
        here: computes margins from the logs, in processes of this machine.
        ways: runs whole episodes of a car that is a node, or in another simulator than SKD's own world, for its margin;
            None: such a car has no margin.
        fresh: makes the runner that runs a sample of the episodes again; None: nobody does.
    """

    rated: Runner
    others: Runner
    here: Workers
    ways: Runner | None = None
    fresh: Fresh | None = None

    @classmethod
    def in_process(
        cls,
        runner: Workers,
        rated: Runner | None = None,
        others: Runner | None = None,
        fresh: Fresh = fresh_process,
    ) -> Runners:
        """Return the runners of an assessment in process: `runner` does all, or whoever keeps some of the episodes."""
        return cls(rated or runner, others or runner, runner, fresh=fresh)

    @classmethod
    def of_graph(cls, plan: Plan, evaluator: Runner, ways: Runner | None = None, fresh: Fresh | None = None) -> Runners:
        """Return the runners of an assessment through the node graph.

        Safe trajectories belong to the reference car, not to the one under test: no graph is needed for them. Margins
        are computed in this process: the graph's threads make it unsafe to fork.
        """
        here = InProcessRunner(1)
        return cls(evaluator, evaluator if plan.safe == OWN else here, here, ways, fresh)


@dataclass(frozen=True)
class Further:
    """What an assessment has besides the figures of its kamikazes.

    Attributes:
        margin_limit: how many ticks the search for the margin may simulate in each trial; see `with_margins`.
        curve: whether kamikazes that are held to a budget are run, for the vulnerability curve.
        risk: what is asked of the risk.
        until_width: width (m) of the interval by φ until which φ are added; None: as many as the plan says.
    """

    margin_limit: int = DEFAULT_MARGIN_LIMIT
    curve: bool = False
    until_width: float | None = None
    risk: RiskAsked = NOTHING_ASKED


def assessed(
    plan: Plan,
    objectives: Sequence[Objective],
    runners: Runners,
    progress: Progress,
    further: Further,
    safe: list[Trajectory] | None = None,
) -> Assessment:
    """Return the assessment of a plan whose adversary has nothing left to learn.

    Args:
        plan: what to assess, whatever its objective.
        objectives: the objectives of the kamikazes.
        runners: run the episodes and compute what follows; they have been started.
        progress: called with how far the work is.
        further: what the assessment has besides the figures of its kamikazes.
        safe: the safe trajectories, if they are known; else an empty list, which receives them.
    """
    safe = [] if safe is None else safe
    if further.until_width:
        rating = rate_until_width(plan, objectives, further.until_width, safe, runners.rated, progress)
    else:
        if not safe:
            safe.extend(safe_trajectories(plan, runners.others, progress))
        rating = rate(plan, objectives, safe, runners.rated, progress)
    rating = with_simulation(rating, runners.here)
    rating = with_margins(rating, runners.here, progress, further.margin_limit, runners.ways)
    rating = with_risks(rating, further.risk, runners.here, progress, runners.ways)
    rating = with_static_tests(rating, runners.others)
    if further.curve:
        rating = with_budgets(rating, runners.others, progress)
    rating = replace(rating, warnings=(*rating.warnings, *aborted_lines(rating), *_drives(rating, runners.rated)))
    return rating if runners.fresh is None else with_repeatability(rating, runners.fresh)


def _drives(rating: Assessment, runner: Runner) -> tuple[str, ...]:
    """Return, a line each, that a user's car hardly drives; of one whose episodes were all aborted there is no more."""
    plan = rating.plan
    if plan.car.is_own:
        return ()
    drives = is_own_world(plan.simulator) and len(rating.reasons) < rating.episodes
    return (*standing(plan.controller, rating.replays), *(driving(plan, runner) if drives else ()))


def with_repeatability(rating: Assessment, fresh: Fresh) -> Assessment:
    """Return the rating with a warning if a user's car does not repeat itself in a sample of its episodes.

    Args:
        rating: the rating, whose episodes have been run.
        fresh: makes the runner that runs the sample again.
    """
    if rating.plan.car.is_own:
        return rating
    found = repeatability(rating.plan.controller, [*rating.kamikaze_logs, *rating.replays], fresh)
    return replace(rating, warnings=(*rating.warnings, *found))


def assess_in_process(
    plan: Plan,
    objectives: Sequence[Objective],
    runners: Runners,
    progress: Progress,
    further: Further,
    origin: Callable[[Plan], Mapping[str, Any]],
    say: Callable[[str], None] = lambda _line: None,
    safe: list[Trajectory] | None = None,
) -> Assessment:
    """Return the assessment of a plan in process, from the first warm-up to the last figure; see `assessed`.

    Of `runners` all lead to `here`, which is started and ended. Once there is nothing left to learn, as `say` is told
    in one line, `origin` says where the assessment of the plan comes from.
    """
    safe, runner = [] if safe is None else safe, runners.here
    if not is_own_world(plan.simulator):  # whose cars are led by whole episodes
        runners = replace(runners, ways=runner)
    with runner:
        # Recorded ones are read first: bad input is said before anything is compiled.
        if plan.safe not in GENERATED and not further.until_width:
            safe.extend(safe_trajectories(plan, runner))
        with margins_compiled_beside(wanted=further.margin_limit > 0) as load_margins:
            if further.risk.behaviour is not None:
                warm_up_risk(plan)
            runner.start(planners_of(plan, objectives), inherited=load_margins)
        plan = learned_plan(plan, runner, progress, say)
        known = origin(plan)
        rating = assessed(plan, objectives, runners, progress, further, safe)
        return replace(rating, provenance=known)
