"""Which simulated trials a physical one is held against: those of the same φ and the same timing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.errors import UsageError
from skd_sim.inputs.files import did_you_mean

from skd_evaluator.extensions.fusion.figures import Figure
from skd_evaluator.extensions.fusion.trial import PhysicalTrial

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
    figure: Figure,
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
