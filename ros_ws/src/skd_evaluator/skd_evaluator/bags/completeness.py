"""Which episodes of a campaign are missing in the recordings, as far as the numbers of the others show."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Set
from pathlib import Path

from skd_sim.errors import UsageError
from skd_sim.inputs.outside import read_json
from skd_sim.world.aborts import counts_in_words
from skd_sim.world.episode import EpisodeLog, Outcome

from skd_evaluator.assessment.plan.plan import ATTEMPTS_PER_WANTED, Stage, split_episode_id
from skd_evaluator.metrics.credibility import not_credible

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

    Attempts are numbered from 0 without gaps, and every φ is tried until as many have collided as for the others or a
    cap is reached (`skd_evaluator.assessment.plan.plan`). If the last attempts of every φ are missing alike, nobody can
    tell.

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
    runs = [len(attempts[Stage.COLLISION_RATE].get(index, ())) for index in sorted(known)]
    if runs and not absent and (max(runs) - min(runs) > 1 or runs != sorted(runs, reverse=True)):  # dealt out in turns
        lines.append(f"the last runs along φ were not recorded: of one {min(runs)}, of another {max(runs)}")
    return lines


def aborted_episodes(logs: Iterable[EpisodeLog]) -> list[str]:
    """Return what has to be said about episodes that do not count because they were aborted."""
    reasons = [log.reason for log in logs if log.outcome == Outcome.ABORTED]
    if not reasons:
        return []
    what = "1 episode counts" if len(reasons) == 1 else f"{len(reasons)} episodes count"
    return [f"{what} for nothing, aborted ({counts_in_words(reasons)})"]


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
    for folder in _folders_of_results(files):
        try:
            said = read_json(folder / "assessment.json")
            rows = [row for one in said["objectives"].values() for row in one["per_safe_trajectory"]]
            attempts, runs = sum(int(row["attempts"]) for row in rows), int(said["collision_runs"])
        except (UsageError, ValueError, TypeError, KeyError, AttributeError):
            continue
        if found[0] < attempts or found[1] < runs:
            lines.append(
                f"{folder / 'assessment.json'} tells of {attempts} kamikaze attempts and {runs} runs along φ, the "
                f"recordings of {found[0]} and {found[1]}"
            )
    return lines


def not_credible_beside(files: Iterable[Path]) -> list[str]:
    """Return why assessments and probes beside recordings say that they are not credible, a line each."""
    found: list[str] = []
    for folder in _folders_of_results(files):
        for name in SUMMARIES:
            try:
                found += not_credible(read_json(folder / name)["warnings"])
            except (UsageError, TypeError, KeyError):
                continue
    return found


def _folders_of_results(files: Iterable[Path]) -> list[Path]:
    """Return the folders in whose folder `bags` files are, sorted."""
    bags = {file.absolute().parent.parent for file in files}
    return sorted(folder.parent for folder in bags if folder.name == "bags")


def _gaps(numbers: Set[int]) -> str:
    """Return in words which numbers from 0 to the greatest are not among some, the first few; empty if all are."""
    count = max(numbers, default=-1) + 1 - len(numbers)
    missing = (number for number in itertools.count() if number not in numbers)
    first = ", ".join(map(str, itertools.islice(missing, min(count, 5))))
    return first if count <= 5 else f"{first}, … ({count} in all)"
