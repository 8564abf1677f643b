"""Which tests Euro NCAP's 2026 matrices have, in which range, and the colour of each.

Source: the template that Euro NCAP's calculator generates (`euroncap-rating-2026` 5.4.9, Crash Avoidance - Frontal
Collisions v1.2; colours: section 5.2, `measured_color`, to which the tolerance of a verification test does not apply).
Rows in which a manufacturer declares a warning or a brake are those of a brake: there is no driver to warn. SKD's world
has no light, so the matrices are those of the day. A speed reduction of more than 30 km/h is red there; so it is here.

Then the tests of UN Regulation 152 and of FMVSS 127 (49 CFR 571.127): each series with its paragraphs and its limit.
UN R152: limits for M1 in running order, of E/ECE/TRANS/505/Rev.3/Add.151/Rev.2; those of the first step (00 series) are
of its Amendment 1. FMVSS 127: Federal Register document 2024-09054, tables 1 to S7.1 and 2 to S8.1.1; ranges of speeds
are stepped by 10 km/h. The targets are those of Euro NCAP's scenarios. Left out is what SKD's world has not: darkness,
warnings, brakes that a driver applies, and the steel plate (S9.2).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
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


GRAVITY = 9.81  # m/s²
Curve = tuple[float, float, str]  # radius (m), angle (rad) and side
_TARGET_LENGTH, _TARGET_WIDTH = 4.023, 1.712  # m, the Global Vehicle Target, as in scenario ccrs

R152_CAR: Final = {
    10: 0, 15: 0, 20: 0, 25: 0, 30: 0, 35: 0, 40: 0, 42: 0, 45: 15, 50: 25, 55: 30, 60: 35
}  # fmt: skip
R152_PEDESTRIAN: Final = {20: 0, 25: 0, 30: 0, 35: 0, 40: 0, 42: 0, 45: 15, 50: 25, 55: 30, 60: 35}
R152_BICYCLE: Final = {20: 0, 25: 0, 30: 0, 35: 0, 38: 0, 40: 0, 45: 25, 50: 30, 55: 35, 60: 40}
R152_FIRST_STEP: Final = {20: 0, 25: 0, 30: 0, 35: 20, 40: 25, 45: 30, 50: 35, 55: 40, 60: 45}
"""Greatest (relative) impact speed by test speed, km/h."""


def _series(
    test: str,
    paragraphs: str,
    scenario: str,
    limits: Mapping[int, int],
    *,
    target: float | None = 0.0,
    places: Iterable[float] = (50.0,),
    changes: Mapping[str, object] | None = None,
    headway: float | None = None,
    criterion: Criterion = Criterion.RELATIVE,
    limit: float | None = None,
) -> ProtocolMatrix:
    points = tuple(
        MatrixPoint(
            float(speed),
            float(speed) if target is None else target,
            place,
            False,
            criterion,
            float(most) if limit is None else limit,
        )
        for speed, most in limits.items()
        for place in places
    )
    return ProtocolMatrix(test, points, scenario, paragraphs, dict(changes or {}), headway)


def _no_contact(first: int, last: int, *more: int) -> dict[int, int]:
    return dict.fromkeys([*range(first, last + 1, 10), *more], 0)


def _r152(pedestrian: Mapping[int, int], *more: ProtocolMatrix) -> tuple[ProtocolMatrix, ...]:
    return (
        _series("car, stationary", "UN R152, 5.2.1.4 and 6.4", "ccrs", R152_CAR),
        _series(  # by relative speed
            "car, moving", "UN R152, 5.2.1.4 and 6.5", "ccrm", {20 + fast: R152_CAR[fast] for fast in range(10, 41, 5)},
            target=20.0,
        ),
        _series(
            "pedestrian", "UN R152, 5.2.2.4 and 6.6", "cpna", pedestrian, target=5.0,
            changes={"adversary.kind": "child"},
        ),
        *more,
    )  # fmt: skip


def _false_reactions() -> Iterable[ProtocolMatrix]:
    """Yield the false reaction scenarios of R152 (Annex 3, Appendix 2), driven on the right: no emergency braking.

    That is 5 m/s² or more (5.2.1.2 to 5.2.3.2). Speeds are the least of the examples, times to collision the greatest,
    where the front enters the curve. The road turns where the driver steers. Lanes of 3.5 m and the radius of 9 m are
    Euro NCAP's; the outer edge of 3.2's curve has 25 m.
    """
    right_angle, outer, shift = 0.5 * math.pi, 25.0 - 0.5 * 3.5, math.sqrt(3.5 / _LANE_CHANGE)
    rows: Iterable[tuple[str, str, str, int, float, float, Iterable[Curve], Mapping[str, object]]] = (
        # test, paragraph, scenario, km/h, s to who stands beyond the curve's beginning, m to its left, curves, changes
        ("turns left before a car", "1.2", "ccrs", 16, 2.8, 3.5, [(9.0, right_angle, "left")],
         {"adversary.start_heading": -right_angle}),
        ("car ahead turns right", "2.2", "ccrs", 26, 10.0, 3.5, [], {"others": [_turning(20.9, 26 / 3.6)]}),
        ("pedestrian behind a curve's guard pipes", "3.2", "cpla", 22, 1.6, 0.0, [(outer, right_angle, "left")],
         {"protocol.speed": 0.0}),
        ("changes lanes before a signboard", "4.2", "ccrs", 40, 4.2, 0.0,
         [(_LANE_CHANGE, shift, "left"), (_LANE_CHANGE, shift, "right")],
         {"adversary.length": 0.5, "adversary.width": 1.0}),
    )  # fmt: skip
    for test, paragraph, scenario, speed, ahead, aside, curves, changes in rows:
        turns = [{"radius": radius, "length": radius * angle, "turn": turn} for radius, angle, turn in curves]
        road = {"road.parts": [{"length": 100.0}, *turns, {"length": 100.0}], "road.origin": 100.0}
        start = {"car.start_time": 5.0, "car.start_time_range": 0.0, "protocol.headway": 5.0 + ahead}
        # It lasts until the horizon.
        end = {"adversary.destination_x": None, "ending": {"arrived": {"ahead_of": 200.0}, "missed": {}}}
        yield _series(
            f"false reaction: {test}", f"UN R152, 5.1.6 and Annex 3, Appendix 2, {paragraph}", scenario, {speed: 0},
            places=(_place(aside),), changes={**road, **start, **end, **changes},
            criterion=Criterion.BRAKING, limit=5.0,
        )  # fmt: skip


def _turning(gap: float, speed: float) -> dict[str, object]:
    """Return a car that turns right `gap` (m) before one with a speed (m/s), 5 s before that one's line (2.2).

    It has 10 km/h, and the radius of 5.5 m of Euro NCAP's turns to the near side. The test's target stands on the next
    lane, far ahead.
    """
    angles = [0.1 * step for step in range(17)]
    south, seconds = gap + 0.5 * _TARGET_LENGTH - 5.0 * speed, 5.5 / (10 / 3.6)
    way = [
        {"time": seconds * one, "x": 5.5 * (1.0 - math.cos(one)), "y": south + 5.5 * math.sin(one)} for one in angles
    ]
    return {**_STANDING, "way": [*way, {"time": seconds * angles[-1] + 18.0, "x": 55.0, "y": way[-1]["y"]}]}


def _fmvss127() -> tuple[ProtocolMatrix, ...]:
    braking = [
        _series(
            f"lead vehicle, {headway} m ahead, brakes by {share:g} g",
            "49 CFR 571.127 S7.5",
            "ccrb",
            {50: 0, 80: 0},
            target=None,
            changes={"protocol.deceleration": share * GRAVITY, "protocol.brake_after": 3.0, "horizon": 24.0},
            headway=float(headway),
        )
        for headway in (12, 40)
        for share in (0.3, 0.5)
    ]
    return (
        _series("lead vehicle, stopped", "49 CFR 571.127 S7.3", "ccrs", _no_contact(10, 80), changes=_TIME),
        _series("lead vehicle, slower", "49 CFR 571.127 S7.4", "ccrm", _no_contact(40, 80), target=20.0, changes=_TIME),
        *braking,
        _series(
            "pedestrian from the right", "49 CFR 571.127 S8.3.1", "cpna", _no_contact(10, 60), target=5.0,
            places=(25.0, 50.0),
        ),
        _series("pedestrian from the left", "49 CFR 571.127 S8.3.2", "cpfa", _no_contact(10, 60), target=8.0),
        _series(
            "pedestrian from behind parked cars", "49 CFR 571.127 S8.3.3", "cpnco", _no_contact(10, 50), target=5.0,
            changes={"obstacles": _PARKED},
        ),
        _series(
            "pedestrian, stationary", "49 CFR 571.127 S8.4", "cpla", _no_contact(10, 50, 55), places=(25.0,),
            changes={"protocol.speed": 0.0},
        ),
        _series(
            "pedestrian along the path", "49 CFR 571.127 S8.5", "cpla", _no_contact(10, 60, 65), target=5.0,
            places=(25.0,),
        ),
        _series(
            "between two cars", "49 CFR 571.127 S5.3 and S9.3", "ccrs", {80: 0}, places=(_place(_ASIDE),),
            changes={"others": [_STANDING], **_TIME}, criterion=Criterion.BRAKING, limit=0.25 * GRAVITY,
        ),
    )  # fmt: skip


def _place(left: float) -> float:
    """Return the impact place (%) of a car's width of 1.8 m that is so far to the left of its axis, m."""
    return round(50.0 + 100.0 * left / 1.8, 6)


_ASIDE = 0.5 * (4.5 + _TARGET_WIDTH)  # m: 4.5 m between the cars (S9.3.1)
_STANDING = {
    "kind": "car", "length": _TARGET_LENGTH, "width": _TARGET_WIDTH, "start_heading": 1.5707963267948966,
    "way": [{"time": 0.0, "x": _ASIDE, "y": 0.5 * _TARGET_LENGTH}],
}  # fmt: skip
_PARKED = [  # S8.3.3: 1 m beside the car, 1 m before the pedestrian, 1 m between them
    {"x": 0.9 + 1.0 + 0.5 * _TARGET_WIDTH, "y": y, "heading": 1.5707963267948966,
     "length": _TARGET_LENGTH, "width": _TARGET_WIDTH}
    for y in (-0.25 - 1.0 - 0.5 * _TARGET_LENGTH, -0.25 - 2.0 - 1.5 * _TARGET_LENGTH)
]  # fmt: skip

_LANE_CHANGE = 463.0  # m, radius: the signboard is half a car's width aside 3.3 s before at the earliest
_TIME = {"car.start_time": 5.0}  # s to the target (S7.2, S9.1)

NCAP = "ncap"
REGULATIONS: Final = {
    "r152": (
        "UN R152, second step",
        _r152(
            R152_PEDESTRIAN,
            _series("bicycle", "UN R152, 5.2.3.4 and 6.7", "cbna", R152_BICYCLE, target=15.0),
            *_false_reactions(),
        ),
    ),
    "r152_first": ("UN R152, first step", _r152(R152_FIRST_STEP)),
    "fmvss127": ("FMVSS 127", _fmvss127()),
}
"""By name: what people call it, and its tests."""
