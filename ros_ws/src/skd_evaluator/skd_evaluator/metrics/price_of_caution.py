"""The price of caution: what a car's safety costs where nothing has to be avoided.

A car that always stops never hits. So it drives past road users who are not in its path, each time with the draws of a
drive on the empty road, and the price is what the two differ by.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from skd_sim.world.state import FloatArray

from skd_evaluator.metrics.clustered import student_quantile
from skd_evaluator.metrics.difference import Difference, difference
from skd_evaluator.metrics.statistics import Interval, jeffreys_interval, mean, sample_variance

HORIZON: Final = 30.0
"""s after which a car that has not passed is taken for one that never will."""
HARD_BRAKING: Final = 2.45
"""m/s², 0.25 g: braking that FMVSS 127 (Federal Register 2024-09054) calls a false activation."""
BRAKING_LASTS: Final = 0.2
"""s for which it lasts, at least."""
DEADLOCK: Final = 0.05
"""Share of harmless runs without getting past, above which a car is said not to get past people."""


class HarmlessRun(NamedTuple):
    """A drive past a road user who is not in the car's path, and the same drive on the empty road.

    Attributes:
        kind: what the road user does.
        passed: time at which the car had passed, s; `HORIZON` where it had not by then, or had hit.
        undisturbed: the same on the empty road, s.
        unslowed: the same at the start speed, s.
        braked: whether it braked hard here alone.
        lane_left: for how long a corner was beyond its lane, s.
    """

    kind: str
    passed: float
    undisturbed: float
    unslowed: float
    braked: bool
    lane_left: float = 0.0

    @property
    def lost(self) -> float:
        """Time that the road user costs the car, s; below 0 where it is quicker than on the empty road."""
        return self.passed - self.undisturbed

    @property
    def slow(self) -> float:
        """Time by which the car is later than at its start speed on the empty road, s."""
        return self.undisturbed - self.unslowed

    @property
    def late(self) -> float:
        """Both together, s: what two cars differ by."""
        return self.passed - self.unslowed


VALUES: Final[Mapping[str, Callable[[HarmlessRun], float]]] = {
    "time_lost": lambda run: run.lost,
    "slow": lambda run: run.slow,
    "needless": lambda run: float(run.braked),
    "deadlock": lambda run: float(run.passed >= HORIZON),
    "late": lambda run: run.late,
}
"""By figure, what each run says: times, s, and whether it brakes without need, or has not passed after `HORIZON`."""
_SHARES: Final = ("needless", "deadlock")


@dataclass(frozen=True)
class PriceOfCaution:
    """What caution costs a car.

    Attributes:
        runs: harmless runs that were not aborted, at least one.
        aborted: how many were.
    """

    runs: tuple[HarmlessRun, ...]
    aborted: int = 0

    def mean(self, name: str) -> float:
        """Return the mean of one of `VALUES` over all runs, s, or its share of them."""
        return mean(self._of(name))

    def ci95(self, name: str) -> Interval | None:
        """Return the 95 % interval of it; None where a kind, the strata of `time_lost` and `late`, has one run.

        These have two parts, each with its own interval: what a run that never passes typically costs more than the
        others, times the share of such runs, which may be rare; and the rest. Both are joined by the method of variance
        estimates recovery (Zou and Donner, Statistics in Medicine 27, 2008).
        """
        values = self._of(name)
        if name in _SHARES:
            return jeffreys_interval(round(sum(values)), len(values))
        if name == "slow":
            return stratified_interval([""] * len(values), np.array(values))
        stuck = self._of("deadlock")
        passing = [value for value, is_stuck in zip(values, stuck, strict=True) if not is_stuck]
        never = mean([VALUES[name](one._replace(passed=HORIZON)) for one in self.runs]) - mean(passing or [0.0])
        rest = np.array(values) - never * np.array(stuck)
        of_rest, share = stratified_interval([one.kind for one in self.runs], rest), self.ci95("deadlock")
        if of_rest is None or share is None:
            return None
        below, above = (math.hypot(never * (mean(stuck) - share[end]), mean(rest) - of_rest[end]) for end in (0, 1))
        return mean(values) - below, mean(values) + above

    def _of(self, name: str) -> list[float]:
        return [VALUES[name](one) for one in self.runs]

    @property
    def time_lost(self) -> float | None:
        """Mean time lost, s; None of a car that never passes, on the empty road either: it has none to lose."""
        return self.mean("time_lost") if any(one.undisturbed < HORIZON for one in self.runs) else None

    @property
    def lanes_left(self) -> tuple[float, float] | None:
        """In which share of the runs the car leaves its lane, and for how long, s; None: in none."""
        return lanes_left([one.lane_left for one in self.runs])

    @property
    def does_not_get_past(self) -> bool:
        """Whether the car surely does not get past people, in more than `DEADLOCK` of the runs."""
        return does_not_get_past({"deadlock_ci95": self.ci95("deadlock")})

    def as_dict(self) -> dict[str, Any]:
        """Return the entry `price_of_caution` of assessment.json."""
        return {
            "horizon": HORIZON,
            "hard_braking": HARD_BRAKING,
            "aborted": self.aborted,
            "runs": [one._asdict() for one in self.runs],
        }


def lanes_left(times: Sequence[float]) -> tuple[float, float] | None:
    """Return the share of runs in which the car leaves its lane, and the mean time of those, s; None: in none.

    Args:
        times: for how long it does in each, s; nan of an aborted run.
    """
    known = np.array(times)[np.isfinite(times)]
    return (float(np.mean(known > 0.0)), float(known[known > 0.0].mean())) if known.any() else None


def stored_price(figures: Mapping[str, Any]) -> PriceOfCaution | None:
    """Return the price that the content of assessment.json has; None where it is not known."""
    entry = figures.get("price_of_caution")
    return entry and PriceOfCaution(tuple(HarmlessRun(**one) for one in entry["runs"]), entry["aborted"])


def price_differences(first: Mapping[str, Any], second: Mapping[str, Any], confidence: float) -> dict[str, Difference]:
    """Return how much more caution costs the second car, by figure; nothing where one of the prices is not known.

    `late` is the time of passing itself, which a verdict names. Runs are paired where draws are the same.

    Args:
        first: content of an assessment.json.
        second: the same of the other car.
        confidence: of each interval.
    """
    prices = [price for price in (stored_price(first), stored_price(second)) if price is not None]
    if len(prices) < 2:
        return {}
    same = first["seed"] == second["seed"] and len(prices[0].runs) == len(prices[1].runs)
    paired = same and not any(one.aborted for one in prices)
    found = {
        name: difference(*([[of(run)] for run in one.runs] for one in prices), paired=paired, confidence=confidence)
        for name, of in VALUES.items()
    }
    return {name: one for name, one in found.items() if one is not None}


def does_not_get_past(figures: Mapping[str, Any]) -> bool:
    """Return whether a car surely does not get past people, by the figures of its assessment; see `DEADLOCK`."""
    interval = figures.get("deadlock_ci95")
    return interval is not None and interval[0] > DEADLOCK


def stratified_interval(kinds: Sequence[str], values: FloatArray) -> Interval | None:
    """Return the 95 % interval of a mean over strata, each with the share that it has of the values.

    Student's t with Satterthwaite's degrees of freedom (Cochran, Sampling Techniques, 3rd ed. 1977, section 5.4). The
    end on the side of the skewness is moved out by the term of Cornish and Fisher's expansion (Johnson, Journal of the
    American Statistical Association 73, 1978). None where a stratum has a single value.
    """
    squares, cubes, freedom = [], [], 0.0
    for kind in dict.fromkeys(kinds):
        group = values[[one == kind for one in kinds]]
        variance, share = sample_variance(group), group.size / values.size
        if variance is None:
            return None
        squares.append(share**2 * variance / group.size)
        cubes.append(share**3 * mean((group - mean(group)) ** 3) / group.size**2)
        freedom += squares[-1] ** 2 / (group.size - 1)
    centre, square = mean(values), math.fsum(squares)
    if square == 0.0:
        return centre, centre
    quantile = student_quantile(square**2 / freedom, 0.95)
    half, skew = quantile * math.sqrt(square), math.fsum(cubes) / (6.0 * square) * (1.0 + 2.0 * quantile**2)
    return centre - half + min(0.0, skew), centre + half + max(0.0, skew)
