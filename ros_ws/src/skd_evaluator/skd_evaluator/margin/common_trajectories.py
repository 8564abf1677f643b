"""Two cars on the same trajectories: margins that compare, and the smallest trial that tells the cars apart.

A margin that was searched for is an upper bound, and depends on what the search happened to find. So before two cars
are compared the hits of least deviation of either are walked before the other one too, and each trial keeps the smaller
deviation: no car is called safer because its search was less lucky. Nothing further is searched. Exact margins stay.

The smallest trial is the least deviation from a safe trajectory on which only one car hits. It is searched for with
both cars: first where one hits at all, then a candidate counts as a hit only if the other car does not hit. Known hits
of either are tried first. Each trial is the first run along its trajectory in a scenario of its own: any command drives
it to the bit, by `--scenario`, `--safe` and `--seed`.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from skd_sim.errors import AssessmentError, UsageError
from skd_sim.options.car_and_adversary import WORLD, AdversaryModel, CarUnderTest, is_own_world
from skd_sim.scenario.scenario import Scenario, scenario_from_dict, with_oncoming_lane
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Mode, Outcome
from skd_sim.world.state import FloatArray, Trajectory

from skd_evaluator.assessment.compare.comparability import refusals
from skd_evaluator.assessment.compare.gate import Check, not_worse
from skd_evaluator.assessment.context import Progress, Runner, silent
from skd_evaluator.assessment.files.results import StoredResult, read_result
from skd_evaluator.assessment.plan import EpisodeGroup, Plan, episode_id, split_episode_id
from skd_evaluator.assessment.run.workers import InProcessRunner, available_workers, check_controller
from skd_evaluator.margin.search.candidates import ENOUGH
from skd_evaluator.margin.search.rounds import SAME, by_episodes, in_processes
from skd_evaluator.margin.search.search import Earlier, Effort, OtherHit, margins_with_other_hits, search_margins
from skd_evaluator.margin.search.trial import prescribed
from skd_evaluator.metrics.deviation import Hit, hit_of
from skd_evaluator.metrics.margins import lane_of_margin
from skd_evaluator.metrics.statistics import mean

MARGIN = "margin"
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
    found, lines, untried = [], list[str](), dict[str, list[str]]()
    for one, other in (both, both[::-1]):
        if one not in searched:
            found.append(one)
            continue
        try:
            least_first = sorted(_hits(other), key=lambda pair: pair[1].distance)
            offered = [OtherHit(phi, whole_trajectory(hit)) for phi, hit in least_first]
            margins = _margins(one, offered, progress)
        except (AssessmentError, UsageError) as error:
            found.append(one)
            untried.setdefault(str(error), []).append(str(one.folder))
            continue
        before, after = (mean(np.concatenate(groups)) for groups in (one.groups[MARGIN], margins))
        found.append(replace(one, groups={**one.groups, MARGIN: margins}))
        if before - after > _LOWERED:
            lines.append(
                f"{one.folder}: its margin falls from {before:.3f} to {after:.3f} m by trajectories found for "
                f"{other.folder}; the comparison uses that"
            )
    lines += [f"{' and '.join(one)}: not tried on the other's trajectories: {why}" for why, one in untried.items()]
    return found[0], found[1], tuple(lines)


def check_not_worse(folder: Path, earlier: StoredResult) -> Check:
    """Return whether the assessment in a folder falls behind an earlier one on common trajectories; see `not_worse`."""
    earlier, mine, lines = on_common_trajectories(earlier, read_result(folder), lambda _label, _done, _total: None)
    return not_worse(mine, earlier, lines)


def _hits(result: StoredResult) -> list[tuple[FloatArray, Hit]]:
    """Return the hits that a margin is of, each with its φ, φ by φ."""
    if MARGIN not in result.groups:
        return []
    pairs = zip(result.safe, result.episodes.margin_hits, strict=True)
    return [(phi, hit) for phi, hits in pairs for hit in hits if hit is not None]


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
    hits = result.episodes.margin_hits if int(result.figures["seed"]) == trials[0].seed else ()
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
    logs = {log.episode.episode_id: log for log in runner.run(found) if log.outcome != Outcome.ABORTED}
    return Earlier(logs, mean(margins) if len(margins) == len(trials) else None)


def check_repeats(result: StoredResult, progress: Progress) -> None:
    """See to it that the car of a result hits again on each of its hits.

    Raises:
        UsageError: the car cannot be made here.
        AssessmentError: it does not.
    """
    _margins(result, (), progress)


def _margins(result: StoredResult, hits: Sequence[OtherHit], progress: Progress) -> tuple[FloatArray, ...]:
    """Return the margins of each φ, m, of a car that also meets some other trajectories.

    Raises:
        UsageError: the car cannot be made here.
        AssessmentError: it fails, or does not repeat the hits of the result.
    """
    trials, groups = _trials(result), result.groups[MARGIN]
    pairs = zip(trials, itertools.chain.from_iterable(result.episodes.margin_hits), strict=True)
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
    car, scenario = _car_of(result), _scenario_of(result)
    plan = Plan(scenario, controller=car.controller, multiplier=car.multiplier, seed=int(result.figures["seed"]))
    safe = [Trajectory(phi, scenario.time_step, f"φ {index}") for index, phi in enumerate(result.safe)]
    return plan.trials(safe, len(result.groups[MARGIN][0]))


def _car_of(result: StoredResult) -> CarUnderTest:
    """Return the car of a result, which can be run here.

    Raises:
        UsageError: it cannot.
    """
    figures = result.figures
    simulator = str((figures.get("options") or {}).get("simulator", WORLD))
    car = CarUnderTest(figures["controller"], figures["multiplier"] or CarUnderTest.multiplier)
    if car.is_external or not is_own_world(simulator):
        raise UsageError("a node of its own" if car.is_external else f"it was in simulator {simulator}")
    return car


def _scenario_of(result: StoredResult) -> Scenario:
    """Return the scenario of a result's margin, with the control period that its car declares.

    Raises:
        UsageError: its car does not go with it.
    """
    scenario = scenario_from_dict(result.figures["scenario"], str(result.folder))
    return check_controller(_car_of(result), with_oncoming_lane(scenario, lane_of_margin(result.figures)))


def _repeats(trial: EpisodeSpec, distance: float, log: EpisodeLog) -> bool:
    phi = trial.safe_trajectory
    return log.hit and phi is not None and abs(hit_of(phi.positions, log).distance - distance) <= SAME


EFFORT = Effort(first=64, limit=256, excursions=128, deepens=False)


@dataclass(frozen=True, eq=False)
class DistinguishingTrial:
    """A trial in which one car hits and another does not.

    Attributes:
        number: of the safe trajectory φ.
        safe: φ, n × 2, m.
        hit: what the deviation is, and how fast the car hits.
        hits: the episode of the car that hits, in mode replay.
        misses: the same episode with the other car.
    """

    number: int
    safe: FloatArray
    hit: Hit
    hits: EpisodeLog
    misses: EpisodeLog

    @property
    def parts_at(self) -> float:
        """Time up to which both cars are in the same place at the same speed, s."""
        both = min(len(self.hits.car), len(self.misses.car))
        alike = np.all(self.hits.car[:both] == self.misses.car[:both], axis=1)
        return self.scenario.time_step * (int(np.logical_and.accumulate(alike).sum()) - 1)

    @property
    def scenario(self) -> Scenario:
        """The scenario in which this trial is the first run along its trajectory."""
        return self.hits.episode.scenario

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain data: m, m/s and s."""
        return {
            "safe_number": self.number,
            "deviation": self.hit.distance,
            "impact_speed": self.hit.impact_speed,
            "cars_part_at": self.parts_at,
            "impact_time": self.hits.impact_time,
        }


class TestedCar(NamedTuple):
    """A car that can be run here, and what is known of it.

    Attributes:
        car: the car.
        scenario: the scenario, with the control period that the car declares.
        seed: of the trials.
        safe: each φ, n × 2, m.
        hits: trajectories that hit it or are likely to.
    """

    car: CarUnderTest
    scenario: Scenario
    seed: int
    safe: Sequence[FloatArray]
    hits: Sequence[OtherHit]

    def drives(self, episode: EpisodeSpec) -> EpisodeSpec:
        """Return an episode with this car under test."""
        return replace(
            episode,
            scenario=replace(episode.scenario, control_period=self.scenario.control_period),
            public=None,
            controller=self.car.controller,
            multiplier=self.car.multiplier,
            adversary_model=AdversaryModel.GENERIC,  # nothing is planned
        )


class _BothCars:
    """A runner of one car that has another one drive where it hits.

    Attributes:
        apart: trajectories on which it hits and the other one does not, positions at ticks, n × 2, m.
        alone: whether a hit counts only where the other car does not hit.
    """

    def __init__(self, runner: Runner, other: TestedCar) -> None:
        self._runner, self._other = runner, other
        self.apart: list[FloatArray] = []
        self.alone = False

    def run(self, episodes: Sequence[EpisodeSpec]) -> Iterator[EpisodeLog]:
        """Run episodes; see `Runner`."""
        logs = list(self._runner.run(episodes))
        others = iter(list(self._runner.run([self._other.drives(log.episode) for log in logs if log.hit])))
        for log in logs:
            both = log.hit and next(others).hit
            if log.hit and not both:
                self.apart.append(log.adversary)
            yield replace(log, outcome=Outcome.MISSED) if both and self.alone else log


def distinguishing_trials(
    first: StoredResult, second: StoredResult, progress: Progress = silent
) -> tuple[DistinguishingTrial | None, DistinguishingTrial | None]:
    """Return the smallest trial in which only the first car hits, and that in which only the second does, where found.

    Args:
        first: an assessment of a car that can be run here.
        second: another one, of the same scenario.
        progress: called with how far the work is.

    Raises:
        UsageError: a car cannot be run here.
        AssessmentError: it fails.
    """
    one, other = map(_tested, (first, second))
    with InProcessRunner(available_workers(), isolated=not (one.car.is_own and other.car.is_own)) as runner:
        runner.start()
        return smallest_trial(one, other, runner, progress), smallest_trial(other, one, runner, progress)


def _tested(result: StoredResult) -> TestedCar:
    hits = [OtherHit(phi, whole_trajectory(hit)) for phi, hit in _hits(result)]
    return TestedCar(_car_of(result), _scenario_of(result), int(result.figures["seed"]), result.safe, hits)


def smallest_trial(
    car: TestedCar, other: TestedCar, runner: Runner, progress: Progress = silent
) -> DistinguishingTrial | None:
    """Return the smallest trial in which one car hits and the other does not; None where none was found.

    Args:
        car: the one that hits; the trials are on its φ.
        other: the one that does not.
        runner: has been started.
        progress: called with how far the work is.

    Raises:
        AssessmentError: a car fails.
    """
    both, found = _BothCars(runner, other), None
    rounds = by_episodes(both, silent)
    scenario, hits = car.scenario, (*car.hits, *other.hits)
    for number, phi in enumerate(car.safe):
        bound = scenario.eta_max if found is None else found.hit.distance
        safe = Trajectory(phi, scenario.time_step)
        trial = _first_run(replace(scenario, eta_max=bound), safe, car.seed, car)
        tried = [phi, *(hit.positions for hit in hits if np.array_equal(hit.safe, phi))]
        known = [prescribed(trial, one) for one in tried]
        both.apart, both.alone = [], False  # hits of least deviation of this car are likely to be its alone
        search_margins([trial], {trial.episode_id: list(both.run(known))}, rounds, EFFORT)
        known, both.alone = [prescribed(trial, one) for one in both.apart], True
        searched = search_margins([trial], {trial.episode_id: list(both.run(known))}, rounds, EFFORT)
        progress("trials that tell the cars apart", number + 1, len(car.safe))
        (hit,), (episode,) = searched.hits, searched.episodes
        if hit is not None and episode is not None:
            shown = replace(episode, scenario=replace(episode.scenario, eta_max=scenario.eta_max))
            hits_log, misses_log = runner.run([car.drives(shown), other.drives(shown)])
            found = DistinguishingTrial(number, phi, hit, hits_log, misses_log)
            if hit.distance <= ENOUGH:
                break
    return found


def _first_run(scenario: Scenario, safe: Trajectory, seed: int, car: TestedCar) -> EpisodeSpec:
    """Return the first run along a φ as the only one of its scenario, for a search: in kamikaze mode."""
    number = episode_id(EpisodeGroup.NOMINAL, 0, 0)
    start = EpisodeSpec(scenario, Mode.KAMIKAZE, seed, number, safe_trajectory=safe).start_gap
    fixed = replace(scenario, car=replace(scenario.car, meet_safe_trajectory=False, start_gap=start))
    return car.drives(EpisodeSpec(fixed, Mode.KAMIKAZE, seed, number, safe_trajectory=safe))
