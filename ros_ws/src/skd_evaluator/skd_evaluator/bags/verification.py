"""Whether the kamikazes of an assessment were planned as it says: the decisions of all of them, or of some, made again.

What is drawn are whole episodes: an adversary carries its belief from tick to tick, so any of its decisions takes all
that went before. Which ones are drawn is not known beforehand, or whoever forges a recording would leave them alone.
"""

from __future__ import annotations

import json
import math
import secrets
import shlex
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from skd_sim.choices.car_under_test import CarUnderTest
from skd_sim.choices.knowledge import Knowledge
from skd_sim.choices.objective import Objective
from skd_sim.choices.options import options_from_text
from skd_sim.encounter.scenario import scenario_from_dict
from skd_sim.episode.command_ages import Timing
from skd_sim.episode.episode import Episode, EpisodeLog, Mode, Outcome
from skd_sim.geometry.trajectory import Trajectory

from skd_evaluator.bags.validation import Otherwise, Unverified, decide_again
from skd_evaluator.campaign.judge.rating import Rating
from skd_evaluator.campaign.plan.plan import Progress
from skd_evaluator.campaign.run.executor_runner import ExecutorRunner
from skd_evaluator.campaign.store.result_file import ASSESSMENT, read_figures, understood
from skd_evaluator.campaign.store.stored_episodes import StoredEpisodes, read_episodes
from skd_evaluator.measure.doubt import DISBELIEF
from skd_evaluator.version import version

LABEL = "decisions made again"
_SEEDS = 2**31
_NAMED = 5  # contradictions that have a line of their own


@dataclass(frozen=True)
class Sample:
    """Which kamikazes are looked at.

    Attributes:
        share: of all, 0 to 1; at least one where it is not 0.
        seed: by which they are drawn.
    """

    share: float
    seed: int

    @classmethod
    def of(cls, share: float, seed: int | None) -> Sample:
        """Return a sample by a seed, or by one that nobody knows yet."""
        return cls(share, secrets.randbelow(_SEEDS) if seed is None else seed)

    def drawn(self, logs: Sequence[EpisodeLog]) -> list[EpisodeLog]:
        """Return those that are drawn, in their order."""
        count = math.ceil(self.share * len(logs))
        rows = np.sort(np.random.default_rng(self.seed).permutation(len(logs))[:count])
        return [logs[row] for row in rows.tolist()]


@dataclass(frozen=True)
class Verification:
    """What came of making decisions again.

    Attributes:
        sample: how they were drawn.
        kamikazes: that ran to their end, drawn or not.
        drawn: so many of them.
        verified: so many were planned as is said.
        unverified: reason → of how many nothing can be said.
        otherwise: those that were not planned as is said, and where that shows first.
    """

    sample: Sample
    kamikazes: int
    drawn: int
    verified: int
    unverified: Mapping[str, int]
    otherwise: tuple[tuple[EpisodeLog, Otherwise], ...]

    def as_dict(self) -> dict[str, Any]:
        """Return it as JSON has it."""
        return {
            "kamikazes": self.kamikazes,
            "drawn": self.drawn,
            "seed": self.sample.seed,
            "verified": self.verified,
            "not_verifiable": dict(self.unverified),
            "not_as_planned": [
                {"episode_id": log.episode.episode_id, "objective": str(log.episode.objective), **found._asdict()}
                for log, found in self.otherwise
            ],
        }

    @property
    def text(self) -> str:
        """The counts, in a line."""
        parts = [f"{self.verified} planned as is said"]
        parts += [f"{count} not verifiable ({reason})" for reason, count in self.unverified.items()]
        parts += [f"{len(self.otherwise)} not planned as is said"] if self.otherwise else []
        how = f", drawn by seed {self.sample.seed}" if self.drawn < self.kamikazes else ""
        return f"decisions of {self.drawn} of {self.kamikazes} kamikazes made again{how}: {', '.join(parts)}"

    @property
    def lines(self) -> list[str]:
        """What was found, a line for each of the first episodes."""
        found = [
            f"episode {log.episode.episode_id} (a kamikaze of objective {log.episode.objective}) was not planned as is "
            f"said: at tick {one.tick} it went {_pair(one.recorded)} m/s, and what it is said to have planned with, "
            f"{log.episode.simulations} simulations and all, gives {_pair(one.planned)} m/s"
            for log, one in self.otherwise[:_NAMED]
        ]
        rest = len(self.otherwise) - _NAMED
        return [*found, f"{rest} more kamikazes were not planned as is said"] if rest > 0 else found

    def told(self, rating: Rating) -> Rating:
        """Return a rating that tells of it; a kamikaze that was not planned as is said makes it fail."""
        lines = [*([self.text] if self.unverified else []), *(f"{DISBELIEF}{line}" for line in self.lines)]
        return replace(rating, verification=self.as_dict(), warnings=(*rating.warnings, *lines))


def _pair(velocity: tuple[float, float]) -> str:
    return f"({velocity[0]:.3f}, {velocity[1]:.3f})"


def verified(logs: Sequence[EpisodeLog], sample: Sample, runner: ExecutorRunner, progress: Progress) -> Verification:
    """Make the decisions of kamikazes again.

    Args:
        logs: of kamikazes that ran to their end.
        sample: which of them.
        runner: does the work; started.
        progress: told of it.
    """
    drawn = sample.drawn(logs)
    unverified: Counter[Unverified] = Counter()
    otherwise = []
    for count, (log, found) in enumerate(zip(drawn, runner.map(decide_again, drawn), strict=True), start=1):
        progress(LABEL, count, len(drawn))
        if isinstance(found, Unverified):
            unverified[found] += 1
        elif found is not None:
            otherwise.append((log, found))
    fine = len(drawn) - unverified.total() - len(otherwise)
    counts = {str(reason): count for reason, count in unverified.items()}
    return Verification(sample, len(logs), len(drawn), fine, counts, tuple(otherwise))


def stored_verification(folder: Path, sample: Sample, runner: ExecutorRunner, progress: Progress) -> Verification:
    """Make the decisions of the kamikazes of a result again, from what its folder says.

    Args:
        folder: with assessment.json and episodes.npz.
        sample: which kamikazes.
        runner: does the work; started.
        progress: told of it.

    Raises:
        UsageError: they cannot be read.
    """
    figures, _ = read_figures(folder)
    stored = read_episodes(folder)
    with understood(folder / ASSESSMENT):
        logs = _kamikazes(figures, stored)
        reason = _not_from_here(figures)
    if reason is None:
        return verified(logs, sample, runner, progress)
    count = len(sample.drawn(logs))
    return Verification(sample, len(logs), count, 0, {str(reason): count}, ())


def _not_from_here(figures: Mapping[str, Any]) -> Unverified | None:
    """Return why a result does not say what its kamikazes were planned with."""
    if figures["version"] != version():
        return Unverified.VERSION
    words = shlex.split((figures.get("provenance") or {}).get("command", ""))
    replayed = "replay" in words and any(word.startswith("--max-d") for word in words)
    return Unverified.DISTANCE if replayed else None


def _kamikazes(figures: Mapping[str, Any], stored: StoredEpisodes) -> list[EpisodeLog]:
    """Return the kamikazes of a result that ran to their end, with all that they were planned with."""
    scenario = scenario_from_dict(figures["scenario"], f"scenario in {ASSESSMENT}")
    options = {
        **options_from_text(json.dumps(figures["options"]), f"options in {ASSESSMENT}"),
        "controller": figures["controller"],
        "multiplier": CarUnderTest.multiplier if figures["multiplier"] is None else figures["multiplier"],
        "car_model": json.dumps(figures["car_model"]) if figures["car_model"] else "",
        "knowledge": Knowledge(figures["knowledge"]),
        "simulations": figures["simulations"],
        "maximum_distance": figures["maximum_distance"],
    }
    delay = (figures.get("command_age") or {}).get("greatest_delay", 0.0)
    rows = np.flatnonzero((stored.mode == Mode.KAMIKAZE) & (stored.outcome != Outcome.ABORTED)).tolist()
    safe = [Trajectory(positions, stored.time_step, "") for positions in stored.safe]
    return [
        EpisodeLog(
            Episode(
                scenario,
                Mode.KAMIKAZE,
                figures["seed"],
                int(stored.episode_id[row]),
                safe_trajectory=safe[int(stored.safe_index[row])],
                objective=Objective(stored.objective[row]),
                **options,
            ),
            Outcome(int(stored.outcome[row])),
            stored.adversary[row],
            stored.car[row],
            float(stored.impact_time[row]),
            float(stored.impact_speed[row]),
            timing=Timing(delay=delay),
        )
        for row in rows
    ]
