"""Which recorded episodes count, which are missing, and the account of what was left out."""

from __future__ import annotations

import contextlib
import itertools
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence, Set, Sized
from dataclasses import dataclass
from pathlib import Path

from skd_sim.errors import UsageError
from skd_sim.inputs.files import read_json
from skd_sim.world.episode import EpisodeLog, Outcome, counts_in_words

from skd_evaluator.assessment.plan import TRIALS_PER_REQUESTED, EpisodeGroup, split_episode_id
from skd_evaluator.assessment.plausibility import Verdict, examine
from skd_evaluator.metrics.aborted import not_credible

OPTION = "--skip-damaged"


class Damage:
    """Keeps the account of what was left out of recordings, and of what a reader of the result should know.

    Attributes:
        left_out: what was left out and why, a line each.
        warnings: what counts, but with a warning, a line each.
        unchecked: files that have no checksums.
    """

    def __init__(self, *, skip: bool = False) -> None:
        """Begin with nothing.

        Args:
            skip: leave damaged parts out instead of refusing them.
        """
        self.skip = skip
        self.left_out: list[str] = []
        self.warnings: list[str] = []
        self.unchecked: list[Path] = []

    @property
    def lines(self) -> list[str]:
        """All that is to be said of it."""
        return [*self.warnings, *self.left_out]

    def leave_out(self, what: str) -> None:
        """Leave something out.

        Raises:
            UsageError: nothing is to be left out.
        """
        if not self.skip:
            raise UsageError(f"{what}; {OPTION} leaves it out")
        if what not in self.left_out:
            self.left_out.append(what)

    def warn(self, what: str) -> None:
        """Take note of a warning about something that counts."""
        if what not in self.warnings:
            self.warnings.append(what)


@dataclass(frozen=True)
class LocatedLog:
    """A log and where it was found.

    Attributes:
        log: what happened in one episode.
        where: file or other origin, for messages.
        campaign: name of the campaign to which the episode belongs.
        start: simulation time at which it began, ns, where the recording has one.
    """

    log: EpisodeLog
    where: str
    campaign: str
    start: int = 0

    @property
    def text(self) -> str:
        """File and episode, for messages."""
        return f"{self.where}: episode {self.log.episode.episode_id}"


def accept(found: Sequence[LocatedLog], damage: Damage) -> list[LocatedLog]:
    """Return which logs count.

    Left out is what cannot have happened, and what SKD's own world would not have given in a campaign of which it gave
    other episodes. Where it gave none, the recording is of another simulator: it counts, checked within that
    simulator's freedom only, and a warning says so.

    Args:
        found: logs of any number of campaigns, each episode once.
        damage: takes note of what is left out, and what is to be said.

    Raises:
        UsageError: something would have to be left out, and `damage` does not allow it.
    """
    verdicts = [examine(one.log) for one in found]
    ours = {one.campaign for one, verdict in zip(found, verdicts, strict=True) if verdict.ours and len(one.log.car) > 1}
    kept: list[LocatedLog] = []
    foreign: dict[str, list[tuple[LocatedLog, Verdict]]] = {}
    for one, verdict in zip(found, verdicts, strict=True):
        if verdict.fault:
            damage.leave_out(f"{one.text}: {verdict.fault}")
        elif not verdict.ours and one.campaign in ours:
            off = f"{verdict.where} does not follow from its other states (by {verdict.deviation:.3g})"
            damage.leave_out(f"{one.text}: {off}, though this campaign ran in SKD's own world")
        else:
            kept.append(one)
            if not verdict.ours:
                foreign.setdefault(one.campaign, []).append((one, verdict))
    for pairs in foreign.values():
        one, verdict = max(pairs, key=lambda pair: pair[1].deviation)
        off = f"{verdict.where} is off by {verdict.deviation:.3g}, {one.text}"
        own = f"{_episodes(pairs)} did not run in SKD's own world ({off})"
        damage.warn(f"{own}: another simulator's impacts are checked roughly")
    return kept


SUMMARIES = ("probe.json", "assessment.json")
"""Files that say of which car the episodes beside them are."""


def unfinished_episodes(ids: Iterable[int]) -> list[str]:
    """Return one line about episodes that were announced and never ended; nothing if there are none."""
    numbers = sorted(ids)
    first = ", ".join(map(str, numbers[:5])) + (", …" if len(numbers) > 5 else "")
    said = f"{_episodes(numbers)} left out, no result was recorded ({first}): did recording end before the episode?"
    return [said] if numbers else []


def missing_episodes(
    announced: Iterable[int], reached: Mapping[int, int], *, requested: int, left_out: bool, which: str = ""
) -> list[str]:
    """Return which episodes the campaign must have had beside those that are recorded, a line each.

    Trials are numbered from 0 without gaps, and every φ is tried until as many have collided as for the others or a
    cap is reached (`skd_evaluator.assessment.plan`). If the last trials of every φ are missing alike, that cannot
    be seen.

    Args:
        announced: ids of the episodes that the recordings mention, however they ended; kamikazes of one objective only.
        reached: how many kamikazes reached what they planned for, by number of φ.
        requested: how many were requested on each φ; it is the same for every objective.
        left_out: whether episodes are left out, so that sets are not what they were.
        which: which kamikazes these are, for the lines.
    """
    kamikazes, nominal = defaultdict[int, set[int]](set), defaultdict[int, set[int]](set)
    of_group = {EpisodeGroup.KAMIKAZE: kamikazes, EpisodeGroup.NOMINAL: nominal}
    for number in announced:
        group, index, trial = split_episode_id(number)
        if group in of_group:
            of_group[group][index].add(trial)
    known = {*kamikazes, *nominal}
    absent = _gaps(known)
    lines = [f"no recording has an episode of safe trajectory {absent}"] if absent else []
    for name, found in ((f"kamikaze trials{which}", kamikazes), ("runs along φ", nominal)):
        gaps = ((index, _gaps(found[index])) for index in sorted(found))
        lines += [f"no recording has {name} {some} of safe trajectory {index}" for index, some in gaps if some]
    for index, count in sorted(reached.items()):
        tried = len(kamikazes[index])
        if not left_out and count < requested and tried < TRIALS_PER_REQUESTED * requested:
            what = f"the last kamikaze trials{which} of safe trajectory {index} were not recorded"
            lines.append(f"{what}: {count} collided in {tried}, of another {requested}")
    runs = [len(nominal[index]) for index in sorted(known)]
    if runs and not absent and (max(runs) - min(runs) > 1 or runs != sorted(runs, reverse=True)):  # dealt out in turns
        lines.append(f"the last runs along φ were not recorded: of one {min(runs)}, of another {max(runs)}")
    return lines


def aborted_episodes(logs: Iterable[EpisodeLog]) -> list[str]:
    """Return what has to be said about episodes that do not count because they were aborted."""
    reasons = [log.reason for log in logs if log.outcome == Outcome.ABORTED]
    verb = "counts" if len(reasons) == 1 else "count"
    return [f"{_episodes(reasons)} {verb} for nothing, aborted ({counts_in_words(reasons)})"] if reasons else []


def _episodes(found: Sized) -> str:
    return "1 episode" if len(found) == 1 else f"{len(found)} episodes"


def not_credible_beside(files: Iterable[Path]) -> list[str]:
    """Return why assessments and probes beside recordings say that they are not credible, a line each."""
    found: list[str] = []
    bags = {file.absolute().parent.parent for file in files}
    for folder in sorted(one.parent for one in bags if one.name == "bags"):
        for name in SUMMARIES:
            with contextlib.suppress(UsageError, TypeError, KeyError):
                found += not_credible(read_json(folder / name)["warnings"])
    return found


def _gaps(numbers: Set[int]) -> str:
    """Return in words which numbers from 0 to the greatest are not among some, the first few; empty if all are."""
    count = max(numbers, default=-1) + 1 - len(numbers)
    missing = (number for number in itertools.count() if number not in numbers)
    first = ", ".join(map(str, itertools.islice(missing, min(count, 5))))
    return first if count <= 5 else f"{first}, … ({count} in all)"
