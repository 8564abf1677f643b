"""A behaviour model fitted to tracked people: the parameters under which simulated people have the same summary.

Simulated people intend to go straight on at one pace; all that differs from that is the model's. Their summary
(`residuals.summary`) is brought to that of the tracks by Gauss and Newton's steps, weighed by how much a summary of as
many persons varies by chance under the model (the simulated method of moments: McFadden, Econometrica 57, 1989). The
same normals at every step make the distance smooth. Intervals follow from the same weights, that of `unrest` from a
test of each value (`inversion`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy
from skd_sim.arrays import FloatArray

from skd_evaluator.metrics.behaviour.model import MEANINGS, NAMES, Behaviour, Parameter
from skd_evaluator.metrics.behaviour.walking import normals_of, walk_many
from skd_evaluator.risk.behaviour.inversion import inverted, ridge
from skd_evaluator.risk.behaviour.residuals import padded, summary

LEAST_TRACKS: Final = 8
FITTED: Final = tuple(name for name, one in MEANINGS.items() if one.fitted)
TESTED: Final = ("unrest",)
"""Parameters of which a standard error says too little; see `inversion`."""
_START = {
    "pace": 0.15, "heading": 0.08, "unrest": 0.3, "pace_noise": 0.08, "pace_time": 1.0, "turn": 0.12, "turn_time": 1.0,
    "hesitation": 1.3, "hesitation_time": 2.0, "sway": 0.02, "hesitation_depth": 1.0, "start_delay": 0.3,
}  # fmt: skip
_COPIES = 16  # simulated persons for each tracked one
_GROUPS = 160  # simulated groups of as many persons, by which chance is known
_STEPS = 12
_SETTLED = 1e-3  # of a step, in standard errors
_DIFFERENCE, _LITTLE = 0.05, 0.005
_FURTHEST = 0.5
_SEED = 20190211


@dataclass(frozen=True, eq=False)
class Fit:
    """What tracks tell of a behaviour model.

    Attributes:
        values: parameters, in the order of `MEANINGS`.
        errors: standard errors of the fitted ones, in the order of `FITTED`, on the scale of `_free`.
        intervals: 95 % interval of each fitted one.
        tracks: number of tracks.
        steps: ticks in all.
        speed: median speed, m/s.
    """

    values: FloatArray
    errors: FloatArray
    intervals: dict[str, tuple[float, float]]
    tracks: int
    steps: int
    speed: float


def _free(values: FloatArray) -> FloatArray:
    """Return the fitted parameters on the scale on which they are fitted."""
    chosen = {name: float(value) for name, value in zip(NAMES, values, strict=True)}
    found = []
    for name in FITTED:
        meaning, value = MEANINGS[name], chosen[name]
        found.append(math.log(value) if meaning.by_logarithm else value * value if meaning.by_square else value)
    return np.array(found)


def _values(free: FloatArray) -> FloatArray:
    """Return all parameters; the inverse of `_free`."""
    found = dict(_START)
    for name, one in zip(FITTED, free, strict=True):
        meaning = MEANINGS[name]
        value = float(one)
        if meaning.by_logarithm:
            value = math.exp(min(value, 10.0))
        elif meaning.by_square:
            value = math.sqrt(max(value, 0.0))
        found[name] = min(max(value, meaning.low), meaning.high)
    return np.array([found[name] for name in NAMES])


def simulated(
    values: FloatArray, lengths: Sequence[int], speed: float, time_step: float, normals: FloatArray
) -> FloatArray:
    """Return tracks of people who intend to go straight on at a speed, padded; see `padded`.

    Args:
        values: parameters, in the order of `MEANINGS`.
        lengths: number of places of each track.
        speed: that they intend, m/s.
        time_step: s.
        normals: one row for each track, `normals_of(max(lengths) - 1)` each.
    """
    longest = max(lengths)
    straight = np.column_stack([np.arange(40 * longest) * speed * time_step, np.zeros(40 * longest)])
    here = np.array(values)
    here[NAMES.index("start_delay")] = 0.0
    ways = np.empty((len(lengths), longest, 2))
    walk_many(straight, here, normals, time_step, ways)
    ways[np.arange(longest) >= np.asarray(lengths)[:, None]] = np.nan
    return ways


class TrackProblem:
    """The summary of tracks, and of people simulated like them."""

    def __init__(self, tracks: Sequence[FloatArray], time_step: float, seed: int) -> None:
        self.ways, self.time_step = padded(tracks), time_step
        self.lengths = [len(one) for one in tracks]
        steps = np.diff(self.ways, axis=1)
        speeds = np.hypot(steps[..., 0], steps[..., 1]) / time_step
        self.speed = float(np.nanmedian(speeds))
        self.wanted = summary(self.ways, time_step)
        rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed)))
        dimension = normals_of(max(self.lengths) - 1)
        self._normals = rng.standard_normal((_COPIES * len(tracks), dimension))
        self._chance = rng.standard_normal((_GROUPS * len(tracks), dimension))

    def summary_at(self, free: FloatArray) -> FloatArray:
        """Return the summary of people simulated by parameters."""
        ways = simulated(_values(free), self.lengths * _COPIES, self.speed, self.time_step, self._normals)
        return summary(ways, self.time_step)

    def allowed(self, free: FloatArray) -> FloatArray:
        """Return the nearest parameters within what is allowed."""
        return _free(_values(free))

    def groups_at(self, free: FloatArray) -> FloatArray:
        """Return the summary of each of many groups of as many persons."""
        ways = simulated(_values(free), self.lengths * _GROUPS, self.speed, self.time_step, self._chance)
        groups = ways.reshape(_GROUPS, len(self.lengths), *ways.shape[1:])
        return np.array([summary(group, self.time_step) for group in groups])

    def chance_at(self, free: FloatArray) -> FloatArray:
        """Return the covariance that the difference of both summaries has by chance."""
        found = self.groups_at(free)
        return np.asarray((1.0 + 1.0 / _COPIES) * np.cov(found.T) + 1e-8 * np.eye(found.shape[1]))

    def jacobian_at(self, free: FloatArray) -> FloatArray:
        """Return its derivatives, numbers of the summary × parameters."""
        columns = []
        for index in range(free.size):
            step, name = np.zeros(free.size), FITTED[index]
            little = 0.25 * _START[name] ** 2 if MEANINGS[name].by_square else _LITTLE
            step[index] = _DIFFERENCE if MEANINGS[name].by_logarithm else max(0.1 * abs(free[index]), little)
            up, down = _free(_values(free + step)), _free(_values(free - step))  # not beyond what is allowed
            wide = up[index] - down[index]
            columns.append((self.summary_at(up) - self.summary_at(down)) / wide)
        return np.column_stack(columns)


def fit_behaviour(tracks: Sequence[FloatArray], time_step: float, *, seed: int = _SEED, intervals: bool = True) -> Fit:
    """Fit a behaviour model to tracks.

    Args:
        tracks: places of each person at ticks, n × 2, m, x along the way that people intend.
        time_step: s.
        seed: of what is simulated; the same seed gives the same fit.
        intervals: whether they are wanted; that of a tested parameter (`TESTED`) takes as long as the fit.

    Raises:
        ValueError: there are fewer than `LEAST_TRACKS`.
    """
    if len(tracks) < LEAST_TRACKS:
        raise ValueError(f"a behaviour model needs at least {LEAST_TRACKS} tracks, got {len(tracks)}")
    problem = TrackProblem(tracks, time_step, seed)
    free = _free(np.array([_START[name] for name in NAMES]))
    weights, damping = np.diag(1.0 / np.diag(problem.chance_at(free))), 1.0
    for turn in range(_STEPS):
        if turn in (2, 5):
            weights = np.diag(1.0 / np.diag(problem.chance_at(free)))
        off = problem.wanted - problem.summary_at(free)
        jacobian = problem.jacobian_at(free)
        best, moved = float(off @ weights @ off), 0.0
        information = jacobian.T @ weights @ jacobian
        while damping < 1e6:
            step = np.linalg.solve(information + ridge(information, damping), jacobian.T @ weights @ off)
            trial = _free(_values(free + np.clip(step, -_FURTHEST, _FURTHEST)))
            left = problem.wanted - problem.summary_at(trial)
            if float(left @ weights @ left) < best:
                moved = float(np.max(np.abs(trial - free) * np.sqrt(np.diag(information))))
                free, damping = trial, max(damping / 5.0, 1e-3)
                break
            damping *= 4.0
        if moved < _SETTLED and turn > 5:
            break
        damping = min(damping, 10.0)
    chance, jacobian = problem.chance_at(free), problem.jacobian_at(free)
    weights = np.diag(1.0 / np.diag(chance))
    gain = np.linalg.pinv(jacobian.T @ weights @ jacobian) @ jacobian.T @ weights
    errors = np.sqrt(np.diag(gain @ chance @ gain.T))
    reach = float(scipy.special.ndtri(0.975)) * errors
    values, low, high = _values(free), _values(free - reach), _values(free + reach)

    places = [NAMES.index(name) for name in FITTED]
    found = {name: (float(low[at]), float(high[at])) for name, at in zip(FITTED, places, strict=True)}
    # Of a parameter on which nothing hangs, such as how long people stand who never do, the tracks tell nothing.
    silent = [name for name, column in zip(FITTED, jacobian.T, strict=True) if not column.any()]
    found.update({name: (MEANINGS[name].low, MEANINGS[name].high) for name in silent})
    for name in (one for one in TESTED if intervals and one not in silent):
        found[name] = tested_interval(problem, free, name, float(errors[FITTED.index(name)]))
    return Fit(values, errors, found, len(tracks), sum(problem.lengths) - len(tracks), problem.speed)


def tested_interval(problem: TrackProblem, free: FloatArray, name: str, error: float) -> tuple[float, float]:
    """Return the interval of a parameter fitted by its square, by inversion of a test.

    Args:
        problem: what is fitted.
        free: the estimate, on the scale on which it is fitted.
        name: of the parameter.
        error: its standard error, about, on that scale.
    """
    index = FITTED.index(name)
    low, high = inverted(problem, free, index, error, MEANINGS[name].high ** 2)
    return math.sqrt(low), math.sqrt(high)


def behaviour_of(fit: Fit, name: str, kind: str, description: str, source: str) -> Behaviour:
    """Return the behaviour model of a fit.

    Args:
        fit: what tracks tell.
        name: of the model.
        kind: of road user.
        description: whom it is of.
        source: of the fitted parameters.
    """
    rows = {}
    for parameter, value in zip(NAMES, fit.values.tolist(), strict=True):
        interval = fit.intervals.get(parameter)
        rounded = None if interval is None else (round(interval[0], 4), round(interval[1], 4))
        rows[parameter] = Parameter(round(value, 4), "assumed" if interval is None else source, rounded)
    return Behaviour(name, kind, description, rows)
