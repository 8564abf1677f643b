"""From a track of others to a safe trajectory: rate, gaps and frame are looked at, and what was done is said."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from skd_adversary.safe_trajectories.car_frame import seen_from_car
from skd_adversary.safe_trajectories.csv_file import safe_trajectory
from skd_sim.arrays import FloatArray
from skd_sim.errors import UsageError
from skd_sim.scenario.road import right_and_along
from skd_sim.scenario.scenario import Scenario

from skd_evaluator.extensions.exchange.coming_in.sources import Source
from skd_evaluator.extensions.fusion.track import FASTEST, Frame, Track

_GAP = 1.5  # times the usual step, from which on a step is a gap
_LEAST_DRIVE = 0.5  # m that a car moves, or it has no direction
_JITTER = 0.3  # m
_FARTHEST_ASIDE = 2.0  # m


class UnusableError(UsageError):
    """A way that cannot be a safe trajectory; the message says why."""


@dataclass(frozen=True)
class Look:
    """What was seen of a track, and what was done with it.

    Attributes:
        positions: how many there were.
        duration: from the first to the last, s.
        rate: positions per second, by the median step.
        longest_step: between two positions, s.
        gaps: steps of more than one and a half times the usual; they are filled in a straight line.
        filled: how long these gaps are together, s.
        frame: name of the frame in the file; empty where it has none.
        placed: what was done to come into the frame `map`, in words.
        cut: what was cut off, in words; empty: nothing.
        starts: clock of the file when the way begins, s.
    """

    positions: int
    duration: float
    rate: float
    longest_step: float
    gaps: int
    filled: float
    frame: str
    placed: str
    cut: str
    starts: float

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain data."""
        return asdict(self)

    @property
    def text(self) -> str:
        """It in a line."""
        gaps = f"{self.gaps} gap{'s' if self.gaps != 1 else ''}, {self.filled:.2f} s in all, filled in straight lines"
        parts = [
            f"{self.positions} positions in {self.duration:.2f} s, {self.rate:.3g} a second",
            gaps if self.gaps else "no gaps",
            self.placed,
            self.cut,
        ]
        return "; ".join(filter(None, parts))


@dataclass(frozen=True, eq=False)
class Way:
    """A safe trajectory that came in.

    Attributes:
        source: where it comes from.
        times: n times from 0 on, s.
        places: n × 2, m, in the frame `map`.
        look: what was seen, and done.
    """

    source: Source
    times: FloatArray
    places: FloatArray
    look: Look

    def write(self, path: Path) -> None:
        """Write it as csv with the columns t, x, y, which `--safe` reads; numbers come back to the last bit."""
        rows = zip(self.times.tolist(), self.places.tolist(), strict=True)
        lines = ["t,x,y", *(f"{time!r},{x!r},{y!r}" for time, (x, y) in rows)]
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def way_of(source: Source, frame: Frame | None, longest_gap: float, scenario: Scenario | None) -> Way:
    """Return a source's way in the frame `map`.

    Args:
        source: track of the road user, and of the car where the frame goes by it.
        frame: where `map` lies in the file's frame; None: as the car drives.
        longest_gap: a longer gap is not filled, s.
        scenario: a way that lasts longer than its horizon is cut to what is around the crossing; None: none is cut.

    Raises:
        UnusableError: it jumps, or has a longer gap.
    """
    track = source.found.track
    steps = np.diff(track.times)
    usual = float(np.median(steps))
    gaps = steps[steps > _GAP * usual]
    if gaps.size and gaps.max() > longest_gap:
        raise UnusableError(f"a gap of {gaps.max():.2f} s, longer than --longest-gap {longest_gap:g} s")
    moved = np.hypot(*np.diff(track.places, axis=0).T)
    jump = moved > FASTEST * steps + _JITTER
    if jump.any():
        row = int(np.argmax(jump))
        raise UnusableError(f"moves {moved[row]:.3g} m in {steps[row]:.3g} s: are positions in m and times in s?")
    placed, said = _in_map(source, frame, 1.0 if scenario is None else scenario.end.crossing)
    begin, end, cut = 0, len(track.times), ""
    if scenario is not None and track.times[-1] - track.times[0] > scenario.horizon:
        begin, end, cut = _around_crossing(scenario, track.times, placed)
    times = track.times[begin:end]
    look = Look(
        len(track.times),
        float(track.times[-1] - track.times[0]),
        1.0 / usual,
        float(steps.max()),
        int(gaps.size),
        float(gaps.sum()),
        source.found.frame,
        said,
        cut,
        float(times[0]),
    )
    if len(times) < 2:
        raise UnusableError("nothing of it is near the crossing within the scenario's horizon")
    return Way(source, times - times[0], placed[begin:end], look)


def _in_map(source: Source, frame: Frame | None, crossing: float) -> tuple[FloatArray, str]:
    """Return positions in the frame `map`, n × 2, m, and what was done."""
    track = source.found.track
    if frame is not None:
        if frame == Frame():
            return track.places, "in the file's own frame"
        turned = math.degrees(frame.turned)
        return track.placed(frame).places, f"map lies at ({frame.x:g}, {frame.y:g}) m, turned by {turned:g}°"
    if source.car is None:
        raise UsageError(f"{source.path}: --frame car needs the car's way")
    return by_car(source.car.track, track, crossing)


def by_car(car: Track, user: Track, crossing: float) -> tuple[FloatArray, str]:
    """Return a road user's positions in the frame that goes by the car's way, n × 2, m, and what was done.

    Args:
        car: the car's track.
        user: the road user's.
        crossing: 1 for a scenario in which the adversary crosses towards the East, −1 towards the West.

    Raises:
        UnusableError: the car does not drive, or not straight.
    """
    if np.hypot(*np.ptp(car.places, axis=0)) < _LEAST_DRIVE:
        raise UnusableError("the car does not drive, so nothing says where North is")
    seen = seen_from_car(car.places, user.places)
    if seen.aside > _FARTHEST_ASIDE:
        raise UnusableError(
            f"the car is up to {seen.aside:.2f} m off a straight line, more than {_FARTHEST_ASIDE:g} m, so its way "
            "does not say where North is: cut it to what is straight, or give --frame"
        )
    said = f"North is where the car drives (at most {seen.aside:.2f} m off its line), y = 0 where its line is crossed"
    towards = "east" if crossing > 0.0 else "west"
    mirrored = seen.mirrored != (crossing < 0.0)
    return seen.positions * [crossing, 1.0], said + (f", mirrored to cross {towards}wards" if mirrored else "")


def _around_crossing(scenario: Scenario, times: FloatArray, places: FloatArray) -> tuple[int, int, str]:
    """Return which positions are within half of the horizon of when the lane's middle is crossed, and what was cut.

    A way that does not cross is cut around where it comes nearest to the middle.
    """
    right = right_and_along(scenario.road.line, np.ascontiguousarray(places))[:, 0]
    crosses = np.flatnonzero(np.diff(np.sign(right)) != 0)
    middle = times[int(crosses[0] if crosses.size else np.argmin(np.abs(right)))]
    half = 0.5 * scenario.horizon
    low = min(max(middle - half, times[0]), times[-1] - scenario.horizon)
    begin = int(np.searchsorted(times, low - 1e-9))
    end = int(np.searchsorted(times, times[begin] + scenario.horizon + 1e-9, side="right"))
    before, behind = times[begin] - times[0], times[-1] - times[end - 1]
    return begin, end, f"cut to the horizon: {before:.2f} s before and {behind:.2f} s after left out"


def read_as_safe(way: Way, scenario: Scenario) -> FloatArray:
    """Return a way as `--safe` reads it with a scenario: positions at its ticks, n × 2, m.

    Raises:
        UnusableError: `--safe` would refuse it.
    """
    path = way.source.path
    try:
        read = safe_trajectory(way.times, way.places, scenario, path, np.arange(len(way.times)))
    except UsageError as error:
        raise UnusableError(re.sub(r"^(, line \d+)?: ", "", str(error).removeprefix(str(path)))) from error
    return read.positions


def entry(way: Way, file: str) -> Mapping[str, Any]:
    """Return what import.json says of a way."""
    source = way.source
    return {
        "file": file,
        "source": str(source.path),
        "format": source.format,
        "road_user": source.found.name,
        "kind": source.found.kind,
        **way.look.as_dict(),
    }
