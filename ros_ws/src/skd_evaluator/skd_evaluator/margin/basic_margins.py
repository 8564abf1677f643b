"""What the equivalent multiplier is read off: margins of basic cars in the attempts of the car that is rated.

A basic car is put in the place of the car under test: the same encounter, φ, seed and numbers of attempts, and so the
same draws. It is the basic car of the paper, which decides once a tick and moves as the paper says, whatever the clock
and the dynamics of the car that is rated: the yardstick is one for all cars, and its margins are exact.

C are hundredths. They are asked for as they are needed: C whose margins lie on both sides of the car's are searched by
bisection, and then those at which the difference is told apart from 0. That depends on the car's margins alone, and not
on what was kept from before, nor on time or the number of workers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt
from skd_sim.dynamics.kinds import BASIC
from skd_sim.encounter.scenario import Scenario
from skd_sim.episode import Episode, Mode
from skd_sim.simulator_registry import WORLD
from skd_sim.trajectory import FloatArray, Trajectory

from skd_evaluator.campaign.executor_runner import ExecutorRunner
from skd_evaluator.campaign.plan import Plan, Progress
from skd_evaluator.margin.exact import exact_margin
from skd_evaluator.margin.margin_cache import MarginCache, margins_key, users_cache
from skd_evaluator.measure.equivalent_multiplier import (
    Difference,
    EquivalentMultiplier,
    difference,
    equivalent_multiplier,
)

LABEL = "basic cars"
LOWEST: Final = 25
HIGHEST: Final = 200
"""Of C, in hundredths."""
_COARSE, _FINE = 5, 1  # hundredths between the C that are asked for: at first, and around the value and interval ends
_PROBES = (25, 50, 75, 100, 115, 130, 150, 200)
_FIRST = 3  # of the probes: the margin of a C takes the longer the greater it is
_QUICK = 115  # hundredths, up to which the margin of an attempt takes milliseconds
_MOST_QUICK, _MOST_SLOW = 1000, 100
"""Attempts in all, up to C = `_QUICK` and above."""


def yardstick(plan: Plan, multiplier: float) -> Plan:
    """Return the plan with the basic car in the place of the car under test.

    On a road with curves it moves as the car under test does, for somebody has to steer.
    """
    scenario = replace(plan.scenario, control_period=None)
    if scenario.road.straight:
        scenario = replace(scenario, car=replace(scenario.car, dynamics=BASIC))
    return replace(plan, scenario=scenario, controller="basic", multiplier=multiplier, car_model="", simulator=WORLD)


def exact_for(scenario: Scenario) -> bool:
    """Tell whether margins of the basic car are exact in an encounter."""
    return scenario.road.straight and not scenario.pedestrian.is_box


def attempts_of(hundredths: int, safe_count: int, attempts: int) -> int:
    """Return how many attempts on each φ, from number 0 on, the basic car of a C is compared in."""
    most = _MOST_QUICK if hundredths <= _QUICK else _MOST_SLOW
    return min(attempts, math.ceil(most / safe_count))


def _margin_of(episode: Episode) -> float:
    eta_max = episode.scenario.eta_max
    found = exact_margin(episode)
    return eta_max if found is None else min(found.distance, eta_max)


@dataclass(frozen=True, eq=False)
class BasicMargins:
    """Margins of basic cars in the attempts of a plan, computed where they are missing and kept.

    Attributes:
        plan: of the car that is rated.
        safe: Φ.
        attempts: of the car, on each φ.
        runner: does the work.
        progress: told of it.
        cache: where margins are kept.
    """

    plan: Plan
    safe: Sequence[Trajectory]
    attempts: int
    runner: ExecutorRunner
    progress: Progress
    cache: MarginCache

    def at(self, hundredths: int) -> list[FloatArray]:
        """Return, per φ, the margin of attempts 0, 1, … of the basic car with C = `hundredths`/100, m."""
        multiplier = hundredths / 100
        plan = yardstick(self.plan, multiplier)
        count = attempts_of(hundredths, len(self.safe), self.attempts)
        key = margins_key(plan.scenario, self.safe, plan.seed, count, multiplier)
        known = self.cache.load(key, len(self.safe), count, plan.scenario.eta_max)
        if known is not None:
            return known
        episodes = [
            plan.episode(Mode.KAMIKAZE, index, attempt, phi)
            for index, phi in enumerate(self.safe)
            for attempt in range(count)
        ]
        found = np.empty(len(episodes))
        for number, margin in enumerate(self.runner.map(_margin_of, episodes)):
            found[number] = margin
            self.progress(f"{LABEL}, C = {multiplier:g}", number + 1, len(episodes))
        margins = list(found.reshape(len(self.safe), count))
        self.cache.save(key, margins)
        return margins


def equivalent_of(
    plan: Plan,
    safe: Sequence[Trajectory],
    margins_per_phi: Sequence[npt.ArrayLike],
    runner: ExecutorRunner,
    progress: Progress,
    cache: MarginCache | None = None,
) -> tuple[EquivalentMultiplier | None, str]:
    """Return the equivalent multiplier of a car, and in one line what it was read off, or why there is none.

    Args:
        plan: of the car.
        safe: Φ, as its episodes have it.
        margins_per_phi: per φ the margin of attempts 0, 1, …, m, at most η_max; nan: aborted.
        runner: does what is to be done.
        progress: told of it.
        cache: where margins of basic cars are kept; by default the user's.

    Raises:
        ValueError: margins of other φ than those of Φ.
    """
    if len(margins_per_phi) != len(safe):
        raise ValueError(f"there are margins of {len(margins_per_phi)} φ and {len(safe)} φ")
    car = [np.asarray(one, dtype=np.float64) for one in margins_per_phi]
    if not any(np.isfinite(one).any() for one in car):
        return None, "no attempt has a margin"
    scenario = plan.scenario
    if not exact_for(scenario):
        what = "a road with curves" if not scenario.road.straight else "an adversary that is a box"
        return None, f"the margin of the basic car is not known with {what}"
    attempts = max(len(one) for one in car)
    fewest = min(attempts_of(one, len(safe), attempts) for one in (LOWEST, HIGHEST))
    if not any(np.isfinite(one[:fewest]).any() for one in car):
        return None, f"none of the first {fewest} attempts on each φ has a margin"
    basic = BasicMargins(plan, safe, attempts, runner, progress, users_cache() if cache is None else cache)
    asked: dict[int, list[FloatArray]] = {}
    differences: dict[int, Difference] = {}

    def compared(hundredths: int) -> Difference:
        if hundredths not in differences:
            margins = basic.at(hundredths)
            found = difference(car, margins)
            assert found is not None  # as looked at above
            asked[hundredths], differences[hundredths] = margins, found
        return differences[hundredths]

    search(compared)
    found = equivalent_multiplier(car, {one / 100: margins for one, margins in asked.items()})
    return found, _said(asked, attempts, len(safe))


def search(compared: Callable[[int], Difference]) -> None:
    """Ask for the C that an equivalent multiplier and its intervals are read off.

    Args:
        compared: returns how much more margin the car has than the basic car of a C (hundredths), and keeps it.
    """

    def more(hundredths: int) -> bool:
        return compared(hundredths).mean > 0.0

    def surely_more(hundredths: int) -> bool:
        one = compared(hundredths)
        return all(interval[0] > 0.0 for interval in (one.ci95, one.ci95_attempts) if interval) and one.mean > 0.0

    def perhaps_more(hundredths: int) -> bool:
        one = compared(hundredths)
        return any(interval[1] >= 0.0 for interval in (one.ci95, one.ci95_attempts) if interval) or one.mean >= 0.0

    step = _FIRST
    if more(_PROBES[step]):
        while step + 1 < len(_PROBES) and more(_PROBES[step + 1]):
            step += 1
    else:
        while step > 0 and not more(_PROBES[step]):
            step -= 1
    low = high = _PROBES[step]
    if more(low) and low < HIGHEST:
        low, high = _halved(*_halved(low, _PROBES[step + 1], _COARSE, more), _FINE, more)
    _outwards(low, -1, lambda one: not surely_more(one))
    _outwards(high, 1, perhaps_more)


def _halved(low: int, high: int, width: int, holds: Callable[[int], bool]) -> tuple[int, int]:
    """Return neighbours, multiples of `width`, of which the lower one holds and the upper one does not.

    Args:
        low: multiple of the width that holds.
        high: a greater one that does not.
        width: of the grid.
        holds: looks at one of the grid.
    """
    while high - low > width:
        middle = low + (high - low) // (2 * width) * width
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low, high


def _outwards(start: int, side: int, inside: Callable[[int], bool]) -> None:
    """Look, from `start` to one side (−1, 1), for neighbouring hundredths between which `inside` ends."""
    last = LOWEST if side < 0 else HIGHEST
    near, stride = start, 2 * _FINE
    if not inside(near):
        return
    while True:
        far = max(near - stride, last) if side < 0 else min(near + stride, last)
        if far == near:
            return
        if not inside(far):
            break
        near, stride = far, 2 * stride
    if side < 0:
        _halved(far, near, _FINE, lambda one: not inside(one))
    else:
        _halved(near, far, _FINE, inside)


def _said(asked: dict[int, list[FloatArray]], attempts: int, safe_count: int) -> str:
    """Return what was compared, in one line."""
    low, high = min(asked) / 100, max(asked) / 100
    text = f"read off {len(asked)} basic cars, C = {low:g} to {high:g}, in the same attempts"
    parts = []
    for most, where in ((_QUICK, f"up to C = {_QUICK / 100:g}"), (HIGHEST, f"above C = {_QUICK / 100:g}")):
        used = {len(one[0]) for hundredths, one in asked.items() if (hundredths > _QUICK) == (most == HIGHEST)}
        if any(count < attempts for count in used):
            parts.append(f"{where} in the first {max(used)} of {attempts} on each of {safe_count} φ")
    return text + (f" ({'; '.join(parts)})" if parts else "")
