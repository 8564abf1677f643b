"""The safety margin of each conflict for a car under test, and the worst conflicts as scenarios of a campaign."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import yaml
from skd_sim.controllers.isolated import isolated
from skd_sim.options.car_and_adversary import AdversaryModel, CarUnderTest, ControllerName
from skd_sim.world.episode import EpisodeSpec, Mode

from skd_evaluator.assessment.context import Progress
from skd_evaluator.assessment.run.workers import Workers
from skd_evaluator.assessment.stages.margin import LABEL, exact_or_found
from skd_evaluator.extensions.log.conflicts import Conflict
from skd_evaluator.margin.actions import has_exact_margin
from skd_evaluator.margin.search.rounds import one_by_one
from skd_evaluator.margin.search.search import IN_PROCESS, search_margins
from skd_evaluator.metrics.deviation import Hit
from skd_evaluator.report.repeat import SCENARIO_FILE, TRAJECTORY_FILE, write_trial

CAMPAIGN = "campaign.yaml"


def with_margins(
    conflicts: Sequence[Conflict], car: CarUnderTest, limit: int, runner: Workers, progress: Progress
) -> list[Conflict]:
    """Return conflicts with the margin of a car in each that can be driven again.

    Args:
        conflicts: found in recordings.
        car: the car under test, in process.
        limit: candidates that the search for a margin may drive.
        runner: drives them, in several processes.
        progress: called with how far the work is.

    Raises:
        AssessmentError: the car fails.
    """
    found = list(conflicts)
    of_car: dict[str, Any] = {"controller": car.controller, "multiplier": car.multiplier}
    of_car["adversary_model"] = AdversaryModel.GENERIC  # nothing is planned
    trials = [
        EpisodeSpec(one.scenario, Mode.KAMIKAZE, 0, row, one.safe, **of_car)
        for row, one in enumerate(found)
        if one.scenario is not None
    ]
    hits = runner.map(partial(_isolated, limit), trials)
    for count, (trial, hit) in enumerate(zip(trials, hits, strict=True), start=1):
        margin = trial.scenario.eta_max if hit is None else min(hit.distance, trial.scenario.eta_max)
        row, exact = trial.episode_id, has_exact_margin(car, trial.scenario)
        speed = None if hit is None else hit.impact_speed
        found[row] = replace(found[row], margin=margin, exact=exact, impact_speed=speed)
        progress(LABEL, count, len(trials))
    return found


def least_deviation(limit: int, trial: EpisodeSpec) -> Hit | None:
    """Return the hit of least deviation in a trial, for which so many candidates may be driven; None: none was found.

    It is exact where the car is known, else the best that was found.
    """
    if has_exact_margin(trial.car, trial.scenario):
        return exact_or_found(trial)
    return search_margins([trial], {}, one_by_one, IN_PROCESS._replace(limit=limit)).hits[0]


def _isolated(limit: int, trial: EpisodeSpec) -> Hit | None:
    return isolated(trial.car.user_code, partial(least_deviation, limit), trial)


def export(folder: Path, conflicts: Sequence[Conflict], controller: str | None, multiplier: float) -> None:
    """Write each conflict that can be driven again as a scenario with its φ, and a campaign of all.

    Args:
        folder: into which; it is there.
        conflicts: the worst first.
        controller: of the car under test; None: basic.
        multiplier: its C, if it is basic.
    """
    cells: list[dict[str, Any]] = []
    for number, one in enumerate(conflicts, start=1):
        assert one.scenario is not None
        assert one.safe is not None
        inside = folder / f"conflict_{number:03}"
        inside.mkdir()
        write_trial(inside, one.scenario, one.safe)
        files = {"scenario": f"{inside.name}/{SCENARIO_FILE}", "safe": f"{inside.name}/{TRAJECTORY_FILE}"}
        cells.append({"name": inside.name, **files})
    name = str(ControllerName(controller or "basic"))
    car = {"controller": name, **({"multiplier": multiplier} if name == "basic" else {})}
    few = {"safe_count": 1, "kamikaze_count": 1, "collision_runs": 1}
    campaign = {"defaults": few, "cars": [car], "scenarios": cells}
    (folder / CAMPAIGN).write_text(yaml.safe_dump(campaign, sort_keys=False), encoding="utf-8")
