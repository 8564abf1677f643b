"""Two assessments held against each other: whether one car is safer than the other, and how sure that is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from skd_evaluator.campaign.encounter_difference import encounter_difference
from skd_evaluator.campaign.options import OWN, SYNTHETIC
from skd_evaluator.campaign.stored_result import StoredResult
from skd_evaluator.measure.difference import Difference, difference
from skd_evaluator.measure.statistics import FloatArray

SAFER, LESS_SAFE, NOT_TOLD_APART, NOT_COMPARED = "safer", "less safe", "not told apart", "not compared"
_VERDICTS = {1: SAFER, 0: NOT_TOLD_APART, -1: LESS_SAFE}
_FIGURES = ("deformation", "skd", "skd_prefix", "collision_rate")


@dataclass(frozen=True, eq=False)
class Comparison:
    """What an assessment says of its car beside another one.

    Attributes:
        first: the one to compare with.
        second: the one of which the verdict speaks.
        differences: second less first, by figure; none where they do not compare.
        phi: number of φ that the differences are over, of the first and of the second.
        refusals: why there is no verdict, a line each.
        warnings: what is to be known of the verdict, a line each.
    """

    first: StoredResult
    second: StoredResult
    differences: dict[str, Difference]
    phi: tuple[int, int]
    refusals: tuple[str, ...]
    warnings: tuple[str, ...]

    @property
    def verdict(self) -> str:
        """What the deformation says of the second car."""
        deformation = self.differences.get("deformation")
        if self.refusals or deformation is None or deformation.interval is None:
            return NOT_COMPARED
        return _VERDICTS[deformation.direction]

    @property
    def design(self) -> str:
        """How the cars were held against each other, in a few words."""
        deformation = self.differences.get("deformation")
        if deformation is None:
            return NOT_COMPARED
        if not deformation.paired:
            return f"unpaired, {self.phi[0]} and {self.phi[1]} φ"
        same = self.first.figures["seed"] == self.second.figures["seed"]
        return f"paired on {self.phi[0]} φ {'and draws' if same else '(other draws)'}"

    def as_dict(self) -> dict[str, Any]:
        """Return the entry of comparison.json."""
        return {
            "first": str(self.first.folder),
            "second": str(self.second.folder),
            "verdict": self.verdict,
            "design": self.design,
            "refusals": list(self.refusals),
            "differences": {name: one.as_dict() for name, one in self.differences.items()},
        }


def compare(first: StoredResult, second: StoredResult, confidence: float = 0.95) -> Comparison:
    """Hold one assessment against another, on the φ that both have where there are such."""
    refused, doubts = refusals(first, second), warnings(first, second)
    if refused:
        return Comparison(first, second, {}, (len(first.safe), len(second.safe)), tuple(refused), tuple(doubts))
    shared = _shared(first, second)
    # By chance a few φ are the same for different seeds too: then the others are not thrown away.
    paired = len(shared) == min(len(first.safe), len(second.safe))
    ours = [one for one, _ in shared] if paired else list(range(len(first.safe)))
    theirs = [other for _, other in shared] if paired else list(range(len(second.safe)))
    if paired and (len(ours) < len(first.safe) or len(theirs) < len(second.safe)):
        doubts.append(
            f"{first.folder} and {second.folder} have {len(ours)} of {len(first.safe)} and {len(second.safe)} φ in "
            "common: the difference is of these alone"
        )
    found = {
        name: difference(_of(first, name, ours), _of(second, name, theirs), paired=paired, confidence=confidence)
        for name in _FIGURES
    }
    differences = {name: one for name, one in found.items() if one is not None}
    return Comparison(first, second, differences, (len(ours), len(theirs)), (), tuple(doubts))


def _of(result: StoredResult, name: str, rows: Sequence[int]) -> list[FloatArray]:
    return [result.groups[name][row] for row in rows]


def _shared(first: StoredResult, second: StoredResult) -> list[tuple[int, int]]:
    """Return the places of the φ that both have, each counted once."""
    places: dict[bytes, list[int]] = {}
    for index, one in reversed(list(enumerate(second.safe))):
        places.setdefault(one.tobytes(), []).append(index)
    found = [(index, places.get(one.tobytes())) for index, one in enumerate(first.safe)]
    return [(index, left.pop()) for index, left in found if left]


def refusals(first: StoredResult, second: StoredResult) -> list[str]:
    """Return why a difference between two assessments would say nothing about their cars, a line each."""
    between = f"{first.folder} and {second.folder}"
    found = []
    ours, theirs = first.figures, second.figures
    if ours["eta_max"] != theirs["eta_max"]:
        found.append(f"{between} have different η_max, {ours['eta_max']:g} and {theirs['eta_max']:g}")
    if first.objective != second.objective:
        found.append(f"{between} are of kamikazes of different objectives, {first.objective} and {second.objective}")
    limits = ours.get("maximum_distance"), theirs.get("maximum_distance")
    if limits[0] != limits[1]:
        found.append(f"{between} have different maximum distances, {limits[0]} and {limits[1]}")
    if differs := encounter_difference(ours["scenario"], theirs["scenario"]):
        key, here, there = differs
        if key != "eta_max":
            found.append(f"{between} are of different encounters: {key} is {here} and {there}")
    kinds = ours["safe"], theirs["safe"]
    if kinds[0] != kinds[1] and not _shared(first, second):
        found.append(f"{between} are of different φ, from {kinds[0]} and {kinds[1]}: their deformations do not compare")
    return found


def warnings(first: StoredResult, second: StoredResult) -> list[str]:
    """Return what makes a difference between two assessments less certain than it looks, a line each."""
    between = f"{first.folder} and {second.folder}"
    found = []
    ours, theirs = first.figures, second.figures
    if len(_shared(first, second)) < min(len(first.safe), len(second.safe)) and ours["safe"] == theirs["safe"]:
        why = {OWN: "made against each car", SYNTHETIC: "of different seeds"}.get(
            str(ours["safe"]), "others of one set"
        )
        found.append(f"{between} are of different φ, {why}: compared as two samples, which takes more φ to tell apart")
    for name, what in (("seed", "seeds"), ("simulations", "budgets of the planner"), ("version", "versions of SKD")):
        if ours.get(name) != theirs.get(name):
            found.append(f"{between} have different {what}, {ours.get(name)} and {theirs.get(name)}")
    return found
