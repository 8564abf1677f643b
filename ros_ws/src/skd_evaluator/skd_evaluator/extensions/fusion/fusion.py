"""The work of `skd fuse`: the physical car, how many trials it takes, the calibrated simulator.

What the physical car does follows from physical trials and a simulator: every figure with its interval, test and gap.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats
from skd_sim.errors import UsageError
from skd_sim.inputs.files import one_line, read_json
from skd_sim.inputs.yaml_file import to_yaml
from skd_sim.options.car_and_adversary import CarUnderTest
from skd_sim.world.state import FloatArray

from skd_evaluator.assessment.files.result_folder import write_json
from skd_evaluator.assessment.run.workers import available_workers, check_controller
from skd_evaluator.bags.tracks import RecordingFrame
from skd_evaluator.cli.arguments import result_folder
from skd_evaluator.cli.output import finish
from skd_evaluator.extensions.fusion import calibration, estimate
from skd_evaluator.extensions.fusion.estimate import Line, Mean, Reach, kurtosis, skewness, trials_for_width
from skd_evaluator.extensions.fusion.recordings import TrialRecorder, overruled, track_of
from skd_evaluator.extensions.fusion.trials import (
    FIGURES,
    GAP_TOLERANCE,
    Pairs,
    PhysicalTrial,
    Simulated,
    TrialFigure,
    paired,
    read_simulated,
    read_trials,
    table_in,
)
from skd_evaluator.metrics.clustered import student_quantile
from skd_evaluator.metrics.entry import Entry
from skd_evaluator.metrics.sample_size import nominal_confidence
from skd_evaluator.metrics.statistics import Interval
from skd_evaluator.report.formats import counted
from skd_evaluator.report.terminal import narrow_table, print_table


@dataclass(frozen=True)
class GapTrend(Entry):
    """How a gap changes with something.

    Attributes:
        slope: of the line of least squares, in the unit of the gap per unit of what it is held against.
        interval: of the slope, by Student's t.
        p_value: two-sided, of no trend.
    """

    KEYS = "slope interval p_value"

    slope: float
    interval: Interval
    p_value: float


@dataclass(frozen=True, eq=False)
class Gap(Entry):
    """Physical less simulated figure.

    Attributes:
        mean: over the φ with trials.
        interval: of the mean, by Student's t; None where all gaps are the same.
        by_simulated: whether it grows with the simulated figure: 0 where the simulator is off by the same everywhere.
        by_order: whether it grows from trial to trial, per trial: brakes that warm up, a track that dries.
        by_phi: of each φ, in the order of the pairs.
    """

    KEYS = "mean interval by_simulated by_order by_phi"

    mean: float
    interval: Interval | None
    by_simulated: GapTrend | None
    by_order: GapTrend | None
    by_phi: FloatArray


def gap_of(y: FloatArray, x: FloatArray, trials: FloatArray, predicted: FloatArray, confidence: float = 0.95) -> Gap:
    """Return the gap of pairs.

    Args:
        y: physical figures, one of each φ.
        x: simulated figures of the same φ.
        trials: physical figures of each trial, in the order in which they were made.
        predicted: what the simulator says of each of these trials.
        confidence: of the intervals, two-sided.
    """
    gaps = y - x
    centre, deviation = float(gaps.mean()), float(gaps.std(ddof=1))
    half = student_quantile(gaps.size - 1.0, confidence) * deviation / math.sqrt(gaps.size)
    interval = (centre - half, centre + half) if half > 0.0 else None
    order = trend(np.arange(trials.size, dtype=np.float64), trials - predicted, confidence)
    return Gap(centre, interval, trend(x, gaps, confidence), order, gaps)


def trend(places: FloatArray, values: FloatArray, confidence: float = 0.95) -> GapTrend | None:
    """Return the line of least squares of values over places; None where the places or the values are all the same."""
    if places.size < 3 or not np.ptp(places) or not np.ptp(values) > 1e-9 * float(np.abs(values).max()):
        return None
    line = stats.linregress(places, values)
    half, slope = student_quantile(places.size - 2.0, confidence) * float(line.stderr), float(line.slope)
    return GapTrend(slope, (slope - half, slope + half), float(line.pvalue))


_MANY = 5
"""Simulated φ for each physical one, below which their own error is felt."""
_RARE, _FEW = 12.0, 20
"""Kurtosis of what is simulated from which a few φ decide a mean, and the φ with trials that it then takes to say
something. The normal distribution has 3."""
_MOST_REACH, _FELT = 4.0, 1.25
"""How many times as far as Student's an interval may reach before nothing is said; and before that is said."""


class NotSaidError(UsageError):
    """A figure of which nothing can be said by these trials; the message says why."""


@dataclass(frozen=True, eq=False)
class FusedFigure(Entry):
    """One figure of the physical car.

    Attributes:
        figure: which.
        pairs: that it rests on.
        confidence: of each interval.
        alone: by the physical trials alone.
        with_simulator: by both; None where it cannot be said.
        line: through the pairs.
        gap: physical less simulated.
        saved: further physical φ that an interval as narrow would have taken without the simulator.
        why_alone: why the physical trials stand alone; None where they do not.
        notes: what a reader should know, a sentence each.
    """

    KEYS = (
        "unit=figure.unit value=stands.value interval=stands.interval confidence predicts why_alone "
        "p_value=line.p_value correlation=line.correlation slope=line.slope residual_deviation=line.residual_deviation "
        "deviation physical_alone=alone with_simulator phi=pairs.phi trials=pairs.trials.size "
        "simulated_phi=pairs.population.size simulated_mean trials_saved=saved gap=gap_by_phi notes"
    )

    figure: TrialFigure
    pairs: Pairs
    confidence: float
    alone: Mean
    with_simulator: Mean | None
    line: Line
    gap: Gap
    saved: int
    why_alone: str | None
    notes: tuple[str, ...]

    @property
    def predicts(self) -> bool:
        """Whether the simulator predicts this figure, so that both together stand."""
        return self.why_alone is None

    @property
    def stands(self) -> Mean:
        """What is said: with the simulator where it predicts, else by the physical trials alone."""
        return self.with_simulator if self.with_simulator is not None and self.predicts else self.alone

    @property
    def deviation(self) -> float:
        """Standard deviation of the physical figure from φ to φ."""
        return float(self.alone.error * self.pairs.phi**0.5)

    @property
    def simulated_mean(self) -> float:
        """Mean of the simulated figure over all φ."""
        return float(self.pairs.population.mean())

    @property
    def gap_by_phi(self) -> dict[str, Any]:
        """The gap, with both figures of each φ."""
        pairs = self.pairs
        rows = zip(pairs.names, pairs.groups, pairs.physical.tolist(), pairs.simulated.tolist(), strict=True)
        by_phi = [
            {"phi": name, "trials": group.size, "physical": real, "simulated": said, "gap": real - said}
            for name, group, real, said in rows
        ]
        return {**self.gap.as_dict(), "by_phi": by_phi}


def fuse(
    physical: Sequence[PhysicalTrial],
    simulated: Mapping[str, Sequence[PhysicalTrial]],
    *,
    looks: int = 1,
    tolerance: float = GAP_TOLERANCE,
) -> tuple[list[FusedFigure], list[str]]:
    """Return every figure that both kinds of trials have, and why others are left out, a line each.

    Args:
        physical: trials, in the order in which they were made.
        simulated: trials by φ.
        looks: how often one looks, at most, before one stops: after equal numbers of trials. Intervals then hold at all
            looks together with 95 %, and so whenever one stops (`metrics.sample_size`).
        tolerance: of the timing of pairs, m.

    Raises:
        UsageError: no figure in common, too few trials, pairs that do not match, or figures that cannot be of trials.
    """
    share = nominal_confidence(looks) if looks > 1 else 0.95
    found, left_out = [], []
    for figure in FIGURES.values():
        pairs = paired(figure, physical, simulated, tolerance)
        if pairs is None:
            continue
        try:
            if not figure.is_rate and not np.ptp(pairs.physical):
                same = f"{pairs.physical[0]:.6g} {figure.unit}"
                raise NotSaidError(f"{figure.text}: {same} on every φ with trials, so nothing is said of other φ")
            found.append(fused_figure(figure, pairs, share))
        except NotSaidError as error:
            left_out.append(str(error))
    if not found:
        left_out.append(f"physical and simulated trials have no figure in common; known are {', '.join(FIGURES)}")
        raise UsageError(left_out[0])
    return found, left_out


def fused_figure(figure: TrialFigure, pairs: Pairs, confidence: float) -> FusedFigure:
    """Return a figure of the physical car by its pairs.

    Raises:
        NotSaidError: the φ with trials do not stand for all of them.
        UsageError: too few φ with trials, or figures that cannot be of trials.
    """
    y, x, population = pairs.physical, pairs.simulated, pairs.population
    if y.size < estimate.LEAST_PAIRS:
        raise UsageError(f"trials on {y.size} φ: at least {estimate.LEAST_PAIRS} φ with physical trials are needed")
    line, why, both, saved = estimate.fitted_line(y, x), None, None, 0
    reach = reach_of_both = (1.0, 1.0)
    if line.slope is None:
        why = "the simulator says the same of all these φ"
    elif figure.is_rate and estimate.fewest_of_each(pairs.groups) < estimate.LEAST_OF_EACH:
        why = f"there are fewer than {estimate.LEAST_OF_EACH} φ with a hit, or without one"
    try:
        if figure.is_rate:
            by_itself = estimate.alone_rate(pairs.groups, confidence)
            both = None if why else estimate.fused_rate(y, x, population, line, confidence)
        else:
            _check_spread(figure, pairs, line)
            reach = _reach(figure, pairs, line, confidence, by_line=False)
            by_itself = estimate.alone(y, confidence, reach)
            if not why:
                reach_of_both = _reach(figure, pairs, line, confidence, by_line=True)
                both = estimate.fused(y, x, population, line, confidence, wrong=figure.wrong, reach=reach_of_both)
    except NotSaidError:
        raise
    except ValueError as error:
        raise UsageError(f"{figure.text}: {error}") from error
    if not why and not line.predicts:
        why = "the simulator does not predict this figure"
    elif both is not None and figure.is_rate:
        saved = max(0, int(y.size * (by_itself.width / both.width) ** 2) - y.size)
    elif both is not None:
        saved = estimate.trials_saved(y.size, both.width / by_itself.width, confidence)
    gap = gap_of(y, x, pairs.trials, pairs.predicted, confidence)
    notes = tuple(_notes(figure, pairs, why, max(reach if why else reach_of_both)))
    return FusedFigure(figure, pairs, confidence, by_itself, both, line, gap, saved, why, notes)


def _check_spread(figure: TrialFigure, pairs: Pairs, line: Line) -> None:
    """Refuse trials on φ that are too much alike, or of a figure that a few φ decide, none of which need be among them.

    Where a few φ decide a mean, such as those on which the car all but hits, trials on others lie close together and on
    a line, and their interval is narrow and wrong. A random sample varies so little in one of twenty cases, by the χ²
    distribution of a variance.

    Raises:
        NotSaidError: it is so.
    """
    begin, x, population = f"{figure.text}: nothing is said, for", pairs.simulated, pairs.population
    least = estimate.least_variance(x.size) * float(np.var(population, ddof=1))
    if line.predicts and not float(np.var(x, ddof=1)) >= least:
        few, every = (f"{np.std(one, ddof=1):.3g} {figure.unit}" for one in (x, population))
        spread = f"simulated standard deviation {few}, over all φ {every}"
        raise NotSaidError(f"{begin} the φ with trials are too alike ({spread}): make more trials")
    if x.size < _FEW and kurtosis(pairs.shape) > _RARE:
        raise NotSaidError(f"{begin} a few φ decide the mean, by the simulation: make trials on at least {_FEW} φ")


def _reach(figure: TrialFigure, pairs: Pairs, line: Line, confidence: float, *, by_line: bool) -> Reach:
    """Return how far an interval reaches for figures of the shape of the simulated ones.

    Raises:
        NotSaidError: too far, in the interval that would stand.
    """
    off = pairs.physical - pairs.physical.mean()
    if by_line:
        off = off - (line.slope or 0.0) * (pairs.simulated - pairs.simulated.mean())
    leans = skewness(pairs.shape - pairs.shape.mean()) >= 0.0
    mirrored, least = (skewness(off) >= 0.0) != leans, estimate.least_variance(off.size) if line.predicts else 0.0
    reach = estimate.rehearsed(pairs.shape, off.size, confidence, by_line=by_line, mirrored=mirrored, least=least)
    if line.predicts == by_line and max(reach) > _MOST_REACH:
        what = f"nothing is said, for {off.size} trials do not tell the mean of figures as skewed as the simulated ones"
        raise NotSaidError(f"{figure.text}: {what}: make more trials")
    return reach


def _notes(figure: TrialFigure, pairs: Pairs, why_alone: str | None, reach: float) -> Iterator[str]:
    count = pairs.phi
    if not pairs.timed:
        yield "the timing of physical trials is not known: pairs are of the same φ alone"
    if why_alone:
        yield f"{why_alone}: the physical trials stand alone"
    elif pairs.population.size < _MANY * count:
        yield f"only {pairs.population.size} simulated φ for {count} physical ones: more would narrow the interval"
    if reach > _FELT:
        yield f"the simulated figures are skewed over φ: the interval reaches up to {reach:.1f} times as far for it"
    if not figure.is_rate and kurtosis(pairs.shape) > _RARE:
        yield "a few φ decide the mean, by the simulation: more trials may move it much"
    if len(pairs.trials) > count:
        yield "several trials of a φ count as one: the interval is by φ"


RESULT = "fusion.json"


@dataclass(frozen=True)
class PlanningBasis:
    """By what the number of trials is planned: of a figure its standard deviation from φ to φ, and its correlation."""

    deviation: float
    correlation: float | None
    simulated_phi: int
    source: str
    warnings: Sequence[str]


def planning_basis(folder: Path, figure: TrialFigure) -> PlanningBasis:
    """Return by what trials are planned: the fusion in a folder, else the assessment in it, or a table.

    Raises:
        UsageError: it cannot be read, lacks the figure, or has the same of all φ.
    """
    path, key = folder / RESULT, figure.key
    if path.exists():
        content: Any = read_json(path)
        try:
            entry, warnings = content["figures"][key], list(map(str, content["warnings"]))
            deviation, simulated_phi, trials = (entry[one] for one in ("deviation", "simulated_phi", "trials"))
            correlation = entry["correlation"] if entry["predicts"] else None
            source = f"by {counted(int(trials), 'physical trial')} in {folder}"
            basis = PlanningBasis(float(deviation), correlation, int(simulated_phi), source, warnings)
        except (KeyError, TypeError, ValueError) as error:
            raise UsageError(f"{path}: has no {key} of skd fuse") from error
    else:
        simulated = read_simulated(folder)
        every = ([one.values[key] for one in trials if key in one.values] for trials in simulated.trials.values())
        means = [float(np.mean(values)) for values in every if values]
        if len(means) < 2:
            raise UsageError(f"{folder}: has no {key} of two φ")
        source = f"as simulated in {folder}: the physical car may vary more"
        basis = PlanningBasis(float(np.std(means, ddof=1)), None, len(means), source, simulated.remarks)
    if not basis.deviation > 0.0:
        raise UsageError(f"{folder}: {figure.text} is the same on every φ, so nothing can be planned")
    return basis


def _recorder(simulated: Simulated, arguments: argparse.Namespace) -> TrialRecorder | None:
    """Return what reads recordings of trials on simulated φ; None where road and shapes are not known."""
    if simulated.scenario is None or simulated.safe is None:
        return None
    x, y, degrees = arguments.frame
    return TrialRecorder(
        simulated.scenario,
        simulated.safe,
        arguments.car,
        arguments.road_user,
        RecordingFrame(x, y, math.radians(degrees)),
        arguments.reference,
        arguments.path_tolerance,
        arguments.gap_tolerance,
    )


# --- the physical car


def rate_car(arguments: argparse.Namespace) -> int:
    """Say what the physical car does; return the exit code."""
    out = result_folder(arguments)
    simulated, table = read_simulated(arguments.simulated), table_in(arguments.physical)
    recorder = _recorder(simulated, arguments)
    trials = read_trials(table, None if recorder is None else recorder.measured)
    figures, left_out = fuse(trials, simulated.trials, looks=arguments.looks, tolerance=arguments.gap_tolerance)
    damage = [] if recorder is None else recorder.damage.lines
    warnings = [*simulated.remarks, *overruled(trials), *left_out, *damage]
    content = {
        "simulated": simulated.source,
        "physical": str(table),
        "looks": arguments.looks,
        "figures": {one.figure.key: one.as_dict() for one in figures},
        "sentences": [_sentence(one) for one in figures],
        "warnings": warnings,
    }
    problem = out.save(lambda folder: write_json(folder / RESULT, content))

    def show() -> None:
        heads = ("", "physical\nalone", "with the\nsimulator", "ρ", "predicts\n(p)", "trials\nsaved", "gap")
        print_table(narrow_table("The physical car; what stands is bold", heads, list(map(_row, figures))))
        for one in figures:
            print("\n  ".join([_sentence(one), *_gap_lines(one)]))

    warnings = [*warnings, *(f"{one.figure.text}: {note}" for one in figures for note in one.notes)]
    return finish(arguments, content, show, warnings, saved=(problem, f"results in {out.path}"))


def _row(one: FusedFigure) -> list[str]:
    """Return the row of a figure in the table of all."""

    def text(mean: Mean) -> str:
        low, high = mean.interval
        if one.figure.is_rate:
            said = f"{100 * mean.value:.0f} % [{100 * low:.0f}, {100 * high:.0f}]"
        else:
            said = f"{mean.value:.2f} [{low:.2f}, {high:.2f}]"
        return f"[bold]{said}[/]" if mean is one.stands else said

    both, says = "—", "—"
    if one.with_simulator is not None:
        both, says = text(one.with_simulator), f"{'yes' if one.predicts else 'no'} ({one.line.p_value:.2g})"
    rho = "—" if one.line.correlation is None else f"{one.line.correlation:.2f}"
    return [one.figure.label, text(one.alone), both, rho, says, str(one.saved), f"{one.gap.mean:+.2f}"]


def _sentence(one: FusedFigure) -> str:
    """Return what may be said of the physical car, with what it rests on."""
    pairs, value, (low, high), unit = one.pairs, one.stands.value, one.stands.interval, one.figure.unit
    name, figure = f"mean {one.figure.text}", f"{value:.2f} {unit}"
    interval = f"{low:.2f} to {high:.2f} {unit}"
    if one.figure.is_rate:
        name, figure, interval = one.figure.text, f"{100 * value:.0f} %", f"{100 * low:.0f} to {100 * high:.0f} %"
    trials = f"{counted(pairs.trials.size, 'physical trial')} on {pairs.phi} φ"
    begin = f"Over all φ the {name} of the physical car is {figure}, with a 95 % interval from {interval}; by {trials}"
    if not one.predicts:
        return f"{begin} alone, for {one.why_alone}."
    saved = f"The simulator predicts it, and saved {counted(one.saved, 'physical trial')}."
    return f"{begin} and simulations of {pairs.population.size} φ. {saved}"


def _gap_lines(one: FusedFigure) -> Iterator[str]:
    """Yield what is to be said of the gap between simulated and physical."""
    gap, unit = one.gap, f" {one.figure.unit}".rstrip()
    span = "" if gap.interval is None else f" [{gap.interval[0]:+.2f}, {gap.interval[1]:+.2f}]"
    yield f"physical less simulated: {gap.mean:+.2f}{unit}{span} on average of {one.pairs.phi} φ"
    worst = int(abs(gap.by_phi).argmax())
    yield f"largest on {one_line(one.pairs.names[worst])}: {gap.by_phi[worst]:+.2f}{unit}"
    trends = (("with the simulated figure", gap.by_simulated), ("from trial to trial", gap.by_order))
    for what, trend in () if one.figure.is_rate else trends:  # a single hit has a trend
        if trend is not None and trend.p_value < 0.05:
            low, high = trend.interval
            yield f"the gap changes {what}: slope {trend.slope:+.3g} [{low:+.3g}, {high:+.3g}]"


# --- how many trials it takes


def plan_trials(arguments: argparse.Namespace) -> int:
    """Say how many trials a width takes, alone and with the simulator; return the exit code."""
    figure, width = FIGURES[arguments.figure], arguments.width
    basis = planning_basis(arguments.simulated, figure)
    known = basis.correlation if arguments.correlation is None else arguments.correlation
    alone = trials_for_width(width, basis.deviation)
    shown = sorted({0.5, 0.7, 0.8, 0.9, 0.95, *(() if known is None else (known,))})
    rows = [(one, trials_for_width(width, basis.deviation, one, basis.simulated_phi)) for one in shown]
    content = {
        "figure": figure.key,
        "width": width,
        "deviation": basis.deviation,
        "correlation": known,
        "simulated_phi": basis.simulated_phi,
        "source": basis.source,
        "physical_alone": alone,
        "with_simulator": [{"correlation": one, "trials": trials} for one, trials in rows],
    }

    def show() -> None:
        unit = f" {figure.unit}".rstrip()
        print(f"{figure.text}: standard deviation {basis.deviation:.3f}{unit} from φ to φ; {basis.source}")
        cells = [("physical trials alone", str(alone or "never"))]
        for one, trials in rows:
            row = f"with the simulator, where ρ = {one:.2f}", str(trials or "never")
            cells.append((f"[bold]{row[0]}[/]", f"[bold]{row[1]}[/]") if one == known else row)
        title = f"Physical trials, one on each φ, until the 95 % interval is {width:g}{unit} wide"
        print_table(narrow_table(title, ("", "trials"), cells))
        if known is None:
            print("how well the simulator predicts is known when at least 5 trials are fused: skd fuse")

    return finish(arguments, content, show, basis.warnings)


# --- calibration


def calibrate(arguments: argparse.Namespace) -> int:
    """Estimate the simulator's parameters by the trials; return the exit code."""
    begin, folder, out = time.perf_counter(), arguments.simulated, result_folder(arguments)
    simulated = read_simulated(folder)
    recorder = _recorder(simulated, arguments)
    if simulated.scenario is None or recorder is None:
        raise UsageError(f"{folder}: must be the folder of an assessment")
    stated = simulated.figures["multiplier"]  # which only a car that has one states
    car = CarUnderTest(
        str(simulated.figures["controller"]), CarUnderTest.multiplier if stated is None else float(stated)
    )
    if car.is_external:
        raise UsageError(f"{folder}: its car ran as a node, and cannot drive the trials again in process")
    world = replace(simulated.scenario, control_period=check_controller(car, simulated.scenario).control_period)
    trials = _recorded(recorder, table_in(arguments.physical))
    workers = arguments.workers or available_workers()
    found = calibration.calibration_of(world, car, trials, arguments.parameters, workers)
    best = replace(calibration.calibrated(world, found.values), name=f"{world.name}_calibrated")
    content = {
        "simulated": simulated.source,
        "physical": str(arguments.physical),
        "trials": len(trials),
        "phi": len({one.phi for one in trials}),
        **found.as_dict(),
        "sentences": list(found.sentences),
        "warnings": [*simulated.remarks, *found.warnings, *recorder.damage.lines],
    }

    def write(where: Path) -> None:
        (where / calibration.SCENARIO).write_text(to_yaml(best.as_dict()), encoding="utf-8")
        write_json(where / calibration.RESULT, content)

    def show() -> None:
        start, rows = calibration.calibrated(world, {}), []
        for one in found.estimates:
            estimate = "—", one.reason or ""
            if one.interval is not None:
                estimate = f"{one.value:.3g}", f"[{one.interval[0]:.3g}, {one.interval[1]:.3g}]"
            rows.append((one.parameter.label, f"{one.parameter.of(start):.3g}", *estimate))
        heads = ("", "scenario", "estimate", "95 %\ninterval")
        print_table(narrow_table("The simulator by the physical trials", heads, rows))
        print(*found.sentences, sep="\n")

    saved = out.save(write), f"the calibrated scenario is {out.path / calibration.SCENARIO}"
    return finish(arguments, content, show, content["warnings"], saved=saved, since=begin)


def _recorded(recorder: TrialRecorder, table: Path) -> list[calibration.Recorded]:
    """Return the trials of a table, each at the simulator's times."""
    found: list[calibration.Recorded] = []

    def keep(path: Path, trial: PhysicalTrial) -> PhysicalTrial:
        scene = recorder.laid(path, trial)
        found.append(calibration.recorded(recorder.scenario, scene, trial.phi, trial.where))
        return replace(trial, track=track_of(scene))

    if len(read_trials(table, keep)) > len(found):
        raise UsageError(f"{table}: a trial without a recording says nothing of how the car went: give each a file")
    return found
