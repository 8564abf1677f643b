"""What a simulator says of each φ: an assessment's runs along φ and margins, or a table of another simulator's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.errors import UsageError
from skd_sim.scenario.scenario import Scenario, scenario_from_dict
from skd_sim.world.episode import Mode, Outcome

from skd_evaluator.assessment.files.assessment_json import ASSESSMENT
from skd_evaluator.assessment.files.episodes_npz import StoredEpisodes
from skd_evaluator.assessment.files.results import read_both
from skd_evaluator.extensions.fusion.trial import PhysicalTrial, figures_of, gap_to_crossing
from skd_evaluator.metrics.margins import open_search
from skd_evaluator.metrics.surrogate.scenes import course_of, scene_of


@dataclass(frozen=True, eq=False)
class Simulated:
    """Simulated trials.

    Attributes:
        source: where they are from.
        trials: by φ, in the order of these.
        scenario: road, shapes and speeds; None of a table, which does not say.
        safe: positions of each φ at ticks, m; empty of a table.
        remarks: what is to be said of them, a line each.
        figures: of the assessment, as they were read with the trials; empty of a table.
    """

    source: str
    trials: Mapping[str, Sequence[PhysicalTrial]]
    scenario: Scenario | None = None
    safe: Mapping[str, FloatArray] | None = None
    remarks: tuple[str, ...] = ()
    figures: Mapping[str, Any] = field(default_factory=dict)


def by_phi(trials: Sequence[PhysicalTrial]) -> dict[str, list[PhysicalTrial]]:
    """Return trials by the name of their φ, both in their order."""
    found: dict[str, list[PhysicalTrial]] = {}
    for one in trials:
        found.setdefault(one.phi, []).append(one)
    return found


def read_simulated(folder: Path) -> Simulated:
    """Read the runs along φ of an assessment, and the margins of its trials.

    Raises:
        UsageError: it is none, is damaged, has no run along φ, or two φ of one name.
    """
    result, stored = read_both(folder)
    scenario = scenario_from_dict(result.figures["scenario"], f"scenario in {folder / ASSESSMENT}")
    if "safe_name" not in stored.further:
        raise UsageError(f"{folder}: its φ have no names, so physical trials cannot be paired with them; assess anew")
    names = [str(name) for name in stored.further["safe_name"]]
    if len(set(names)) < len(names):
        raise UsageError(f"{folder}: two of its φ have one name, so physical trials cannot be paired with them")
    trials = [trial for index, name in enumerate(names) for trial in _runs(stored, scenario, index, name)]
    if not trials:
        raise UsageError(f"{folder}: has no run along φ; assess with --collision-runs")
    for name, margins in zip(names, result.groups.get("margin", ()), strict=False):
        trials += [PhysicalTrial(name, {"margin": float(margin)}, None, str(folder)) for margin in margins]
    found = by_phi(trials)
    ordered = {name: found[name] for name in names if name in found}
    safe = dict(zip(names, stored.safe, strict=True))
    remarks = (*result.remarks, *(f"{folder}: {line}" for line in open_search(result.figures)))
    return Simulated(str(folder), ordered, scenario, safe, remarks, result.figures)


def _runs(stored: StoredEpisodes, scenario: Scenario, index: int, name: str) -> list[PhysicalTrial]:
    ran = (stored.mode == Mode.REPLAY) & (stored.outcome != Outcome.ABORTED) & (stored.safe_index == index)
    found = []
    for number in np.flatnonzero(ran).tolist():
        course = course_of(scenario, stored.adversary[number], stored.car[number], stored.contact(number))
        values = figures_of(scene_of(scenario, *course), hit=bool(stored.hit[number]))
        if stored.collided[number]:
            values["clearance"] = 0.0
        found.append(PhysicalTrial(name, values, gap_to_crossing(scenario, course.car[0]), stored_name(number, stored)))
    return found


def stored_name(number: int, stored: StoredEpisodes) -> str:
    """Return which episode it is, for messages."""
    return f"episode {int(stored.episode_id[number])}"
