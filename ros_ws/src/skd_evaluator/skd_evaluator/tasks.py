"""What the command line and the evaluator's own process do alike: scenario, episodes through the graph, results."""

from __future__ import annotations

import datetime
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NoReturn, Protocol

from skd_adversary.car_model_file import car_model_for_scenario
from skd_adversary.safe_trajectories import is_citr
from skd_adversary.warm_up import any_car_models, warm_up_episodes
from skd_sim.aborts import counted_reasons
from skd_sim.car_under_test import CarUnderTest
from skd_sim.dynamics.limits import command_limits
from skd_sim.encounter.scenario import Scenario, check_control_period, load_scenario
from skd_sim.episode import Episode, EpisodeLog, Outcome
from skd_sim.errors import UsageError
from skd_sim.knowledge import Knowledge, check_knowledge, default_knowledge
from skd_sim.objective import DEFAULT_OBJECTIVES, Objective, objectives_named
from skd_sim.options import options_of, values_of
from skd_sim.simulator_registry import is_own_world

from skd_evaluator.campaign.assessment import Assessment
from skd_evaluator.campaign.options import DEFAULT_MARGIN_LIMIT, OWN, SYNTHETIC, CampaignOptions
from skd_evaluator.campaign.plan import EpisodeRunner, Plan, Progress, safe_trajectories
from skd_evaluator.campaign.rating import Rating, hit_too_often, rate
from skd_evaluator.campaign.results import ResultFolder, episode_summary, write_assessment, write_json
from skd_evaluator.campaign.workers import InProcessRunner, check_controller
from skd_evaluator.learning.lesson import learned, needs_learning
from skd_evaluator.margin.assessment_margin import with_margins
from skd_evaluator.report.doubts import margin_doubts
from skd_evaluator.ros.options import GraphOptions


class GraphEvaluator(EpisodeRunner, Protocol):
    """The evaluator node, without anything of ROS in its type."""

    def publish_assessment(self, rating: Rating) -> None:
        """Tell the graph."""


def scenario_for(name: str | None, safe: str) -> Scenario:
    """Return the scenario asked for, or the one that goes with the safe trajectories."""
    if name:
        return load_scenario(name)
    return load_scenario("citr_crossing" if safe not in (SYNTHETIC, OWN) and is_citr(safe) else "crossing")


def with_asked_period(scenario: Scenario, period: float | None) -> Scenario:
    """Return a scenario in which the car decides as often as asked for (s), if that is asked for at all.

    Raises:
        UsageError: the period does not divide the scenario's time step.
    """
    if period is None:
        return scenario
    changed = replace(scenario, control_period=period)
    check_control_period(changed, f"--control-period in scenario {scenario.name}")
    return changed


def check_car(values: Mapping[str, Any], scenario: Scenario, *, graph: bool) -> Scenario:
    """Refuse, before any work, a controller that does not exist, or options or a scenario that do not go with it.

    Args:
        values: of the options of an episode and of the graph, as the command line has them.
        scenario: of the test.
        graph: whether episodes run through the node graph.

    Returns:
        The scenario with the control period that the controller declares, or that is asked for, if so.
    """
    if not graph:
        for one in options_of(GraphOptions):
            if one.graph_only and values[one.name] != one.unsaid:
                raise UsageError(f"--{one.name.replace('_', '-')} is for the node graph: add --graph")
    car = CarUnderTest(values["controller"], values["multiplier"])
    if not car.has_multiplier and car.multiplier != CarUnderTest.multiplier:
        raise UsageError(f"--multiplier is C of the basic controller; {car.controller} has none")
    if not car.is_external:
        scenario = check_controller(car, scenario)
        for one in options_of(GraphOptions):
            if one.external_only and values[one.name] != one.unsaid:
                raise UsageError(f"--{one.name.replace('_', '-')} goes with --controller external")
    elif not graph:
        raise UsageError("--controller external needs the node graph: add --graph")
    else:
        scenario = with_asked_period(scenario, values["control_period"])
    if graph:
        GraphOptions(**values_of(GraphOptions, values)).check(car)
    _check_itself(values, graph=graph)
    return scenario


def _check_itself(values: Mapping[str, Any], *, graph: bool) -> None:
    """Refuse an adversary that plans with copies of the car where there is none to copy; and its options without it."""
    if values.get("knowledge") == Knowledge.ITSELF:
        if graph:
            _refuse_copies()
        if not is_own_world(values["simulator"]):
            raise UsageError(f"--knowledge {Knowledge.ITSELF} needs SKD's own world: leave out --simulator")
        return
    for name in ("told", "controller_calls"):
        if values.get(name):
            raise UsageError(f"--{name.replace('_', '-')} goes with --knowledge {Knowledge.ITSELF}")


def _refuse_copies() -> NoReturn:
    raise UsageError(
        f"knowledge {Knowledge.ITSELF} needs a car that runs in process, for a node cannot be copied: use "
        f"{Knowledge.LEARNED}"
    )


def plan_of(values: Mapping[str, Any], scenario: Scenario, **fixed: Any) -> Plan:
    """Return the plan that options of the command line or parameters of the node ask for, of their last objective.

    Args:
        values: by name of the option; others are passed over.
        scenario: of the test.
        fixed: options that the command decides for itself.
    """
    plain = {**values, **fixed}
    plain["objective"] = objectives_named(plain["objective"])[-1]
    controller = plain.get("controller", CampaignOptions.controller)  # a sweep has basic cars only
    car, model = CarUnderTest(controller, plain["multiplier"]), bool(plain["car_model"])
    asked = plain.get("knowledge")
    known = Knowledge(asked) if asked else Knowledge.LEARNED if model else default_knowledge(car)
    check_knowledge(known, car, model=model)
    plain["knowledge"] = str(known)
    if model:
        plain["car_model"] = car_model_for_scenario(Path(plain["car_model"]).expanduser(), scenario)
    return Plan(scenario, **values_of(CampaignOptions, plain))


def default_folder(task: str) -> Path:
    """Return a new folder named for the task and the time."""
    stamp = datetime.datetime.now().strftime("%Y%m%d-%H%M%S-%f")[:-3]
    return Path("skd_results") / f"{task}-{stamp}"


def compile_for_graph(plan: Plan, objectives: Sequence[Objective]) -> None:
    """Compile planners into the disk cache: in its first episode the adversary's node would be silent for too long.

    Those of a basic car whose C is known, by the default objectives, that node compiles itself at its start.
    """
    if plan.knows == Knowledge.ITSELF:
        _refuse_copies()
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
    runner: EpisodeRunner,
    progress: Progress,
    say: Callable[[str], None],
    graph: GraphOptions | None = None,
) -> Plan:
    """Return a plan whose adversary knows of the car what it is to know, and say what was learned; see `learned`.

    Args:
        plan: what is to be rated.
        runner: of the episodes; started.
        progress: told how far it is.
        say: told what was done, in one line.
        graph: how the node graph is run; None: episodes run in process.
    """
    how = None
    if graph is not None:
        how = {one.name: getattr(graph, one.name) for one in options_of(GraphOptions) if one.name != "graphs"}
    command = None if graph is None else graph.controller_command
    return learned(plan, runner, progress, say=say, command=command, graph=how)


def graph_rating(
    plan: Plan,
    objectives: Sequence[Objective],
    evaluator: GraphEvaluator,
    progress: Progress,
    *,
    lockstep: bool,
    margin_limit: int = DEFAULT_MARGIN_LIMIT,
    way_runner: EpisodeRunner | None = None,
) -> Rating:
    """Run a plan through the graph, judge it and publish the assessment; what there is to learn has been learned.

    Args:
        plan: what to assess, whatever its objective.
        objectives: of the kamikazes.
        evaluator: runs the episodes.
        progress: told how far it is.
        lockstep: whether the graph's nodes wait for one another: only then ways can be walked again.
        margin_limit: as in `with_margins`.
        way_runner: runs the ways that are tried for the margin; by default the evaluator.
    """
    # Safe trajectories belong to the reference car, not to the one under test: no graph is needed for them.
    safe = safe_trajectories(plan, evaluator if plan.safe == OWN else InProcessRunner(1), progress)
    rating = rate(plan, objectives, safe, evaluator, progress)
    # In this process: the graph's threads make it unsafe to fork.
    rating = with_margins(
        rating, InProcessRunner(1), progress, margin_limit, (way_runner or evaluator) if lockstep else None
    )
    evaluator.publish_assessment(rating)
    return rating


def fill(folder: Path, rating: Rating) -> None:
    """Write everything that an assessment leaves on disk."""
    from skd_evaluator.report.pictures import save_trajectories  # slow to import, and needed only now

    write_assessment(folder, rating)
    for name, assessment in picture_names(rating).items():
        save_trajectories(folder / name, rating, assessment)
    if rating.vulnerability is not None:
        from skd_evaluator.report.vulnerability import save_vulnerability, shown_curve

        save_vulnerability(folder / "vulnerability.png", [shown_curve(rating.as_dict())])


def picture_names(rating: Rating) -> dict[str, Assessment]:
    """Return the file of each picture of trajectories: `trajectories.png` is of the kamikazes that rank the car."""
    first = rating.for_deformation
    others = [one for one in rating.assessments if one is not first]
    return {"trajectories.png": first, **{f"trajectories_{one.plan.objective}.png": one for one in others}}


def fill_episode(folder: Path, log: EpisodeLog) -> None:
    """Write what a single episode leaves on disk beside its bag."""
    write_json(folder / "episode.json", episode_summary(log))


def save_with_scratch(out: ResultFolder, scratch: Path, write: Callable[[Path], None]) -> str | None:
    """As `write_with_scratch`, but return why it failed; see `ResultFolder.save`."""
    return out.save(partial(_write_all, scratch, write))


def write_with_scratch(out: ResultFolder, scratch: Path, write: Callable[[Path], None]) -> None:
    """Write results, and beside them what has been gathered in `scratch`: bags and logs."""
    out.write(partial(_write_all, scratch, write))


def _write_all(scratch: Path, write: Callable[[Path], None], folder: Path) -> None:
    write(folder)
    for part in scratch.iterdir():
        if any(part.iterdir()):
            part.rename(folder / part.name)


def undefined(rating: Rating) -> str | None:
    """Return why SKD is not defined, in one line; none where it is."""
    assessment = rating.for_skd
    if assessment.skd.skd is not None:
        return None
    discarded = assessment.skd.discarded_by_distance
    why = f"all {discarded} are further than the maximum distance" if discarded else "no kamikaze trajectory was found"
    if assessment.reasons and not assessment.attempts:
        why = f"every kamikaze episode was aborted ({most_frequent(assessment.reasons)})"
    elif not discarded and any(kamikaze.aborted for kamikaze in assessment.kamikaze):
        aborted = sum(kamikaze.aborted for kamikaze in assessment.kamikaze)
        why = f"{why}, and {aborted} of {assessment.attempts + aborted} kamikaze episodes were aborted"
    return f"{why}; SKD is not defined"


def most_frequent(reasons: Iterable[str]) -> str:
    """Return the first reason of the most frequent kind."""
    kind, most = next(iter(counted_reasons(reasons).items()))
    return str(most["first"] or kind)


def doubts(rating: Rating, *, planned: bool = True) -> list[str]:
    """Return what a reader should know before believing the figures, in one line each.

    Args:
        rating: with the figures.
        planned: whether how close its kamikazes came belongs to it; in a sweep of one adversary it is a column.
    """
    found = []
    for trajectory, (hits, runs) in zip(rating.safe, rating.hits(), strict=True):
        if hit_too_often(hits, runs):
            found.append(
                f"safe trajectory {trajectory.name!r} was hit in {100 * hits / runs:.0f} % of {runs} runs along it: "
                "with this car it is not safe, and a kamikaze need not leave it"
            )
    found += _doubts_of_margin(rating) if planned else []
    if rating.until_width is not None and not rating.until_width.reached:
        found.append(rating.until_width.text)
    if rating.clipped:
        low, high = command_limits(rating.plan.scenario)
        found.append(
            f"{sum(rating.clipped)} commands in {len(rating.clipped)} episodes asked more than this car can "
            f"do; they were clipped to {low:.3g} … {high:.3g} m/s²"
        )
    return found


def _doubts_of_margin(rating: Rating) -> list[str]:
    """Return what is to be known of the margin, and of what was planned beside it, in one line each."""
    margins = rating.margins
    if margins is None:
        return []
    touched = sum(log.outcome == Outcome.COLLISION for log in rating.kamikaze_logs)
    hit = sum(log.hit for log in rating.kamikaze_logs) + rating.hit_runs
    close, _ = rating.closeness()
    scenario = rating.plan.scenario.as_dict()
    return margin_doubts({**margins.figures(), "closeness": close, "scenario": scenario}, touched, hit)


def too_many_aborted(rating: Rating, maximum: float) -> str | None:
    """Return, in one line, that more episodes were aborted than may be; none where not.

    Args:
        rating: of all episodes.
        maximum: share of them.
    """
    reasons = rating.reasons
    if not reasons or len(reasons) <= maximum * rating.episodes:
        return None
    most = next(iter(counted_reasons(reasons).values()))
    return (
        f"{len(reasons)} of {rating.episodes} episodes were aborted, more than --max-aborted {100 * maximum:g} %; "
        f"{most['count']} of them: {most_frequent(reasons)}"
    )


def episode_line(log: EpisodeLog) -> str:
    """Return how an episode ended, in a few words."""
    impact = ""
    if log.outcome == Outcome.COLLISION:
        impact = f" after {log.impact_time:.2f} s at {log.impact_speed:.2f} m/s"
    return f"{log.outcome.name.lower()}{impact}; {len(log.adversary) - 1} ticks"
