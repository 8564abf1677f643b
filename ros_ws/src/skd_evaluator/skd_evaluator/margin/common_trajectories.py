"""Margins of two cars after each of them has met the trajectories that were found for the other.

A margin that was searched for is an upper bound, and depends on what the search happened to find. So before two cars
are compared the hits of least deviation of either are walked before the other one too, and each trial keeps the smaller
deviation: no car is called safer because its search was less lucky. Nothing further is searched. Exact margins stay.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from skd_sim.errors import UsageError
from skd_sim.options.car_under_test import WORLD, CarUnderTest, is_own_world
from skd_sim.scenario.scenario import Scenario, scenario_from_dict
from skd_sim.world.episode import EpisodeLog, EpisodeSpec
from skd_sim.world.state import FloatArray, Trajectory

from skd_evaluator.assessment.compare.comparability import refusals
from skd_evaluator.assessment.compare.gate import Check, not_worse
from skd_evaluator.assessment.context import Progress, Runner
from skd_evaluator.assessment.files.episodes_npz import read_episodes
from skd_evaluator.assessment.files.results import StoredResult, read_result
from skd_evaluator.assessment.plan import Plan, split_episode_id
from skd_evaluator.assessment.run.workers import InProcessRunner, available_workers, check_controller
from skd_evaluator.errors import AssessmentError
from skd_evaluator.margin.search.rounds import SAME, in_processes
from skd_evaluator.margin.search.search import Earlier, OtherHit, margins_with_other_hits
from skd_evaluator.margin.search.trial import prescribed
from skd_evaluator.metrics.deviation import Hit, hit_of
from skd_evaluator.metrics.statistics import mean

MARGIN = "margin"
Hits = Sequence[Sequence[Hit | None]]
"""For each φ the hits of least deviation, one a trial; None: no hit was found."""
_LOWERED = 1e-3  # m: less is not said


def on_common_trajectories(
    first: StoredResult, second: StoredResult, progress: Progress
) -> tuple[StoredResult, StoredResult, tuple[str, ...]]:
    """Return two results with the margins that compare, and what a reader should know of them, a line each.

    Args:
        first: an assessment.
        second: the one to compare with it.
        progress: called with how far the work is.
    """
    both = first, second
    searched = [one for one in both if one.figures.get("margin_budget") is not None]
    if not searched or any(MARGIN not in one.groups for one in both) or refusals(first, second):
        return first, second, ()
    hits = [read_episodes(one.folder).margin_hits for one in both]
    found, lines = [], []
    for one, mine, other, theirs in zip(both, hits, both[::-1], hits[::-1], strict=True):
        if one not in searched:
            found.append(one)
            continue
        try:
            margins = _margins(one, mine, _hits(other, theirs), progress)
        except (AssessmentError, UsageError) as error:
            found.append(one)
            lines.append(f"{one.folder}: not tried on the trajectories that were found for {other.folder}: {error}")
            continue
        before, after = (mean(np.concatenate(groups)) for groups in (one.groups[MARGIN], margins))
        found.append(replace(one, groups={**one.groups, MARGIN: margins}))
        if before - after > _LOWERED:
            lines.append(
                f"{one.folder}: trajectories that were found for {other.folder} lower its margin from {before:.3f} to "
                f"{after:.3f} m, which the comparison goes by"
            )
    return found[0], found[1], tuple(lines)


def check_not_worse(folder: Path, earlier: StoredResult) -> Check:
    """Return whether the assessment in a folder falls behind an earlier one on common trajectories; see `not_worse`."""
    earlier, mine, lines = on_common_trajectories(earlier, read_result(folder), lambda _label, _done, _total: None)
    return not_worse(mine, earlier, lines)


def _hits(result: StoredResult, hits_per_phi: Hits) -> list[OtherHit]:
    """Return the hits of least deviation of a result, least first."""
    found = [(hit, phi) for phi, mine in zip(result.safe, hits_per_phi, strict=True) for hit in mine if hit is not None]
    return [OtherHit(phi, whole_trajectory(hit)) for hit, phi in sorted(found, key=lambda one: one[0].distance)]


def whole_trajectory(hit: Hit) -> FloatArray:
    """Return the positions of a hit, n × 2, m, the last of them not at the contact but at the end of its tick."""
    positions = hit.trajectory.positions
    before, contact = positions[-2:]
    share = max(hit.duration - (len(positions) - 2), 1e-9)
    return np.concatenate([positions[:-1], [before + (contact - before) / share]])


def earlier_version(result: StoredResult, trials: Sequence[EpisodeSpec], runner: Runner) -> Earlier:
    """Return what is known of an earlier version of a car that is rated now.

    Args:
        result: of that version.
        trials: of the car now: those on the same φ with the same seed have a hit.
        runner: has been started.

    Raises:
        UsageError: the result has no trial of these.
        AssessmentError: the car fails.
    """
    hits = read_episodes(result.folder).margin_hits if int(result.figures["seed"]) == trials[0].seed else ()
    known = dict(zip((one.tobytes() for one in result.safe), hits, strict=False))
    found, margins = [], []
    for trial in trials:
        mine = known.get(trial.safe_trajectory.positions.tobytes(), ()) if trial.safe_trajectory else ()
        number = split_episode_id(trial.episode_id)[2]
        if number < len(mine):
            hit = mine[number]
            margins.append(trial.scenario.eta_max if hit is None else hit.distance)
            found += [] if hit is None else [prescribed(trial, whole_trajectory(hit))]
    if not found:
        raise UsageError(f"{result.folder}: has no margin on these φ with this seed, with which the search could begin")
    logs = {log.episode.episode_id: log for log in runner.run(found)}
    return Earlier(logs, mean(margins) if len(margins) == len(trials) else None)


def check_repeats(result: StoredResult, progress: Progress) -> None:
    """See to it that the car of a result hits again on each of its hits.

    Raises:
        UsageError: the car cannot be made here.
        AssessmentError: it does not.
    """
    _margins(result, read_episodes(result.folder).margin_hits, (), progress)


def _margins(result: StoredResult, own: Hits, hits: Sequence[OtherHit], progress: Progress) -> tuple[FloatArray, ...]:
    """Return the margins of each φ, m, of a car that also meets some other trajectories.

    Raises:
        UsageError: the car cannot be made here.
        AssessmentError: it fails, or does not repeat the hits of the result.
    """
    trials, groups = _trials(result), result.groups[MARGIN]
    pairs = zip(trials, itertools.chain.from_iterable(own), strict=True)
    hit_in = [(trial, hit) for trial, hit in pairs if hit is not None]
    first = trials[0]
    with InProcessRunner(available_workers(), isolated=not first.car.is_own) as runner:
        runner.start()
        logs = list(runner.run([prescribed(trial, whole_trajectory(hit)) for trial, hit in hit_in]))
        again = sum(_repeats(trial, hit.distance, log) for (trial, hit), log in zip(hit_in, logs, strict=True))
        if again < len(logs):
            raise AssessmentError(
                f"of its {len(logs)} hits {again} come again: its code has changed, or it does not repeat itself"
            )
        known = {log.episode.episode_id: log for log in logs}
        found = margins_with_other_hits(trials, known, hits, in_processes(runner, progress))
    ends = np.cumsum([len(one) for one in groups])[:-1]
    return tuple(map(np.minimum, groups, np.split(found, ends)))


def _trials(result: StoredResult) -> list[EpisodeSpec]:
    """Return the trials in which a result has margins, φ by φ.

    Raises:
        UsageError: its car cannot be run here.
    """
    car, scenario = car_of(result), scenario_of(result)
    plan = Plan(scenario, controller=car.controller, multiplier=car.multiplier, seed=int(result.figures["seed"]))
    safe = [Trajectory(phi, scenario.time_step, f"φ {index}") for index, phi in enumerate(result.safe)]
    return plan.trials(safe, len(result.groups[MARGIN][0]))


def car_of(result: StoredResult) -> CarUnderTest:
    """Return the car of a result, which can be run here.

    Raises:
        UsageError: it cannot.
    """
    figures = result.figures
    simulator = str((figures.get("options") or {}).get("simulator", WORLD))
    car = CarUnderTest(figures["controller"], figures["multiplier"] or CarUnderTest.multiplier)
    if car.is_external or not is_own_world(simulator):
        raise UsageError("its car is a node of its own" if car.is_external else f"it was in simulator {simulator}")
    return car


def scenario_of(result: StoredResult) -> Scenario:
    """Return the scenario of a result, with the control period that its car declares.

    Raises:
        UsageError: its car does not go with it.
    """
    return check_controller(car_of(result), scenario_from_dict(result.figures["scenario"], str(result.folder)))


def _repeats(trial: EpisodeSpec, distance: float, log: EpisodeLog) -> bool:
    phi = trial.safe_trajectory
    return log.hit and phi is not None and abs(hit_of(phi.positions, log).distance - distance) <= SAME
