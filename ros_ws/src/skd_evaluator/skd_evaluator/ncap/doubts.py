"""Whether the car of `skd ncap` always is the same, and drives in a test as it does where something wobbles."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from scipy.stats import binomtest
from skd_sim.choices.car_under_test import CarUnderTest
from skd_sim.dynamics.limits import clipped_line, command_limits
from skd_sim.episode.episode import Episode, EpisodeLog, Outcome

from skd_evaluator.campaign.run.led import LedWay
from skd_evaluator.measure.doubt import DISBELIEF, DOUBT
from skd_evaluator.ncap.wanted import KMH


class _Share(NamedTuple):
    """What is said of tests that are driven with a share of the car's noise.

    Attributes:
        words: the share.
        chance: of a sign test, that counts as none.
        begins: the warning.
    """

    words: str
    chance: float
    begins: str


SHARES = {1e-6: _Share("a millionth", 0.2, DOUBT), 0.3: _Share("three tenths", 0.001, "")}
"""Of the car's noise, with which each static test is driven once more.

With next to no noise hardly a test of any car goes otherwise, and colours that take less of it than any car has are
doubtful; with a third of it many do, for the worse and the better.
"""
_MORE = 5.0  # km/h at the impact, by which a test goes worse or better
_LEAST, _SHARE = 3, 0.1  # so many tests more, and such a share of them, have to go worse than go better


@dataclass
class Seen:
    """What a car has done in all encounters.

    Attributes:
        tests: its static tests.
        shaken: for each of `SHARES`, tests and the same with so much of the car's noise; of cars that have none, none.
        failed: why some of these could not be driven; empty if they could.
        kamikazes: episodes in which somebody planned to be hit.
        led: ways on which searches have led the car.
        otherwise: cells in which it went otherwise on some of these when nobody made copies of it.
    """

    tests: list[EpisodeLog] = field(default_factory=list)
    shaken: dict[float, list[tuple[EpisodeLog, EpisodeLog]]] = field(default_factory=dict)
    failed: str = ""
    kamikazes: list[EpisodeLog] = field(default_factory=list)
    led: list[LedWay] = field(default_factory=list)
    otherwise: int = 0


def has_noise(test: Episode) -> bool:
    """Return whether the car of a static test has noise elsewhere."""
    car = test.shown_scenario.car
    return car.speed_noise > 0.0 or car.acceleration_noise > 0.0


def shaken(test: Episode, share: float) -> Episode:
    """Return a static test in which the car has a share of its noise."""
    shown = test.shown_scenario.car
    speed, acceleration = share * shown.speed_noise, share * shown.acceleration_noise
    car = replace(test.scenario.car, speed_noise=speed, acceleration_noise=acceleration)
    return replace(test, scenario=replace(test.scenario, car=car))


def doubts_of(car: CarUnderTest, seen: Seen) -> Iterator[str]:
    """Yield, a line each, why the grid may be that of another car than one that always drives so, by what was seen.

    Args:
        car: a user's car.
        seen: what it has done.
    """
    if seen.otherwise:
        cells = "a cell" if seen.otherwise == 1 else f"{seen.otherwise} cells"
        yield (
            f"{DISBELIEF}in {cells} {car.controller} answered otherwise when nobody made copies of it, on ways that "
            "the search for the margin tried: these have no margin, and the others may be those of another car"
        )
    yield from _knows_stillness(car, seen)


def aborted(seen: Seen) -> Iterator[str]:
    """Yield, a line each, how many episodes were aborted: a car can end its process just before it hits."""
    for what, logs, follows in (
        ("static tests", seen.tests, "their cells have no colour"),
        ("kamikazes", seen.kamikazes, "they count for nothing"),
    ):
        if lost := sum(log.outcome == Outcome.ABORTED for log in logs):
            yield f"{lost} of {len(logs)} {what} were aborted, and {follows}"


def clipped(seen: Seen) -> Iterator[str]:
    """Yield, in a line, how often the car asked for more than it can do."""
    logs = [log for log in (*seen.tests, *seen.kamikazes) if log.clipped]
    if logs:
        limits = [command_limits(log.episode.scenario) for log in logs]
        low, high = min(one[0] for one in limits), max(one[1] for one in limits)
        yield clipped_line([log.clipped for log in logs], low, high)


def _knows_stillness(car: CarUnderTest, seen: Seen) -> Iterator[str]:
    """Yield, in a line each, with how little noise the car does worse than in its tests, which have none."""
    if seen.failed:
        yield f"static tests could not be driven again with some of the car's noise: {seen.failed}"
    for share, (words, chance, begins) in SHARES.items():
        pairs = seen.shaken.get(share, [])
        judged = [pair for pair in pairs if all(log.outcome != Outcome.ABORTED for log in pair)]
        changes = [_impact(log) - _impact(test) for test, log in judged]
        worse, better = sum(change > _MORE for change in changes), sum(change < -_MORE for change in changes)
        many = worse - better >= max(_LEAST, _SHARE * len(changes))
        if many and binomtest(worse, worse + better, alternative="greater").pvalue < chance:
            yield (
                f"{begins}in {worse} of {len(changes)} static tests {car.controller} hits more than {_MORE:g} km/h "
                f"faster, and in {better} slower, if it moves with {words} of its noise, where a test has none: either "
                "it knows a test by this, or its colours take a car that has no noise"
            )


def _impact(log: EpisodeLog) -> float:
    return KMH * log.impact_speed if log.outcome == Outcome.COLLISION else 0.0
