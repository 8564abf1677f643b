"""What is said of a scenario: in lines, and as plain data."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from skd_adversary.crossing.road_users import road_user_named
from skd_adversary.safe_trajectories import REGULATORY, count_safe_trajectories
from skd_sim.scenario.scenario import Scenario

from skd_evaluator.assessment.plan.options import OWN, SYNTHETIC, WALKERS

_KMH = 3.6


def sources_of(scenario: Scenario) -> list[str]:
    """Return where a scenario's safe trajectories can come from, beside files."""
    walkers = [WALKERS] if scenario.adversary.kind == "pedestrian" else []
    return [SYNTHETIC, OWN, *walkers, *([REGULATORY] if scenario.protocol is not None else [])]


def places_of(scenario: Scenario) -> list[float]:
    """Return the impact places of its protocol, % of the car's width; none where it has no protocol."""
    return [] if scenario.protocol is None else list(scenario.protocol.impact_places)


def scenario_data(scenario: Scenario, known: str | None) -> dict[str, Any]:
    """Return what is said of a scenario as plain data.

    Args:
        scenario: the scenario.
        known: why the basic car's margin is not exact in it, in a few words; None where it is.
    """
    return {
        "name": scenario.name,
        "description": scenario.description,
        "adversary": scenario.adversary.kind,
        "car_speed": scenario.car.start_speed,
        "impact_places": places_of(scenario),
        "safe": sources_of(scenario),
        "basic_margin": "exact" if known is None else f"searched; it is not exact {known}",
        "source": "" if scenario.protocol is None else scenario.protocol.source,
    }


def scenario_lines(scenario: Scenario, known: str | None) -> list[str]:
    """Return what is said of a scenario, line by line; arguments as of `scenario_data`."""
    return [f"{scenario.name}: {scenario.description}", *(f"  {line}" for line in _lines(scenario, known))]


def _lines(scenario: Scenario, known: str | None) -> Iterator[str]:
    car, adversary, protocol = scenario.car, scenario.adversary, scenario.protocol
    user = road_user_named(adversary.kind)
    body = f"{adversary.length:g} × {adversary.width:g} m" if adversary.is_box else f"a disc of {adversary.radius:g} m"
    yield (
        f"car: {_KMH * car.start_speed:.0f} km/h, its front {car.start_gap:.1f} to "
        f"{car.start_gap + car.start_gap_range:.1f} m before the crossing line"
    )
    yield f"adversary: {user.name}, {body}, at most {_KMH * adversary.speed:.0f} km/h"
    if scenario.obstacles or scenario.others:
        yield f"beside it: {len(scenario.obstacles)} parked, {len(scenario.others)} others"
    if protocol is not None:
        yield f"target of its protocol: {_KMH * protocol.speed:.0f} km/h, at {_listed(protocol.impact_places)} %"
        yield f"source: {protocol.source}"
    yield f"safe trajectories: {', '.join(sources_of(scenario))}, or files{_count(scenario)}"
    yield f"margin of the basic car: {'exact' if known is None else f'found by search; it is not exact {known}'}"


def _count(scenario: Scenario) -> str:
    return "" if scenario.protocol is None else f" ({count_safe_trajectories(REGULATORY, scenario)} regulatory ones)"


def _listed(places: Sequence[float]) -> str:
    return ", ".join(f"{place:g}" for place in places)
