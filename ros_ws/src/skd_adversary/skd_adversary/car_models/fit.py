"""From ticks to a learned car: a law of braking with its intervals, or a forest where that predicts better."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np
from skd_sim.kernels.compilation import kernel
from skd_sim.world.state import BoolArray, FloatArray, IntArray

from skd_adversary.car_models import laws, speed_change
from skd_adversary.car_models.car_model_file import (
    OPTIONAL,
    PARAMETERS,
    CarParameter,
    FittedCar,
    LawCalibration,
    ParameterPrior,
    Prediction,
)
from skd_adversary.car_models.forest import Trees, described, forest_transform, grow, leaf_of
from skd_adversary.car_models.identifiability import (
    LEAST_LOGS,
    LEVEL,
    Identification,
    IntervalEstimate,
    half_width_estimate,
    normal_estimate,
    step_estimate,
)
from skd_adversary.car_models.observations import Observations

_HELD_OUT_FOLDS = 4  # one of them is predicted from the others, for the calibration
_KS_TICKS = 20  # fewer say nothing about calibration
_OF_BRAKING = ("trigger", "trigger_spread", "reaction_delay", "deceleration", "deceleration_noise")


def _modes(
    change: speed_change.SpeedChange, law: laws.Law, data: Observations, rows: BoolArray
) -> tuple[BoolArray, BoolArray]:
    """Return which ticks, of those that count, were braking and which free, given the law."""
    free, braking, _ = (part[rows] for part in speed_change.densities(change, data))
    brakes = laws.braking_probability(law, data)[rows]
    for_it, against = brakes * braking, (1.0 - brakes) * free
    return for_it > against, (against >= for_it) & (brakes < 0.5)


def _learn(
    change: speed_change.SpeedChange, data: Observations, rows: BoolArray
) -> tuple[speed_change.SpeedChange, laws.LawCandidate, list[laws.LawCandidate]]:
    """Return the change of speed, the chosen family and all families."""
    candidates = laws.compare(change, data, rows)
    chosen = laws.choose(candidates)
    # A fast car's free and braking ticks can look alike; the law tells which they were.
    braking, free = _modes(change, chosen.law, data, rows)
    change = speed_change.refit(change, data.of(rows), free, braking)
    e = laws.evidence(change, data, chosen.law.family, rows)
    return change, replace(chosen, law=laws.fit_family(chosen.law.family, e), evidence=e), candidates


def fit_with_law(
    data: Observations, *, version: str = "unknown"
) -> tuple[FittedCar, tuple[speed_change.SpeedChange, laws.Law] | None]:
    """Return the car that the logs show, and its law with how the speed changes; None where they show no law.

    Args:
        data: all ticks of all logs.
        version: version of SKD, which the model records.
    """
    rows = speed_change.moving(data)
    seen, starts = data.of(rows), data.speed[data.tick == 0]
    start_speed = float(np.median(starts)) if starts.size else 0.0
    car = FittedCar(
        measure="distance",
        gate="none",
        spread="sharp",
        lapse=0.0,
        parameters={},
        logs=data.episodes,
        ticks=len(data),
        time_step=data.time_step,
        version=version,
        front=data.front,
        rear=data.rear,
    )
    counts = Identification(logs=data.episodes, start_speed=start_speed)
    if seen.episodes < 2 or len(seen) < LEAST_LOGS:
        why = f"only {data.episodes} logs with {len(data)} ticks, at least {LEAST_LOGS} logs are needed"
        return replace(car, parameters=counts.unknown(why, *(one for one in PARAMETERS if one not in OPTIONAL))), None
    change = speed_change.fit_speed_change(seen)
    if change.weights[1] <= 0.0:
        counts = replace(counts, free=len(seen))
        unknown = counts.unknown(counts.why_not_braking(), *_OF_BRAKING)
        return replace(car, parameters=unknown | _free_parameters(counts, change, seen, starts)), None
    change, chosen, candidates = _learn(change, data, rows)
    law = chosen.law
    braking, is_free = _modes(change, law, data, rows)
    free = seen.of(is_free & (speed_change.densities(change, seen)[0] > 0.0))
    counts = replace(
        counts,
        braking_logs=int(np.unique(seen.episode[braking]).size),
        free=len(free),
        braking=int(braking.sum()),
        lapse=law.lapse,
    )
    parameters = {
        **_law_parameters(counts, chosen, candidates, data.time_step),
        **_braking_parameters(counts, change, seen.of(braking)),
        **_free_parameters(counts, change, free, starts),
    }
    car = replace(
        car,
        parameters=parameters,
        measure=law.family.measure,
        gate=law.family.gate,
        spread=law.family.spread,
        lapse=law.lapse,
        families=tuple(one.row for one in candidates),
        chosen=law.family.name,
        calibration=_calibration(data, change, law),
        braking_ticks=counts.braking,
    )
    return car, (change, law)


def _law_parameters(
    counts: Identification, chosen: laws.LawCandidate, candidates: Sequence[laws.LawCandidate], time_step: float
) -> dict[str, CarParameter]:
    """Return trigger, its spread, path and delay."""
    law, e = chosen.law, chosen.evidence
    why, make = counts.why_no_law(), functools.partial(counts.parameter, measure=law.family.measure)
    if law.family.spread == "sharp":
        trigger = make("trigger", lambda: step_estimate(*laws.trigger_profile(e, law)), why, "uniform")
        spread = make("trigger_spread", lambda: laws.sharp_spread(e, law), why, "uniform", limit=None)
        if spread.identifiable:
            spread = replace(spread, prior=ParameterPrior("point", 0.0))  # the family says so
    else:
        both = [] if why else [*laws.spread_estimates(e, law)]
        trigger = make("trigger", lambda: both[0], why)
        spread = make("trigger_spread", lambda: both[1], why)
    found = {"trigger": trigger, "trigger_spread": spread}
    if law.family.gate != "none":
        found["path_half_width"] = make(
            "path_half_width", lambda: step_estimate(*laws.gate_profile(e, law)), why, "uniform"
        )
    delay = functools.partial(_delay_estimate, law, candidates, time_step)
    found["reaction_delay"] = make("reaction_delay", delay, why, "uniform", limit=None)
    return found


def _delay_estimate(law: laws.Law, candidates: Sequence[laws.LawCandidate], time_step: float) -> IntervalEstimate:
    """Return the delay, in whole ticks: those that together have 95 % of the likelihood."""
    family = law.family
    tried = {
        other.delay: one.law.log_likelihood
        for one in candidates
        if (other := one.law.family).spread == "sharp" and (other.measure, other.gate) == (family.measure, family.gate)
    }
    delays = np.array(sorted(tried))
    values = np.array([tried[int(delay)] for delay in delays])
    share = np.exp(values - values.max())
    share /= share.sum()
    order = np.argsort(-share)
    kept = delays[order[: 1 + int(np.searchsorted(np.cumsum(share[order]), LEVEL))]]
    mean = float(share @ delays)
    deviation = math.sqrt(max(0.0, float(share @ np.square(delays - mean))))
    deviation = 0.0 if kept.size == 1 else deviation
    low, high = min(int(kept.min()), family.delay), max(int(kept.max()), family.delay)
    return IntervalEstimate(family.delay * time_step, deviation * time_step, low * time_step, high * time_step)


def _braking_parameters(
    counts: Identification, change: speed_change.SpeedChange, braking: Observations
) -> dict[str, CarParameter]:
    """Return the deceleration and its noise."""
    why = counts.why_not_braking()
    both = [] if why else [*speed_change.braking_estimates(change, braking)]
    return {
        "deceleration": counts.parameter("deceleration", lambda: both[0], why),
        "deceleration_noise": counts.parameter("deceleration_noise", lambda: both[1], why),
    }


def _free_parameters(
    counts: Identification, change: speed_change.SpeedChange, free: Observations, starts: FloatArray
) -> dict[str, CarParameter]:
    """Return noise of the speed, cruise speed and the gain that holds it."""
    why, make = counts.why_not_free(), counts.parameter
    noise = make("speed_noise", lambda: half_width_estimate(change.speed_noise, len(free)), why, "uniform")
    if change.gain > 0.0 and not why:
        pulled = _pull_estimates(change, free)
        cruise = make("cruise_speed", lambda: pulled[0], "")
        gain = make("cruise_gain", lambda: pulled[1], "")
        found = {"cruise_speed": cruise, "cruise_gain": gain, "speed_noise": noise}
        if math.isfinite(change.limit):
            found["cruise_acceleration"] = make("cruise_acceleration", lambda: pulled[2], "")
        return found
    # A car that does not return to a speed cruises at the one that it is started with.
    mean, deviation = float(starts.mean()), float(starts.std()) / math.sqrt(max(1, starts.size))
    cruise = make("cruise_speed", lambda: normal_estimate(mean, deviation), why)
    still = make("cruise_gain", lambda: IntervalEstimate(0.0, 0.0, 0.0, 0.0), why, "uniform")
    return {"cruise_speed": cruise, "cruise_gain": still, "speed_noise": noise}


def _pull_estimates(
    change: speed_change.SpeedChange, free: Observations
) -> tuple[IntervalEstimate, IntervalEstimate, IntervalEstimate]:
    """Return cruise speed (m/s), gain (1/s) and largest acceleration (m/s²) with intervals by weighted least squares.

    Each from the ticks that tell of it: below the speed at which the limit begins to hold, and above.
    """
    limited = free.speed < change.cruise_speed - change.limit / change.gain
    limit_error = 0.0
    if limited.any():
        some = free.of(limited)
        spread = change.speed_noise * some.speed / (math.sqrt(3.0) * free.time_step)
        limit_error = float(1.0 / math.sqrt(np.square(1.0 / spread).sum()))
    slope, offset, covariance = speed_change.acceleration_line(free.of(~limited))
    toward = np.array([offset / slope**2, -1.0 / slope])  # of −offset/slope
    cruise_error = math.sqrt(float(toward @ covariance @ toward))
    gain_error = math.sqrt(float(covariance[0, 0]))
    pairs = (change.cruise_speed, cruise_error), (change.gain, gain_error), (change.limit, limit_error)
    cruise, gain, limit = itertools.starmap(normal_estimate, pairs)
    return cruise, gain, limit


def _calibration(data: Observations, change: speed_change.SpeedChange, law: laws.Law) -> LawCalibration | None:
    """Return how well a fourth of the logs is predicted from the others by the chosen family."""
    test = laws.folds_of(data.episode, _HELD_OUT_FOLDS) == _HELD_OUT_FOLDS - 1
    if not test.any() or int(speed_change.moving(data.of(test)).sum()) < _KS_TICKS:
        return None
    train = data.of(~test)
    rows = speed_change.moving(train)
    if train.of(rows).episodes < 2:
        return None
    known = law
    for _ in range(2):  # changes of speed and law anew, from those of all logs
        braking, free = _modes(change, known, train, rows)
        change = speed_change.refit(change, train.of(rows), free, braking)
        known = laws.fit_family(law.family, laws.evidence(change, train, law.family, rows), near=law)
    values = laws.integral_transform(change, known, data.of(test), np.random.default_rng(0))
    statistic, p_value = laws.kolmogorov_smirnov(values)
    return LawCalibration(int(values.size), statistic, p_value)


FOLDS: Final = 5
"""Parts that logs are dealt out to in turn. The manoeuvres of a probe take turns by eight: none is in one part only."""
LEAST_EPISODES: Final = 2 * FOLDS
"""Fewer logs, and nothing is held out: the law it is."""
NEAR: Final = (15.0, 4.0)
"""m ahead and aside: who is nearer than that has to do with the car."""
_LOW, _STEP = -6.0, 0.02  # m/s: changes of speed over which scores are summed
_BINS = 500


def near(data: Observations) -> BoolArray:
    """Return which ticks have the road user near the car: up to 15 m ahead of or beside it, up to 4 m aside."""
    beside = np.abs(data.lateral) <= NEAR[1]
    return np.asarray(beside & (data.gap <= NEAR[0]) & (data.gap >= -data.car_length))


def learn_car(data: Observations, *, version: str = "unknown", folds: int = FOLDS) -> FittedCar:
    """Return the car that the logs show: as a law, and as a forest where it evades, or that predicts it better.

    Better is by more than a standard error of the score of held-out ticks near the road user. The law has seen the
    ticks by which it is judged, the forest has not.

    Args:
        data: all ticks of all logs.
        version: version of SKD, which the model records.
        folds: how many of the parts are predicted from the others; fewer take less time.
    """
    car, fitted = fit_with_law(data, version=version)
    if data.episodes < LEAST_EPISODES or not speed_change.moving(data).any():
        return car
    if data.evades:
        return replace(car, forest=grow(data))
    fold, rng = laws.folds_of(data.episode, FOLDS), np.random.default_rng(0)
    parts = [data.of(fold == part) for part in range(folds)]
    grown = (grow(data.of(fold != part)).trees for part in range(folds))
    by_forest = _joined([_of_forest(trees, test, rng) for trees, test in zip(grown, parts, strict=True)])
    predictions = [by_forest.prediction("forest")]
    if fitted is not None:
        by_law = _joined([_of_law(*fitted, test, rng) for test in parts])
        predictions.insert(0, by_law.prediction("law"))
        gain = by_law.scores - by_forest.scores
        _, episode = np.unique(by_law.episode, return_inverse=True)
        by_episode = np.bincount(episode, gain) if gain.size else np.zeros(1)
        if not by_episode.sum() > math.sqrt(by_episode.size) * float(by_episode.std()):
            return replace(car, predictions=tuple(predictions))
    return replace(car, forest=grow(data), predictions=tuple(predictions))


class _Scores(NamedTuple):
    """How well ticks were predicted: integral transforms of the moving ones, scores of those near and moving."""

    transforms: FloatArray
    is_near: BoolArray
    scores: FloatArray
    episode: IntArray

    def prediction(self, model: str) -> Prediction:
        """Return them in figures."""
        close = self.transforms[self.is_near]
        return Prediction(
            model,
            int(self.transforms.size),
            laws.kolmogorov_smirnov(self.transforms)[0],
            int(close.size),
            laws.kolmogorov_smirnov(close)[0] if close.size else 0.0,
            float(self.scores.mean()) if self.scores.size else 0.0,
        )


def _joined(parts: Sequence[_Scores]) -> _Scores:
    return _Scores(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def _of_forest(trees: Trees, test: Observations, rng: np.random.Generator) -> _Scores:
    """Return how well a forest that has not seen them predicts ticks."""
    rows = speed_change.moving(test)
    counted = rows & near(test)
    features, change = described(test)
    scores = np.zeros(int(counted.sum()))
    _forest_scores(*trees, features[counted], change[counted], scores)
    return _Scores(forest_transform(trees, test, rows, rng), near(test)[rows], scores, test.episode[counted])


def _of_law(change: speed_change.SpeedChange, law: laws.Law, test: Observations, rng: np.random.Generator) -> _Scores:
    """Return how well a law predicts ticks."""
    rows = speed_change.moving(test)
    counted = rows & near(test)
    scores = _law_scores(change, law, test)[counted]
    return _Scores(laws.integral_transform(change, law, test, rng), near(test)[rows], scores, test.episode[counted])


def _law_scores(change: speed_change.SpeedChange, law: laws.Law, data: Observations) -> FloatArray:
    """Return the continuous ranked probability score of each tick, m/s: ∫ (F(z) − 1[observed ≤ z])² dz."""
    brakes = laws.braking_probability(law, data)
    observed = data.speed_after - data.speed
    total = np.zeros(len(data))
    for index in range(_BINS):
        z = _LOW + (index + 0.5) * _STEP
        free, braking = speed_change.distributions(change, replace(data, speed_after=data.speed + z))
        below = np.where(z < -data.speed, 0.0, brakes * braking + (1.0 - brakes) * free)
        total += np.square(below - (observed <= z)) * _STEP
    return np.asarray(total)


@kernel
def _forest_scores(
    roots: Any, nodes: Any, donors: Any, features: FloatArray, change: FloatArray, scores: FloatArray
) -> None:
    """Write the same score of each tick by a forest, over the same grid."""
    mass = np.empty(_BINS + 1)
    for row in range(features.shape[0]):
        mass[:] = 0.0
        for root in roots:
            leaf = leaf_of(nodes, root, features[row])
            first, count = int(nodes[leaf, 1]), int(nodes[leaf, 2])
            for donor in range(first, first + count):
                place = math.ceil((donors[donor, 0] - _LOW) / _STEP - 0.5)  # the first z at or above it
                mass[min(_BINS, max(0, place))] += 1.0 / count / roots.shape[0]
        below = 0.0
        for index in range(_BINS):
            below += mass[index]
            above = 1.0 if change[row] <= _LOW + (index + 0.5) * _STEP else 0.0
            scores[row] += (below - above) * (below - above) * _STEP
