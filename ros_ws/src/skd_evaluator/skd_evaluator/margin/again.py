"""Whether the margin of a stored result is the car's: what SKD's own cars do on the ways of it is known.

A basic car's margin is computed anew, which takes some milliseconds an attempt. Of SKD's other cars the ways on which
they are said to be hit are walked again. A user's own car is not there, and nothing that a result names is imported.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from skd_adversary.model.road_users import road_user_named
from skd_sim.choices.car_under_test import CarUnderTest
from skd_sim.choices.simulators import WORLD, is_own_world
from skd_sim.encounter.scenario import scenario_from_dict
from skd_sim.episode.episode import Episode, EpisodeLog, Mode
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


def _led(episode: Episode, way: StoredWay) -> Iterator[LedAdversary]:
    """Yield who may have gone a way: one, or, where it was hit as it turned, one for each turn that it could take.

    What turns its body can be hit as a tick begins. Positions do not say then which way it turned.
    """
    velocities = np.diff(way.positions, axis=0) / episode.scenario.time_step
    share = way.duration - (len(velocities) - 1)  # of the last tick: the last position is that of the contact
    if 0.0 < share <= 1.0:
        velocities[-1:] /= share
        yield LedAdversary(velocities)
    elif share == 0.0 and episode.safe_trajectory is not None and len(velocities):
        user, phi = road_user_named(episode.scenario.adversary.kind), episode.safe_trajectory.positions
        how = (episode.scenario, phi, way.positions)
        for last in [*user.choices(*how)[-1], user.as_phi(*how)[-1]]:
            yield LedAdversary(np.vstack([velocities[:-1], last]))


def _walked(episode: Episode, way: StoredWay | None) -> Iterator[str]:
    if way is None:
        return
    logs = [run_episode(episode, adversary=one) for one in _led(episode, way)]
    wrongs = [_unlike(log, way) for log in logs] or [f"its hit is at {way.duration:.6g} ticks, and not in its last one"]
    if all(wrongs):
        yield wrongs[0]


def _unlike(log: EpisodeLog, way: StoredWay) -> str:
    """Return how an episode on a way differs from what is said of it; empty: not at all."""
    if not log.hit:
        return f"nobody is hit on its way, which ends as {log.outcome.name}"
    if abs(log.impact_time / log.episode.scenario.time_step - way.duration) > _SAME:
        return f"the hit on its way is at {log.impact_time:.6g} s"
    if abs(log.impact_speed - way.impact_speed) > _SAME:
        return f"the hit on its way is at {log.impact_speed:.6g} m/s, and not at {way.impact_speed:.6g} m/s"
    return ""


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
