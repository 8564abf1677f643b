"""Margins of basic cars in the trials of the car that is rated: the equivalent multiplier follows from them.

A basic car is put in the place of the car under test: the same scenario, φ, seed and numbers of trials, and so the
same draws. It is the basic car of the paper, which decides once a tick and moves as the paper says, whatever the clock
and the dynamics of the car that is rated: all cars have the same yardstick, and its margins are exact.

C are hundredths. They are computed as they are needed: C whose margins lie on both sides of the car's are searched by
bisection, and then those at which the difference is told apart from 0. That depends on the car's margins alone, and not
on what was kept from before, nor on time or the number of workers.

Margins that were found are kept in the user's cache, beside compiled kernels: a file for a car and its trials, named
for all that its numbers depend on.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import Final
from zipfile import BadZipFile

import numpy as np
import numpy.typing as npt
from skd_adversary.crossing.road_users import AS_PHI
from skd_sim.errors import UsageError
from skd_sim.kernels.compilation import cache_folder
from skd_sim.options.car_and_adversary import BASIC, WORLD
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.episode import EpisodeSpec
from skd_sim.world.state import FloatArray, Trajectory

from skd_evaluator.assessment.context import Progress
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.workers import Workers
from skd_evaluator.files import keep
from skd_evaluator.margin.actions import velocities, why_not_exact
from skd_evaluator.margin.exact.exact import exact_margin
from skd_evaluator.metrics.margins import (
    EquivalentMultiplier,
    MarginDifference,
    difference,
    equivalent_multiplier,
)

LABEL = "margin, equivalent basic car"
LOWEST: Final = 25
HIGHEST: Final = 200
"""Of C, in hundredths."""
_COARSE, _FINE = 5, 1  # hundredths between the C that are computed: at first, and around the value and interval ends
_PROBES = (25, 50, 75, 100, 115, 130, 150, 200)
_FIRST = 3  # of the probes
_MOST, _MOST_OF_ANY_PACE = 1000, 200
"""Trials in all in which a basic car is compared, where every step of φ is one of the adversary's, and elsewhere: the
search for a margin has then some ten times as many places to look at."""
_SAME_STEP = 1e-9  # m


def yardstick(plan: Plan, multiplier: float) -> Plan:
    """Return the plan with the basic car in the place of the car under test.

    On a road with curves it moves as the car under test does, which can steer.
    """
    scenario = replace(plan.scenario, control_period=None)
    if scenario.road.straight:
        scenario = replace(scenario, car=replace(scenario.car, dynamics=BASIC))
    return replace(plan, scenario=scenario, controller="basic", multiplier=multiplier, car_model="", simulator=WORLD)


def unknown_for(plan: Plan) -> str:
    """Return, in a few words, why no basic car's margin is exact in this scenario; empty if it is."""
    basic = yardstick(plan, 1.0)
    return why_not_exact(basic.car, basic.scenario)


def trials_of(scenario: Scenario, safe: Sequence[Trajectory], trials: int) -> int:
    """Return how many trials on each φ, from number 0 on, basic cars are compared in.

    Args:
        scenario: the scenario of the test.
        safe: the safe trajectories Φ.
        trials: how many trials the car has on each φ.
    """
    most = _MOST if all(_steps_are_moves(scenario, phi) for phi in safe) else _MOST_OF_ANY_PACE
    return min(trials, math.ceil(most / len(safe)))


def _steps_are_moves(scenario: Scenario, phi: Trajectory) -> bool:
    steps = np.diff(phi.positions[:, :2], axis=0)
    moves = velocities(scenario, phi.positions, 0) * scenario.time_step
    own = np.delete(moves, AS_PHI, axis=0)
    apart = np.abs(steps[:, None, :] - own[None, :, :]).max(axis=2)
    return bool((apart.min(axis=1, initial=math.inf) <= _SAME_STEP).all())


def margin_of(episode: EpisodeSpec) -> float:
    """Return the margin of a trial of a basic car, at most η_max, m; nan where its search has no room."""
    eta_max = episode.scenario.eta_max
    try:
        found = exact_margin(episode)
    except UsageError:
        return math.nan
    return eta_max if found is None else min(found.distance, eta_max)


@dataclass(frozen=True, eq=False)
class BasicMargins:
    """Margins of basic cars in the trials of a plan, computed where they are missing and kept.

    Attributes:
        plan: the plan of the assessment of the car that is rated.
        safe: the safe trajectories Φ.
        trials: how many trials there are on each φ, from number 0 on.
        runner: computes the margins, in several processes.
        progress: called with how far the work is.
        cache: folder in which margins are kept; None: in the user's cache.
    """

    plan: Plan
    safe: Sequence[Trajectory]
    trials: int
    runner: Workers
    progress: Progress
    cache: Path | None

    def at(self, hundredths: int) -> list[FloatArray]:
        """Return, per φ, the margin of trials 0, 1, … of the basic car with C = `hundredths`/100, m."""
        multiplier = hundredths / 100
        plan = yardstick(self.plan, multiplier)

        def compute() -> tuple[FloatArray, bool]:
            episodes, found = plan.trials(self.safe, self.trials), list[float]()
            for margin in self.runner.map(margin_of, episodes):
                found.append(margin)
                self.progress(f"{LABEL}, C = {multiplier:g}", len(found), len(episodes))
            return np.array(found), True

        return kept_margins(plan, self.safe, self.trials, multiplier, compute, self.cache)[0]


def equivalent_of(
    plan: Plan,
    safe: Sequence[Trajectory],
    margins_per_phi: Sequence[npt.ArrayLike],
    runner: Workers,
    progress: Progress,
    cache: Path | None = None,
) -> tuple[EquivalentMultiplier | None, str]:
    """Return the equivalent multiplier of a car, and in one line what it was read off, or why there is none.

    Args:
        plan: the plan of the car's assessment.
        safe: Φ, as the car's episodes have it.
        margins_per_phi: for each φ the margins of trials 0, 1, …, m; a margin above η_max counts as η_max; nan: the
            trial was aborted.
        runner: computes margins of basic cars, in several processes.
        progress: called with how far the work is.
        cache: folder in which margins of basic cars are kept; by default in the user's cache.
    """
    car = [np.minimum(np.asarray(one, dtype=np.float64), plan.scenario.eta_max) for one in margins_per_phi]
    if not any(np.isfinite(one).any() for one in car):
        return None, "no trial has a margin"
    if where := unknown_for(plan):
        return None, f"the margin of the basic car is not known {where}"
    trials = max(len(one) for one in car)
    used = trials_of(plan.scenario, safe, trials)
    car = [one[:used] for one in car]
    if not any(np.isfinite(one).any() for one in car):
        return None, f"none of the first {used} trials on each φ has a margin"
    basic = BasicMargins(plan, safe, used, runner, progress, cache)
    computed: dict[int, list[FloatArray]] = {}
    differences: dict[int, MarginDifference] = {}

    def compared(hundredths: int) -> MarginDifference:
        if hundredths not in differences:
            margins = basic.at(hundredths)
            found = difference(car, margins)
            if found is None:
                raise _NothingInCommonError
            computed[hundredths], differences[hundredths] = margins, found
        return differences[hundredths]

    try:
        search(compared, _guess(plan))
    except _NothingInCommonError:
        return None, "the search for the margins of basic cars has no room"
    found = equivalent_multiplier(car, {one / 100: margins for one, margins in computed.items()})
    low, high = min(computed) / 100, max(computed) / 100
    note = f"read off {len(computed)} basic cars, C = {low:g} to {high:g}, in the same trials"
    return found, note + (f" (the first {used} of {trials} on each φ)" if used < trials else "")


class _NothingInCommonError(Exception):
    pass


def _guess(plan: Plan) -> int | None:
    """Return where to begin, in hundredths: a car of a known C is like the basic car with it; None: unknown."""
    if not (plan.car.has_multiplier and plan.car.is_known):
        return None
    return min(max(round(100 * plan.car.multiplier), LOWEST), HIGHEST)


def search(compared: Callable[[int], MarginDifference], guess: int | None = None) -> None:
    """Compute the margins of those C from which an equivalent multiplier and its intervals follow.

    Args:
        compared: returns how much more margin the car has than the basic car of a C (hundredths), and keeps it.
        guess: C (hundredths) near which it may be.
    """

    def more(hundredths: int) -> bool:
        return compared(hundredths).mean > 0.0

    def surely_more(hundredths: int) -> bool:
        one = compared(hundredths)
        return all(interval[0] > 0.0 for interval in (one.ci95, one.ci95_trials) if interval) and one.mean > 0.0

    def perhaps_more(hundredths: int) -> bool:
        one = compared(hundredths)
        return any(interval[1] >= 0.0 for interval in (one.ci95, one.ci95_trials) if interval) or one.mean >= 0.0

    probes = _PROBES if guess is None else _around(guess)
    step = _FIRST if guess is None else probes.index(guess)
    if more(probes[step]):
        while step + 1 < len(probes) and more(probes[step + 1]):
            step += 1
    else:
        while step > 0 and not more(probes[step]):
            step -= 1
    low = high = probes[step]
    if more(low) and low < HIGHEST:
        low, high = _halved(*_halved(low, probes[step + 1], _COARSE, more), _FINE, more)
    _outwards(low, -1, lambda one: not surely_more(one))
    _outwards(high, 1, perhaps_more)


def _around(guess: int) -> tuple[int, ...]:
    """Return hundredths to both sides of one, each twice as far away as the last, as far as the ends."""
    away = [1 << power for power in range(8)]
    found = {LOWEST, guess, HIGHEST, *(guess - one for one in away), *(guess + one for one in away)}
    return tuple(sorted(one for one in found if LOWEST <= one <= HIGHEST))


def _halved(low: int, high: int, width: int, holds: Callable[[int], bool]) -> tuple[int, int]:
    """Return two hundredths, at most `width` apart, of which the lower one holds and the upper one does not.

    Args:
        low: a hundredth for which the condition holds.
        high: a greater hundredth for which the condition does not hold.
        width: the two hundredths are multiples of it, if both ends are.
        holds: tells whether the condition holds for a hundredth.
    """
    while high - low > width:
        middle = low + max(1, (high - low) // (2 * width)) * width
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


DEFINITION = 2
"""Of the margin of a trial: one more whenever what `exact_margin` gives for the same episode changes."""


def margins_key(scenario: Scenario, safe: Sequence[Trajectory], seed: int, trials: int, driver: object) -> str:
    """Return the SHA-256 of all that the margins of a car depend on, in hexadecimal digits.

    Args:
        scenario: the scenario in which the car drives.
        safe: Φ, in the order of their numbers.
        seed: seed of the campaign.
        trials: how many trials there are on each φ.
        driver: C of a basic car; of another one its name, and what else its margins depend on.
    """
    described = {name: value for name, value in scenario.as_dict().items() if name not in ("name", "description")}
    paths = [[one.positions.shape, one.time_step] for one in safe]
    about = json.dumps([DEFINITION, described, seed, trials, driver, paths], sort_keys=True)
    found = hashlib.sha256(about.encode())
    for one in safe:
        found.update(one.positions.astype("<f8").tobytes())
    return found.hexdigest()


def kept_margins(
    plan: Plan,
    safe: Sequence[Trajectory],
    trials: int,
    driver: object,
    compute: Callable[[], tuple[FloatArray, bool]],
    cache: Path | None = None,
) -> tuple[list[FloatArray], bool]:
    """Return, per φ, the margins of a driver, m, and whether they have converged: kept ones, else computed and kept.

    Args:
        plan: with the driver in the place of the car.
        safe: Φ, in the order of their numbers.
        trials: how many trials there are on each φ.
        driver: as of `margins_key`.
        compute: returns the margins of all trials, and whether they have converged.
        cache: folder in which they are kept; by default in the user's cache.
    """
    folder = cache_folder().with_name("margins") if cache is None else cache
    file = folder / f"{margins_key(plan.scenario, safe, plan.seed, trials, driver)}.npz"
    with contextlib.suppress(OSError, ValueError, EOFError, BadZipFile), np.load(file) as kept:  # or it is damaged
        return list(kept["margins"]), bool(kept["converged"])
    found, converged = compute()
    margins, content = found.reshape(len(safe), trials), BytesIO()
    np.savez(content, margins=margins, converged=converged)
    keep(file, content.getvalue())
    return list(margins), converged
