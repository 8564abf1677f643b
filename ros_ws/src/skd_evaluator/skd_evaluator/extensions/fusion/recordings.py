"""Recordings of physical trials: laid over their φ in space and time, checked, and looked at like episodes.

A recording's clock says nothing of when φ began, so that is the moment from which the tracked road user is nearest to
φ, in the mean of squares. From there to the end of φ, or to the contact, is the trial.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from skd_adversary.safe_trajectories.recordings import interpolated
from skd_sim.errors import UsageError
from skd_sim.inputs.files import did_you_mean
from skd_sim.scenario.road import right_and_along, road_pose
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.state import FloatArray

from skd_evaluator.bags import tracks
from skd_evaluator.bags.checks import Damage
from skd_evaluator.bags.files import find_recordings
from skd_evaluator.bags.read import ADVERSARY, CAR
from skd_evaluator.bags.tracks import RecordingFrame, Track
from skd_evaluator.bags.transforms import zigzag
from skd_evaluator.extensions.fusion.trials import GAP_TOLERANCE, PhysicalTrial, figures_of, gap_to_crossing
from skd_evaluator.metrics.surrogate_measures import clearances
from skd_evaluator.metrics.surrogate_scenes import Interaction

PATH_TOLERANCE = 0.5
"""m that the tracked road user may be off φ at any moment: beyond, it was not a trial on that φ."""
_NOISE = 0.3  # m of two tracked places
_MOVES = 1.0  # m/s, from which directions and speeds of positions say something
_SAME_SPEED, _SLACK, _SPEED_OVER = 1.3, 1.0, 0.5  # ratio, m/s and s by which stated speeds are compared with positions
_STEP = 0.05  # s between moments
_SHIFTS = 0.02  # s between beginnings of φ that are tried; then finer
_OVER = 0.3  # s over which velocities are taken: a sensor's noise of 2 cm is 0.1 m/s then
_LEAST_SHARE = 0.5  # of φ that must be tracked
_TURNED, _POINTED = math.radians(30.0), math.radians(12.0)  # off the lane's heading, and off where the car goes
_WENT, _SHOWN = 1.0, 1.5  # s over which is looked where a car goes, and m that show it
_END = 0.5  # s that a recording may end before φ does, and over which is looked whether the two still come nearer


def read_tracks(path: Path, car: str | None, other: str | None, damage: Damage | None = None) -> tuple[Track, Track]:
    """Return the tracks of the car and of the other road user, in the recording's frame.

    Args:
        path: a recording, a bag's folder, or a csv file with the columns t, id, x, y, and perhaps heading and speed.
        car: topic or id of the car; None: what SKD itself calls it.
        other: topic or id of the other.
        damage: takes note of what is left out; by default that is refused.

    Raises:
        UsageError: it cannot be read, is implausible, lacks one of the two, or they are in two frames.
    """
    if not path.exists():
        raise UsageError(f"{path}: no such file or folder")
    is_table = path.suffix.lower() == ".csv"
    usual = (tracks.TABLE_CAR, tracks.TABLE_OTHER) if is_table else (CAR, ADVERSARY)
    first, second = car or usual[0], other or usual[1]
    if first == second:
        raise UsageError(f"{path}: car and road user are both {first!r}; say which is which")
    if is_table:
        found = {
            name: one for name, one in tracks.table_tracks(path, [first, second]).items() if isinstance(one, Track)
        }
    else:
        files = [file for files in find_recordings([path], damage) for file in files]
        found = tracks.bag_tracks(files, [first, second], damage=damage)
    tracks.one_frame(path, found[first], found[second])
    for one in found.values():
        _check_track(one)
    return found[first], found[second]


def _check_track(track: Track) -> None:
    """Refuse a track that is too short or long, jumps, or whose speeds are not those of its positions."""
    times, why = track.times, track.jump
    if len(times) < 5:
        why = f"{len(times)} positions are no track"
    elif not why:
        off = zigzag(times, track.places)
        worst = int(np.argmax(off))
        if off[worst] > _NOISE:
            why = f"leaps by {off[worst]:.2g} m at {times[worst + 1]:.2f} s: positions without jumps are needed"
        elif track.speeds is not None:
            why = _wrong_speeds(track, np.abs(track.speeds))
    if why:
        raise UsageError(f"{track.where}: {why}")


def _wrong_speeds(track: Track, speeds: FloatArray) -> str:
    """Return how stated speeds (m/s) are not those of the positions, on the whole or at a moment; empty if they are."""
    times = track.times
    went = float(np.hypot(*np.diff(track.places, axis=0).T).sum())
    stated = float(np.trapezoid(speeds, times))
    if max(went, stated) < _MOVES * (times[-1] - times[0]):
        return ""
    ratio = stated / max(went, 1e-9)
    if not 1.0 / _SAME_SPEED <= ratio <= _SAME_SPEED:
        hint = ": is it in km/h?" if abs(ratio - 3.6) < 0.5 else ""
        return f"its speed is {ratio:.2g} times that of its positions{hint}"
    seen = np.hypot(*_velocity_at(track, times, _SPEED_OVER, holes=True).T)
    off = np.abs(seen - speeds) - _SLACK - (_SAME_SPEED - 1.0) * np.maximum(seen, speeds)
    at = int(np.argmax(off))
    said = f"its speed is {speeds[at]:.2g} m/s at {times[at]:.2f} s, and that of its positions {seen[at]:.2g} m/s"
    return said if off[at] > 0.0 else ""


def _places_at(track: Track, times: FloatArray, *, holes: bool = False) -> FloatArray:
    """Return places at some times (s), n × 2, m, in straight lines; a hole is refused unless `holes`."""
    known = track.times
    if times[0] < known[0] - 1e-6 or times[-1] > known[-1] + 1e-6:
        there, trial = (f"{one[0]:.2f} to {one[-1]:.2f} s" for one in (known, times))
        raise UsageError(f"{track.where}: is tracked from {there}, and the trial is from {trial}{_why(track)}")
    hole = np.diff(known)[np.clip(np.searchsorted(known, times), 1, len(known) - 1) - 1].max()
    if hole > tracks.LONGEST_GAP and not holes:
        raise UsageError(f"{track.where}: has a hole of {hole:.2f} s, more than {tracks.LONGEST_GAP:g} s{_why(track)}")
    return interpolated(times, known, track.places)


def _why(track: Track) -> str:
    """Return what was left out of a track, for messages."""
    return "".join(f"; {note}" for note in track.notes)


def _velocity_at(track: Track, times: FloatArray, over: float, *, holes: bool = False) -> FloatArray:
    """Return velocities at some times (s), n × 2, m/s, by the places half of `over` (s) before and after."""
    before = np.maximum(times - 0.5 * over, track.times[0])
    after = np.minimum(times + 0.5 * over, track.times[-1])
    moved = _places_at(track, after, holes=holes) - _places_at(track, before, holes=holes)
    return np.asarray(moved / (after - before)[:, None])


def _headings_at(track: Track, times: FloatArray) -> FloatArray:
    """Return headings at some times (s), rad: as recorded, else those of the velocities, kept while it stands."""
    if track.headings is not None:
        return np.interp(times, track.times, np.unwrap(track.headings))
    velocity = _velocity_at(track, times, _OVER)
    moves = np.flatnonzero(np.hypot(*velocity.T) >= _MOVES)
    if not moves.size:
        raise UsageError(f"{track.where}: stands all the time and has no heading: record its heading")
    kept = moves[np.maximum(0, np.searchsorted(moves, np.arange(len(times)), side="right") - 1)]
    return np.unwrap(np.arctan2(velocity[kept, 1], velocity[kept, 0]))


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
        damage: takes note of what of recordings is left out.
    """

    scenario: Scenario
    safe: Mapping[str, FloatArray]
    car: str | None = None
    other: str | None = None
    frame: RecordingFrame = field(default_factory=RecordingFrame)
    reference: float = 0.0
    tolerance: float = PATH_TOLERANCE
    gap_tolerance: float = GAP_TOLERANCE
    damage: Damage = field(default_factory=lambda: Damage(skip=True))

    def measured(self, path: Path, trial: PhysicalTrial) -> PhysicalTrial:
        """Return a trial with timing and figures as its recording has them.

        Where the table says that the car did not hit, a contact has to be deeper than noise.

        Raises:
            UsageError: it cannot be read, does not follow φ, does not fit the road, or contradicts the table.
        """
        said, where = trial.values, trial.where
        is_apart = said.get("hit") == 0.0 or said.get("clearance", 0.0) > 0.0
        depth = _NOISE if is_apart else 0.0
        scene = self.laid(path, trial, depth)
        speeds, is_hit = scene.car[:, 3].tolist(), self.scenario.collision.is_hit
        contact, seen = _first_contact(scene, depth), _first_contact(scene, 0.0)
        hit = contact is not None and is_hit(speeds[contact])
        if contact is None and said.get("hit") != 1.0:
            self._check_whole(scene, self.safe[trial.phi], path)
        if hit and is_apart:
            how = f"in the recording it is more than {depth:g} m inside the road user, at {speeds[-1]:.1f} m/s"
            raise UsageError(f"{where}: says that the car did not hit, and {how} (hit = 1)")
        values, gap = figures_of(scene, hit=hit), gap_to_crossing(self.scenario, scene.car[0])
        if said.get("hit") == 1.0:
            if values["clearance"] > _NOISE:
                apart = f"in the recording it stays {values['clearance']:.2f} m away"
                raise UsageError(f"{where}: says that the car hit, and {apart}")
            values["clearance"] = 0.0
        for key in ("clearance", "required_deceleration"):
            if key in said and abs(said[key] - values[key]) > _NOISE:
                raise UsageError(f"{where}: {key} is said to be {said[key]:g}, the recording gives {values[key]:.3g}")
        if trial.gap is not None and abs(trial.gap - gap) > self.gap_tolerance:
            gaps = f"{trial.gap:.2f} m, and the recording gives {gap:.2f}"
            raise UsageError(f"{where}: gap is said to be {gaps}: leave it out, or give --reference")
        values, gap = {**values, **said}, gap if trial.gap is None else trial.gap
        seen_hit = seen is not None and is_hit(speeds[seen])
        return replace(trial, values=values, gap=gap, seen_hit=seen_hit, track=track_of(scene))

    def laid(self, path: Path, trial: PhysicalTrial, depth: float = 0.0) -> Interaction:
        """Return the recording of a trial from the beginning of its φ to its end, or to the contact.

        Args:
            path: the recording.
            trial: which it is.
            depth: how far inside each other the outlines have to be for a contact, m.

        Raises:
            UsageError: it cannot be read, does not follow φ, or does not fit the road.
        """
        if trial.phi not in self.safe:
            raise UsageError(f"{trial.where}: φ {trial.phi!r} was not simulated{did_you_mean(trial.phi, self.safe)}")
        car, other = (track.placed(self.frame) for track in read_tracks(path, self.car, self.other, self.damage))
        phi = self.safe[trial.phi]
        begin = self._beginning(other, phi, path)
        scene = self._scene(car, other, begin, self.scenario.time_step * (len(phi) - 1))
        contact = _first_contact(scene, depth)
        if contact is not None:
            timed = ("times", "car", "other", "velocity", "turned")
            scene = replace(scene, **{name: getattr(scene, name)[: contact + 1] for name in timed})
        self._check_follows(scene, phi, path)
        self._check_road(scene, path)
        fastest, least = float(scene.car[:, 3].max()), self.scenario.collision.hit_speed
        if fastest < least:
            what = f"the car never drives, at most {fastest:.2f} m/s"
            raise UsageError(f"{path}: {what}, and a hit begins at {least:g} m/s")
        return scene

    def _beginning(self, other: Track, phi: FloatArray, path: Path) -> float:
        """Return when φ began, s on the recording's clock."""
        ticks = self.scenario.time_step * np.arange(len(phi))
        first, last = other.times[0], other.times[-1] - _LEAST_SHARE * ticks[-1]
        if last < first:
            raise UsageError(f"{path}: the road user is tracked for less than half of its φ ({ticks[-1]:.1f} s)")

        def off(begin: float) -> float:
            tracked = (begin + ticks <= other.times[-1] + 1e-9) & (begin + ticks >= other.times[0] - 1e-9)
            apart = interpolated(begin + ticks[tracked], other.times, other.places) - phi[tracked]
            return float(np.mean(apart[:, 0] ** 2 + apart[:, 1] ** 2))

        best = min(np.arange(first, last + _SHIFTS, _SHIFTS).tolist(), key=off)
        return float(min(np.clip(best + np.linspace(-_SHIFTS, _SHIFTS, 81), first, None).tolist(), key=off))

    def _scene(self, car: Track, other: Track, begin: float, duration: float) -> Interaction:
        end = min(begin + duration, other.times[-1])
        times = np.append(np.arange(begin, end - 1e-9, _STEP), end)
        headings = _headings_at(car, times)
        places = _places_at(car, times) - self.reference * np.column_stack([np.cos(headings), np.sin(headings)])
        body = self.scenario.adversary
        turned = _headings_at(other, times) if body.is_box else np.zeros(len(times))
        if car.speeds is None:
            speeds = np.hypot(*_velocity_at(car, times, _OVER).T)
        else:
            speeds = np.interp(times, car.times, np.abs(car.speeds))
        states = np.column_stack([places, headings, speeds])
        footprint = self.scenario.car.front, self.scenario.car.rear, self.scenario.car.half_width
        velocity = _velocity_at(other, times, _OVER)
        return Interaction(times - begin, states, _places_at(other, times), velocity, turned, footprint, body.shape)

    def _check_follows(self, scene: Interaction, phi: FloatArray, path: Path) -> None:
        ticks = self.scenario.time_step * np.arange(len(phi))
        off = np.hypot(*(scene.other - interpolated(scene.times, ticks, phi)).T)
        worst = int(np.argmax(off))
        if off[worst] > self.tolerance:
            how = f"{off[worst]:.2f} m off its φ after {scene.times[worst]:.1f} s, more than {self.tolerance:g} m"
            raise UsageError(f"{path}: the road user is {how}: is it this φ, and does --frame say where map lies?")

    def _check_whole(self, scene: Interaction, phi: FloatArray, path: Path) -> None:
        """Refuse a recording that ends while the two still come nearer: how near they came is not known."""
        missing = self.scenario.time_step * (len(phi) - 1) - float(scene.times[-1])
        distances = clearances(scene)
        before = distances[scene.times < scene.times[-1] - _END]
        if missing > _END and (not before.size or distances[-1] < before.min()):
            how = f"ends {missing:.1f} s before its φ does, and the two still come nearer then"
            raise UsageError(f"{path}: {how}: record until the car has passed or stands, or to the contact (hit = 1)")

    def _check_road(self, scene: Interaction, path: Path) -> None:
        """Refuse a car that is beside its lane, across it, or goes elsewhere than it points."""
        line = self.scenario.road.line
        places = right_and_along(line, np.ascontiguousarray(scene.car[:, :2]))
        lanes = np.array([road_pose(line, along)[2] for along in places[:, 1].tolist()])
        over = max(1, min(round(_WENT / _STEP), len(scene.times) - 1))
        went = (scene.car[over:, :2] - scene.car[:-over, :2]) @ np.array([1.0, 1j])
        pointed = np.cumsum(np.exp(1j * scene.car[:, 2]))
        off = np.abs(np.angle(went * (pointed[over:] - pointed[:-over]).conj()))[np.abs(went) >= _SHOWN]
        aside = float(np.abs(places[:, 0]).max())
        turned = float(np.abs(np.angle(np.exp(1j * (scene.car[:, 2] - lanes)))).max())
        why = ""
        if aside > 0.5 * self.scenario.road.lane_width:
            why = f"is {aside:.1f} m beside its lane's centre: does --frame say where map lies?"
        elif turned > _TURNED:
            why = f"points {math.degrees(turned):.0f}° off its lane: does --frame turn it?"
        elif off.size and off.max() > _POINTED:
            heading = "is its heading in rad, counter-clockwise from the x axis of the recording's frame?"
            why = f"goes {math.degrees(off.max()):.0f}° aside of where it points: {heading}"
        if why:
            raise UsageError(f"{path}: the car {why}")


def track_of(scene: Interaction) -> FloatArray:
    """Return where car and road user were at each moment of a trial, n × 4, m."""
    return np.column_stack([scene.car[:, :2], scene.other])


def overruled(trials: Sequence[PhysicalTrial]) -> list[str]:
    """Return, in a line, in how many trials a table says that the car did not hit although its recording has a hit."""
    other = [one for one in trials if one.seen_hit and one.values["hit"] == 0.0]
    if not other:
        return []
    seen = sum(bool(one.seen_hit) for one in trials)
    often = f"in {len(other)} of {len(trials)} trials the car hits in the recording and not in the table"
    depth = f"less than {_NOISE:g} m deep, which may be noise: the table counts"
    return [f"{often}, {depth}; by the recordings it hits in {seen} (first: {other[0].where})"]


def _first_contact(scene: Interaction, depth: float) -> int | None:
    """Return the first moment at which the outlines are so far inside each other (m); None without any."""
    front, rear, half_width = scene.footprint
    shrunk = replace(scene, footprint=(front - depth, rear - depth, max(0.0, half_width - depth)))
    touching = np.flatnonzero(clearances(shrunk) <= 0.0)
    return int(touching[0]) if touching.size else None
