"""What came of a regulator's static tests of the places that an assessment's φ stand for, without a colour."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from skd_adversary.safe_trajectories import REGULATORY
from skd_sim.options.car_under_test import is_own_world
from skd_sim.world.episode import EpisodeLog, Outcome

from skd_evaluator.assessment.judge.collision_partner import ADVERSARY, collision_partner, speed_ahead
from skd_evaluator.assessment.judge.rating import Rating
from skd_evaluator.assessment.plan.plan import EpisodeRunner
from skd_evaluator.assessment.run.static_test import static_episodes
from skd_evaluator.errors import AssessmentError, OutOfReachError


@dataclass(frozen=True, kw_only=True)
class Tested:
    """One static test: no noise, and a target that goes the protocol's way whatever the car does.

    Attributes:
        place: where on its front the unbraked car meets the target, % of its width.
        touched: whether the car touched anybody.
        target: whether that was the target.
        impact_speed: speed of the car when it did, m/s; 0 where it did not.
        speed_ahead: speed of the target the way that the car pointed then, m/s; 0 where it was not touched.
        fastest: greatest speed of the car, m/s.
        aborted: why the test was aborted; empty: it was not.

    Raises:
        ValueError: one entry contradicts another.
    """

    place: float
    touched: bool = False
    target: bool = False
    impact_speed: float = 0.0
    speed_ahead: float = 0.0
    fastest: float = 0.0
    aborted: str = ""

    def __post_init__(self) -> None:
        """Refuse what no test can have found."""
        strange = self.impact_speed < 0.0 or self.impact_speed > self.fastest or (self.touched and bool(self.aborted))
        if strange or (not self.touched and (self.target or self.impact_speed or self.speed_ahead)):
            raise ValueError(f"the static test at {self.place:g} % contradicts itself")

    @classmethod
    def of(cls, place: float, log: EpisodeLog) -> Tested:
        """Return what an episode of `static_episodes` says."""
        if log.outcome == Outcome.ABORTED:
            return cls(place=place, aborted=log.reason)
        touched = log.outcome == Outcome.COLLISION
        impact = log.impact_speed if touched else 0.0
        return cls(
            place=place,
            touched=touched,
            target=touched and collision_partner(log) == ADVERSARY,
            impact_speed=impact,
            speed_ahead=speed_ahead(log) if touched else 0.0,
            fastest=max(impact, float(log.car[:, 2].max())),
        )

    def as_dict(self) -> dict[str, Any]:
        """Return the entry in assessment.json."""
        return dataclasses.asdict(self)


def place_of(name: str) -> float | None:
    """Return the impact place (%) of a safe trajectory by its name; None where it stands for none."""
    kind, _, place = name.partition("/")
    try:
        return float(place) if kind == REGULATORY else None
    except ValueError:
        return None


def with_static_tests(rating: Rating, runner: EpisodeRunner) -> Rating:
    """Return the rating with the static test of each impact place that one of its φ stands for.

    There are some with the φ of a protocol, in SKD's own world, of a car that is no node of its own.

    Args:
        rating: the rating, whose episodes have been run.
        runner: runs the tests, whose episodes belong to none of its figures.
    """
    plan = rating.plan
    places = _places(rating)
    if not places or not is_own_world(plan.simulator) or plan.car.is_external:
        return rating
    assert plan.scenario.protocol is not None
    every = zip(plan.scenario.protocol.impact_places, static_episodes(plan.scenario, plan.car), strict=True)
    wanted = [(place, episode) for place, episode in every if place in places]
    try:
        logs = list(runner.run([episode for _, episode in wanted]))
    except OutOfReachError:
        raise
    except AssessmentError as error:  # a car that fails here alone has its figures all the same
        tests = tuple(Tested(place=place, aborted=str(error)) for place, _ in wanted)
    else:
        tests = tuple(Tested.of(place, log) for (place, _), log in zip(wanted, logs, strict=True))
    return dataclasses.replace(rating, static_tests=tuple(one.as_dict() for one in tests))


def _places(rating: Rating) -> Sequence[float]:
    if rating.plan.safe != REGULATORY or rating.plan.scenario.protocol is None:
        return ()
    return [place for one in rating.safe if (place := place_of(one.name)) is not None]
