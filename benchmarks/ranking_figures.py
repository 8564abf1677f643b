"""The figures by which ranking.py ranks cars: what each trial of a car gives, and which way is better."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypedDict

from cars.catalogue import Car
from contacts import run_of
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.episodes import run_episode
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages.margin import minimal_deviations
from skd_evaluator.assessment.stages.risk import crude_crossings
from skd_evaluator.metrics.behaviour import WALKERS
from skd_evaluator.metrics.behaviour.model import load_behaviour
from skd_evaluator.metrics.deviation import deviation
from skd_evaluator.metrics.frechet import discrete_frechet
from skd_evaluator.metrics.risks import SCALES, Touch
from skd_evaluator.risk.crossings import AnyCar, CrossingPlan
from skd_sim.options.car_and_adversary import Objective
from skd_sim.world.episode import EpisodeSpec, Mode, Outcome
from skd_sim.world.state import Trajectory
from wide_scenarios import HITS

ALONG_TRIALS = 25
"""Runs along each φ, for the contact rate."""
Values = list[list[float]]
"""Of each φ, of each of its trials."""


class Found(TypedDict):
    """What was computed of a car, as it is stored.

    Attributes:
        values: of its trials.
        note: what one has to know of them, a few words; else empty.
    """

    values: Values
    note: str


@dataclass(frozen=True)
class Work:
    """What a figure is computed from: a car, the safe trajectories, and how many trials each of these has."""

    car: Car
    safe: Sequence[Trajectory]
    trials: int
    seed: int
    runner: InProcessRunner
    limit: int = 512
    """Candidates that the margin's search may drive in a trial."""
    crossings: int = 25
    """Of the risk, on each φ: as many as in an assessment."""

    def plan(self, objective: Objective = Objective.DEVIATION) -> Plan:
        """Return the assessment that the trials are of."""
        return Plan(
            self.car.scenario,
            controller=self.car.controller,
            multiplier=self.car.multiplier,
            kamikaze_count=self.trials,
            seed=self.seed,
            objective=objective,
        )

    def episodes(self, plan: Plan, mode: Mode, trials: int) -> list[EpisodeSpec]:
        """Return the trials, φ by φ."""
        numbers = range(trials)
        return [plan.episode(mode, index, number, phi) for index, phi in enumerate(self.safe) for number in numbers]

    def each(self, episodes: Sequence[EpisodeSpec], value_of: Callable[[EpisodeSpec], float], note: str = "") -> Found:
        """Return what a function of a module gives for each trial."""
        return {"values": self.by_phi(list(self.runner.map(value_of, episodes))), "note": note}

    def by_phi(self, values: Sequence[float]) -> Values:
        """Return values that stand φ by φ, equally many each, in their groups."""
        size = len(values) // len(self.safe)
        return [list(values[first : first + size]) for first in range(0, len(values), size)]


def _hit_along(episode: EpisodeSpec) -> float:
    return float(run_of(run_episode(episode)) in HITS)


def _needed(episode: EpisodeSpec) -> float:
    """Return the deviation (m) of a kamikaze that hits, at most η_max, which stands for all others."""
    log, scenario = run_episode(episode), episode.scenario
    if not log.hit:
        return scenario.eta_max
    assert episode.safe_trajectory is not None
    ticks = log.impact_time / scenario.time_step
    return min(scenario.eta_max, deviation(episode.safe_trajectory.positions, log.trajectory.positions, ticks))


def _frechet(episode: EpisodeSpec) -> float:
    """Return the discrete Fréchet distance (m) of a kamikaze that touches the car; nan of one that does not."""
    log = run_episode(episode)
    assert episode.safe_trajectory is not None
    if log.outcome != Outcome.COLLISION:
        return float("nan")
    return float(discrete_frechet(episode.safe_trajectory.positions, log.trajectory.positions))


def along(work: Work) -> Found:
    """Return which runs of the car against somebody who walks along φ are hits."""
    return work.each(work.episodes(work.plan(), Mode.REPLAY, ALONG_TRIALS), _hit_along)


def margin(work: Work) -> Found:
    """Return the margin of each trial: exact for the basic car, else searched."""
    episodes = work.episodes(work.plan(), Mode.KAMIKAZE, work.trials)
    eta_max = work.car.scenario.eta_max
    hits, search = minimal_deviations(episodes, {}, work.runner, lambda *_: None, work.limit)
    note = "exact" if search is None else f"{search.budget} candidates{'' if search.converged else ', not converged'}"
    return {
        "values": work.by_phi([eta_max if one is None else min(eta_max, one.distance) for one in hits]),
        "note": note,
    }


def planned_generic(work: Work) -> Found:
    """Return what kamikazes need that know nothing of the car but take it for a basic one; of a basic one, its C."""
    return work.each(work.episodes(work.plan(), Mode.KAMIKAZE, work.trials), _needed)


def risk(scale: float) -> Callable[[Work], Found]:
    """Return what gives which crossings are hits by the front of the car, of people whose deviations are scaled."""

    def found(work: Work) -> Found:
        plan = replace(work.plan(), safe_count=len(work.safe))
        crossing_plan = CrossingPlan(plan, tuple(work.safe), load_behaviour(WALKERS).values)
        crossings = crude_crossings(crossing_plan, work.crossings * len(work.safe))
        hit = AnyCar(crossing_plan, work.runner).run(crossings, scale).touch == Touch.FRONT
        return {
            "values": [hit[crossings.phi == phi].astype(float).tolist() for phi in range(len(work.safe))],
            "note": "",
        }

    return found


def skd_paper(work: Work) -> Found:
    """Return the paper's distances."""
    return work.each(work.episodes(work.plan(Objective.PAPER), Mode.KAMIKAZE, work.trials), _frechet)


@dataclass(frozen=True)
class Figure:
    """A figure that ranks cars: the mean of what its trials give.

    Attributes:
        label: in tables.
        better: +1 where more of it is safer, −1 where less is.
        compute: what gives it.
        digits: of its unit, in tables.
    """

    label: str
    better: int
    compute: Callable[[Work], Found]
    digits: int = 2


FIGURES = {
    "margin": Figure("margin (m)", +1, margin),
    "planned_generic": Figure("planned, generic (m)", +1, planned_generic),
    "along": Figure("nominal collision rate", -1, along, digits=3),
    "skd_paper": Figure("SKD, paper (m)", +1, skd_paper),
    **{f"risk_{scale:g}": Figure(f"R({scale:g})", -1, risk(scale), digits=3) for scale in SCALES},
}
