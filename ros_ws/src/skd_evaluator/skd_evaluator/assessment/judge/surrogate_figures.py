"""Surrogate safety measures of the episodes of an assessment, and what they come to: median and worst, no rating.

What they say depends on who walks: along φ nobody aims at the car, and kamikazes want to be hit. So the two are never
put together.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, TextIO

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.episode import EpisodeLog, Outcome

from skd_evaluator.assessment.judge.collision_partner import ADVERSARY, collision_partner
from skd_evaluator.assessment.plan.plan import split_episode_id
from skd_evaluator.metrics.surrogate_measures import SURROGATE_MEASURES, surrogate_measures
from skd_evaluator.metrics.surrogate_scenes import course_of

SURROGATES = "surrogate_measures.csv"
ALONG_PHI, KAMIKAZES = "along_phi", "kamikazes"
DEPENDS_ON = {
    ALONG_PHI: "the car and φ: nobody aims at the car",
    KAMIKAZES: "the car, φ, and kamikazes that aim at being hit",
}


@dataclass(frozen=True, eq=False)
class Surrogates:
    """Surrogate safety measures of episodes.

    Attributes:
        logs: the episodes, aborted ones left out.
        objectives: objective of each; empty of a run along φ.
        values: of each measure by its name, one an episode; nan: not defined, or it never came about.
    """

    logs: tuple[EpisodeLog, ...]
    objectives: tuple[str, ...]
    values: dict[str, FloatArray]

    def as_dict(self) -> dict[str, Any]:
        """Return what they come to: the entry of assessment.json."""
        objectives = np.array(self.objectives, str)
        names = [name for name in dict.fromkeys(self.objectives) if name]
        return {
            ALONG_PHI: self._group(objectives == "", ALONG_PHI),
            KAMIKAZES: {name: self._group(objectives == name, KAMIKAZES) for name in names},
        }

    def write_csv(self, file: TextIO) -> None:
        """Write the content of surrogate_measures.csv, row by row: an episode each, blank where not defined."""
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(["objective", "episode_id", "phi", "trial", "outcome", *self.values])
        for log, objective, *values in zip(self.logs, self.objectives, *self.values.values(), strict=True):
            number = log.episode.episode_id
            _, phi, trial = split_episode_id(number)
            told = [f"{one:.9g}" if math.isfinite(one) else "" for one in values]
            rows.writerow([objective, number, phi, trial, log.outcome.name.lower(), *told])

    def _group(self, rows: Any, who: str) -> dict[str, Any]:
        found: dict[str, Any] = {"depends_on": DEPENDS_ON[who], "episodes": int(np.count_nonzero(rows))}
        for name, measure in SURROGATE_MEASURES.items():
            values = self.values[name][rows] if self.logs else np.empty(0)
            known = values[np.isfinite(values)]
            worst = known.min if measure.worst == "min" else known.max
            found[name] = {
                "median": float(np.median(known)) if known.size else None,
                "worst": float(worst()) if known.size else None,
                "defined": int(known.size),
            }
        return found


def surrogates_of(scenario: Scenario, episodes: Iterable[tuple[EpisodeLog, str]]) -> Surrogates:
    """Return the measures of episodes in a scenario, each with its objective; those of the adversary and the car.

    An episode that ended because the car touched one of the others counts as one in which it did not touch the
    adversary.
    """
    kept = [(log, objective) for log, objective in episodes if log.outcome != Outcome.ABORTED and len(log.car) > 1]
    logs: Sequence[EpisodeLog] = [log for log, _ in kept]
    courses = (
        course_of(
            scenario,
            log.adversary,
            log.car,
            (log.impact_time, log.impact_speed) if log.outcome == Outcome.COLLISION else None,
        )
        for log in logs
    )
    collided = np.array([collision_partner(log) == ADVERSARY for log in logs], bool)
    return Surrogates(tuple(logs), tuple(name for _, name in kept), surrogate_measures(scenario, courses, collided))
