"""The smallest trial that tells two cars apart: the least deviation from a safe trajectory on which only one hits.

The search of the margin looks for it with both cars: first where one car hits at all, then a candidate counts as a hit
only if the other car does not hit. Hits that are known of either car are tried first. Each trial is the first run along
its trajectory in a scenario of its own: any command drives it to the bit, by `--scenario`, `--safe` and `--seed`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from skd_sim.options.adversary import AdversaryModel
from skd_sim.options.car_under_test import CarUnderTest
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Mode, Outcome
from skd_sim.world.state import FloatArray, Trajectory

from skd_evaluator.assessment.context import Progress, Runner, silent
from skd_evaluator.assessment.files.results import StoredResult
from skd_evaluator.assessment.plan import EpisodeGroup, episode_id
from skd_evaluator.assessment.run.workers import InProcessRunner, available_workers
from skd_evaluator.margin.common_trajectories import MARGIN, car_of, scenario_of, whole_trajectory
from skd_evaluator.margin.search.candidates import ENOUGH
from skd_evaluator.margin.search.rounds import by_episodes
from skd_evaluator.margin.search.search import Effort, search_margins
from skd_evaluator.margin.search.trial import prescribed
from skd_evaluator.metrics.deviation import Hit

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
        hits: trajectories that hit it or are likely to, the φ of each as bytes and the positions at ticks, n × 2, m.
    """

    car: CarUnderTest
    scenario: Scenario
    seed: int
    safe: Sequence[FloatArray]
    hits: Sequence[tuple[bytes, FloatArray]]

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
            if log.hit and next(others).hit:
                yield replace(log, outcome=Outcome.MISSED) if self.alone else log
                continue
            if log.hit:
                self.apart.append(log.adversary)
            yield log


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
    safe, seed = result.safe, int(result.figures["seed"])
    return TestedCar(car_of(result), scenario_of(result), seed, safe, _hits_of(result))


def _hits_of(result: StoredResult) -> list[tuple[bytes, FloatArray]]:
    """Return the hits that a margin is of, the φ of each as bytes and the positions at ticks, n × 2, m."""
    if MARGIN not in result.groups:
        return []
    pairs = zip(result.safe, result.episodes.margin_hits, strict=True)
    return [(phi.tobytes(), whole_trajectory(hit)) for phi, hits in pairs for hit in hits if hit is not None]


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
        known = [prescribed(trial, one) for one in (phi, *(hit for of, hit in hits if of == phi.tobytes()))]
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
