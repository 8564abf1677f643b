"""Whether the margin of a stored result is the car's: what SKD's own cars do on the ways of it is known.

A basic car's margin is computed anew, which takes some milliseconds an attempt. Of SKD's other cars the ways on which
they are said to be hit are walked again. A user's own car is not there, and nothing that a result names is imported.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from skd_sim.choices.car_under_test import CarUnderTest
from skd_sim.choices.simulators import WORLD, is_own_world
from skd_sim.encounter.scenario import scenario_from_dict
from skd_sim.episode.episode import Episode, Mode
from skd_sim.errors import UsageError
from skd_sim.geometry.trajectory import Trajectory

from skd_evaluator.campaign.plan.plan import Stage, episode_id
from skd_evaluator.campaign.run.led import LedAdversary
from skd_evaluator.campaign.run.runner import run_episode
from skd_evaluator.campaign.store.result_file import ASSESSMENT
from skd_evaluator.campaign.store.stored_episodes import StoredEpisodes, StoredWay
from skd_evaluator.margin.exact.exact import exact_margin
from skd_evaluator.margin.ways.foretold import foretold

_SAME = 1e-6
"""m, m/s, ticks: far more than another processor rounds otherwise, and less than any figure shows."""


class Again(NamedTuple):
    """What came of the margins of a result when they were made again.

    Attributes:
        problems: margins that are not the car's, a line each.
        remark: what was done, and how often; empty: nothing, for the car is not there.
    """

    problems: tuple[str, ...] = ()
    remark: str = ""


def margins_again(folder: Path, figures: Mapping[str, Any], stored: StoredEpisodes) -> Again:
    """Return what the margins of a result are by SKD's own cars.

    Args:
        folder: of the result.
        figures: content of its assessment.json, under the keys of today.
        stored: its episodes.

    Raises:
        UsageError: its scenario is none.
    """
    car = CarUnderTest(figures["controller"], 1.0 if figures["multiplier"] is None else float(figures["multiplier"]))
    simulator = str((figures.get("options") or {}).get("simulator", WORLD))
    if stored.margins is None or figures.get("margin_how") or not (car.is_own and is_own_world(simulator)):
        return Again()
    scenario = scenario_from_dict(figures["scenario"], f"scenario in {ASSESSMENT}")
    exact = figures["margin_budget"] is None
    if exact and not foretold(car, scenario):
        return Again(
            (f"{folder}: margin_budget is null, as of margins that are computed, and this car's are searched",)
        )
    problems, count = [], 0
    for index, (margins, ways) in enumerate(zip(stored.margins, stored.margin_ways, strict=True)):
        known = {way.attempt: way for way in ways}
        for attempt, margin in enumerate(margins.tolist()):
            episode = Episode(
                scenario,
                Mode.KAMIKAZE,
                int(figures["seed"]),
                episode_id(Stage.KAMIKAZE, index, attempt),
                controller=car.controller,
                multiplier=car.multiplier,
                safe_trajectory=Trajectory(stored.safe[index], stored.time_step, ""),
            )
            found = [*_walked(episode, known.get(attempt)), *(_computed(episode, margin) if exact else ())]
            problems += [f"{folder}: margin of attempt {attempt} of safe trajectory {index}: {one}" for one in found]
            count += 1
    done = "computed anew" if exact else "looked at by walking their ways again"
    return Again(tuple(problems), f"{count} margins were {done}" if count else "")


def _led(way: StoredWay, time_step: float) -> LedAdversary:
    velocities = np.diff(way.positions, axis=0) / time_step
    velocities[-1:] /= way.duration - (len(velocities) - 1)  # the last position is that of the contact
    return LedAdversary(velocities)


def _walked(episode: Episode, way: StoredWay | None) -> Iterator[str]:
    if way is None:
        return
    log = run_episode(episode, adversary=_led(way, episode.scenario.time_step))
    if not log.hit:
        yield f"nobody is hit on its way, which ends as {log.outcome.name}"
    elif abs(log.impact_time / episode.scenario.time_step - way.duration) > _SAME:
        yield f"the hit on its way is at {log.impact_time:.6g} s"
    elif abs(log.impact_speed - way.impact_speed) > _SAME:
        yield f"the hit on its way is at {log.impact_speed:.6g} m/s, and not at {way.impact_speed:.6g} m/s"


def _computed(episode: Episode, margin: float) -> Iterator[str]:
    try:
        least = exact_margin(episode)
    except UsageError:  # more memory than is allowed: then one was searched for
        return
    found, gap = (np.inf, 0.0) if least is None else (least.distance, least.gap)
    if not (margin == found or abs(margin - found) <= gap + _SAME):
        yield f"it is {_shown(margin)}, this car gives {_shown(found)}"


def _shown(margin: float) -> str:
    return f"{margin:.6g} m" if np.isfinite(margin) else "beyond η_max"
