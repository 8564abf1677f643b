"""A stored sweep of the basic car: what the equivalent multiplier of another car is read off.

It holds, for each multiplier C and each φ, the deformation of every attempt. It serves an assessment of the same φ, in
the same encounter, by kamikazes of objective `deformation` with the same planning budget; only what belongs to the car
may differ. One comes with SKD, of the synthetic φ of seed 0 (`scripts/make-reference-sweep`). `skd sweep` leaves one
for each kind of φ that it was made with.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from skd_sim.encounter.scenario import scenario_from_dict
from skd_sim.errors import UsageError
from skd_sim.objective import RANKING_OBJECTIVES
from skd_sim.options import further_options
from skd_sim.trajectory import Trajectory

from skd_evaluator.arrays import Column, read_arrays
from skd_evaluator.campaign.assessment import Assessment
from skd_evaluator.campaign.encounter_difference import encounter_difference
from skd_evaluator.campaign.plan import Plan, split_episode_id
from skd_evaluator.measure.equivalent_multiplier import EquivalentMultiplier, equivalent_multiplier
from skd_evaluator.measure.statistics import FloatArray
from skd_evaluator.version import version

FILE_NAME = "reference_{}.npz"
"""In the folder of a sweep, with the kind of φ."""
SHIPPED = "reference_sweep.npz"
_SAME_PLACE = 1e-9  # m
_COLUMNS = {
    "about": Column(np.uint8, (-1,)),
    "multipliers": Column(np.float64, (-1,)),
    "deformations": Column(np.float64, (-1, -1, -1)),
    "positions": Column(np.float64, (-1, 2)),
    "offsets": Column(np.int64, (-1,)),
}


@dataclass(frozen=True, eq=False)
class ReferenceSweep:
    """Deformations of the basic car.

    Attributes:
        source: where it is from, for messages.
        scenario: of the sweep, as plain data.
        seed: of its draws.
        simulations: planner's budget per decision.
        multipliers: C, ascending.
        safe: positions of each φ, m.
        deformations: C × φ × attempts, m; failed attempts are η_max, nan where there is none.
        version: of SKD that made it.
    """

    source: str
    scenario: Mapping[str, Any]
    seed: int
    simulations: int
    multipliers: FloatArray
    safe: tuple[FloatArray, ...]
    deformations: FloatArray
    version: str

    def mismatch(self, plan: Plan, safe: Sequence[Trajectory] | None = None) -> str | None:
        """Return why this is no reference for a plan, in a few words; None where it is.

        Args:
            plan: of the assessment; its objective is that of the kamikazes.
            safe: its φ, where they are known already.
        """
        if plan.objective != RANKING_OBJECTIVES[0]:
            return f"it is of objective {RANKING_OBJECTIVES[0]}, these kamikazes are of objective {plan.objective}"
        if plan.maximum_distance is not None:
            return f"its kamikazes have no maximum distance, these have {plan.maximum_distance:g} m"
        if plan.simulations != self.simulations:
            return f"its kamikazes plan with {self.simulations} simulations, these with {plan.simulations}"
        if others := further_options(plan):
            said = ", ".join(f"{name} {value}" for name, value in others.items())
            return f"its kamikazes have every option by default, these have {said}"
        if differs := encounter_difference(self.scenario, plan.scenario.as_dict()):
            key, there, here = differs
            return f"its scenario has {key} {there}, this one {here}"
        if safe is not None and not self._same_safe(safe):
            return f"it is of {len(self.safe)} other φ"
        return None

    def _same_safe(self, safe: Sequence[Trajectory]) -> bool:
        return len(safe) == len(self.safe) and all(
            here.positions.shape == there.shape and np.abs(here.positions - there).max() <= _SAME_PLACE
            for here, there in zip(safe, self.safe, strict=True)
        )

    def equivalent(self, assessment: Assessment) -> EquivalentMultiplier | None:
        """Return the equivalent multiplier of a car that this is a reference for; None without an attempt."""
        car = attempt_deformations(assessment)
        if not any(np.isfinite(one).any() for one in car):
            return None
        return equivalent_multiplier(
            car,
            self.multipliers.tolist(),
            [list(one) for one in self.deformations],
            paired=assessment.plan.seed == self.seed,
            seed=assessment.plan.seed,
        )


def attempt_deformations(assessment: Assessment) -> list[FloatArray]:
    """Return per φ what each attempt counts as, by its number, m; nan: it was aborted, or not run."""
    found = []
    eta_max = assessment.deformation.eta_max
    rows = zip(assessment.kamikaze, assessment.deformation.per_safe_trajectory, strict=True)
    for kamikaze, row in rows:
        numbers = [split_episode_id(log.episode.episode_id)[2] for log in (*kamikaze.logs, *kamikaze.misses)]
        values = np.full(max(numbers, default=-1) + 1, np.nan)
        values[numbers] = row.restricted
        found.append(np.minimum(values, eta_max))
    return found


def reference_from(assessments: Sequence[Assessment], source: str = "") -> ReferenceSweep:
    """Return the reference that assessments of the basic car make: one per C, of the same φ and campaign."""
    ordered = sorted(assessments, key=lambda one: one.plan.multiplier)
    first = ordered[0]
    groups = [attempt_deformations(one) for one in ordered]
    longest = max(len(group) for one in groups for group in one)
    table = np.full((len(groups), len(first.safe), longest), np.nan)
    for row, one in enumerate(groups):
        for column, group in enumerate(one):
            table[row, column, : len(group)] = group
    return ReferenceSweep(
        source,
        first.plan.scenario.as_dict(),
        first.plan.seed,
        first.plan.simulations,
        np.array([one.plan.multiplier for one in ordered]),
        tuple(one.positions for one in first.safe),
        table,
        version(),
    )


def save_reference(path: Path, reference: ReferenceSweep) -> None:
    """Write a reference: numpy arrays, and a text with what they are of."""
    about = {name: getattr(reference, name) for name in ("scenario", "seed", "simulations", "version")}
    np.savez_compressed(
        path,
        about=np.frombuffer(json.dumps(about, ensure_ascii=False).encode(), np.uint8),
        multipliers=reference.multipliers,
        deformations=reference.deformations,
        positions=np.concatenate(reference.safe),
        offsets=np.cumsum([0, *map(len, reference.safe)], dtype=np.int64),
    )


def load_reference(path: Path) -> ReferenceSweep:
    """Read a reference.

    Raises:
        UsageError: it cannot be read, or is none.
    """
    arrays = read_arrays(path, _COLUMNS)
    offsets = arrays["offsets"]
    try:
        about = json.loads(arrays["about"].tobytes())
        reference = ReferenceSweep(
            source=str(path),
            scenario=scenario_from_dict(about["scenario"], str(path)).as_dict(),  # one of before a key has its default
            seed=int(about["seed"]),
            simulations=int(about["simulations"]),
            multipliers=arrays["multipliers"],
            safe=tuple(arrays["positions"][low:high] for low, high in itertools.pairwise(offsets.tolist())),
            deformations=arrays["deformations"],
            version=str(about["version"]),
        )
    except (ValueError, KeyError, TypeError) as error:
        raise UsageError(f"{path}: not a stored sweep of the basic car ({error})") from error
    shape = (len(reference.multipliers), len(reference.safe))
    rising = len(reference.multipliers) >= 2 and bool((np.diff(reference.multipliers) > 0.0).all())
    if not (rising and reference.safe and reference.deformations.shape[:2] == shape):
        raise UsageError(f"{path}: not a stored sweep of the basic car (its arrays do not go together)")
    return reference


def shipped_reference() -> ReferenceSweep | None:
    """Return the reference that comes with SKD; None where it was left out of the installation."""
    with resources.as_file(resources.files("skd_evaluator.campaign") / SHIPPED) as path:
        return load_reference(path) if path.exists() else None


def references_at(path: Path) -> list[ReferenceSweep]:
    """Return the references in a file, or in the folder of a sweep.

    Raises:
        UsageError: there is none.
    """
    files = sorted(path.glob(FILE_NAME.format("*"))) if path.is_dir() else [path]
    if not files:
        raise UsageError(f"--reference {path}: no {FILE_NAME.format('*')} in it; give the folder of a `skd sweep`")
    return [load_reference(file) for file in files]


def fitting(
    references: Sequence[ReferenceSweep], plan: Plan, safe: Sequence[Trajectory] | None = None
) -> ReferenceSweep:
    """Return the first of the references asked for that fits.

    Raises:
        UsageError: none does.
    """
    reasons = []
    for reference in references:
        why = reference.mismatch(plan, safe)
        if why is None:
            return reference
        reasons.append(f"--reference {reference.source} is none for this: {why}")
    raise UsageError("; ".join(reasons))


# The same whether φ were given or recorded: a replay says what the live run said.
_HOW_TO_MAKE_ONE = "skd sweep --dense --out DIR (with --safe PATH for recorded φ), then skd assess --reference DIR"


def equivalent_of(
    assessment: Assessment, reference: ReferenceSweep | None = None
) -> tuple[EquivalentMultiplier | None, str]:
    """Return the equivalent multiplier of an assessed car, or None and why there is none.

    Args:
        assessment: of the car.
        reference: to read it off; by default the one that comes with SKD.
    """
    chosen = reference or shipped_reference()
    why = "none is installed" if chosen is None else chosen.mismatch(assessment.plan, assessment.safe)
    if chosen is None or why is not None:
        return None, f"no reference sweep for these φ ({why}): {_HOW_TO_MAKE_ONE}"
    return chosen.equivalent(assessment), ""
