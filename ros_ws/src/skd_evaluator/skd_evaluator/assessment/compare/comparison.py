"""Compare two assessments: whether one car is safer than the other, and how sure that is.

Margin and risk decide, for they depend on the car alone: a car is safer if the margin and the risk at every scale say
so or tie, and one of them says so; and if the estimate of neither the margin nor R(2), the risk that ranks, points the
other way: what is no longer a tie need not be significant to withhold it. Figures of planned kamikazes depend on car
and adversary: they are compared only if adversary model and objective were the same, and decide only where a
car has no margin.

Safety has a price (`metrics/price_of_caution.py`), which the verdict names; a car that does not get past people is not
called safer. Nor is one that hits harder, in nearly all trials.

A margin whose search has not converged is an upper bound: a car of which no more is known is never the safer one. What
a search may have missed is part of the interval of the difference.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from skd_sim.world.state import FloatArray

from skd_evaluator.assessment.compare.comparability import (
    OF_SKD,
    PLANNED,
    different_phi,
    different_roads,
    refusals,
    shared,
    unlike_behaviours,
    unlike_plans,
    unlike_skd,
    warnings,
)
from skd_evaluator.assessment.figure_table import AT_THE_TOP, Better, Of, shown_in
from skd_evaluator.assessment.files.results import StoredResult
from skd_evaluator.metrics.clustered import clustered_rate
from skd_evaluator.metrics.difference import Difference, difference
from skd_evaluator.metrics.margins import CONVERGED_WITHIN, longer_search, stopped_at
from skd_evaluator.metrics.price_of_caution import price_differences, stored_price
from skd_evaluator.metrics.risks import RANKS
from skd_evaluator.metrics.statistics import mean

SAFER, LESS_SAFE, INCONCLUSIVE, NOT_COMPARED = "safer", "less safe", "inconclusive", "not compared"
SAME = "the same in every trial"
AS_SAFE, AS_SAFE_WITHIN = "as safe", 0.1  # of the lesser margin
EACH = " for each harmless road user"
STUCK = "not called safer, for it is often stuck"
OTHER_STUCK = "not called less safe, for the other is often stuck"
MARGIN, DEVIATION, IMPACT = "margin", "deviation", "impact_speed"
RANKING_RISK = f"risk_{RANKS:g}"
RISKS = tuple(one.key for one in AT_THE_TOP.values() if one.of is Of.RISK and one.difference)
_SIGNS = {name: 1 if AT_THE_TOP[name].better is Better.MORE else -1 for name in (MARGIN, DEVIATION, *RISKS)}
HARDER, MOST_IMPACTS = 2.0, 0.9
"""m/s, and the share of impacts that are harder by more, from which on a car is not called safer."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """What an assessment says of its car beside another one.

    Attributes:
        first: the result to compare with.
        second: the result about which the verdict is.
        differences: second less first, by figure; none where they cannot be compared.
        phi: number of φ that the differences are over, of the first and of the second.
        refusals: why there is no difference at all, a line each.
        planned_refusal: why figures of planned kamikazes are not compared, in one line; empty where they are.
        warnings: what a reader should know of the verdict, a line each.
        price: how much later the second car gets past a harmless road user, s; None: not known.
        harder: share of the second car's impacts that are surely harder, if they are; less 0: of the first car's.
    """

    first: StoredResult
    second: StoredResult
    differences: dict[str, Difference]
    phi: tuple[int, int]
    refusals: tuple[str, ...]
    planned_refusal: str
    warnings: tuple[str, ...]
    price: Difference | None = None
    harder: float = 0.0

    @property
    def judged_by(self) -> str | None:
        """Figure by which the verdict is made: the margin, else the planned deviation; None without a verdict."""
        for name in (MARGIN, DEVIATION):
            if name in self.differences:
                return name if self.differences[name].interval is not None else None
        return None

    @property
    def verdict(self) -> str:
        """What is said of the second car: the first of these rows that holds."""
        said, keeps_out = self._said, self._keeps_out
        later = self.price.value if self.price is not None and self.price.direction else 0.0
        quicker = f"{abs(later):.1f} s {'quicker' if later < 0.0 else 'slower'}{EACH}"
        rows = (
            (self.judged_by is None, NOT_COMPARED),
            (said >= 0 and bool(keeps_out), keeps_out),
            (said > 0 and later > 0.0, f"{SAFER} at the price of {later:.1f} s{EACH}"),
            (said > 0, SAFER),
            (said < 0 and later < 0.0, f"{LESS_SAFE}, and {quicker}"),
            (said < 0, LESS_SAFE),
            (later != 0.0 and self._as_safe, f"{AS_SAFE}, and {quicker}"),
            (self.is_same, SAME),
        )
        return next((verdict for holds, verdict in rows if holds), INCONCLUSIVE)

    @property
    def is_same(self) -> bool:
        """Whether both are on the same φ, and the same in every trial to the last digit."""
        ours, theirs = self.first.groups, self.second.groups
        return (
            self.second.same_safe(self.first.safe)
            and ours.keys() == theirs.keys()
            and all(
                np.array_equal(np.concatenate(ours[key]), np.concatenate(theirs[key]), equal_nan=True) for key in ours
            )
        )

    @property
    def by_figures(self) -> int:
        """1: margin and risk say that the second car is safer; −1: less safe; 0: nothing, or they disagree."""
        says = set(self._sure.values())
        return 0 if len(says) != 1 or self.opposed else says.pop()

    @property
    def _said(self) -> int:
        """The same, 0 too where the safer car's margin is an upper bound, or its impacts are much harder."""
        said = self.by_figures
        return 0 if said and (self.is_bound[said > 0] or self.harder * said > 0.0) else said

    @property
    def _as_safe(self) -> bool:
        """Whether nothing tells the cars apart, and their margins surely differ by at most `AS_SAFE_WITHIN`."""
        found = self.differences.get(MARGIN)
        if found is None or found.interval is None or self._sure or self.harder or any(self.is_bound):
            return False
        least = min(mean(np.concatenate(one.groups[MARGIN])) for one in (self.first, self.second))
        return max(map(abs, found.interval)) <= AS_SAFE_WITHIN * least

    @property
    def _keeps_out(self) -> str:
        """That one car has the greater figure, and alone does not get past people; else empty."""
        prices = (stored_price(one.figures) for one in (self.first, self.second))
        first, second = (one is not None and one.does_not_get_past for one in prices)
        judge = self.judged_by
        leaning = 0 if judge is None else _SIGNS[judge] * self.differences[judge].leaning
        if second and not first and leaning > 0:
            return STUCK
        return OTHER_STUCK if first and not second and leaning < 0 else ""

    @property
    def reason(self) -> str:
        """Why the verdict is withheld, in a few words; empty where it is not, or where nothing tells the cars apart."""
        rows = (
            (len(set(self._sure.values())) == 2, f"{'margin and risk' if MARGIN in self._sure else 'risks'} disagree"),
            (self.bounded is not None, "upper bound"),
            (bool(self.opposed), f"{_labels(self.opposed)} points the other way"),
            (self.harder * self.by_figures > 0.0, "its impacts are harder"),
        )
        return next((why for holds, why in rows if holds), "") if self.verdict == INCONCLUSIVE else ""

    @property
    def bounded(self) -> StoredResult | None:
        """The car that would be the safer one, were its margin not an upper bound; None where there is no such."""
        margin = self.differences[MARGIN].direction if self.judged_by == MARGIN else 0
        held = (side > 0 for side in (margin, self.by_figures) if side and self.is_bound[side > 0])
        return next(((self.first, self.second)[side] for side in held), None)

    @property
    def is_bound(self) -> tuple[bool, bool]:
        """Whether the margin of the first and of the second car is but an upper bound."""
        first, second = (one.figures["margin_converged"] is False for one in (self.first, self.second))
        return first, second

    @property
    def votes(self) -> dict[str, int]:
        """What decides, by figure: 1: the second car is safer; −1: less safe; 0: inconclusive."""
        votes = {name: _SIGNS[name] * self.differences[name].direction for name in self._deciding}
        if votes.get(MARGIN) and self.is_bound[votes[MARGIN] > 0]:
            votes[MARGIN] = 0  # the greater margin may be less
        return votes

    @property
    def opposed(self) -> tuple[str, ...]:
        """Of margin and R(2) those that are inconclusive, and point away from all figures that do.

        Risks at other scales oppose where they are sure: where φ itself is dangerous for a car, people who deviate
        three times as much are hit less, and few who deviate once are hit by a good one.
        """
        says = set(self._sure.values())
        requested = [name for name in self._deciding if name not in RISKS or name == RANKING_RISK]
        return tuple(name for name in requested if says == {-_SIGNS[name] * self.differences[name].leaning})

    @property
    def behind_by(self) -> str | None:
        """Figure by which the second car is surely less safe while none says surely that it is safer; None: no such.

        It decides at a gate, which does not wait until all estimates point one way.
        """
        return next(iter(self._sure)) if set(self._sure.values()) == {-1} else None

    @property
    def _sure(self) -> dict[str, int]:
        """Of `votes` those that are not inconclusive."""
        return {name: vote for name, vote in self.votes.items() if vote}

    @property
    def _deciding(self) -> list[str]:
        return [name for name in (self.judged_by, *RISKS) if name is not None and name in self.differences]

    @property
    def decided_by(self) -> str | None:
        """Figure that decides: a risk, where the margin is inconclusive and the risk is not."""
        stated = list(self._sure)
        undecided = self.verdict in (INCONCLUSIVE, NOT_COMPARED) or not stated
        return self.judged_by if undecided or self.judged_by in stated else stated[0]

    @property
    def design(self) -> str:
        """How the cars were compared, in a few words."""
        judge = next((self.differences[name] for name in (MARGIN, DEVIATION) if name in self.differences), None)
        if judge is None:
            return NOT_COMPARED
        if not judge.paired:
            return f"unpaired, {self.phi[0]} and {self.phi[1]} φ"
        same = self.first.figures["seed"] == self.second.figures["seed"]
        return f"paired on {self.phi[0]} φ {'and draws' if same else '(other draws)'}"

    def lines(self) -> list[str]:
        """Return everything that has to be said beside the verdict, a line each."""
        of_plans = self.planned_refusal if MARGIN not in self.differences else ""
        return [*self.refusals, *([of_plans] if of_plans else []), *self.warnings]

    def as_dict(self) -> dict[str, Any]:
        """Return the entry of comparison.json."""
        return {
            "first": str(self.first.folder),
            "second": str(self.second.folder),
            "verdict": self.verdict,
            "reason": self.reason,
            "judged_by": self.decided_by,
            "opposed_by": list(self.opposed),
            "design": self.design,
            "refusals": list(self.refusals),
            "planned_refusal": self.planned_refusal,
            "differences": {name: one.as_dict() for name, one in self.differences.items()},
            "price": self.price and self.price.as_dict(),
        }


def compare(first: StoredResult, second: StoredResult, confidence: float = 0.95) -> Comparison:
    """Compare one assessment with another, on the φ that both have if there are any."""
    refused, remarks, unlike = refusals(first, second), warnings(first, second), planned_refusal([first, second])
    if refused:
        count = (len(first.safe), len(second.safe))
        return Comparison(first, second, {}, count, tuple(refused), unlike, tuple(remarks))
    remarks = [*different_phi(first, second), *different_roads(first, second), *remarks]
    both = shared(first, second)
    # By chance a few φ are the same for different seeds too: then the others are not thrown away.
    paired = len(both) == min(len(first.safe), len(second.safe))
    ours = [one for one, _ in both] if paired else list(range(len(first.safe)))
    theirs = [other for _, other in both] if paired else list(range(len(second.safe)))
    if paired and (len(ours) < len(first.safe) or len(theirs) < len(second.safe)):
        remarks.append(
            f"{first.folder} and {second.folder} are compared on the {len(ours)} φ that both have, of "
            f"{len(first.safe)} and {len(second.safe)}"
        )
    left_out = _left_out(first, second, planned=not unlike)
    same = paired and first.figures["seed"] == second.figures["seed"]
    found = {
        name: difference(
            *_values(name, (first, ours), (second, theirs), same=same),
            paired=paired,
            # All scales of the risk together err no more often than the margin.
            confidence=1.0 - (1.0 - confidence) / len(RISKS) if name in RISKS else confidence,
        )
        for name in (one.key for one in shown_in("difference"))
        if name not in left_out
    }
    differences = {name: one for name, one in found.items() if one is not None}
    if MARGIN in differences:
        ends = _missed(first, second, ours), _missed(second, first, theirs)
        differences[MARGIN] = differences[MARGIN].widened(below=ends[1], above=ends[0])
    prices = price_differences(first.figures, second.figures, confidence)
    price = prices.pop("late", None)
    more = less = 0.0
    if all(IMPACT in one.groups for one in (first, second)):
        speeds = _of(first, IMPACT, ours), _of(second, IMPACT, theirs)
        more, less = harder(*speeds, same=same), harder(*speeds[::-1], same=same)
    held = Comparison(
        first, second, differences | prices, (len(ours), len(theirs)), (), unlike, (), price, more or -less
    )
    return replace(held, warnings=(*_of_the_judge(held), *_of_the_risks(held), *_of_the_impacts(held), *remarks))


def harder(first: Sequence[FloatArray], second: Sequence[FloatArray], *, same: bool) -> float:
    """Return the share of the second car's impacts that are harder by more than `HARDER`; 0 unless surely nearly all.

    Args:
        first: per φ the impact speed of each trial, m/s; nan where nobody is hit.
        second: the same of the second car.
        same: whether trials are of the same φ and draws: then each is compared with its own, else with all.
    """
    if same:
        pairs = [(one[: len(other)], other[: len(one)]) for one, other in zip(first, second, strict=True)]
        shares = [(other > one + HARDER)[~np.isnan(one + other)] for one, other in pairs]
    else:
        known = np.concatenate(first) if len(first) else np.empty(0)
        known = known[~np.isnan(known)]
        shares = [(one[~np.isnan(one), None] > known + HARDER).mean(axis=1) for one in second] if known.size else []
    counts = [(round(float(one.sum())), one.size) for one in shares if one.size]
    found = clustered_rate(counts) if counts else None
    surely = found is not None and found.interval is not None and found.interval[0] >= MOST_IMPACTS
    return found.value if found is not None and surely else 0.0


def _missed(one: StoredResult, other: StoredResult, rows: Sequence[int]) -> tuple[float, float]:
    """Return how much too high the margin of a result may be, and with which standard error, m.

    Of two searches that stopped at different places, the shorter one has missed more: both may have missed as much as
    one may that has converged.
    """
    excess = one.figures.get("margin_excess") or {"mean": 0.0, "error": 0.0}
    missed = float(excess["mean"])
    if _unlike_budgets(one, other):
        missed = max(missed, CONVERGED_WITHIN * mean(np.concatenate(_of(one, MARGIN, rows))))
    return missed, float(excess["error"])


def _unlike_budgets(one: StoredResult, other: StoredResult) -> bool:
    budgets = {result.figures.get("margin_budget") for result in (one, other)}
    return None not in budgets and len(budgets) == 2


def _left_out(first: StoredResult, second: StoredResult, *, planned: bool) -> set[str]:
    """Return the figures that are not compared: those that one result lacks, and planned ones that cannot be compared.

    Only figures that both results have are compared: old results do not tell a hit from any other touch.
    """
    figures = first.figures, second.figures
    left_out = set() if planned else set(PLANNED)
    if planned and unlike_skd(figures):
        left_out |= set(OF_SKD)
    if any(MARGIN not in one.groups for one in (first, second)):
        left_out.add(MARGIN)
    if any(one["nominal_collision_rate"] is None for one in figures):
        left_out.add("nominal_collision_rate")
    unlike = unlike_behaviours(first, second)
    left_out |= {name for name in RISKS if unlike or any(name not in one.groups for one in (first, second))}
    return left_out


def _of_the_risks(held: Comparison) -> list[str]:
    """Return what a reader should know of the risks beside the verdict, a line each."""
    first, second = held.first.folder, held.second.folder
    if unlike := unlike_behaviours(held.first, held.second):
        return [f"risks of {first} and {second} are not compared: their behaviour models are {unlike}"]
    better, worse = ([name for name, vote in held.votes.items() if vote == sign] for sign in (1, -1))
    if better and worse:
        said = f"better by {_labels(better)} and worse by {_labels(worse)}"
        disagree = "margin and risk disagree: " if MARGIN in (*better, *worse) else ""
        return [f"inconclusive: {disagree}{second} is {said} than {first}"]
    if held.bounded is not None:
        return []
    if held.opposed:
        sure, unsure = ("better", "worse") if better else ("worse", "better")
        said = f"{sure} than {first} by {_labels(better or worse)}, but its {_labels(held.opposed)} looks {unsure}"
        return [f"inconclusive: {second} is {said}, if not significantly"]
    return []


def _of_the_impacts(held: Comparison) -> list[str]:
    """Return that a car with more room is hit much harder, which withholds the verdict."""
    if held.harder * held.by_figures <= 0.0:
        return []
    one, other = (held.second, held.first) if held.harder > 0.0 else (held.first, held.second)
    share = f"{100.0 * abs(held.harder):.0f} % of the impacts of {one.folder} are harder by more than {HARDER:g} m/s"
    return [f"{share} than those of {other.folder}: it is not called the safer one"]


def _labels(figures: Sequence[str]) -> str:
    return ", ".join(AT_THE_TOP[name].label for name in figures)


def _of_the_judge(held: Comparison) -> list[str]:
    """Return what a reader should know of the figure by which the verdict is made, a line each."""
    both = held.first, held.second
    found = []
    if MARGIN in held.differences:
        for one, is_bound in zip(both, held.is_bound, strict=True):
            if is_bound:
                said = f"the margin of {one.folder} is at most {mean(np.concatenate(one.groups[MARGIN])):.3f} m"
                why = f"its search {stopped_at(one.figures)}"
                if one is held.bounded and held.verdict == INCONCLUSIVE:
                    why = f"and may be less: {longer_search(one.figures)}"
                found.append(f"{said}, {why}")
        if _unlike_budgets(*both):
            budgets = " and ".join(str(one.figures["margin_budget"]) for one in both)
            allowed = f"the interval allows for {100 * CONVERGED_WITHIN:g} % of each margin that a search may miss"
            found.append(f"the margins were searched with {budgets} candidates a trial; {allowed}")
        tracks = [re.sub(r"^by up to \d+ |;.*", "", one.figures["margin_how"] or "") for one in both]
        if tracks[0] != tracks[1]:
            said = " and ".join(track or "runs in process" for track in tracks)
            found.append(f"the margins were found in different ways: {said}")
        deviation = held.differences.get(DEVIATION)
        if deviation is not None and held.differences[MARGIN].direction * deviation.direction < 0:
            found.append(
                "planned deviations say the opposite of the margins, and do not decide: plans depend on the adversary"
            )
        return found
    unknown = [(one.folder, one.figures["margin_note"]) for one in both if MARGIN not in one.groups]
    without = [f"{folder} ({note})" if note else str(folder) for folder, note in unknown]
    judged = (
        "judged by planned deviations, which are of car and adversary, with the same adversary model"
        if held.differences.get(DEVIATION) is not None
        else "not judged"
    )
    return [f"no margin of {' and of '.join(without)}: {judged}"]


def _of(result: StoredResult, name: str, rows: Sequence[int]) -> list[FloatArray]:
    return [result.groups[name][row] for row in rows]


def _values(
    name: str, *sides: tuple[StoredResult, Sequence[int]], same: bool
) -> tuple[list[FloatArray], list[FloatArray]]:
    """Return the values of both cars by φ: of a risk only the crossings that both have, so that they pair.

    Estimates of subset simulation have no crossings to pair, and stay as they are.
    """
    first, second = (_of(one, name, rows) for one, rows in sides)
    if same and name in RISKS and all(np.isin(group, (0.0, 1.0)).all() for group in (*first, *second)):
        counts = [min(len(one), len(other)) for one, other in zip(first, second, strict=True)]
        first, second = ([one[:count] for one, count in zip(side, counts, strict=True)] for side in (first, second))
    return first, second


def ranking_figure(results: Sequence[StoredResult]) -> str | None:
    """Return the figure by which results can be ranked: the margin, else the planned deviation; None: neither.

    Neither, if one of them cannot be compared with the first. The margin, if each result has one; the planned
    deviation, if not all have a margin and all planned figures can be compared.
    """
    if any(refusals(results[0], other) for other in results[1:]):
        return None
    if all(MARGIN in one.groups for one in results):
        return MARGIN
    figures = [one.figures for one in results]
    unknown = any(one["deviation"] is None for one in figures)
    return None if unknown or unlike_plans(figures) else DEVIATION


def planned_refusal(results: Sequence[StoredResult]) -> str:
    """Return why planned figures of some results cannot be compared, in one line; empty if they can."""
    unlike = unlike_plans(one.figures for one in results)
    of = " and ".join(str(one.folder) for one in results)
    return f"planned figures are not compared: {of} have {unlike}" if unlike else ""
