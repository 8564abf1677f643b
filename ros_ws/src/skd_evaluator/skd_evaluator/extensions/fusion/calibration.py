"""Calibration: parameters of the simulated car and road by least squares over recorded trials, with intervals.

What is compared is where the car is along the road, tick by tick, in the recording and in the simulation of the same
trial. The controller is asked with car and road user as they were recorded, so that its commands are those of the trial
whatever the simulated car does. A car that decides by what it sees would otherwise decide otherwise after the first
small difference, and late parts of a trial would say nothing of brake and road.

A search over a grid, then Gauss-Newton with finite differences, and steps to all sides. A limit is believed where
trials go worse without it, by an F test in which each φ counts as one number: beyond a limit all values are alike, and
noise would find one. One that is not shown may be there all the same, so intervals of the others hold both. What is
left of a trial is not independent from tick to tick: a car that braked late stays ahead. So the covariance is the
cluster jackknife of φ, of which each is left out in turn, by one step of Gauss-Newton (CR3: J. G. MacKinnon and
H. White, Journal of Econometrics 29, 1985; R. M. Bell and D. F. McCaffrey, Survey Methodology 28, 2002), with Student's
quantile.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy import special
from skd_sim.arrays import FloatArray
from skd_sim.errors import UsageError
from skd_sim.options.car_under_test import DYNAMICS
from skd_sim.scenario.road import right_and_along
from skd_sim.scenario.scenario import Scenario, scenario_from_dict
from skd_sim.simulators.simulator import Frame, WorldSimulator
from skd_sim.world.episode import EpisodeSpec, Mode, Outcome
from skd_sim.world.state import CarState, Trajectory

from skd_evaluator.assessment.run.episodes import run_episode
from skd_evaluator.errors import AssessmentError
from skd_evaluator.extensions.fusion.estimate import LEAST_PAIRS
from skd_evaluator.metrics.clustered import student_quantile
from skd_evaluator.metrics.statistics import Interval
from skd_evaluator.metrics.surrogate_scenes import Interaction

TYRES = "multi_body"
"""Dynamics that take the place of those without a brake and tyres."""


@dataclass(frozen=True)
class WorldParameter:
    """A parameter of the simulator.

    Attributes:
        name: in files and messages.
        place: its key in a scenario.
        text: what it is, as people read it.
        unit: of it; empty for a ratio.
        range: least and greatest value that is looked at.
        tried: values from which the search begins.
        step: by which its effect is looked at.
        is_limit: whether it is felt only where a car comes to it: beyond, all values are alike.
        sensing: whether it concerns cars with a laser alone.
    """

    name: str
    place: tuple[str, str]
    text: str
    unit: str
    range: tuple[float, float]
    tried: tuple[float, ...]
    step: float
    is_limit: bool = False
    sensing: bool = False

    def of(self, scenario: Scenario) -> float:
        """Return its value in a scenario."""
        section, key = self.place
        return float(getattr(getattr(scenario, section), key))

    def shown(self, value: float) -> str:
        """Return a value with its unit."""
        return f"{value:.3g} {self.unit}".rstrip()


PARAMETERS = {
    one.name: one
    for one in (
        WorldParameter(
            "delay", ("car", "brake_delay"), "brake's delay", "s", (0.0, 1.0), (0.0, 0.1, 0.2, 0.35, 0.55), 0.03
        ),
        WorldParameter(
            "deceleration",
            ("car", "brake_limit"),
            "brake's greatest deceleration",
            "m/s²",
            (0.5, 15.0),
            (2.0, 3.0, 4.0, 5.0, 6.5, 8.5),
            0.15,
            is_limit=True,
        ),
        WorldParameter(
            "friction",
            ("road", "friction"),
            "friction, relative to a dry road",
            "",
            (0.05, 1.3),
            (0.15, 0.25, 0.35, 0.5, 0.7, 0.9),
            0.02,
            is_limit=True,
        ),
        WorldParameter(
            "sensor_range",
            ("sensor", "maximum_range"),
            "sensor's range",
            "m",
            (2.0, 100.0),
            (6.0, 9.0, 12.0, 15.0, 20.0, 30.0, 50.0),
            1.0,
            is_limit=True,
            sensing=True,
        ),
    )
}


def calibrated(scenario: Scenario, values: Mapping[str, float]) -> Scenario:
    """Return a scenario with values of parameters, by name; its car gets a brake and tyres if it has none."""
    data = dict(scenario.as_dict())
    if not DYNAMICS[scenario.car.dynamics].tyres:
        data["car"] = {**data["car"], "dynamics": TYRES}
    for name, value in values.items():
        section, key = PARAMETERS[name].place
        data[section] = {**data[section], key: float(value)}
    return scenario_from_dict(data, f"scenario {scenario.name}, calibrated")


_OFF_SPEED = 0.08
"""Share by which a trial's first speed may differ from the scenario's: beyond, it was another test."""
_NO_CONTACT = 60.0  # m/s: nobody ends a run, so that the whole recording can be compared


@dataclass(frozen=True, eq=False)
class Recorded:
    """A physical trial at the simulator's times.

    Attributes:
        phi: name of its φ.
        other: positions of the road user at ticks, n × 2, m.
        car: states of the car at control periods, from the first tick to the last: x, y (m), heading (rad), speed.
        where: file and line, for messages.
    """

    phi: str
    other: FloatArray
    car: FloatArray
    where: str


@dataclass(frozen=True)
class ReplayedDrive:
    """A trial that is to be driven again.

    Attributes:
        trial: as it was recorded.
        scenario: the simulated world.
        controller: of the car.
        multiplier: of the basic car.
    """

    trial: Recorded
    scenario: Scenario
    controller: str
    multiplier: float


class ShownRecording:
    """SKD's own world, whose car goes by itself while its controller is shown the recorded one."""

    places_others: Final = True

    def __init__(self, states: FloatArray) -> None:
        """Take the recorded states of the car, at control periods."""
        self._states, self._inner = states, WorldSimulator()
        self.places: list[tuple[float, float]] = []

    def reset(self, episode: EpisodeSpec) -> Frame:
        """Begin where the recording begins, at its speed."""
        frame = self._inner.reset(episode)
        world, self._periods = self._inner.world, episode.scenario.control_periods
        begin = CarState(*map(float, self._states[0]))
        world.car = begin
        world.dynamics.reset(begin)
        self.places = [begin[:2]]
        return frame._replace(car=begin)

    def step(self, acceleration: float, velocity: tuple[float, float]) -> Frame:
        """Advance the world by one control period."""
        frame = self._inner.step(acceleration, velocity)
        if frame.period == 0:
            self.places.append(frame.car[:2])
        number = min(frame.tick * self._periods + frame.period, len(self._states) - 1)
        return frame._replace(car=CarState(*map(float, self._states[number])))

    @property
    def clipped(self) -> int:
        """How many commands were beyond what the car can do."""
        return self._inner.clipped


def recorded(scenario: Scenario, scene: Interaction, phi: str, where: str) -> Recorded:
    """Return a trial at the simulator's times, until the end of its φ or the contact.

    Raises:
        UsageError: it is shorter than three ticks, or the car began at another speed than in the scenario.
    """
    ticks = int(scene.times[-1] / scenario.time_step + 1e-6)
    if ticks < 2:
        raise UsageError(f"{where}: the trial lasts {scene.times[-1]:.1f} s, too short to calibrate with")
    speed, wanted = float(scene.car[0, 3]), scenario.car.start_speed
    if abs(speed - wanted) > _OFF_SPEED * wanted:
        raise UsageError(
            f"{where}: the car begins at {speed:.2f} m/s, and in the simulation at {wanted:.2f}: simulate the speed "
            "of the trials (--set car.start_speed=…)"
        )
    times = scenario.time_step * np.arange(ticks + 1)
    places = np.column_stack([np.interp(times, scene.times, column) for column in scene.other.T])
    periods = scenario.control_duration * np.arange(ticks * scenario.control_periods + 1)
    states = np.column_stack([np.interp(periods, scene.times, column) for column in scene.car.T])
    return Recorded(phi, places, states, where)


def off_by(drive: ReplayedDrive) -> FloatArray:
    """Return how far the recorded car is ahead of the simulated one along the road, at each tick, m.

    Raises:
        AssessmentError: the episode was aborted.
    """
    trial, scenario = drive.trial, drive.scenario
    car = replace(
        scenario.car, start_gap_range=0.0, meet_safe_trajectory=False, speed_noise=0.0, acceleration_noise=0.0
    )
    collision = replace(scenario.collision, minimum_impact_speed=_NO_CONTACT)
    episode = EpisodeSpec(
        replace(scenario, car=car, collision=collision),
        Mode.REPLAY,
        0,
        0,
        Trajectory(trial.other, scenario.time_step, trial.phi),
        public=scenario,
        controller=drive.controller,
        multiplier=drive.multiplier,
    )
    shown = ShownRecording(trial.car)
    log = run_episode(episode, simulator=shown)
    if log.outcome == Outcome.ABORTED:
        raise AssessmentError(f"{trial.where}: the trial could not be driven again: {log.reason}")
    line = scenario.road.line
    simulated = right_and_along(line, np.array(shown.places))[:, 1]
    seen = right_and_along(line, np.ascontiguousarray(trial.car[:: scenario.control_periods, :2]))[:, 1]
    count = min(len(simulated), len(seen))
    return np.asarray(seen[:count] - simulated[:count])


Off = Callable[[Mapping[str, float]], list[FloatArray]]
"""Given values of parameters: recorded less simulated place of each trial, m, per tick."""
POOR = 0.3
"""m, root mean square, left between recorded and simulated places, above which nothing is said: it is another car."""
_ALIKE = 0.97
"""Cosine of two parameters' effects from which on nobody can tell them apart."""
_FELT = 0.02
"""m, root mean square over all ticks: a step of a parameter that moves cars less than that is not felt."""
_ROUNDS, _NEAR = 12, 0.02
"""Steps of Gauss-Newton, and share of a parameter's step by which the last may still move it."""
_HALVINGS = 5
_AS_WELL = 1.1
"""Sum of squares over the least one, up to which a limit explains the trials as well as another."""
_HARDLY = "the trials hardly depend on it"
_POLISHED = 3
"""How often steps to all sides and Gauss-Newton take turns."""
_SHOWN = 0.01
"""p-value of trials going no worse without a limit, below which it is believed."""


@dataclass(frozen=True)
class ParameterEstimate:
    """A parameter as the trials have it.

    Attributes:
        parameter: which.
        value: estimated, or the scenario's where the trials say nothing.
        interval: of 95 %; None where the trials say nothing.
        error: standard error; None likewise.
        reason: why the trials say nothing; else empty.
    """

    parameter: WorldParameter
    value: float
    interval: Interval | None
    error: float | None
    reason: str = ""


@dataclass(frozen=True, eq=False)
class SimulatorCalibration:
    """All parameters.

    Attributes:
        estimates: in the order of `PARAMETERS`.
        covariance: of those that have an interval, in this order.
        freedom: degrees of freedom of Student's t.
        before: root mean square of recorded less simulated places, m, with the scenario's own values.
        after: the same with the estimated ones.
        by_trial: of each trial, after.
    """

    estimates: tuple[ParameterEstimate, ...]
    covariance: FloatArray
    freedom: float
    before: float
    after: float
    by_trial: FloatArray

    @property
    def told(self) -> tuple[ParameterEstimate, ...]:
        """Those that have an interval."""
        return tuple(one for one in self.estimates if one.interval is not None)

    @property
    def values(self) -> dict[str, float]:
        """Values of all parameters of the simulated world, by name."""
        return {one.parameter.name: one.value for one in self.estimates}


def estimated(
    off: Off, start: Mapping[str, float], free: Sequence[str], groups: Sequence[int], confidence: float = 0.95
) -> SimulatorCalibration:
    """Return parameters by trials.

    Args:
        off: gives recorded less simulated places.
        start: values of all parameters in the scenario.
        free: names of those that may be estimated; where two are not told apart, the earlier is.
        groups: number of each trial's φ.
        confidence: of the intervals.

    Raises:
        ValueError: fewer than five φ.
    """
    off, numbers = _remembered(off), np.asarray(groups)
    count = len(set(groups))
    if count < LEAST_PAIRS:
        raise ValueError(f"trials on {count} φ are too few to calibrate with: at least {LEAST_PAIRS} are needed")
    before = _together(off(start))
    values, reasons = _begun(off, dict(start), free)
    names = [name for name in free if not PARAMETERS[name].is_limit or values[name] != start[name]]
    maybe: list[dict[str, Interval]] = []
    slopes: list[list[FloatArray]] = []
    while names:
        values = _descended(off, values, names)
        slopes = _slopes(off, values, names)
        dropped = _dropped(slopes, names)
        if dropped is None:
            dropped = _not_shown(off, values, start, names, count)
            if dropped is None:
                break
            maybe.append(_intervals(values, names, slopes, off(values), numbers, confidence)[1])
        name, reasons[name] = dropped
        names.remove(name)
        values[name] = start[name]
    left, freedom = off(values), float(max(1, count - len(names)))
    spread, intervals = _intervals(values, names, slopes, left, numbers, confidence)
    spread, intervals = _widened(values, names, spread, intervals, maybe, student_quantile(freedom, confidence))
    found = []
    for name in (one for one in PARAMETERS if one in values):
        if name in names:
            error = math.sqrt(spread[names.index(name), names.index(name)])
            found.append(ParameterEstimate(PARAMETERS[name], values[name], intervals[name], error))
        else:
            found.append(
                ParameterEstimate(PARAMETERS[name], values[name], None, None, reasons.get(name) or "not asked for")
            )
    order = [names.index(one.parameter.name) for one in found if one.interval is not None]
    return SimulatorCalibration(
        tuple(found),
        spread[np.ix_(order, order)],
        freedom,
        math.sqrt(np.mean(before**2)),
        math.sqrt(np.mean(_together(left) ** 2)),
        np.array([math.sqrt(np.mean(one**2)) for one in left]),
    )


def _together(parts: Sequence[FloatArray]) -> FloatArray:
    return np.concatenate(parts)


def _squares(off: Off, values: Mapping[str, float]) -> float:
    return float(np.sum(_together(off(values)) ** 2))


def _intervals(
    values: Mapping[str, float],
    names: Sequence[str],
    slopes: Sequence[Sequence[FloatArray]],
    left: Sequence[FloatArray],
    groups: np.ndarray,
    confidence: float,
) -> tuple[FloatArray, dict[str, Interval]]:
    """Return covariance and intervals of parameters, in their ranges."""
    if not names:
        return np.zeros((0, 0)), {}
    spread = _covariance(slopes, left, groups)
    quantile = student_quantile(max(1.0, len(set(groups.tolist())) - len(names)), confidence)
    found = {}
    for place, name in enumerate(names):
        low, high = PARAMETERS[name].range
        reach = quantile * math.sqrt(spread[place, place])
        found[name] = max(low, values[name] - reach), min(high, values[name] + reach)
    return spread, found


def _widened(
    values: Mapping[str, float],
    names: Sequence[str],
    spread: FloatArray,
    intervals: Mapping[str, Interval],
    maybe: Sequence[Mapping[str, Interval]],
    quantile: float,
) -> tuple[FloatArray, dict[str, Interval]]:
    """Return covariance and intervals that hold those with a limit, too, that was left out and may be there."""
    times, found = np.ones(len(names)), dict(intervals)
    for place, name in enumerate(names):
        low = min(one[name][0] for one in [intervals, *maybe])
        high = max(one[name][1] for one in [intervals, *maybe])
        found[name] = low, high
        reach = max(values[name] - low, high - values[name])
        times[place] = max(1.0, reach / (quantile * math.sqrt(spread[place, place])))
    return spread * np.outer(times, times), found


def _remembered(off: Off) -> Off:
    """Return the same, of which each answer is computed once."""
    known: dict[tuple[float, ...], list[FloatArray]] = {}

    def answer(values: Mapping[str, float]) -> list[FloatArray]:
        key = tuple(values[name] for name in PARAMETERS if name in values)
        if key not in known:
            known[key] = off(values)
        return known[key]

    return answer


def _begun(off: Off, start: dict[str, float], free: Sequence[str]) -> tuple[dict[str, float], dict[str, str]]:
    """Return the values from which to go on, and why some limits are not told.

    Each limit is tried with every value of what is none, and the first is taken that explains the trials as well as
    any: a weak brake and a wet road look alike.
    """
    plain = [name for name in free if not PARAMETERS[name].is_limit]
    tried = [start]
    for name in plain:
        tried += [{**one, name: value} for one in tried for value in PARAMETERS[name].tried]
    found = {"": min(tried, key=lambda one: _squares(off, one))}
    for name in (one for one in free if PARAMETERS[one].is_limit):
        grid = [{**one, name: value} for one in tried for value in PARAMETERS[name].tried]
        best = min([found[""], *grid], key=lambda one: _squares(off, one))
        found[name] = _descended(off, best, [*plain, name]) if best[name] != start[name] else best
    squares = {name: _squares(off, one) for name, one in found.items()}
    chosen = next(name for name, left in squares.items() if left <= _AS_WELL * min(squares.values()))
    reasons = {
        name: f"the trials do not tell it from the {PARAMETERS[chosen].text}"
        if chosen and left <= _AS_WELL * squares[chosen]
        else _HARDLY
        for name, left in squares.items()
        if name and name != chosen
    }
    further = [
        {**found[chosen], name: value}
        for name, reason in reasons.items()
        if reason == _HARDLY and chosen
        for value in PARAMETERS[name].tried
    ]
    return min([found[chosen], *further], key=lambda one: _squares(off, one)), reasons


def _slopes(off: Off, values: Mapping[str, float], names: Sequence[str]) -> list[list[FloatArray]]:
    """Return by parameter and trial how simulated places change with it, m per unit: by a step to either side."""
    found = []
    for name in names:
        parameter = PARAMETERS[name]
        low, high = (
            min(max(values[name] + side * parameter.step, parameter.range[0]), parameter.range[1])
            for side in (-1.0, 1.0)
        )
        less, more = off({**values, name: low}), off({**values, name: high})
        found.append([(one - other) / (high - low) for one, other in zip(less, more, strict=True)])
    return found


def _descended(off: Off, values: dict[str, float], names: Sequence[str]) -> dict[str, float]:
    """Return values after Gauss-Newton and steps to all sides, in turn."""
    for _ in range(_POLISHED):
        values = _by_slopes(off, values, names)
        aside = _beside(off, values, names)
        if aside == values:
            break
        values = aside
    return values


def _beside(off: Off, values: dict[str, float], names: Sequence[str]) -> dict[str, float]:
    """Return values some steps to either side, one parameter after another, where that is better."""
    for name in names:
        parameter = PARAMETERS[name]
        low, high = parameter.range
        sides = [min(max(values[name] + steps * parameter.step, low), high) for steps in (-2.0, -0.7, 0.7, 2.0)]
        values = min([values, *({**values, name: value} for value in sides)], key=lambda one: _squares(off, one))
    return values


def _by_slopes(off: Off, values: dict[str, float], names: Sequence[str]) -> dict[str, float]:
    """Return values after steps of Gauss-Newton, halved where they do not help."""
    for _ in range(_ROUNDS):
        slopes = np.column_stack([_together(one) for one in _slopes(off, values, names)])
        left = _together(off(values))
        scale = np.array([PARAMETERS[name].step for name in names])
        step = np.linalg.lstsq(slopes * scale, left, rcond=1e-6)[0] * scale
        least, share = float(left @ left), 1.0
        for _halving in range(_HALVINGS):
            tried = dict(values)
            for name, by in zip(names, step.tolist(), strict=True):
                low, high = PARAMETERS[name].range
                tried[name] = min(max(values[name] + share * by, low), high)
            if _squares(off, tried) < least:
                break
            share *= 0.5
        else:
            return values
        moved = max(abs(tried[name] - values[name]) / PARAMETERS[name].step for name in names)
        values = tried
        if moved < _NEAR:
            break
    return values


def _dropped(slopes: Sequence[Sequence[FloatArray]], names: Sequence[str]) -> tuple[str, str] | None:
    """Return a parameter of which the trials say nothing, and why; None where there is none."""
    felt = [_together(one) * PARAMETERS[name].step for one, name in zip(slopes, names, strict=True)]
    for one, name in zip(felt, names, strict=True):
        if math.sqrt(float(np.mean(one**2))) < _FELT * PARAMETERS[name].step / _typical(name):
            return name, _HARDLY
    for second in range(len(names) - 1, 0, -1):
        for first in range(second):
            alike = float(felt[first] @ felt[second]) / math.sqrt(
                float(felt[first] @ felt[first]) * float(felt[second] @ felt[second])
            )
            if abs(alike) > _ALIKE:
                return names[second], f"the trials do not tell it from the {PARAMETERS[names[first]].text}"
    return None


def _not_shown(
    off: Off, values: Mapping[str, float], start: Mapping[str, float], names: Sequence[str], count: int
) -> tuple[str, str] | None:
    """Return a limit without which the trials go as well, and that; None where there is none."""
    for name in reversed(names):
        if not PARAMETERS[name].is_limit or values[name] == start[name]:
            continue
        without = _descended(off, {**values, name: start[name]}, [one for one in names if one != name])
        left, more = (sum(float(one @ one) for one in off(found)) for found in (values, without))
        freedom = max(1, count - len(names))
        beyond = (more - left) / max(left / freedom, 1e-12)
        if float(special.fdtrc(1, freedom, max(0.0, beyond))) > _SHOWN:
            return name, "without it the trials go as well: the car did not come to it"
    return None


def _typical(name: str) -> float:
    """Return a change of a parameter that matters: a tenth of the values that are tried."""
    tried = PARAMETERS[name].tried
    return 0.1 * (tried[-1] - tried[0])


def _covariance(slopes: Sequence[Sequence[FloatArray]], left: Sequence[FloatArray], groups: np.ndarray) -> FloatArray:
    """Return the cluster jackknife of the estimates: each φ left out by one step of Gauss-Newton."""
    parts, scores = [], []
    for number in dict.fromkeys(groups.tolist()):
        trials = np.flatnonzero(groups == number).tolist()
        slope = np.column_stack([np.concatenate([one[trial] for trial in trials]) for one in slopes])
        off = np.concatenate([left[trial] for trial in trials])
        parts.append(slope.T @ slope)
        scores.append(slope.T @ off)
    whole, score = np.sum(parts, axis=0), np.sum(scores, axis=0)
    best = np.linalg.solve(whole, score)  # 0 but for values at the end of a range
    moved = np.array(
        [
            np.linalg.lstsq(whole - part, score - own, rcond=1e-9)[0] - best
            for part, own in zip(parts, scores, strict=True)
        ]
    )
    count = len(parts)
    return np.asarray((count - 1.0) / count * (moved.T @ moved))
