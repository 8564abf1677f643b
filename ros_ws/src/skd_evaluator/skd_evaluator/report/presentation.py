"""What is said and written of an assessment or an episode: warnings, failures, a line that sums it up, files."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from skd_sim.world.dynamics.basic import clipped_line, command_limits
from skd_sim.world.episode import EpisodeLog, Outcome, counted_reasons

from skd_evaluator.assessment.assessment import Assessment, hit_too_often
from skd_evaluator.assessment.episode_figures import collision_partner, simulator_contacts
from skd_evaluator.assessment.figure_table import Of, figures_of
from skd_evaluator.assessment.files.result_folder import ResultFolder, write_json
from skd_evaluator.assessment.files.results import episode_summary, write_assessment
from skd_evaluator.assessment.objective_result import ObjectiveResult
from skd_evaluator.assessment.run.workers import available_workers, in_background
from skd_evaluator.metrics import aborted
from skd_evaluator.metrics.aborted import NOT_CREDIBLE, not_credible
from skd_evaluator.metrics.risks import Touch
from skd_evaluator.report.formats import contact_warnings, margin_warnings


def undefined(assessment: Assessment) -> str | None:
    """Return why SKD is not defined, in one line; None if it is."""
    result = assessment.for_skd
    if result.skd.distances.mean is not None:
        return None
    discarded = result.skd.discarded
    why = f"all {discarded} are further than the maximum distance" if discarded else "no kamikaze trajectory was found"
    if result.reasons and not result.trials:
        why = f"every kamikaze episode was aborted ({most_frequent(result.reasons)})"
    elif not discarded and any(kamikaze.aborted for kamikaze in result.kamikaze):
        lost = sum(kamikaze.aborted for kamikaze in result.kamikaze)
        why = f"{why}, and {lost} of {result.trials + lost} kamikaze episodes were aborted"
    return f"{why}; SKD is not defined"


def most_frequent(reasons: Iterable[str]) -> str:
    """Return the first reason of the most frequent kind."""
    kind, most = next(iter(counted_reasons(reasons).items()))
    return str(most["first"] or kind)


def figure_warnings(assessment: Assessment, *, planned: bool = True) -> list[str]:
    """Return what a reader should know before believing the figures, in one line each.

    Args:
        assessment: the assessment with its figures.
        planned: whether optimality gap is among the warnings; a table that has it as a column needs none.
    """
    nothing = undefined(assessment) if assessment.margins is not None else None
    found = [nothing] if nothing else []
    for trajectory, (hits, runs) in zip(assessment.safe, assessment.hits(), strict=True):
        if hit_too_often(hits, runs):
            found.append(
                f"safe trajectory {trajectory.name!r} was hit in {100 * hits / runs:.0f} % of {runs} runs along it: "
                "with this car it is not safe, and a kamikaze need not leave it"
            )
    found += _hits_of_others(assessment)
    found += _warnings_of_margin(assessment) if planned else []
    if assessment.until_width is not None and not assessment.until_width.reached:
        found.append(assessment.until_width.text)
    if assessment.clipped:
        low, high = _limits(assessment)
        found.append(clipped_line(assessment.clipped, low, high))
    return found + contact_warnings({"simulator_contacts": simulator_contacts(assessment.logs)})


def _limits(assessment: Assessment) -> tuple[float, float]:
    """Return the least and the greatest acceleration of the car, as its simulator says, or as in SKD's world; m/s²."""
    said = (assessment.simulation or {}).get("limits")
    low, high = command_limits(assessment.plan.scenario) if said is None else said
    return float(low), float(high)


def _hits_of_others(assessment: Assessment) -> list[str]:
    """Return how often the car ran into others than the adversary, which counts as any collision, in a line each."""
    others = assessment.plan.scenario.others
    logs = [*assessment.kamikaze_logs, *assessment.nominal_runs] if others else []
    who = [collision_partner(log) for log in logs]
    return [
        f"in {who.count(index)} of {len(logs)} episodes the car ran into others[{index}], a {other.kind}, and not into "
        "the adversary; that counts as any collision"
        for index, other in enumerate(others)
        if index in who
    ]


def _warnings_of_margin(assessment: Assessment) -> list[str]:
    """Return what a reader should know of the margin and of the planned figures, in one line each."""
    margins = assessment.margins
    if margins is None:
        return []
    touched = sum(log.outcome == Outcome.COLLISION for log in assessment.kamikaze_logs)
    hit = sum(log.hit for log in assessment.logs)
    close, _ = assessment.optimality_gap()
    figures_of_margin = figures_of(Of.MARGIN, margins)
    scenario = assessment.plan.scenario.as_dict()
    return margin_warnings({**figures_of_margin, "optimality_gap": close, "scenario": scenario}, touched, hit)


def any_aborted(assessment: Assessment) -> bool:
    """Whether any episode was aborted of which a figure is."""
    scales = () if assessment.risks is None else assessment.risks.scales
    return (
        bool(assessment.reasons)
        or any(one.lost or one.number_of(Touch.ABORTED) for one in scales)
        or any(point.aborted for point in assessment.budgets)
    )


def aborted_lines(assessment: Assessment) -> list[str]:
    """Return, a line each, how many episodes of each figure were aborted, and what it would be at worst."""
    return aborted.aborted_lines(assessment.as_dict()) if any_aborted(assessment) else []


def too_many_aborted(assessment: Assessment, maximum: float, figures: Mapping[str, Any] | None = None) -> str | None:
    """Return, in one line, of which figure more episodes were aborted than may be; None if that is not so.

    Args:
        assessment: the assessment of all episodes, aborted ones counted.
        maximum: share of the episodes that may be aborted.
        figures: content of its assessment.json, of one that was made anew from its episodes, which are not all.
    """
    if figures is None and not any_aborted(assessment):
        return None
    return aborted.too_many_aborted(figures or assessment.as_dict(), maximum)


def why_failed(assessment: Assessment, maximum_aborted: float, figures: Mapping[str, Any] | None = None) -> list[str]:
    """Return why an assessment counts as failed, a line each; empty if it does not.

    That SKD is not defined is no reason where the margin is known.

    Args:
        assessment: the assessment of all episodes, aborted ones counted.
        maximum_aborted: share of the episodes that may be aborted, of all and of those of each figure.
        figures: see `too_many_aborted`.
    """
    too_many = too_many_aborted(assessment, maximum_aborted, figures)
    nothing = undefined(assessment) if assessment.margins is None else None
    return [why for why in (nothing, too_many, *not_credible(assessment.warnings)) if why]


def with_failures(assessment: Assessment, maximum_aborted: float) -> Assessment:
    """Return the assessment with why it counts as failed among its warnings, for who sees no exit code.

    That SKD is not defined makes no margin less credible.

    Args:
        assessment: the assessment of all episodes, aborted ones counted.
        maximum_aborted: share of the episodes that may be aborted, of all and of those of each figure.
    """
    too_many = too_many_aborted(assessment, maximum_aborted)
    found = [undefined(assessment), f"{NOT_CREDIBLE}{too_many}" if too_many else None]
    return replace(assessment, warnings=(*assessment.warnings, *(line for line in found if line)))


def warnings_of(assessment: Assessment, *, planned: bool = True, said: Collection[str] = ()) -> list[str]:
    """Return what a reader should know that is no failure, a line each.

    Args:
        assessment: the assessment with its figures.
        planned: see `figure_warnings`.
        said: lines that the reader was told already.
    """
    failures = not_credible(assessment.warnings)
    of_episodes = [line for line in assessment.warnings if line not in failures and line not in said]
    return [*of_episodes, *figure_warnings(assessment, planned=planned)]


def episode_line(log: EpisodeLog) -> str:
    """Return how an episode ended, in a few words."""
    impact = ""
    if log.outcome == Outcome.COLLISION:
        impact = f" after {log.impact_time:.2f} s at {log.impact_speed:.2f} m/s"
    return f"{log.outcome.name.lower()}{impact}; {len(log.adversary) - 1} ticks"


def fill(folder: Path, assessment: Assessment, *, may_fork: bool = False) -> None:
    """Write everything that an assessment leaves on disk.

    Args:
        folder: folder that is filled.
        assessment: assessment of the car.
        may_fork: whether another process may draw some of the pictures: not where other threads run, as those of ROS 2.
    """
    from skd_evaluator.report.pictures import save_trajectories  # slow to import, and needed only now

    def draw() -> None:
        for name, part in picture_names(assessment).items():
            save_trajectories(folder / name, assessment, part)

    with ExitStack() as stack:
        forks = may_fork and available_workers() > 1
        drawn = stack.enter_context(in_background(draw)) if forks else lambda: False
        write_assessment(folder, assessment)
        if assessment.vulnerability is not None:  # in this process: one forked from a user of Vega waits for ever
            from skd_evaluator.report.charts import ChartedCar, save_vulnerability

            figures = assessment.as_dict()
            car = ChartedCar(str(figures["car"]), figures, curves=figures["vulnerability_curve"])
            save_vulnerability(folder / "vulnerability.png", [car])
        if not drawn():
            draw()


def picture_names(assessment: Assessment) -> dict[str, ObjectiveResult]:
    """Return the file of each picture of trajectories: `trajectories.png` shows the kamikazes that rank the car."""
    first = assessment.for_deviation
    others = [one for one in assessment.results if one is not first]
    return {"trajectories.png": first, **{f"trajectories_{one.plan.objective}.png": one for one in others}}


def fill_episode(folder: Path, log: EpisodeLog) -> None:
    """Write what a single episode leaves on disk beside its bag."""
    write_json(folder / "episode.json", episode_summary(log))


def save_with_scratch(out: ResultFolder, scratch: Path, write: Callable[[Path], None]) -> str | None:
    """As `write_with_scratch`, but return why it failed; see `ResultFolder.save`."""
    return out.save(partial(_write_all, scratch, write))


def write_with_scratch(out: ResultFolder, scratch: Path, write: Callable[[Path], None]) -> None:
    """Write results, and beside them the bags and logs that are in `scratch`."""
    out.write(partial(_write_all, scratch, write))


def _write_all(scratch: Path, write: Callable[[Path], None], folder: Path) -> None:
    write(folder)
    for part in scratch.iterdir():
        if any(part.iterdir()):
            part.rename(folder / part.name)
