"""For which cars it is known beforehand how they answer every sequence of actions: their margin is exact."""

from __future__ import annotations

from skd_adversary.model.road_user import pedestrian
from skd_adversary.model.road_users import road_user_named
from skd_sim.choices.car_dynamics import DYNAMICS
from skd_sim.choices.car_under_test import CarUnderTest
from skd_sim.encounter.scenario import Scenario
from skd_sim.episode.episode import Episode, Mode


def foretold(car: CarUnderTest, scenario: Scenario) -> bool:
    """Tell whether it is known what a car answers to every sequence of actions.

    That is the basic car, deciding once a tick, on a straight road and beside a pedestrian that is a disc, with no
    obstacles and others,
    that crosses to the right.
    """
    return not _why_not(car, scenario)


def _why_not(car: CarUnderTest, scenario: Scenario) -> str:
    """Return what is not known, in a few words; empty where all is."""
    if not car.is_known:
        return f"what controller {car.controller} answers to other actions is not known"
    if not DYNAMICS[scenario.car.dynamics].known:
        return f"the search knows the basic car, not car.dynamics {scenario.car.dynamics}"
    if not scenario.road.straight or scenario.adversary.is_box:
        return "the search knows straight roads and adversaries that are discs, no others"
    if road_user_named(scenario.adversary.kind) is not pedestrian.ROAD_USER:
        return f"the search knows what a pedestrian can do, not adversary.kind {scenario.adversary.kind}"
    if scenario.obstacles or scenario.others:
        return "the search knows nothing of obstacles and others"
    if scenario.end.crossing < 0.0 or scenario.ending is not None:
        return "the search knows adversaries that cross to the right, and end beyond the car's path"
    if scenario.control_periods != 1:
        return "the search knows a car that decides once a time step"
    return ""


def require_foretold(episode: Episode) -> None:
    """Refuse an episode of which it is not known what each sequence of actions would have led to.

    Raises:
        ValueError: it is not in kamikaze mode, or its car not foretold.
    """
    why = _why_not(episode.car, episode.scenario)
    if not why and (episode.mode != Mode.KAMIKAZE or episode.safe_trajectory is None):
        why = f"only of a kamikaze episode it is asked who could have been hit, not in mode {episode.mode.name}"
    if why:
        raise ValueError(why)
