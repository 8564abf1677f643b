"""Physical and simulated trials: φ, timing and figures of each, from tables and assessments; and their pairs."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from skd_adversary.safe_trajectories.recordings import csv_rows, header_of
from skd_sim.errors import UsageError
from skd_sim.inputs.files import did_you_mean, real_path
from skd_sim.scenario.road import right_and_along
from skd_sim.scenario.scenario import Scenario, scenario_from_dict
from skd_sim.world.episode import Mode, Outcome
from skd_sim.world.state import FloatArray

from skd_evaluator.assessment.files.assessment_json import ASSESSMENT
from skd_evaluator.assessment.files.episodes_npz import StoredEpisodes
from skd_evaluator.assessment.files.results import read_result
from skd_evaluator.metrics.margins import open_search
from skd_evaluator.metrics.surrogate_measures import GRID, MOST, greatest_required_deceleration, least_clearance
from skd_evaluator.metrics.surrogate_scenes import Interaction, Interactions, course_of, scene_of


@dataclass(frozen=True)
class TrialFigure:
    """A figure of a trial.

    Attributes:
        key: its name in tables and in fusion.json.
        text: its name as people read it.
        unit: of it; empty for a share.
        most: largest value that it can have: more is another unit, or no trial.
        is_rate: whether a trial has it or not: 1 or 0.
        wrong: trials in which the simulator was wrong that are added to what is seen of it. A required deceleration is
            0 where neither comes into the other's way, and much where one nearly does: partly it is a yes or no, as
            a hit is, and a simulator that was right in a dozen trials will be wholly wrong in one some day.
    """

    key: str
    text: str
    unit: str
    most: float
    is_rate: bool = False
    wrong: float = 0.0

    @property
    def label(self) -> str:
        """Text and unit."""
        return f"{self.text} ({self.unit})" if self.unit else self.text


FIGURES = {
    one.key: one
    for one in (
        TrialFigure("clearance", "least clearance", "m", 100.0),
        TrialFigure("required_deceleration", "greatest required deceleration", "m/s²", MOST, wrong=1.0),
        TrialFigure("hit", "nominal collision rate", "", 1.0, is_rate=True),
        TrialFigure("margin", "margin", "m", 100.0),
    )
}


@dataclass(frozen=True)
class PhysicalTrial:
    """One trial.

    Attributes:
        phi: name of the φ that the adversary was to walk.
        values: by key of `FIGURES`.
        gap: timing: how far the car's front was before the crossing line when φ began, m; None where it is not known.
        where: file and line, for messages.
        seen_hit: whether the car hits by its recording, whatever the table says; None without a recording.
        track: where car and road user were from the beginning of φ to its end, or to the contact, by the recording,
            n × 4, m; None without one.
    """

    phi: str
    values: Mapping[str, float] = field(default_factory=dict)
    gap: float | None = None
    where: str = ""
    seen_hit: bool | None = None
    track: FloatArray | None = field(default=None, repr=False, compare=False)


def figures_of(scene: Interaction, *, hit: bool) -> dict[str, float]:
    """Return the figures of a trial by what happened in it."""
    return {
        "clearance": least_clearance(scene),
        "required_deceleration": greatest_required_deceleration(Interactions.of(scene).every(GRID).whole),
        "hit": float(hit),
    }


def gap_to_crossing(scenario: Scenario, car: FloatArray) -> float:
    """Return how far the front of a car (reference point (x, y), m) is before the crossing line, m."""
    along = right_and_along(scenario.road.line, car[None, :2].copy())[0, 1]
    return float(-along - scenario.car.front)


NAME = "trials.csv"
"""The table in a folder of trials."""
_COLUMNS = ("phi", "file", "gap", *FIGURES)
_FARTHEST = 1000.0  # m that a car may start off
_SAME = 1e-3  # m that no two drives agree by at every moment: any sensor's noise is more


def table_in(path: Path) -> Path:
    """Return the table that a path names: itself, or the one in a folder.

    Raises:
        UsageError: there is none.
    """
    table = path / NAME if path.is_dir() else path
    if not table.exists():
        raise UsageError(f"{table}: no such file; give a table with the columns phi and file, or phi and figures")
    return table


def read_trials(
    path: Path, measured: Callable[[Path, PhysicalTrial], PhysicalTrial] | None = None
) -> list[PhysicalTrial]:
    """Read a table of trials, in the order of its rows.

    Args:
        path: csv file with a header: `phi`, and `file` (a recording, from the table's folder) or figures, by their
            keys; `gap` is the timing of a trial.
        measured: returns a trial with the figures that its recording shows; None: recordings cannot be measured.

    Raises:
        UsageError: the table cannot be read, a column is missing or unknown, a value is none that can be, or one
            recording is there twice.
    """
    header = header_of(path)
    for name in header:
        if name not in _COLUMNS:
            hint = did_you_mean(name, _COLUMNS)
            raise UsageError(f"{path}, line 1: unknown column {name!r}{hint}; there are {', '.join(_COLUMNS)}")
    if not set(header) & {"file", *FIGURES}:
        raise UsageError(f"{path}, line 1: neither a column 'file' nor one of {', '.join(FIGURES)}")
    texts = ["phi", *(["file"] if "file" in header else [])]
    numbers = [name for name in header if name not in texts]
    found: list[PhysicalTrial] = []
    known: dict[Path, PhysicalTrial] = {}
    for line, (phi, *files), row in csv_rows(path, numbers, texts, empty=numbers):
        values = {name: value for name, value in zip(numbers, row, strict=True) if not math.isnan(value)}
        trial = _checked_trial(PhysicalTrial(phi, values, values.pop("gap", None), f"{path}, line {line}"))
        if any(files):
            if measured is None:
                raise UsageError(f"{trial.where}: to measure recordings SIMULATED must be the folder of an assessment")
            file = path.parent / files[0]
            trial = measured(file, trial)
            _check_once(known, real_path(file), trial)
        elif not values:
            raise UsageError(f"{trial.where}: has neither a file nor a figure")
        found.append(trial)
    if not found:
        raise UsageError(f"{path}: has no trial")
    return found


def _checked_trial(trial: PhysicalTrial) -> PhysicalTrial:
    """Return the trial of a row, whose values are such as can be."""
    where, values, gap = trial.where, trial.values, trial.gap
    if not trial.phi:
        raise UsageError(f"{where}: phi is empty")
    for key, value in values.items():
        figure = FIGURES[key]
        if figure.is_rate and value not in (0.0, 1.0):
            raise UsageError(f"{where}: {key} must be 1 (the car hit) or 0, got {value:g}")
        if not 0.0 <= value <= figure.most:
            limits = f"from 0 to {figure.most:g} {figure.unit}, got {value:g}: is it in {figure.unit}?"
            raise UsageError(f"{where}: {key} must be {limits}")
    if values.get("hit") == 1.0 and values.get("clearance", 0.0) > 0.0:
        raise UsageError(f"{where}: the car hit, and its clearance is {values['clearance']:g} m; it must be 0")
    if gap is not None and not 0.0 <= gap <= _FARTHEST:
        raise UsageError(f"{where}: gap must be from 0 to {_FARTHEST:g} m, got {gap:g}")
    return trial


def _check_once(known: dict[Path, PhysicalTrial], file: Path, trial: PhysicalTrial) -> None:
    """Refuse a recording that was there before, by its file or, of a copy, by its tracks: it would count twice."""

    def is_same(other: PhysicalTrial) -> bool:  # one of the recordings may end earlier
        if trial.track is None or other.track is None:
            return False
        count = min(len(trial.track), len(other.track))
        return bool(np.abs(trial.track[:count] - other.track[:count]).max() < _SAME)

    before = known.get(file) or next(filter(is_same, known.values()), None)
    if before is not None:
        raise UsageError(f"{trial.where}: is the recording of {before.where} once more; give each trial its own")
    known[file] = trial


@dataclass(frozen=True, eq=False)
class Simulated:
    """Simulated trials.

    Attributes:
        source: where they are from.
        trials: by φ, in the order of these.
        scenario: road, shapes and speeds; None of a table.
        safe: positions of each φ at ticks, m; None of a table.
        remarks: warnings of the assessment, a line each.
        figures: of the assessment; empty of a table.
    """

    source: str
    trials: Mapping[str, Sequence[PhysicalTrial]]
    scenario: Scenario | None = None
    safe: Mapping[str, FloatArray] | None = None
    remarks: tuple[str, ...] = ()
    figures: Mapping[str, Any] = field(default_factory=dict)


def read_simulated(path: Path) -> Simulated:
    """Read the runs along φ of an assessment and the margins of its trials, or a table of simulated trials.

    Raises:
        UsageError: it is none, is damaged, has no run along φ, or two φ of one name.
    """
    if not path.is_dir():
        return Simulated(str(path), _by_phi(read_trials(table_in(path))))
    result = read_result(path)
    stored = result.episodes
    scenario = scenario_from_dict(result.figures["scenario"], f"scenario in {path / ASSESSMENT}")
    names = [str(name) for name in stored.further.get("safe_name", ())]
    if not names or len(set(names)) < len(names):
        raise UsageError(f"{path}: its φ have no names, or two the same, so physical trials cannot be paired with them")
    trials = [trial for index, name in enumerate(names) for trial in _runs(stored, scenario, index, name)]
    if not trials:
        raise UsageError(f"{path}: has no run along φ; assess with --collision-runs")
    for name, margins in zip(names, result.groups.get("margin", ()), strict=False):
        trials += [PhysicalTrial(name, {"margin": float(margin)}, None, str(path)) for margin in margins]
    found = _by_phi(trials)
    return Simulated(
        str(path),
        {name: found[name] for name in names if name in found},
        scenario,
        dict(zip(names, stored.safe, strict=True)),
        (*result.remarks, *(f"{path}: {line}" for line in open_search(result.figures))),
        result.figures,
    )


def _by_phi(trials: Sequence[PhysicalTrial]) -> dict[str, list[PhysicalTrial]]:
    names = dict.fromkeys(one.phi for one in trials)
    return {name: [one for one in trials if one.phi == name] for name in names}


def _runs(stored: StoredEpisodes, scenario: Scenario, index: int, name: str) -> list[PhysicalTrial]:
    ran = (stored.mode == Mode.REPLAY) & (stored.outcome != Outcome.ABORTED) & (stored.safe_index == index)
    found = []
    for number in np.flatnonzero(ran).tolist():
        course = course_of(scenario, stored.adversary[number], stored.car[number], *stored.impact(number))
        values = figures_of(scene_of(scenario, *course), hit=bool(stored.hit[number]))
        if stored.collided[number]:
            values["clearance"] = 0.0
        where, gap = f"episode {int(stored.episode_id[number])}", gap_to_crossing(scenario, course.car[0])
        found.append(PhysicalTrial(name, values, gap, where))
    return found


GAP_TOLERANCE = 0.5
"""m by which the gaps at the start of a simulated and a physical trial may differ for both to be of one timing."""


@dataclass(frozen=True, eq=False)
class Pairs:
    """One figure of physical trials and what the simulator says of the same φ, and of all.

    Attributes:
        names: of the φ with physical trials, in the order of the first of them.
        groups: physical figures of each, one per trial.
        physical: their means, n.
        simulated: mean of the simulated figures of the same φ and timing, n.
        population: mean of the simulated figures of every φ, N.
        trials: physical figures in the order of the trials, k.
        predicted: what the simulator says of each of these trials, k.
        timed: whether the timing of every physical trial is known.
        shape: simulated figures of every run of every φ, each with a timing of its own, as a physical trial has one.
    """

    names: tuple[str, ...]
    groups: tuple[FloatArray, ...]
    physical: FloatArray
    simulated: FloatArray
    population: FloatArray
    trials: FloatArray
    predicted: FloatArray
    timed: bool
    shape: FloatArray

    @property
    def phi(self) -> int:
        """How many φ have physical trials."""
        return len(self.names)


def paired(
    figure: TrialFigure,
    physical: Sequence[PhysicalTrial],
    simulated: Mapping[str, Sequence[PhysicalTrial]],
    tolerance: float = GAP_TOLERANCE,
) -> Pairs | None:
    """Pair physical with simulated trials.

    Args:
        figure: the one that is looked at.
        physical: trials in the order in which they were made.
        simulated: trials by φ.
        tolerance: of the timing, m.

    Returns:
        None where physical or simulated trials do not have the figure.

    Raises:
        UsageError: some physical trials have the figure and others not; a φ was never simulated, or never with such a
            timing.
    """
    key = figure.key
    every = {name: [one for one in trials if key in one.values] for name, trials in simulated.items()}
    every = {name: trials for name, trials in every.items() if trials}
    lacking = [one for one in physical if key not in one.values]
    if len(lacking) == len(physical) or not every:
        return None
    if lacking:
        raise UsageError(f"{lacking[0].where}: has no {key}, which other trials have: give it for all or for none")
    predicted = np.array([_predicted(key, one, every, tolerance) for one in physical])
    values = np.array([one.values[key] for one in physical])
    names = tuple(dict.fromkeys(one.phi for one in physical))
    rows = [[index for index, one in enumerate(physical) if one.phi == name] for name in names]
    groups = tuple(values[one] for one in rows)
    runs = [np.array([one.values[key] for one in trials]) for trials in every.values()]
    return Pairs(
        names,
        groups,
        np.array([group.mean() for group in groups]),
        np.array([predicted[one].mean() for one in rows]),
        np.array([np.mean(one) for one in runs]),
        values,
        predicted,
        all(one.gap is not None for one in physical),
        np.concatenate(runs),
    )


def _predicted(key: str, trial: PhysicalTrial, every: Mapping[str, Sequence[PhysicalTrial]], tolerance: float) -> float:
    if trial.phi not in every:
        hint = did_you_mean(trial.phi, every)
        raise UsageError(f"{trial.where}: φ {trial.phi!r} was not simulated{hint}")
    runs = every[trial.phi]
    gap = trial.gap
    if gap is not None:
        known = [one.gap for one in runs if one.gap is not None]
        runs = [one for one in runs if one.gap is None or abs(one.gap - gap) <= tolerance]
        if not runs:
            began = f"{gap:.2f} m before the crossing line when {trial.phi} began"
            simulated = f"and in the simulation {min(known):.2f} to {max(known):.2f} m"
            raise UsageError(f"{trial.where}: the car was {began}, {simulated}: no run within {tolerance:g} m")
    return float(np.mean([one.values[key] for one in runs]))
