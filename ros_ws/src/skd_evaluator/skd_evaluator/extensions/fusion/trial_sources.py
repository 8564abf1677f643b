"""Where trials come from: tables, an assessment's runs along φ and margins, and recordings that are measured.

A recording is laid over its φ in space and time, and looked at like an episode. Its clock says nothing of when φ began,
so that is the moment from which the tracked road user is nearest to φ, in the mean of squares. From there to the end of
φ, or to the contact, is the trial.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.errors import UsageError
from skd_sim.inputs.files import did_you_mean, finite_number, read_text, real_path
from skd_sim.inputs.yaml_file import short
from skd_sim.scenario.road import right_and_along, road_pose
from skd_sim.scenario.scenario import Scenario, scenario_from_dict
from skd_sim.world.episode import Mode, Outcome

from skd_evaluator.assessment.files.assessment_json import ASSESSMENT
from skd_evaluator.assessment.files.episodes_npz import StoredEpisodes
from skd_evaluator.assessment.files.results import read_both
from skd_evaluator.extensions.fusion.recording import read_tracks
from skd_evaluator.extensions.fusion.track import RecordingFrame, Track
from skd_evaluator.extensions.fusion.trial import (
    FIGURES,
    GAP_TOLERANCE,
    PhysicalTrial,
    checked_value,
    figures_of,
    gap_to_crossing,
)
from skd_evaluator.metrics.margins import open_search
from skd_evaluator.metrics.surrogate_measures import clearances
from skd_evaluator.metrics.surrogate_scenes import Scene, course_of, scene_of

NAME = "trials.csv"
"""The table in a folder of trials."""
_PHI, _FILE, _GAP = "phi", "file", "gap"
_COLUMNS = (_PHI, _FILE, _GAP, *FIGURES)
_FARTHEST = 1000.0  # m that a car may start off
_SAME = 1e-3  # m that no two drives agree by at every moment: any sensor's noise is more


def table_in(path: Path) -> Path:
    """Return the table that a path names: itself, or the one in a folder.

    Raises:
        UsageError: there is none.
    """
    table = path / NAME if path.is_dir() else path
    if not table.exists():
        raise UsageError(
            f"{table}: no such file; give a table of trials with the columns phi and file, or phi and figures"
        )
    return table


def read_trials(
    path: Path, measured: Callable[[Path, PhysicalTrial], PhysicalTrial] | None = None
) -> list[PhysicalTrial]:
    """Read a table of trials, in the order of its rows.

    Args:
        path: csv file with a header: `phi`, and `file` (a recording, from the table's folder) or figures, by their
            keys; `gap` says the timing of a trial.
        measured: returns a trial with the figures that its recording shows; None: recordings cannot be measured.

    Raises:
        UsageError: the table cannot be read, a column is missing or unknown, a value is none that can be, or one
            recording is there twice.
    """
    rows = csv.DictReader(StringIO(read_text(path), newline=""), strict=True)
    try:
        header = [name.strip() for name in rows.fieldnames or []]
        _check_header(path, header, recordings=measured is not None)
        rows.fieldnames = header
        found: list[PhysicalTrial] = []
        known: dict[Path, PhysicalTrial] = {}
        for row in rows:
            where = f"{path}, line {rows.line_num}"
            if None in row or None in row.values():
                raise UsageError(f"{where}: has another number of values than the header")
            row = {name: value.strip() for name, value in row.items()}
            found.append(_trial(path, where, row, measured))
            if row.get(_FILE):
                _check_once(known, path.parent / row[_FILE], found[-1])
    except csv.Error as error:
        raise UsageError(f"{path}, line {rows.line_num}: not csv: {error}") from error
    if not found:
        raise UsageError(f"{path}: has no trial")
    return found


def _check_header(path: Path, header: list[str], *, recordings: bool) -> None:
    for name in header:
        if name not in _COLUMNS:
            raise UsageError(
                f"{path}, line 1: unknown column {name!r}{did_you_mean(name, _COLUMNS)}; there are "
                f"{', '.join(_COLUMNS)}"
            )
    if len(set(header)) < len(header):
        raise UsageError(f"{path}, line 1: a column stands twice")
    if _PHI not in header:
        raise UsageError(f"{path}, line 1: no column 'phi', which says on which φ each trial was")
    if not set(header) & {_FILE, *FIGURES}:
        raise UsageError(f"{path}, line 1: neither a column 'file' nor one of {', '.join(FIGURES)}")
    if _FILE in header and not recordings:
        raise UsageError(
            f"{path}, line 1: recordings cannot be measured without road and shapes: SIMULATED must be the folder of "
            "an assessment, or the table must hold figures"
        )


def _check_once(known: dict[Path, PhysicalTrial], file: Path, trial: PhysicalTrial) -> None:
    """Refuse a recording that was there before, by its file or, of a copy, by its tracks: it would count twice."""
    path = real_path(file)
    before = known.get(path) or next((one for one in known.values() if _same_track(one, trial)), None)
    if before is not None:
        raise UsageError(f"{trial.where}: is the recording of {before.where} once more; give each trial its own")
    known[path] = trial


def _same_track(one: PhysicalTrial, other: PhysicalTrial) -> bool:
    """Return whether two trials are of one drive; one of the recordings may end earlier."""
    if one.track is None or other.track is None:
        return False
    count = min(len(one.track), len(other.track))
    return bool(np.abs(one.track[:count] - other.track[:count]).max() < _SAME)


def _trial(
    path: Path, where: str, row: dict[str, str], measured: Callable[[Path, PhysicalTrial], PhysicalTrial] | None
) -> PhysicalTrial:
    if not row[_PHI]:
        raise UsageError(f"{where}: phi is empty")
    values = {
        key: checked_value(figure, finite_number(row[key], f"{where}: {key}"), where)
        for key, figure in FIGURES.items()
        if row.get(key)
    }
    if values.get("hit") == 1.0 and values.get("clearance", 0.0) > 0.0:
        raise UsageError(f"{where}: the car hit, and its clearance is {values['clearance']:g} m; it must be 0")
    gap = finite_number(row[_GAP], f"{where}: gap") if row.get(_GAP) else None
    if gap is not None and not 0.0 <= gap <= _FARTHEST:
        raise UsageError(f"{where}: gap must be from 0 to {_FARTHEST:g} m, got {gap:g}")
    trial = PhysicalTrial(row[_PHI], values, gap, where)
    if row.get(_FILE):
        if "\0" in row[_FILE]:
            raise UsageError(f"{where}: file must be the path of a recording, got {short(row[_FILE])}")
        assert measured is not None
        return measured(path.parent / row[_FILE], trial)
    if not values:
        raise UsageError(f"{where}: has neither a file nor a figure")
    return trial


@dataclass(frozen=True, eq=False)
class Simulated:
    """Simulated trials.

    Attributes:
        source: where they are from.
        trials: by φ, in the order of these.
        scenario: road, shapes and speeds; None of a table, which does not say.
        safe: positions of each φ at ticks, m; empty of a table.
        remarks: what is to be said of them, a line each.
        figures: of the assessment, as they were read with the trials; empty of a table.
    """

    source: str
    trials: Mapping[str, Sequence[PhysicalTrial]]
    scenario: Scenario | None = None
    safe: Mapping[str, FloatArray] | None = None
    remarks: tuple[str, ...] = ()
    figures: Mapping[str, Any] = field(default_factory=dict)


def by_phi(trials: Sequence[PhysicalTrial]) -> dict[str, list[PhysicalTrial]]:
    """Return trials by the name of their φ, both in their order."""
    found: dict[str, list[PhysicalTrial]] = {}
    for one in trials:
        found.setdefault(one.phi, []).append(one)
    return found


def read_simulated(folder: Path) -> Simulated:
    """Read the runs along φ of an assessment, and the margins of its trials.

    Raises:
        UsageError: it is none, is damaged, has no run along φ, or two φ of one name.
    """
    result, stored = read_both(folder)
    scenario = scenario_from_dict(result.figures["scenario"], f"scenario in {folder / ASSESSMENT}")
    if "safe_name" not in stored.further:
        raise UsageError(f"{folder}: its φ have no names, so physical trials cannot be paired with them; assess anew")
    names = [str(name) for name in stored.further["safe_name"]]
    if len(set(names)) < len(names):
        raise UsageError(f"{folder}: two of its φ have one name, so physical trials cannot be paired with them")
    trials = [trial for index, name in enumerate(names) for trial in _runs(stored, scenario, index, name)]
    if not trials:
        raise UsageError(f"{folder}: has no run along φ; assess with --collision-runs")
    for name, margins in zip(names, result.groups.get("margin", ()), strict=False):
        trials += [PhysicalTrial(name, {"margin": float(margin)}, None, str(folder)) for margin in margins]
    found = by_phi(trials)
    ordered = {name: found[name] for name in names if name in found}
    safe = dict(zip(names, stored.safe, strict=True))
    remarks = (*result.remarks, *(f"{folder}: {line}" for line in open_search(result.figures)))
    return Simulated(str(folder), ordered, scenario, safe, remarks, result.figures)


def _runs(stored: StoredEpisodes, scenario: Scenario, index: int, name: str) -> list[PhysicalTrial]:
    ran = (stored.mode == Mode.REPLAY) & (stored.outcome != Outcome.ABORTED) & (stored.safe_index == index)
    found = []
    for number in np.flatnonzero(ran).tolist():
        course = course_of(scenario, stored.adversary[number], stored.car[number], stored.contact(number))
        values = figures_of(scene_of(scenario, *course), hit=bool(stored.hit[number]))
        if stored.collided[number]:
            values["clearance"] = 0.0
        found.append(PhysicalTrial(name, values, gap_to_crossing(scenario, course.car[0]), stored_name(number, stored)))
    return found


def stored_name(number: int, stored: StoredEpisodes) -> str:
    """Return which episode it is, for messages."""
    return f"episode {int(stored.episode_id[number])}"


PATH_TOLERANCE = 0.5
"""m that the tracked road user may be off φ at any moment: beyond, it was not a trial on that φ."""
_STEP = 0.05  # s between moments
_SHIFTS = 0.02  # s between beginnings of φ that are tried; then finer
_OVER = 0.3  # s over which velocities are taken: a sensor's noise of 2 cm is 0.1 m/s then
_LEAST_SHARE = 0.5  # of φ that must be tracked, or nobody can say where it began
_TURNED = math.radians(30.0)  # off the lane's heading, from which frames do not fit
_POINTED = math.radians(12.0)  # between where a car points and where it goes: tyres slip by less
_WENT, _SHOWN = 1.0, 1.5  # s over which is looked where a car goes, and m that show it
_MARGIN = 0.3  # m: noise of two tracked places
_END = 0.5  # s that a recording may end before φ does, and over which is looked whether the two still come nearer


@dataclass(frozen=True)
class TrialRecorder:
    """How recordings of trials are read.

    Attributes:
        scenario: road and shapes.
        safe: positions of each φ at ticks, m, by name.
        car: topic or id of the car; None: SKD's own name.
        other: topic or id of the road user.
        frame: where `map` lies in the recording's frame.
        reference: how far ahead of the scenario's reference point of the car the tracked point is, m.
        tolerance: m that the road user may be off φ.
        gap_tolerance: m that the timing of a table may be off that of the recording.
    """

    scenario: Scenario
    safe: Mapping[str, FloatArray]
    car: str | None = None
    other: str | None = None
    frame: RecordingFrame = field(default_factory=RecordingFrame)
    reference: float = 0.0
    tolerance: float = PATH_TOLERANCE
    gap_tolerance: float = GAP_TOLERANCE

    def measured(self, path: Path, trial: PhysicalTrial) -> PhysicalTrial:
        """Return a trial with timing and figures as its recording has them.

        Raises:
            UsageError: it cannot be read, does not follow φ, does not fit the road, or contradicts the table.
        """
        scene, deeper = self.laid(path, trial), 0.0
        track = track_of(scene)
        touched = _touches(scene, deeper)
        seen = touched and self.scenario.collision.is_hit(float(scene.car[-1, 3]))
        if touched and _says_apart(trial):
            scene, deeper = self._laid_apart(path, trial), _MARGIN
            touched = _touches(scene, deeper)
        if not touched and trial.values.get("hit") != 1.0:
            self._check_whole(scene, self.safe[trial.phi], path)
        hit = touched and self.scenario.collision.is_hit(float(scene.car[-1, 3]))
        if hit and deeper:
            raise UsageError(
                f"{trial.where}: says that the car did not hit, and in the recording it is more than {deeper:g} m "
                f"inside the road user's outline, at {scene.car[-1, 3]:.1f} m/s; that is a hit (hit = 1)"
            )
        values = figures_of(scene, hit=hit)
        _check_agrees(trial, values)
        if trial.values.get("hit") == 1.0:
            values["clearance"] = 0.0
        gap = gap_to_crossing(self.scenario, scene.car[0])
        if trial.gap is not None and abs(trial.gap - gap) > self.gap_tolerance:
            raise UsageError(
                f"{trial.where}: gap is said to be {trial.gap:.2f} m, and the recording gives {gap:.2f}, more than "
                f"{self.gap_tolerance:g} m off: leave it out, or does --reference say which point is tracked?"
            )
        said = gap if trial.gap is None else trial.gap
        return replace(trial, values={**values, **trial.values}, gap=said, seen_hit=seen, track=track)

    def laid(self, path: Path, trial: PhysicalTrial, deeper: float = 0.0) -> Scene:
        """Return the recording of a trial from the beginning of its φ to its end, or to the contact.

        Args:
            path: the recording.
            trial: which it is.
            deeper: how far inside each other the outlines have to be for a contact, m.

        Raises:
            UsageError: it cannot be read, does not follow φ, or does not fit the road.
        """
        if trial.phi not in self.safe:
            raise UsageError(f"{trial.where}: φ {trial.phi!r} was not simulated{did_you_mean(trial.phi, self.safe)}")
        car, other = (track.placed(self.frame) for track in read_tracks(path, self.car, self.other))
        phi = self.safe[trial.phi]
        begin = self._beginning(other, phi, path)
        scene = self._scene(car, other, begin, self.scenario.time_step * (len(phi) - 1))
        touching = np.flatnonzero(clearances(_shrunk(scene, deeper)) <= 0.0)
        if touching.size:
            scene = _until(scene, int(touching[0]) + 1)
        self._check_follows(scene, phi, path)
        self._check_road(scene, path)
        self._check_drives(scene, path)
        return scene

    def _laid_apart(self, path: Path, trial: PhysicalTrial) -> Scene:
        """Return the recording of a trial of which the table says that nobody was hit, to a contact beyond noise."""
        try:
            return self.laid(path, trial, _MARGIN)
        except UsageError as error:
            raise UsageError(
                f"{trial.where}: says that the car did not hit, and in the recording it touches the road user; then, "
                f"{error}"
            ) from error

    def _beginning(self, other: Track, phi: FloatArray, path: Path) -> float:
        """Return when φ began, s on the recording's clock."""
        ticks = self.scenario.time_step * np.arange(len(phi))
        first, last = other.times[0], other.times[-1] - _LEAST_SHARE * ticks[-1]
        if last < first:
            raise UsageError(
                f"{path}: the road user is tracked for {other.times[-1] - other.times[0]:.1f} s, less than half of its "
                f"φ ({ticks[-1]:.1f} s)"
            )

        def off(begin: float) -> float:
            tracked = (begin + ticks <= other.times[-1] + 1e-9) & (begin + ticks >= other.times[0] - 1e-9)
            x, y = (np.interp(begin + ticks[tracked], other.times, column) for column in other.places.T)
            return float(np.mean((x - phi[tracked, 0]) ** 2 + (y - phi[tracked, 1]) ** 2))

        shifts = np.arange(first, last + _SHIFTS, _SHIFTS)
        best = float(shifts[int(np.argmin([off(float(shift)) for shift in shifts]))])
        finer = np.clip(best + np.linspace(-_SHIFTS, _SHIFTS, 81), first, None)
        return float(finer[int(np.argmin([off(float(shift)) for shift in finer]))])

    def _scene(self, car: Track, other: Track, begin: float, duration: float) -> Scene:
        end = min(begin + duration, other.times[-1])
        times = np.append(np.arange(begin, end - 1e-9, _STEP), end)
        headings = car.headings_at(times, _OVER)
        ahead = np.column_stack([np.cos(headings), np.sin(headings)])
        places = car.at(times) - self.reference * ahead
        body = self.scenario.adversary
        turned = other.headings_at(times, _OVER) if body.is_box else np.zeros(len(times))
        states = np.column_stack([places, headings, car.speeds_at(times, _OVER)])
        footprint = self.scenario.car.front, self.scenario.car.rear, self.scenario.car.half_width
        velocity = other.velocity_at(times, _OVER)
        return Scene(times - begin, states, other.at(times), velocity, turned, footprint, body.shape)

    def _check_follows(self, scene: Scene, phi: FloatArray, path: Path) -> None:
        ticks = self.scenario.time_step * np.arange(len(phi))
        wanted = np.column_stack([np.interp(scene.times, ticks, column) for column in phi.T])
        off = np.hypot(*(scene.other - wanted).T)
        worst = int(np.argmax(off))
        if off[worst] > self.tolerance:
            raise UsageError(
                f"{path}: the road user is {off[worst]:.2f} m off its φ after {scene.times[worst]:.1f} s, more than "
                f"{self.tolerance:g} m: is it the φ of this trial, and does --frame say where map lies?"
            )

    def _check_whole(self, scene: Scene, phi: FloatArray, path: Path) -> None:
        """Refuse a recording that ends while the two still come nearer: nobody knows how near they came."""
        missing = self.scenario.time_step * (len(phi) - 1) - float(scene.times[-1])
        distances = clearances(scene)
        before = distances[scene.times < scene.times[-1] - _END]
        if missing > _END and (not before.size or distances[-1] < before.min()):
            raise UsageError(
                f"{path}: ends {missing:.1f} s before its φ does, and the two still come nearer then: record car and "
                "road user until the car has passed or stands, or to the contact (hit = 1 in the table)"
            )

    def _check_road(self, scene: Scene, path: Path) -> None:
        line = self.scenario.road.line
        places = right_and_along(line, np.ascontiguousarray(scene.car[:, :2]))
        aside = float(np.abs(places[:, 0]).max())
        if aside > 0.5 * self.scenario.road.lane_width:
            raise UsageError(
                f"{path}: the car is {aside:.1f} m beside its lane's centre: does --frame say where map lies?"
            )
        lanes = np.array([road_pose(line, along)[2] for along in places[:, 1].tolist()])
        off = np.abs(np.angle(np.exp(1j * (scene.car[:, 2] - lanes))))
        turned = off[0] if off[0] > _TURNED else off.max()
        if turned > _TURNED:
            raise UsageError(f"{path}: the car points {math.degrees(turned):.0f}° off its lane: does --frame turn it?")
        self._check_points(scene, path)

    def _check_drives(self, scene: Scene, path: Path) -> None:
        """Refuse a car that stands all the time: it hits nobody, and that says nothing of how it avoids people."""
        fastest, least = float(scene.car[:, 3].max()), self.scenario.collision.hit_speed
        if fastest < least:
            raise UsageError(
                f"{path}: the car never drives, at most {fastest:.2f} m/s, and a hit begins at {least:g} m/s; in a "
                "trial it has to come up to the road user"
            )

    @staticmethod
    def _check_points(scene: Scene, path: Path) -> None:
        """Refuse a car that goes elsewhere than it points: a heading in another unit may be near its lane's."""
        over = max(1, min(round(_WENT / _STEP), len(scene.times) - 1))
        went = (scene.car[over:, :2] - scene.car[:-over, :2]) @ np.array([1.0, 1j])
        pointed = np.cumsum(np.exp(1j * scene.car[:, 2]))
        aside = np.abs(np.angle(went * (pointed[over:] - pointed[:-over]).conj()))
        aside = aside[np.abs(went) >= _SHOWN]
        if aside.size and aside.max() > _POINTED:
            raise UsageError(
                f"{path}: the car goes {math.degrees(aside.max()):.0f}° aside of where it points: is its heading in "
                "rad, counter-clockwise from the x axis of the recording's frame?"
            )


def track_of(scene: Scene) -> FloatArray:
    """Return where car and road user were at each moment of a trial, n × 4, m."""
    return np.column_stack([scene.car[:, :2], scene.other])


def overruled(trials: Sequence[PhysicalTrial]) -> list[str]:
    """Return, in a line, in how many trials a table says that the car did not hit although its recording has a hit."""
    other = [one for one in trials if one.seen_hit and one.values["hit"] == 0.0]
    if not other:
        return []
    seen = sum(bool(one.seen_hit) for one in trials)
    return [
        f"in {len(other)} of {len(trials)} trials the table says that the car did not hit, and in the recording "
        f"it does, less than {_MARGIN:g} m deep, which may be noise: the table counts; by the recordings it hits in "
        f"{seen} (first: {other[0].where})"
    ]


def _says_apart(trial: PhysicalTrial) -> bool:
    return trial.values.get("hit") == 0.0 or trial.values.get("clearance", 0.0) > 0.0


def _shrunk(scene: Scene, by: float) -> Scene:
    """Return a scene whose car has an outline that is so much smaller on each side, m."""
    front, rear, half_width = scene.footprint
    return replace(scene, footprint=(front - by, rear - by, max(0.0, half_width - by)))


def _touches(scene: Scene, deeper: float) -> bool:
    """Return whether the outlines are so far inside each other in the end, m."""
    return bool(clearances(_shrunk(scene, deeper))[-1] <= 0.0)


def _until(scene: Scene, count: int) -> Scene:
    return Scene(
        scene.times[:count],
        scene.car[:count],
        scene.other[:count],
        scene.velocity[:count],
        scene.turned[:count],
        scene.footprint,
        scene.shape,
    )


def _check_agrees(trial: PhysicalTrial, measured: Mapping[str, float]) -> None:
    """Refuse a table that says otherwise than the recording beside it, noise left aside."""
    said = trial.values.get("hit")
    if said == 1.0 and measured["clearance"] > _MARGIN:
        raise UsageError(
            f"{trial.where}: says that the car hit, and in the recording it stays {measured['clearance']:.2f} m away"
        )
    for key in ("clearance", "required_deceleration"):
        if key in trial.values and abs(trial.values[key] - measured[key]) > _MARGIN:
            raise UsageError(
                f"{trial.where}: {key} is said to be {trial.values[key]:g}, and the recording gives {measured[key]:.3g}"
            )
