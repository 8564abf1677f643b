"""Whether a revision of a car is worse than a good one: a paired sequential test on the same trials.

The test bets on the differences of paired deviations (Waudby-Smith and Ramdas, JRSS-B 86:1, 2024). Under the hypothesis
that the mean difference is at most 0, each counted as at most `SCALE`, the bettor's capital is a non-negative
supermartingale that begins at 1: it ever reaches 1/α with a probability of at most α (Ville). So the test may look
after each trial and stops as soon as it knows. Each trial has a φ of its own, and both cars are searched alike: each
with the same effort, and on the trajectory that was found for the other.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from skd_sim.errors import AssessmentError, UsageError
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Outcome
from skd_sim.world.state import FloatArray, Trajectory

from skd_evaluator.assessment.context import Progress, silent
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.workers import Workers
from skd_evaluator.files import write_file
from skd_evaluator.margin.common_trajectories import DistinguishingTrial, TestedCar, smallest_trial
from skd_evaluator.margin.search.rounds import in_processes
from skd_evaluator.margin.search.search import Effort, OtherHit, search_margins
from skd_evaluator.margin.search.trial import prescribed
from skd_evaluator.metrics.deviation import hit_of

GOOD, BAD, SKIP = "good", "bad", "skip"
"""Verdicts, as `git bisect` calls them."""
ERROR: Final = 0.05
"""Probability of any wrong verdict of a bisection, at most."""
SCALE: Final = 0.25
"""m: a greater difference counts as this."""
EFFORT: Final = Effort(first=32, limit=64, deepens=False)
_SHARES: Final = np.linspace(0.1, 0.9, 9)  # of the capital that are bet; each has a ninth of it at the beginning
_TRIALS: Final = 8  # that are searched at once
_PHIS: Final = 3  # among whose trials the smallest that distinguishes two versions is looked for


def e_values(differences: FloatArray) -> FloatArray:
    """Return the capital of a bettor after each of some paired differences, m, n, who begins with 1.

    It grows where they are positive. See the module for what it says.
    """
    counted = np.clip(differences / SCALE, -1.0, 1.0)[:, None]
    capital: FloatArray = np.exp(np.cumsum(np.log1p(_SHARES * counted), axis=0)).mean(axis=1)
    return capital


def level_of(revisions: int) -> float:
    """Return the capital at which a test knows, where as many verdicts as bisecting so many revisions takes are right.

    All of them together are wrong with a probability of at most `ERROR` (Bonferroni).
    """
    return (2 + math.ceil(math.log2(max(1, revisions)))) / ERROR


class Judgement(NamedTuple):
    """What was found of a revision.

    Attributes:
        word: `good`, `bad`, or `skip` where it cannot be judged.
        why: the reason, in a few words.
    """

    word: str
    why: str


@dataclass(frozen=True)
class Version:
    """A version of a car, and the trials that it is judged by.

    Attributes:
        name: of the version, in messages.
        key: digest of its files.
        plan: has the car.
        safe: φ of each trial, the same for all versions.
    """

    name: str
    key: str
    plan: Plan
    safe: Sequence[Trajectory]

    @cached_property
    def trials(self) -> list[EpisodeSpec]:
        """One trial on each φ, in kamikaze mode."""
        return self.plan.trials(self.safe, 1)


class PairedTest:
    """Compares versions of a car with a good and a bad one.

    Attributes:
        level: capital at which the test knows.
        known: what was found before, as plain data: of each version by its key the trajectories on which it hits;
            verdicts by key, or by digest of how a version drove; and how many trials tell the good one from the bad.
    """

    def __init__(self, good: Version, bad: Version, runner: Workers, level: float, progress: Progress = silent) -> None:
        """Begin without knowing anything.

        Args:
            good: the good version.
            bad: the bad one, of the same trials.
            runner: has been started.
            level: see `level_of`.
            progress: called with how far the work is.
        """
        self._ends, self._runner, self.level, self._progress = (good, bad), runner, level, progress
        self.known: dict[str, Any] = {"hits": {}, "verdicts": {}, "trials": 0}

    def read(self, file: Path) -> None:
        """Go on with what `write` has kept, if anything."""
        if file.is_file():
            self.known = json.loads(file.read_text(encoding="utf-8"))

    def write(self, file: Path) -> None:
        """Keep what was found."""
        write_file(file, json.dumps(self.known))

    def differences(self) -> FloatArray:
        """Return by how much less the bad version needs than the good one in each trial, m.

        Raises:
            AssessmentError: one of them fails.
        """
        return np.concatenate([self._difference(*self._ends, part) for part in self._parts()])

    def check_ends(self) -> None:
        """See to it that the bad version is worse than the good one.

        Raises:
            UsageError: that cannot be shown.
            AssessmentError: one of them fails.
        """
        if self.known["trials"]:
            return
        good, bad = self._ends
        used, differences = 0, np.empty(0)
        for part in self._parts():
            differences = np.append(differences, self._difference(good, bad, part))
            used = part.stop
            if e_values(differences).max() >= self.level:
                break
        else:
            raise UsageError(
                f"{bad.name} is not shown to be worse than {good.name} in {used} trials (e-value "
                f"{e_values(differences).max():.3g}, {self.level:.3g} is needed): their margins differ by "
                f"{differences.mean():.3f} m; a smaller difference takes more --safe-count"
            )
        self.known["trials"] = used
        for version, word in zip(self._ends, (GOOD, BAD), strict=True):
            self.known["verdicts"] |= {version.key: word, self._driven(version): word}

    def verdict(self, key: str, make: Callable[[], Version]) -> Judgement:
        """Return whether a version is worse than the good one.

        One that drives as an earlier one to the bit, along φ and wherever the good or the bad one hits, has its
        verdict. One that fails is skipped.

        Args:
            key: digest of its files.
            make: returns it.
        """
        verdicts = self.known["verdicts"]
        if word := verdicts.get(key):
            return Judgement(word, "has the same files as a revision that is judged")
        try:
            version = make()
            driven = self._driven(version)
            word, why = verdicts.get(driven), "drives exactly like a revision that is judged"
            found = Judgement(word, why) if word else self._tested(version)
        except (UsageError, AssessmentError) as error:
            return Judgement(SKIP, str(error))
        verdicts |= {key: found.word, driven: found.word}
        return found

    def distinguishing_trial(self, worse: Version, before: Version) -> DistinguishingTrial | None:
        """Return the smallest trial that is found in which one version hits and another one does not.

        It is looked for where the trials need least deviation to hit.

        Raises:
            AssessmentError: a version fails.
        """
        part = slice(0, self.known["trials"])
        least = sorted(zip(self._deviations(worse, before, part), range(part.stop), strict=True))[:_PHIS]
        safe = [worse.safe[number].positions for _, number in least]
        hits = [
            OtherHit(phi.positions, hit)
            for version in (worse, before, *self._ends)
            for phi, hit in zip(worse.safe[part], self._hits(version, part), strict=True)
            if hit is not None
        ]
        car, other = (TestedCar(one.plan.car, one.plan.scenario, one.plan.seed, safe, hits) for one in (worse, before))
        return smallest_trial(car, other, self._runner, self._progress)

    def _tested(self, version: Version) -> Judgement:
        good, bad = self._ends
        worse, better = np.empty(0), np.empty(0)
        for part in self._parts():
            worse = np.append(worse, self._difference(good, version, part))
            better = np.append(better, self._difference(version, bad, part))
            first = [_first(e_values(one) >= self.level) for one in (worse, better)]
            if min(first) < part.stop:
                after = f"after {min(first) + 1} trials"
                if first[0] <= first[1]:
                    return Judgement(BAD, f"worse than the good one, {after}")
                return Judgement(GOOD, f"better than the bad one, {after}")
        return Judgement(SKIP, f"neither worse than the good one nor better than the bad one in {len(worse)} trials")

    def _parts(self) -> Iterator[slice]:
        count = len(self._ends[0].trials)
        yield from (slice(begin, min(begin + _TRIALS, count)) for begin in range(0, count, _TRIALS))

    def _hits(self, version: Version, part: slice) -> list[FloatArray | None]:
        """Return the trajectories of least deviation on which a version hits in some trials, n × 2, m, or None."""
        kept = self.known["hits"].setdefault(version.key, [])
        while len(kept) < part.stop:
            trials = version.trials[len(kept) : len(kept) + _TRIALS]
            found = search_margins(trials, {}, in_processes(self._runner, self._progress), EFFORT)
            followed = [None if one is None else one.safe_trajectory for one in found.episodes]
            kept += [None if one is None else one.positions.tolist() for one in followed]
        return [None if one is None else np.array(one) for one in kept[part]]

    def _logs(self, version: Version, places: Iterable[tuple[int, FloatArray | None]]) -> Iterator[EpisodeLog | None]:
        """Yield what happens to a version where the road user follows positions in a trial; None without positions."""
        pairs = list(places)
        trials = [prescribed(version.trials[at], one) for at, one in pairs if one is not None]
        logs = self._runner.run(trials)
        for _, positions in pairs:
            log = None if positions is None else next(logs)
            if log is not None and log.outcome == Outcome.ABORTED:
                raise AssessmentError(log.reason)
            yield log

    def _difference(self, first: Version, second: Version, part: slice) -> FloatArray:
        """Return by how much less the second version needs than the first, m, in some trials."""
        difference: FloatArray = self._deviations(first, second, part) - self._deviations(second, first, part)
        return difference

    def _deviations(self, version: Version, other: Version, part: slice) -> FloatArray:
        """Return the deviation of least with which a version hits in some trials, as found for it or another, m."""
        found = np.full(part.stop - part.start, version.plan.scenario.eta_max)
        for whose in (version, other):
            numbers = range(part.start, part.stop)
            for place, log in enumerate(self._logs(version, zip(numbers, self._hits(whose, part), strict=True))):
                if log is not None and log.hit:
                    phi = version.safe[part.start + place].positions
                    found[place] = min(found[place], hit_of(phi, log).distance)
                elif log is not None and whose is version:
                    raise AssessmentError(f"{version.name} does not repeat itself: a hit did not come again")
        return found

    def _driven(self, version: Version) -> str:
        """Return a digest of how a version drives along φ, and where the good or the bad one hits."""
        part = slice(0, self.known["trials"])
        followed: list[Sequence[FloatArray | None]] = [[one.positions for one in version.safe[part]]]
        followed += [self._hits(one, part) for one in self._ends]
        digest = hashlib.sha256()
        for log in self._logs(version, (pair for some in followed for pair in enumerate(some))):
            digest.update(b"" if log is None else log.car.tobytes() + bytes([log.hit]))
        return digest.hexdigest()


def _first(known: Any) -> float:
    """Return the place of the first that is true; infinity: none is."""
    return int(np.argmax(known)) if known.any() else math.inf
