"""Which tests Euro NCAP's 2026 matrices have, in which range, and the colour of each.

Source: the template that Euro NCAP's calculator generates (`euroncap-rating-2026` 5.4.9, Crash Avoidance - Frontal
Collisions v1.2; colours: section 5.2, `measured_color`, to which the tolerance of a verification test does not apply).
Rows in which a manufacturer declares a warning or a brake are those of a brake: there is no driver to warn. SKD's world
has no light, so the matrices are those of the day. A speed reduction of more than 30 km/h is red there; so it is here.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cache
from typing import Any, Final


class Criterion(StrEnum):
    """What a matrix goes by."""

    RELATIVE = "relative impact speed"
    IMPACT = "impact speed"
    REDUCTION = "speed reduction"
    BRAKING = "peak deceleration"

    @property
    def unit(self) -> str:
        """Of its values."""
        return "m/s²" if self is Criterion.BRAKING else "km/h"


CRITERIA = tuple(map(str, Criterion))
_VRU = (10.0, 20.0, 30.0, 40.0, 50.0, 60.0)
_TURNS = (10.0, 15.0, 20.0, 25.0)
_FIVE = (10.0, 25.0, 50.0, 75.0, 90.0)
_REAR = (-25.0, 0.0, 25.0, 50.0, 75.0, 100.0, 125.0)


@dataclass(frozen=True)
class MatrixPoint:
    """One test of a matrix.

    Attributes:
        speed: of the car, km/h.
        target: speed of the target, km/h.
        place: impact place, % of the car's width; None where the matrix has columns of target speeds in its place.
        standard: whether it is in the standard range, else in the extended one.
        criterion: what its colour goes by.
        limit: greatest value of the criterion with which it is passed; None: the matrix has colours.
    """

    speed: float
    target: float
    place: float | None
    standard: bool
    criterion: Criterion
    limit: float | None = None


@dataclass(frozen=True)
class ProtocolMatrix:
    """The tests of a matrix that one scenario has, or a series of tests of a regulation.

    Attributes:
        test: the name by which the calculator knows the matrix; two scenarios may share one; or of a series.
        points: its tests.
        scenario: in which a series drives; empty: the matrix is that of a scenario.
        paragraphs: of the regulation.
        changes: of the scenario's keys.
        headway: how far ahead of the car the target starts, m; None: as the scenario says.
    """

    test: str
    points: tuple[MatrixPoint, ...]
    scenario: str = ""
    paragraphs: str = ""
    changes: Mapping[str, Any] = field(default_factory=dict)
    headway: float | None = None


def matrix_of(scenario: str) -> ProtocolMatrix | None:
    """Return the tests that a shipped scenario has in 2026's matrices; None where it has none."""
    return _matrices().get(scenario)


def scenarios_of(test: str) -> list[str]:
    """Return the shipped scenarios that make up a matrix."""
    return [name for name, one in _matrices().items() if one.test == test]


def known_scenarios() -> list[str]:
    """Return the scenarios that have tests in the matrices."""
    return list(_matrices())


@cache
def _matrices() -> dict[str, ProtocolMatrix]:
    relative, impact = Criterion.RELATIVE, Criterion.IMPACT
    found = {
        "cpna": ("CPNA day", _grid(_VRU, 5.0, _FIVE, (25.0, 50.0, 75.0), relative)),
        "cpfa": ("CPFA day", _grid(_VRU, 8.0, _FIVE, (50.0,), relative)),
        "cpnco": ("CPNCO day", _grid(_VRU, 5.0, (25.0, 50.0, 75.0), (50.0,), relative)),
        "cpla": ("CPLA day", _along((10.0, 20.0, 30.0, 40.0), 5.0, 5.0)),
        "cbna": ("CBNA", _grid(_VRU, 15.0, _FIVE, (50.0, 75.0), relative)),
        "cbnao": ("CBNAO", _grid(_VRU, 10.0, _FIVE, (50.0, 75.0), relative)),
        "cbfa": ("CBFA", _grid(_VRU, 20.0, _FIVE, (25.0, 50.0), relative)),
        "cbla": ("CBLA", _along((20.0, 30.0, 40.0), 15.0, 20.0)),
        **{f"cpta{way}s": ("CPTAfs & CPTAns", _turn(way, 5.0, _FIVE, (50.0,))) for way in "fn"},
        **{f"cpta{way}o": ("CPTAfo & CPTAno", _turn(way, 5.0, _FIVE, (50.0,))) for way in "fn"},
        "cbtafs": ("CBTAfs & CBTAns", _turn("f", 15.0, (75.0, 100.0), (100.0,))),
        "cbtans": ("CBTAfs & CBTAns", _turn("n", 15.0, (0.0, 75.0), (0.0,))),
        "cbtafo": ("CBTAfo & CBTAno", _turn("f", 15.0, _FIVE, (50.0,))),
        "cbtano": ("CBTAfo & CBTAno", _turn("n", 15.0, (25.0, 50.0, 75.0), (50.0,))),
        "ccrs": ("CCRs", _grid(_steps(10, 80), 0.0, _REAR, _REAR[1:-1], relative)),
        "ccrm": (
            "CCRm",
            [
                point
                for speed in _steps(30, 130)
                for point in _grid((speed,), max(20.0, speed - 60.0), _REAR, _REAR[1:-1], relative)
            ],
        ),
        "ccrb": ("CCRb", _braking(_REAR)),
        "cmrs": ("CMRs", _grid(_steps(10, 80), 0.0, _FIVE, _FIVE[1:-1], relative)),
        "cmrb": ("CMRb", _braking(_FIVE)),
        **{name: (f"CCF{name[3:]}", _head_on()) for name in ("ccfhos", "ccfhol")},
        **{name: (f"{name[:2].upper()}Ftap", _across(impact)) for name in ("ccftap", "cmftap")},
        **{name: (f"{name[:2].upper()}Cscp", _straight_across(impact)) for name in ("cccscp", "cmcscp")},
    }
    return {name: ProtocolMatrix(test, tuple(points)) for name, (test, points) in found.items()}


def _steps(first: int, last: int) -> tuple[float, ...]:
    return tuple(float(speed) for speed in range(first, last + 1, 10))


def _grid(
    speeds: Sequence[float], target: float, places: Sequence[float], standard: Sequence[float], criterion: Criterion
) -> Iterator[MatrixPoint]:
    for speed in speeds:
        for place in places:
            yield MatrixPoint(speed, target, place, place in standard, criterion)


def _along(slow: Sequence[float], target: float, fast_target: float) -> Iterator[MatrixPoint]:
    """Yield the tests with a road user ahead: those from 70 km/h on are avoided or failed."""
    places = (10.0, 25.0, 50.0, 75.0)
    yield from _grid(slow, target, places, (50.0,), Criterion.RELATIVE)
    yield from _grid((50.0, 60.0), target, places, (25.0, 50.0), Criterion.RELATIVE)
    yield from _grid((70.0, 80.0), fast_target, places, (25.0,), Criterion.IMPACT)


def _turn(way: str, target: float, places: Sequence[float], standard: Sequence[float]) -> Iterator[MatrixPoint]:
    """Yield the tests of a car that turns: to the far side at four speeds, to the near side at one."""
    for speed in _TURNS if way == "f" else (10.0,):
        yield from _grid((speed,), target, places, standard if speed < 25.0 else (), Criterion.IMPACT)


def _braking(places: Sequence[float]) -> Iterator[MatrixPoint]:
    for speed in _steps(30, 130):
        yield from _grid((speed,), speed, places, places[1:-1] if speed <= 80.0 else (), Criterion.RELATIVE)


def _head_on() -> Iterator[MatrixPoint]:
    for speed, target in zip(_steps(30, 100), (50.0, 50.0, 50.0, 70.0, 70.0, 70.0, 90.0, 100.0), strict=True):
        standard = (25.0, 50.0, 75.0) if speed <= 80.0 else ()
        yield from _grid((speed,), target, (25.0, 50.0, 75.0, 100.0), standard, Criterion.REDUCTION)


def _across(criterion: Criterion) -> Iterator[MatrixPoint]:
    for speed in _TURNS:
        for target in (30.0, 45.0, 60.0, 80.0):
            yield MatrixPoint(speed, target, None, speed < 25.0 and target < 80.0, criterion)


def _straight_across(criterion: Criterion) -> Iterator[MatrixPoint]:
    for speed in _steps(20, 80):
        for target in _steps(20, 80 if speed <= 30.0 else 60 if speed <= 60.0 else 30):
            yield MatrixPoint(speed, target, None, speed <= 60.0 and target <= 60.0, criterion)


GREEN, YELLOW, ORANGE, BROWN, RED = COLOURS = ("green", "yellow", "orange", "brown", "red")
ROOM: Final = 0.5
"""m, the margin below which a green test stands out."""
_BELOW: Final = {  # by test speed, km/h: the relative impact speed (km/h) below which a test that hit has a colour
    10.0: (),
    20.0: (),
    30.0: ((10.0, BROWN),),
    40.0: ((10.0, ORANGE), (20.0, BROWN)),
    50.0: ((10.0, YELLOW), (20.0, ORANGE), (30.0, BROWN)),
}
_REDUCTIONS: Final = ((10.0, RED), (20.0, ORANGE), (30.0, GREEN), (math.inf, RED))


def colour_of(criterion: Criterion, speed: float, value: float, limit: float | None = None) -> str:
    """Return the colour of a test; where there is a limit it is green or red.

    Args:
        criterion: what it goes by.
        speed: test speed, km/h.
        value: of the criterion, in its unit; without a contact an impact speed of 0.
        limit: greatest value with which it is passed (of decelerations, least with which it is not); None: the matrix
            has colours.

    Raises:
        ValueError: the criterion has no colours at this test speed.
    """
    if limit is not None:
        less = value < limit or (value == limit and criterion is not Criterion.BRAKING)
        return GREEN if less else RED
    if criterion is Criterion.REDUCTION:
        return next(name for most, name in _REDUCTIONS if value <= most)
    if value <= 0.0:
        return GREEN
    if criterion is Criterion.IMPACT:
        return RED
    bands = _BELOW.get(min(speed, max(_BELOW)))
    if bands is None:
        raise ValueError(f"there are no colours at {speed:g} km/h")
    return next((name for most, name in bands if value < most), RED)
