"""A physical or simulated trial: its φ, timing and figures; and which simulated trials it is paired with."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.errors import UsageError
from skd_sim.inputs.files import did_you_mean
from skd_sim.scenario.road import right_and_along
from skd_sim.scenario.scenario import Scenario

from skd_evaluator.metrics.surrogate_measures import GRID, MOST, greatest_required_deceleration, least_clearance
from skd_evaluator.metrics.surrogate_scenes import Scene, Scenes


@dataclass(frozen=True)
class TrialFigure:
    """A figure of a trial.

    Attributes:
        key: its name in tables and in fusion.json.
        text: its name as people read it.
        unit: of it; empty for a share.
        most: largest value that it can have: more is another unit, or no trial.
        is_rate: whether a trial has it or not: 1 or 0.
        wrong: trials in which the simulator was wrong that are added to what is seen of it. A required deceleration is
            0 where nobody comes into the other's way, and much where somebody nearly does: partly it is a yes or no, as
            a hit is, and a simulator that was right in a dozen trials will be wholly wrong in one some day.
    """

    key: str
    text: str
    unit: str
    most: float
    is_rate: bool = False
    wrong: float = 0.0


FIGURES = {
    one.key: one
    for one in (
        TrialFigure("clearance", "least clearance", "m", 100.0),
        TrialFigure("required_deceleration", "greatest required deceleration", "m/s²", MOST, wrong=1.0),
        TrialFigure("hit", "nominal collision rate", "", 1.0, is_rate=True),
        TrialFigure("margin", "margin", "m", 100.0),
    )
}


def checked_value(figure: TrialFigure, value: float, where: str) -> float:
    """Return a value of a figure.

    Args:
        figure: what it is of.
        value: the value.
        where: file and line, for the message.

    Raises:
        UsageError: it is no finite number, or one that the figure cannot have in its unit.
    """
    unit = f" {figure.unit}" if figure.unit else ""
    if not math.isfinite(value):
        raise UsageError(f"{where}: {figure.key} must be a finite number, got {value}")
    if figure.is_rate and value not in (0.0, 1.0):
        raise UsageError(f"{where}: {figure.key} must be 1 (the car hit) or 0, got {value:g}")
    if not 0.0 <= value <= figure.most:
        raise UsageError(
            f"{where}: {figure.key} must be from 0 to {figure.most:g}{unit}, got {value:g}: is it in"
            f"{unit or ' shares'}?"
        )
    return value


@dataclass(frozen=True)
class PhysicalTrial:
    """One trial.

    Attributes:
        phi: name of the φ that the adversary was to walk.
        values: by key of `figures.FIGURES`.
        gap: timing: how far the car's front was before the crossing line when φ began, m; None where it is not known.
        where: file and line, for messages.
        seen_hit: whether the car hits by its recording, whatever the table says; None without a recording.
        track: where car and road user were from the beginning of φ to its end, or to the contact, by the recording,
            n × 4, m; None without one.
    """

    phi: str
    values: Mapping[str, float] = field(default_factory=dict)
    gap: float | None = None
    where: str = ""
    seen_hit: bool | None = None
    track: FloatArray | None = field(default=None, repr=False, compare=False)


def figures_of(scene: Scene, *, hit: bool) -> dict[str, float]:
    """Return the figures of a trial by what happened in it."""
    return {
        "clearance": least_clearance(scene),
        "required_deceleration": greatest_required_deceleration(Scenes.of(scene).every(GRID).whole),
        "hit": float(hit),
    }


def gap_to_crossing(scenario: Scenario, car: FloatArray) -> float:
    """Return how far the front of a car (reference point (x, y), m) is before the crossing line, m."""
    along = right_and_along(scenario.road.line, car[None, :2].copy())[0, 1]
    return float(-along - scenario.car.front)


GAP_TOLERANCE = 0.5
"""m by which the gaps at the start of a simulated and a physical trial may differ for both to be of one timing."""


@dataclass(frozen=True, eq=False)
class Pairs:
    """One figure of physical trials and what the simulator says of the same φ, and of all.

    Attributes:
        names: of the φ with physical trials, in the order of the first of them.
        groups: physical figures of each, one per trial.
        physical: their means, n.
        simulated: mean of the simulated figures of the same φ and timing, n.
        population: mean of the simulated figures of every φ, N.
        trials: physical figures in the order of the trials, k.
        predicted: what the simulator says of each of these trials, k.
        timed: whether the timing of every physical trial is known.
        runs: simulated figures of every run of every φ, each with a timing of its own as a physical trial has one; they
            show the figure's shape. None: the same as those of every φ.
    """

    names: tuple[str, ...]
    groups: tuple[FloatArray, ...]
    physical: FloatArray
    simulated: FloatArray
    population: FloatArray
    trials: FloatArray
    predicted: FloatArray
    timed: bool
    runs: FloatArray | None = None

    @property
    def shape(self) -> FloatArray:
        """Simulated figures that are skewed as single trials are."""
        return self.population if self.runs is None else self.runs


def paired(
    figure: TrialFigure,
    physical: Sequence[PhysicalTrial],
    simulated: Mapping[str, Sequence[PhysicalTrial]],
    tolerance: float = GAP_TOLERANCE,
) -> Pairs | None:
    """Pair physical with simulated trials.

    Args:
        figure: the one that is looked at.
        physical: trials in the order in which they were made.
        simulated: trials by φ.
        tolerance: of the timing, m.

    Returns:
        None where physical or simulated trials do not have the figure.

    Raises:
        UsageError: some physical trials have the figure and others not; a φ was never simulated, or never with such a
            timing.
    """
    key = figure.key
    every = {name: [one for one in trials if key in one.values] for name, trials in simulated.items()}
    every = {name: trials for name, trials in every.items() if trials}
    having = [one for one in physical if key in one.values]
    if not having or not every:
        return None
    if len(having) < len(physical):
        lacking = next(one for one in physical if key not in one.values)
        raise UsageError(f"{lacking.where}: has no {key}, which other trials have: give it for all trials or for none")
    predicted = np.array([_predicted(key, one, every, tolerance) for one in physical])
    values = np.array([one.values[key] for one in physical])
    names = tuple(dict.fromkeys(one.phi for one in physical))
    of = np.array([names.index(one.phi) for one in physical])
    groups = tuple(values[of == index] for index in range(len(names)))
    means = np.array([group.mean() for group in groups])
    said = np.array([predicted[of == index].mean() for index in range(len(names))])
    population = np.array([np.mean([one.values[key] for one in trials]) for trials in every.values()])
    timed = all(one.gap is not None for one in physical)
    runs = np.array([one.values[key] for trials in every.values() for one in trials])
    return Pairs(names, groups, means, said, population, values, predicted, timed, runs)


def _predicted(key: str, trial: PhysicalTrial, every: Mapping[str, Sequence[PhysicalTrial]], tolerance: float) -> float:
    if trial.phi not in every:
        hint = did_you_mean(trial.phi, every)
        raise UsageError(f"{trial.where}: φ {trial.phi!r} was not simulated{hint}")
    runs = every[trial.phi]
    gap = trial.gap
    if gap is not None:
        known = [one.gap for one in runs if one.gap is not None]
        runs = [one for one in runs if one.gap is None or abs(one.gap - gap) <= tolerance]
        if not runs:
            raise UsageError(
                f"{trial.where}: the car was {gap:.2f} m before the crossing line when {trial.phi} began, in the "
                f"simulation {min(known):.2f} to {max(known):.2f} m: no simulated run within {tolerance:g} m is of "
                "that timing; simulate more runs along φ, or start the car where it starts in the simulation"
            )
    return float(np.mean([one.values[key] for one in runs]))
