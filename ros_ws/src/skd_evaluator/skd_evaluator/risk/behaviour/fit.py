"""A behaviour model fitted to tracked people: the parameters under which simulated people have the same summary.

Simulated people intend to go straight on at one pace; all that differs from that is the model's. Their summary
(`summary`) is brought to that of the tracks by Gauss and Newton's steps, weighed by how much a summary of as
many persons varies by chance under the model (the simulated method of moments: McFadden, Econometrica 57, 1989). The
same normals at every step make the distance smooth. Intervals follow from the same weights, that of `unrest` from a
test of each value (`inversion`).

What tracks of people say about how they deviate: residuals of constant velocity, and other numbers of a group.

The residual at a horizon is how far a person is from where the velocity of the last tick would have led.

The interval of a behaviour model's parameter by inversion of a test: the values that the tracks do not reject.

A standard error at the estimate does not do for how much people differ in restlessness. So few of them tell little of
it, the estimate is 0 for one group in six, and the spread by chance hangs on the value itself: where the estimate is
small by chance, so is its error. So each value is tried by itself. All other parameters are fitted with it, groups of
people are simulated by them, and the tracks are held against those groups by the one number that tells of the parameter
and, to first order, of no other (the score of a C(α) test: Neyman, in Grenander, Probability and Statistics, 1959). A
value is in the interval if the tracks' number is between the groups' quantiles.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
import scipy
from skd_sim.world.state import FloatArray

from skd_evaluator.metrics.behaviour.model import MEANINGS, NAMES, Behaviour, Parameter, normals_of, walk_many

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
    trajectories = np.empty((len(lengths), longest, 2))
    walk_many(straight, here, normals, time_step, trajectories)
    trajectories[np.arange(longest) >= np.asarray(lengths)[:, None]] = np.nan
    return trajectories


class TrackProblem:
    """The summary of tracks, and of people simulated like them."""

    def __init__(self, tracks: Sequence[FloatArray], time_step: float) -> None:
        self.ways, self.time_step = padded(tracks), time_step
        self.lengths = [len(one) for one in tracks]
        steps = np.diff(self.ways, axis=1)
        speeds = np.hypot(steps[..., 0], steps[..., 1]) / time_step
        self.speed = float(np.nanmedian(speeds))
        self.observed = summary(self.ways, time_step)
        rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(_SEED)))
        dimension = normals_of(max(self.lengths) - 1)
        self._normals = rng.standard_normal((_COPIES * len(tracks), dimension))
        self._chance = rng.standard_normal((_GROUPS * len(tracks), dimension))

    def summary_at(self, free: FloatArray) -> FloatArray:
        """Return the summary of people simulated by parameters."""
        trajectories = simulated(_values(free), self.lengths * _COPIES, self.speed, self.time_step, self._normals)
        return summary(trajectories, self.time_step)

    def allowed(self, free: FloatArray) -> FloatArray:
        """Return the nearest parameters within what is allowed."""
        return _free(_values(free))

    def groups_at(self, free: FloatArray) -> FloatArray:
        """Return the summary of each of many groups of as many persons."""
        trajectories = simulated(_values(free), self.lengths * _GROUPS, self.speed, self.time_step, self._chance)
        groups = trajectories.reshape(_GROUPS, len(self.lengths), *trajectories.shape[1:])
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


def fit_behaviour(tracks: Sequence[FloatArray], time_step: float, *, intervals: bool = True) -> Fit:
    """Fit a behaviour model to tracks.

    Args:
        tracks: places of each person at ticks, n × 2, m, x along the way that people intend.
        time_step: s.
        intervals: whether they are wanted; that of a tested parameter (`TESTED`) takes as long as the fit.

    Raises:
        ValueError: there are fewer than `LEAST_TRACKS`.
    """
    if len(tracks) < LEAST_TRACKS:
        raise ValueError(f"a behaviour model needs at least {LEAST_TRACKS} tracks, got {len(tracks)}")
    problem = TrackProblem(tracks, time_step)
    free = _free(np.array([_START[name] for name in NAMES]))
    weights, damping = np.diag(1.0 / np.diag(problem.chance_at(free))), 1.0
    for turn in range(_STEPS):
        if turn in (2, 5):
            weights = np.diag(1.0 / np.diag(problem.chance_at(free)))
        off = problem.observed - problem.summary_at(free)
        jacobian = problem.jacobian_at(free)
        best, moved = float(off @ weights @ off), 0.0
        information = jacobian.T @ weights @ jacobian
        while damping < 1e6:
            step = np.linalg.solve(information + ridge(information, damping), jacobian.T @ weights @ off)
            trial = _free(_values(free + np.clip(step, -_FURTHEST, _FURTHEST)))
            left = problem.observed - problem.summary_at(trial)
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


HORIZONS: Final = (0.6, 1.2, 2.4)
"""s."""
QUANTILES: Final = (0.5, 0.95, 0.99)
_SHAPE = (0.5, 0.8, 0.95, 0.99)
_SLOW = 0.4  # of one's own brisk pace: who is slower has all but stopped
_BRISK = 0.7  # quantile of one's speeds
_LEAST = 1e-4


def padded(trajectories: Sequence[FloatArray]) -> FloatArray:
    """Return ways of several lengths as one array, m × longest × 2, with nan behind their ends."""
    found = np.full((len(trajectories), max(map(len, trajectories)), 2), np.nan)
    for row, track in enumerate(trajectories):
        found[row, : len(track)] = track
    return found


def residuals(trajectories: FloatArray, ticks: int) -> FloatArray:
    """Return residuals of constant velocity, m × n × 2 (along East and North), m; nan where a way is over.

    Args:
        trajectories: places at ticks, m × n × 2, m; nan behind the end of a way.
        ticks: the horizon.
    """
    step = trajectories[:, 1:-ticks] - trajectories[:, : -ticks - 1]
    return np.asarray(trajectories[:, 1 + ticks :] - trajectories[:, 1:-ticks] - ticks * step)


def ticks_of(horizon: float, time_step: float) -> int:
    """Return how many ticks a horizon (s) has."""
    return max(1, round(horizon / time_step))


def quantile_table(trajectories: FloatArray, time_step: float) -> FloatArray:
    """Return the quantiles of the length of the residuals, horizons × `QUANTILES`, m."""
    rows = [np.hypot(*np.moveaxis(residuals(trajectories, ticks_of(one, time_step)), -1, 0)) for one in HORIZONS]
    return np.array([np.quantile(row[np.isfinite(row)], QUANTILES) for row in rows])


def summary(trajectories: FloatArray, time_step: float) -> FloatArray:
    """Return the numbers by which a behaviour model is fitted to a group of tracks.

    Logarithms of quantiles of the residuals, of their part across, of how persons differ in pace, direction and
    restlessness, and of the highest speeds; and the shares, by their square roots, of ticks and of persons that all but
    stand.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # rows of nothing but nan
        return _summary(trajectories, time_step)


def _summary(trajectories: FloatArray, time_step: float) -> FloatArray:
    found: list[float] = []
    near: FloatArray | None = None
    for horizon in HORIZONS:
        both = residuals(trajectories, ticks_of(horizon, time_step))
        length = np.hypot(both[..., 0], both[..., 1])
        near = length if near is None else near
        found += _logs(np.quantile(length[np.isfinite(length)], _SHAPE))
        across = np.abs(both[..., 1])
        found += _logs(np.quantile(across[np.isfinite(across)], (0.5, 0.95)))
    steps = np.diff(trajectories, axis=1)
    speeds = np.hypot(steps[..., 0], steps[..., 1]) / time_step
    brisk = _quantile_of_rows(speeds, _BRISK)
    found.append(_log_sd(np.log(np.maximum(brisk, _LEAST))))
    whole = np.nansum(steps, axis=1)
    found.append(_log_sd(np.arctan2(whole[:, 1], whole[:, 0])))
    assert near is not None
    found.append(_log_sd(np.log(np.maximum(np.sqrt(np.nanmean(near**2, axis=1)), _LEAST))))
    relative = speeds / brisk[:, None]
    known = np.isfinite(relative)
    found += _logs(np.quantile(relative[known], (0.3, 0.5, 0.9, 0.99)))
    slow = known & (relative < _SLOW)
    found += [np.sqrt(slow.sum() / known.sum()), np.sqrt(slow.any(axis=1).mean())]
    bends = np.diff(steps[..., 1], axis=1)
    found += _logs([np.sqrt(np.nanmean(bends**2))])
    return np.array(found)


def _quantile_of_rows(values: FloatArray, share: float) -> FloatArray:
    """Return a quantile of each row, nan left out; numpy's own is slow."""
    ranked = np.sort(values, axis=1)  # nan come last
    place = share * (np.isfinite(values).sum(axis=1) - 1)
    below = np.maximum(place.astype(np.int64), 0)
    rows, above = np.arange(len(values)), np.minimum(below + 1, values.shape[1] - 1)
    low, high = ranked[rows, below], ranked[rows, above]
    return np.asarray(low + (place - below) * np.where(np.isfinite(high), high - low, 0.0))


def _logs(values: npt.ArrayLike) -> list[float]:
    return [float(one) for one in np.log(np.maximum(np.asarray(values, np.float64), _LEAST))]


def _log_sd(values: FloatArray) -> float:
    return float(np.log(max(float(np.std(values, ddof=1)), _LEAST)))


_BISECTIONS: Final = 6
_RIDGE: Final = 1e-2
_FURTHEST: Final = 0.5
_OUTWARD: Final = 6


def inverted(problem: TrackProblem, free: FloatArray, index: int, error: float, most: float) -> tuple[float, float]:
    """Return the 95 % interval of a parameter that is at least 0, on the scale on which it is fitted.

    Args:
        problem: what is fitted.
        free: the estimate of all fitted parameters.
        index: of the parameter among them.
        error: its standard error, about; says where to look.
        most: greatest value allowed, on that scale.
    """
    tail, weights = 0.5 * (1.0 - 0.95), _weights(problem.groups_at(free))

    def above(value: float) -> float:
        """Return by how much a value is not too large: below 0 it is rejected."""
        score, groups = _score(problem, weights, free, index, value)
        return score - float(np.quantile(groups, tail))

    def below(value: float) -> float:
        score, groups = _score(problem, weights, free, index, value)
        return float(np.quantile(groups, 1.0 - tail)) - score

    inside = float(free[index])
    high, outside = inside, min(most, inside + 2.0 * error)
    for _ in range(_OUTWARD):
        if outside >= most or above(outside) < 0.0:
            break
        high, outside = outside, min(most, outside + error)
    high = _edge(above, high, outside)
    low = 0.0 if inside <= 0.0 or below(0.0) >= 0.0 else _edge(below, inside, 0.0)
    return low, high


def ridge(information: FloatArray, share: float) -> FloatArray:
    """Return what is added to an information matrix, so that steps are short and it has an inverse.

    Args:
        information: a row for each parameter.
        share: of its diagonal that is added; where that is 0, for nothing hangs on a parameter, 1 is.
    """
    diagonal = np.diag(information)
    return np.asarray(np.diag(np.where(diagonal > 0.0, share * diagonal, 1.0)))


def _edge(fine: Callable[[float], float], inside: float, outside: float) -> float:
    """Return where a function becomes negative, by bisection."""
    for _ in range(_BISECTIONS):
        middle = 0.5 * (inside + outside)
        inside, outside = (middle, outside) if fine(middle) >= 0.0 else (inside, middle)
    return 0.5 * (inside + outside)


def _weights(groups: FloatArray) -> FloatArray:
    """Return how much each number of a summary counts: the inverse of its variance among groups."""
    return np.asarray(1.0 / (groups.var(axis=0, ddof=1) + 1e-8))


def _score(
    problem: TrackProblem, weights: FloatArray, free: FloatArray, index: int, value: float
) -> tuple[float, FloatArray]:
    """Return what tells of the parameter, of the tracks and of groups that are simulated with a value of it."""
    here, jacobian = _others_fitted(problem, weights, free, index, value)
    groups = problem.groups_at(here)
    centre, weighed = groups.mean(axis=0), jacobian.T * _weights(groups)
    gain = (np.linalg.pinv(weighed @ jacobian) @ weighed)[index]
    return float(gain @ (problem.observed - centre)), (groups - centre) @ gain


def _others_fitted(
    problem: TrackProblem, weights: FloatArray, free: FloatArray, index: int, value: float
) -> tuple[FloatArray, FloatArray]:
    """Return all parameters, the others being fitted by one step, and the derivatives from which it went."""
    here = free.copy()
    here[index] = value
    here = problem.allowed(here)
    jacobian, off = problem.jacobian_at(here), problem.observed - problem.summary_at(here)
    others = np.delete(jacobian, index, axis=1)
    information = (others.T * weights) @ others
    step = np.linalg.solve(information + ridge(information, _RIDGE), (others.T * weights) @ off)
    best = float(off @ (weights * off))
    for share in (1.0, 0.5, 0.25):
        trial = here.copy()
        trial[np.arange(here.size) != index] += np.clip(share * step, -_FURTHEST, _FURTHEST)
        trial = problem.allowed(trial)
        left = problem.observed - problem.summary_at(trial)
        if float(left @ (weights * left)) < best:
            return trial, jacobian
    return here, jacobian
