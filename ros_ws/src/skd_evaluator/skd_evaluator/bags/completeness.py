"""Which episodes of a campaign are missing in the recordings, as far as the numbers of the others show."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence, Set, Sized
from itertools import accumulate, islice
from pathlib import Path

import numpy as np
from skd_sim.episode.aborts import counts_in_words
from skd_sim.episode.episode import EpisodeLog, Outcome
from skd_sim.errors import UsageError
from skd_sim.inputs.outside import read_json

from skd_evaluator.bags.validation import is_over
from skd_evaluator.campaign.plan.plan import ATTEMPTS_PER_WANTED, Stage, split_episode_id
from skd_evaluator.measure.doubt import in_doubt

SUMMARIES = ("probe.json", "assessment.json")
"""Files that say of which car the episodes beside them are."""
_NAMES = {Stage.KAMIKAZE: "kamikaze attempts", Stage.COLLISION_RATE: "runs along φ"}


def unfinished_episodes(ids: Iterable[int]) -> list[str]:
    """Return one line about episodes that were announced and never ended; nothing if there are none."""
    numbers = sorted(ids)
    if not numbers:
        return []
    what = "1 episode" if len(numbers) == 1 else f"{len(numbers)} episodes"
    first = ", ".join(str(number) for number in numbers[:5]) + (", …" if len(numbers) > 5 else "")
    return [f"{what} left out, no result was recorded ({first}): did recording end before the episode?"]


def missing_episodes(
    announced: Iterable[int],
    reached: Mapping[int, int],
    *,
    wanted: int,
    left_out: bool,
    which: str = "",
) -> list[str]:
    """Return which episodes the campaign must have had beside those that are recorded, a line each.

    Attempts are numbered from 0 without gaps, every φ is tried until as many have collided as for the others or a cap
    is reached, and runs along φ are dealt out evenly (`skd_evaluator.campaign.plan.plan`). If the last attempts of
    every φ are missing alike, nobody can tell.

    Args:
        announced: ids of the episodes that the recordings mention, however they ended; kamikazes of one objective only.
        reached: how many kamikazes reached what they planned for, by number of φ.
        wanted: how many were wanted on each φ; it is the same for every objective.
        left_out: whether episodes are left out, so that sets are not what they were.
        which: which kamikazes these are, for the lines.
    """
    names = {**_NAMES, Stage.KAMIKAZE: _NAMES[Stage.KAMIKAZE] + which}
    attempts: dict[Stage, dict[int, set[int]]] = {stage: {} for stage in _NAMES}
    for number in announced:
        stage, index, attempt = split_episode_id(number)
        if stage in attempts:
            attempts[stage].setdefault(index, set()).add(attempt)
    lines = []
    known = {index for of_stage in attempts.values() for index in of_stage}
    absent = _gaps(known)
    if absent:
        lines.append(f"no recording has an episode of safe trajectory {absent}")
    for stage, of_stage in attempts.items():
        for index, numbers in sorted(of_stage.items()):
            gaps = _gaps(numbers)
            if gaps:
                lines.append(f"no recording has {names[stage]} {gaps} of safe trajectory {index}")
    for index, count in sorted(reached.items()):
        tried = len(attempts[Stage.KAMIKAZE].get(index, ()))
        if not left_out and count < wanted and tried < ATTEMPTS_PER_WANTED * wanted:
            lines.append(
                f"the last {names[Stage.KAMIKAZE]} of safe trajectory {index} were not recorded: {count} "
                f"collided in {tried}, of another {wanted}"
            )
    uneven = [] if absent else _with_fewer_runs(attempts[Stage.COLLISION_RATE])
    if uneven:
        lines.append(f"the last runs along safe trajectory {_some(uneven)} were not recorded: others have more")
    return lines


def _with_fewer_runs(runs: Mapping[int, Sized]) -> list[int]:
    """Return the numbers of φ with fewer runs than φ after them, or fewer than one less than the most."""
    counts = [len(runs.get(index, ())) for index in range(max(runs, default=-1) + 1)]
    most_after = list(accumulate(reversed(counts), max))[::-1]
    most = max(counts, default=0)
    return [index for index, count in enumerate(counts) if count < max(most - 1, most_after[index])]


def aborted_episodes(logs: Iterable[EpisodeLog]) -> list[str]:
    """Return what has to be said about episodes that do not count because they are marked as aborted.

    Only the recording says that they were. An episode whose states reach an end, or were not recorded at all, may as
    well have been a hit.
    """
    lost = [log for log in logs if log.outcome == Outcome.ABORTED]
    if not lost:
        return []
    ended = sum(is_over(log) for log in lost)
    unknown = sum(not np.isfinite(log.car).all() for log in lost)
    told = f"; by their states {ended} of them had come to their end" if ended else ""
    told += f"; of {unknown} no states are recorded" if unknown else ""
    what = "1 episode counts" if len(lost) == 1 else f"{len(lost)} episodes count"
    return [f"{what} for nothing, said to have been aborted ({counts_in_words(log.reason for log in lost)}){told}"]


def fewer_than_said(announced: Iterable[int], files: Iterable[Path]) -> list[str]:
    """Return which episodes are missing in recordings, according to the assessments beside them, a line each.

    `skd assess --graph --record` leaves its bags in the folder `bags` beside its assessment.json.

    Args:
        announced: ids of the episodes of which the recordings know.
        files: the files with recordings.
    """
    numbers = [split_episode_id(number)[0] for number in announced]
    found = (numbers.count(Stage.KAMIKAZE), numbers.count(Stage.COLLISION_RATE))
    lines = []
    bags = {file.absolute().parent.parent for file in files}
    for folder in sorted(folder.parent for folder in bags if folder.name == "bags"):
        said = _said_in(folder / "assessment.json")
        if said is not None and (found[0] < said[0] or found[1] < said[1]):
            lines.append(
                f"{folder / 'assessment.json'} tells of {said[0]} kamikaze attempts and {said[1]} runs along φ, the "
                f"recordings of {found[0]} and {found[1]}"
            )
    return lines


def doubts_beside(files: Iterable[Path]) -> list[str]:
    """Return why assessments and probes beside recordings say that theirs may be of another car, a line each."""
    found: list[str] = []
    bags = {file.absolute().parent.parent for file in files}
    for folder in sorted(folder.parent for folder in bags if folder.name == "bags"):
        for name in SUMMARIES:
            try:
                found += in_doubt(read_json(folder / name)["warnings"])
            except (UsageError, TypeError, KeyError):
                continue
    return found


def _said_in(file: Path) -> tuple[int, int] | None:
    """Return how many attempts and runs an assessment had; None if it cannot be read."""
    try:
        said = read_json(file)
        # Before there were several objectives the only one was at the top.
        by_objective = said["objectives"].values() if "objectives" in said else [said]
        attempts = sum(int(row["attempts"]) for one in by_objective for row in one["per_safe_trajectory"])
        return attempts, int(said["collision_runs"])
    except (UsageError, ValueError, TypeError, KeyError, AttributeError, OverflowError):
        return None


def _gaps(numbers: Set[int]) -> str:
    """Return in words which numbers from 0 to the greatest are not among some; empty if all are.

    They are not listed first: a forged recording may number its only episode 2³² - 1.
    """
    count = max(numbers, default=-1) + 1 - len(numbers)
    missing = (number for number in itertools.count() if number not in numbers)
    return _in_words(list(islice(missing, min(count, 5))), count)


def _some(numbers: Sequence[int]) -> str:
    """Return in words the first few of some numbers in order, and how many there are."""
    return _in_words(numbers[:5], len(numbers))


def _in_words(first: Sequence[int], count: int) -> str:
    said = ", ".join(str(number) for number in first)
    return said if count <= len(first) else f"{said}, … ({count} in all)"
