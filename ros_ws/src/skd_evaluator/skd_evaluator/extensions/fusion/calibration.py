"""Calibration: parameters of the simulated car and road by least squares over recorded trials, with intervals.

What is compared is where the car is along the road, tick by tick, in the recording and in the simulation of the same
trial. The controller gets car and road user as they were recorded, so that its commands are those of the trial
whatever the simulated car does. A car that decides by what it sees would otherwise decide otherwise after the first
small difference, and late parts of a trial would say nothing of brake and road.

A search over a grid, then scipy's least squares with differences of finite steps. A limit is believed where trials go
worse without it, by an F test in which each φ counts as one number: beyond a limit all values are alike, and noise
would find one. One that is not shown may be there all the same, so intervals of the others hold both. What is left of a
trial is not independent from tick to tick: a car that braked late stays ahead. So the covariance is the cluster
jackknife of φ, of which each is left out in turn, by one step of Gauss-Newton (CR3: J. G. MacKinnon and H. White,
Journal of Econometrics 29, 1985; R. M. Bell and D. F. McCaffrey, Survey Methodology 28, 2002), with Student's quantile.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy import special
from scipy.optimize import least_squares
from skd_adversary.safe_trajectories.recordings import interpolated
from skd_sim.errors import AssessmentError, UsageError
from skd_sim.options.car_and_adversary import DYNAMICS, CarUnderTest
from skd_sim.scenario.road import right_and_along
from skd_sim.scenario.scenario import Scenario, scenario_from_dict
from skd_sim.simulators.simulator import Frame, WorldSimulator
from skd_sim.world.dynamics.basic import Command
from skd_sim.world.episode import EpisodeSpec, Mode, Outcome
from skd_sim.world.state import CarState, FloatArray, Trajectory

from skd_evaluator.assessment.run.episodes import run_episode
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.extensions.fusion.estimate import LEAST_PAIRS
from skd_evaluator.metrics.clustered import student_quantile
from skd_evaluator.metrics.entry import Entry
from skd_evaluator.metrics.statistics import Interval
from skd_evaluator.metrics.surrogate_scenes import Interaction

RESULT, SCENARIO = "simulator.json", "simulator.yaml"
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
    place: str
    text: str
    unit: str
    range: tuple[float, float]
    tried: tuple[float, ...]
    step: float
    is_limit: bool = False
    sensing: bool = False

    @property
    def label(self) -> str:
        """Text and unit."""
        return f"{self.text} ({self.unit})" if self.unit else self.text

    def of(self, scenario: Scenario) -> float:
        """Return its value in a scenario."""
        section, key = self.place.split(".")
        return float(getattr(getattr(scenario, section), key))

    def shown(self, value: float) -> str:
        """Return a value with its unit."""
        return f"{value:.3g} {self.unit}".rstrip()


PARAMETERS = {
    one.name: one
    for one in (
        WorldParameter("delay", "car.brake_delay", "brake's delay", "s", (0.0, 1.0), (0.0, 0.1, 0.2, 0.35, 0.55), 0.03),
        WorldParameter("deceleration", "car.brake_limit", "brake's greatest deceleration", "m/s²",
                       (0.5, 15.0), (2.0, 3.0, 4.0, 5.0, 6.5, 8.5), 0.15, is_limit=True),
        WorldParameter("friction", "road.friction", "friction, relative to a dry road", "",
                       (0.05, 1.3), (0.15, 0.25, 0.35, 0.5, 0.7, 0.9), 0.02, is_limit=True),
        WorldParameter("sensor_range", "sensor.maximum_range", "sensor's range", "m",
                       (2.0, 100.0), (6.0, 9.0, 12.0, 15.0, 20.0, 30.0, 50.0), 1.0, is_limit=True, sensing=True),
    )
}  # fmt: skip


def calibrated(scenario: Scenario, values: Mapping[str, float]) -> Scenario:
    """Return a scenario with values of parameters, by name; its car gets a brake and tyres if it has none."""
    data = dict(scenario.as_dict())
    if not DYNAMICS[scenario.car.dynamics].tyres:
        data["car"] = {**data["car"], "dynamics": TYRES}
    for name, value in values.items():
        section, key = PARAMETERS[name].place.split(".")
        data[section] = {**data[section], key: float(value)}
    return scenario_from_dict(data, f"scenario {scenario.name}, calibrated")


_OFF_SPEED = 0.08
"""Share by which a trial's first speed may differ from the scenario's: beyond, it was another test."""
_NO_CONTACT = 60.0  # m/s: no contact ends a run, so that the whole recording can be compared


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


class ShownRecording(WorldSimulator):
    """SKD's own world, whose car goes by itself while its controller is shown the recorded one.

    Attributes:
        places: of the car that goes by itself, at each tick, m.
    """

    def __init__(self, states: FloatArray) -> None:
        """Take the recorded states of the car, at control periods."""
        self._states = states

    def reset(self, episode: EpisodeSpec) -> Frame:
        """Begin where the recording begins, at its speed."""
        frame, begin = super().reset(episode), CarState(*map(float, self._states[0]))
        self.world.car = begin
        self.world.dynamics.reset(begin)
        self.places = [begin[:2]]
        return frame._replace(car=begin)

    def step(self, command: Command, velocity: tuple[float, float]) -> Frame:
        """Advance the world by one control period."""
        frame = super().step(command, velocity)
        if frame.period == 0:
            self.places.append(frame.car[:2])
        number = min(frame.tick * self._episode.scenario.control_periods + frame.period, len(self._states) - 1)
        return frame._replace(car=CarState(*map(float, self._states[number])))


def recorded(scenario: Scenario, scene: Interaction, phi: str, where: str) -> Recorded:
    """Return a trial at the simulator's times, until the end of its φ or the contact.

    Raises:
        UsageError: it is shorter than three ticks, or the car began at another speed than in the scenario.
    """
    ticks = int(scene.times[-1] / scenario.time_step + 1e-6)
    if ticks < 2:
        raise UsageError(f"{where}: the trial lasts {scene.times[-1]:.1f} s, too short to calibrate with")
    speed, simulated = float(scene.car[0, 3]), scenario.car.start_speed
    if abs(speed - simulated) > _OFF_SPEED * simulated:
        what = f"begins at {speed:.2f} m/s, and in the simulation at {simulated:.2f}"
        raise UsageError(f"{where}: the car {what}: simulate that speed (--set car.start_speed=…)")
    times = scenario.time_step * np.arange(ticks + 1)
    periods = scenario.control_duration * np.arange(ticks * scenario.control_periods + 1)
    return Recorded(
        phi, interpolated(times, scene.times, scene.other), interpolated(periods, scene.times, scene.car), where
    )


def off_by(scenario: Scenario, tested: CarUnderTest, trial: Recorded) -> FloatArray:
    """Return how far the recorded car is ahead of the simulated one along the road, at each tick, m.

    Args:
        scenario: the simulated world.
        tested: the car that is driven again.
        trial: as it was recorded.

    Raises:
        AssessmentError: the episode was aborted.
    """
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
        controller=tested.controller,
        multiplier=tested.multiplier,
    )
    shown = ShownRecording(trial.car)
    log = run_episode(episode, simulator=shown)
    if log.outcome == Outcome.ABORTED:
        raise AssessmentError(f"{trial.where}: the trial could not be driven again: {log.reason}")
    seen = np.ascontiguousarray(trial.car[:: scenario.control_periods, :2])
    count = min(len(seen), len(shown.places))
    ahead, simulated = (right_and_along(scenario.road.line, one) for one in (seen, np.array(shown.places)))
    return np.asarray(ahead[:count, 1] - simulated[:count, 1])


Off = Callable[[Mapping[str, float]], list[FloatArray]]
"""Given values of parameters: recorded less simulated place of each trial, m, per tick."""
POOR = 0.3
"""m, root mean square, left between recorded and simulated places, above which nothing is said: it is another car."""
_ALIKE = 0.97
"""Cosine of two parameters' effects from which on they are alike."""
_FELT = 0.02
"""m, root mean square over all ticks: a parameter that moves cars less, where it changes much, is not felt."""
_NEAR = 1e-4
"""Share of values, and of the sum of squares, that the last step of least squares may still change."""
_AS_WELL = 1.1
"""Sum of squares over the least one, up to which a limit explains the trials as well as another."""
_HARDLY = "the trials hardly depend on it"
_SHOWN = 0.01
"""p-value of trials going no worse without a limit, below which it is believed."""


@dataclass(frozen=True)
class ParameterEstimate(Entry):
    """A parameter as the trials have it.

    Attributes:
        parameter: which.
        value: estimated, or the scenario's where the trials say nothing.
        interval: of 95 %; None where the trials say nothing.
        error: standard error; None likewise.
        reason: why the trials say nothing; else None.
    """

    KEYS = "place=parameter.place unit=parameter.unit value ci95=interval standard_error=error reason"

    parameter: WorldParameter
    value: float
    interval: Interval | None
    error: float | None
    reason: str | None = None


@dataclass(frozen=True, eq=False)
class SimulatorCalibration(Entry):
    """All parameters.

    Attributes:
        estimates: in the order of `PARAMETERS`.
        covariance: of those that have an interval, in this order.
        freedom: degrees of freedom of Student's t.
        before: root mean square of recorded less simulated places, m, with the scenario's own values.
        after: the same with the estimated ones.
        by_trial: of each trial, after.
    """

    KEYS = (
        "parameters covariance degrees_of_freedom=freedom places_off_before=before places_off_after=after "
        "places_off_by_trial=by_trial"
    )

    estimates: tuple[ParameterEstimate, ...]
    covariance: FloatArray
    freedom: float
    before: float
    after: float
    by_trial: FloatArray

    @property
    def parameters(self) -> dict[str, ParameterEstimate]:
        """Them by name."""
        return {one.parameter.name: one for one in self.estimates}

    @property
    def identified(self) -> tuple[ParameterEstimate, ...]:
        """Those that have an interval."""
        return tuple(one for one in self.estimates if one.interval is not None)

    @property
    def values(self) -> dict[str, float]:
        """Values of all parameters of the simulated world, by name."""
        return {one.parameter.name: one.value for one in self.estimates}

    @property
    def warnings(self) -> list[str]:
        """What to know of them, a line each."""
        if not self.identified:
            return ["the trials say nothing of the simulator's parameters"]
        return [
            f"{one.parameter.text} is at the end of its range, {one.parameter.shown(one.value)}"
            for one in self.identified
            if one.value in one.parameter.range
        ]

    @property
    def sentences(self) -> Iterator[str]:
        """What may be said of the simulated car."""
        for one in self.identified:
            assert one.interval is not None
            value, low, high = map(one.parameter.shown, (one.value, *one.interval))
            yield f"The {one.parameter.text} is {value}, with a 95 % interval from {low} to {high}."
        off = f"Simulated cars are {self.after:.2f} m from where recorded ones were (root mean square)"
        yield f"{off}; with the scenario's own values {self.before:.2f} m."


def estimated(off: Off, start: Mapping[str, float], free: Sequence[str], groups: Sequence[int]) -> SimulatorCalibration:
    """Return parameters by trials.

    Args:
        off: gives recorded less simulated places.
        start: values of all parameters in the scenario.
        free: names of those that may be estimated; where two are alike, the earlier is.
        groups: number of each trial's φ.

    Raises:
        ValueError: fewer than five φ.
    """
    misfit, count = _Misfit(off, groups), len(set(groups))
    if count < LEAST_PAIRS:
        raise ValueError(f"trials on {count} φ are too few to calibrate with: at least {LEAST_PAIRS} are needed")
    values, reasons = _begun(misfit, dict(start), free)
    names = [name for name in free if not PARAMETERS[name].is_limit or values[name] != start[name]]
    ends: dict[str, list[Interval]] = {name: [] for name in names}
    spread, reach = np.zeros((0, 0)), np.zeros(0)
    while names:
        values = misfit.fitted(values, names)
        dropped = _dropped(misfit.slopes(values, names), names)
        if dropped is None:
            spread = misfit.covariance(values, names)
            reach = student_quantile(max(1.0, count - len(names))) * np.sqrt(np.diag(spread))
            for name, far in zip(names, reach.tolist(), strict=True):
                low, high = PARAMETERS[name].range
                ends[name].append((max(low, values[name] - far), min(high, values[name] + far)))
            dropped = _not_shown(misfit, values, start, names, count)
            if dropped is None:
                break
        name, reasons[name] = dropped
        names.remove(name)
        values[name] = start[name]
    found = {
        name: ParameterEstimate(PARAMETERS[name], values[name], None, None, reasons.get(name, "not requested"))
        for name in PARAMETERS
        if name in values
    }
    if names:  # intervals hold those with a limit, too, that was left out and may be there
        both = [(min(low for low, _ in ends[name]), max(high for _, high in ends[name])) for name in names]
        at = np.array([values[name] for name in names])
        wider = np.maximum(1.0, np.abs(np.transpose(both) - at).max(axis=0) / reach)
        spread = spread * np.outer(wider, wider)
        for name, interval, error in zip(names, both, np.sqrt(np.diag(spread)).tolist(), strict=True):
            found[name] = ParameterEstimate(PARAMETERS[name], values[name], interval, error)
    order = [names.index(name) for name in found if name in names]
    before, after = (math.sqrt(np.mean(misfit.together(one) ** 2)) for one in (start, values))
    by_trial = np.array([math.sqrt(np.mean(one**2)) for one in misfit(values)])
    freedom = float(max(1, count - len(names)))
    return SimulatorCalibration(tuple(found.values()), spread[np.ix_(order, order)], freedom, before, after, by_trial)


def calibration_of(
    world: Scenario, car: CarUnderTest, trials: Sequence[Recorded], names: Sequence[str] | None, workers: int
) -> SimulatorCalibration:
    """Return the parameters of a simulated world by trials of a car.

    Args:
        world: the scenario as it was simulated.
        car: whose controller drives the trials again.
        trials: as they were recorded.
        names: of the parameters that may be estimated; None: all.
        workers: number of processes.

    Raises:
        UsageError: too few φ, a parameter that the world does not have, or cars that are not alike with any values.
    """
    known = [name for name, one in PARAMETERS.items() if not one.sensing or world.sensor is not None]
    if absent := [one for one in names or () if one not in known]:
        raise UsageError(f"{absent[0]} cannot be calibrated: scenario {world.name} has no sensor")
    start = {name: PARAMETERS[name].of(calibrated(world, {})) for name in known}
    numbers = list(dict.fromkeys(one.phi for one in trials))
    with InProcessRunner(workers, isolated=not car.is_own) as runner:
        runner.start()

        def off(values: Mapping[str, float]) -> list[np.ndarray]:
            return list(runner.map(partial(off_by, calibrated(world, values), car), trials))

        try:
            free = [name for name in known if not names or name in names]
            found = estimated(off, start, free, [numbers.index(one.phi) for one in trials])
        except ValueError as error:
            raise UsageError(str(error)) from error
    if found.after > POOR:
        apart = f"{found.after:.2f} m (root mean square) off the recorded ones, more than {POOR:g} m"
        raise UsageError(f"with the best parameters simulated cars are {apart}: it is another car, or other software")
    return found


class _Misfit:
    """Recorded less simulated places by values of parameters; each set of values is simulated once."""

    def __init__(self, off: Off, groups: Sequence[int]) -> None:
        self._off, self._groups = off, np.asarray(groups)
        self._known: dict[tuple[float, ...], list[FloatArray]] = {}

    def __call__(self, values: Mapping[str, float]) -> list[FloatArray]:
        """Return it by trial, m, per tick."""
        key = tuple(values.values())
        if key not in self._known:
            self._known[key] = self._off(values)
        return self._known[key]

    def together(self, values: Mapping[str, float]) -> FloatArray:
        """Return it of all trials, one after the other."""
        return np.concatenate(self(values))

    def squares(self, values: Mapping[str, float]) -> float:
        """Return the sum of its squares, m²."""
        return float(np.sum(self.together(values) ** 2))

    def slopes(self, values: Mapping[str, float], names: Sequence[str]) -> FloatArray:
        """Return how simulated places change with parameters, m per unit, a column each: by a step to either side."""
        found = []
        for name in names:
            sides = np.clip(values[name] + np.array([-1.0, 1.0]) * PARAMETERS[name].step, *PARAMETERS[name].range)
            less, more = (self.together({**values, name: side}) for side in sides.tolist())
            found.append((less - more) / (sides[1] - sides[0]))
        return np.column_stack(found)

    def fitted(self, values: dict[str, float], names: Sequence[str]) -> dict[str, float]:
        """Return the values of least squares near some, of which those with names may move within their ranges."""
        if not names:
            return values

        def put(at: FloatArray) -> dict[str, float]:
            return {**values, **dict(zip(names, at.tolist(), strict=True))}

        def left(at: FloatArray) -> FloatArray:
            return self.together(put(at))

        def slopes(at: FloatArray) -> FloatArray:
            return -self.slopes(put(at), names)

        chosen, begin = [PARAMETERS[name] for name in names], [values[name] for name in names]
        (low, high), steps = np.array([one.range for one in chosen]).T, [one.step for one in chosen]
        found = least_squares(left, begin, slopes, (low, high), "dogbox", ftol=_NEAR, xtol=_NEAR, x_scale=steps)
        return put(found.x)

    def covariance(self, values: Mapping[str, float], names: Sequence[str]) -> FloatArray:
        """Return the cluster jackknife of the estimates: each φ left out by one step of Gauss-Newton."""
        left, slopes = self.together(values), self.slopes(values, names)
        of = np.repeat(self._groups, [len(one) for one in self(values)])
        rows = [of == number for number in dict.fromkeys(of.tolist())]
        parts = np.array([slopes[one].T @ slopes[one] for one in rows])
        scores = np.array([slopes[one].T @ left[one] for one in rows])
        whole, score = parts.sum(axis=0), scores.sum(axis=0)
        best = np.linalg.solve(whole, score)  # 0 but for values at the end of a range
        moved = [
            np.linalg.lstsq(whole - part, score - own, rcond=1e-9)[0] - best
            for part, own in zip(parts, scores, strict=True)
        ]
        return np.asarray((len(rows) - 1.0) / len(rows) * (np.transpose(moved) @ moved))


def _begun(misfit: _Misfit, start: dict[str, float], free: Sequence[str]) -> tuple[dict[str, float], dict[str, str]]:
    """Return the values from which to go on, and why some limits are not identified.

    Each limit is tried with every value of what is none, and the first is taken that explains the trials as well as
    any: a weak brake and a wet road look alike.
    """
    plain = [name for name in free if not PARAMETERS[name].is_limit]
    tried = [start]
    for name in plain:
        tried += [{**one, name: value} for one in tried for value in PARAMETERS[name].tried]
    found = {"": min(tried, key=misfit.squares)}
    for name in (one for one in free if PARAMETERS[one].is_limit):
        grid = [{**one, name: value} for one in tried for value in PARAMETERS[name].tried]
        best = min([found[""], *grid], key=misfit.squares)
        found[name] = misfit.fitted(best, [*plain, name]) if best[name] != start[name] else best
    squares = {name: misfit.squares(one) for name, one in found.items()}
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
    return min([found[chosen], *further], key=misfit.squares), reasons


def _dropped(slopes: FloatArray, names: Sequence[str]) -> tuple[str, str] | None:
    """Return a parameter of which the trials say nothing, and why; None where there is none."""
    for slope, name in zip(slopes.T, names, strict=True):
        tried = PARAMETERS[name].tried  # a change that matters is a tenth of those
        if math.sqrt(np.mean(slope**2)) * 0.1 * (tried[-1] - tried[0]) < _FELT:
            return name, _HARDLY
    unit = slopes / np.linalg.norm(slopes, axis=0)
    alike = np.argwhere(np.tril(np.abs(unit.T @ unit), -1) > _ALIKE)
    if not alike.size:
        return None
    second, first = max(alike.tolist(), key=lambda pair: (pair[0], -pair[1]))
    return names[second], f"the trials do not tell it from the {PARAMETERS[names[first]].text}"


def _not_shown(
    misfit: _Misfit, values: Mapping[str, float], start: Mapping[str, float], names: Sequence[str], count: int
) -> tuple[str, str] | None:
    """Return a limit without which the trials go as well, and that; None where there is none."""
    for name in reversed(names):
        if not PARAMETERS[name].is_limit or values[name] == start[name]:
            continue
        without = misfit.fitted({**values, name: start[name]}, [one for one in names if one != name])
        left, more, freedom = misfit.squares(values), misfit.squares(without), max(1, count - len(names))
        beyond = (more - left) / max(left / freedom, 1e-12)
        if special.fdtrc(1, freedom, max(0.0, beyond)) > _SHOWN:
            return name, "without it the trials go as well: the car did not come to it"
    return None
