"""Which episodes of a campaign are in no recording, as far as the numbers of the others tell."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path

from skd_evaluator.campaign.plan import ATTEMPTS_PER_WANTED, KamikazeSet, Stage, split_episode_id
from skd_evaluator.files import open_regular

_LARGEST = 64 * 2**20  # bytes of an assessment.json
_NAMES = {Stage.KAMIKAZE: "kamikaze attempts", Stage.COLLISION_RATE: "runs along φ"}


def unfinished_episodes(ids: Iterable[int]) -> list[str]:
    """Return what is to be said of episodes that were announced and never ended: one line, if there are any."""
    numbers = sorted(ids)
    if not numbers:
        return []
    what = "1 episode" if len(numbers) == 1 else f"{len(numbers)} episodes"
    first = ", ".join(str(number) for number in numbers[:5]) + (", …" if len(numbers) > 5 else "")
    return [f"{what} left out, no result was recorded ({first}): did recording end before the episode?"]


def missing_episodes(
    announced: Iterable[int], kamikaze: Mapping[int, KamikazeSet], *, left_out: bool, which: str = ""
) -> list[str]:
    """Return what a campaign must have had beside what is recorded, a line each.

    Attempts are numbered from 0 without gaps, every φ is tried until as many have collided as for the others or a cap
    is reached, and runs along φ are dealt out evenly (`skd_evaluator.campaign.plan`). Of a campaign that lacks the last
    attempts of every φ alike, nothing can be told.

    Args:
        announced: ids of the episodes of which the recordings know, whatever became of them; kamikazes of one
            objective.
        kamikaze: by number of φ.
        left_out: whether episodes are left out, so that sets are not what they were.
        which: kamikazes these are, to be said behind them.
    """
    names = {**_NAMES, Stage.KAMIKAZE: _NAMES[Stage.KAMIKAZE] + which}
    attempts: dict[Stage, dict[int, set[int]]] = {stage: {} for stage in _NAMES}
    for number in announced:
        stage, index, attempt = split_episode_id(number)
        if stage in attempts:
            attempts[stage].setdefault(index, set()).add(attempt)
    lines = []
    known = {index for of_stage in attempts.values() for index in of_stage}
    absent = set(range(max(known, default=-1) + 1)) - known
    if absent:
        lines.append(f"no recording has an episode of safe trajectory {_some(absent)}")
    for stage, of_stage in attempts.items():
        for index, numbers in sorted(of_stage.items()):
            gaps = set(range(max(numbers) + 1)) - numbers
            if gaps:
                lines.append(f"no recording has {names[stage]} {_some(gaps)} of safe trajectory {index}")
    wanted = max((len(group.logs) for group in kamikaze.values()), default=0)
    for index, group in sorted(kamikaze.items()):
        tried = len(attempts[Stage.KAMIKAZE].get(index, ()))
        if not left_out and len(group.logs) < wanted and tried < ATTEMPTS_PER_WANTED * wanted:
            lines.append(
                f"the last {names[Stage.KAMIKAZE]} of safe trajectory {index} were not recorded: {len(group.logs)} "
                f"collided in {tried}, of another {wanted}"
            )
    runs = attempts[Stage.COLLISION_RATE]
    counts = [len(runs.get(index, ())) for index in range(max(runs, default=-1) + 1)]
    uneven = [index for index, count in enumerate(counts) if count < max(counts) - 1 or count < max(counts[index:])]
    if uneven and not absent:
        lines.append(f"the last runs along safe trajectory {_some(set(uneven))} were not recorded: others have more")
    return lines


def fewer_than_said(announced: Iterable[int], files: Iterable[Path]) -> list[str]:
    """Return what assessments beside recordings say that a campaign had, and recordings have not, a line each.

    `skd assess --graph --record` leaves its bags in the folder `bags` beside its assessment.json.

    Args:
        announced: ids of the episodes of which the recordings know.
        files: the recordings.
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


def _said_in(file: Path) -> tuple[int, int] | None:
    """Return how many attempts and runs an assessment had; none where it cannot be read."""
    try:
        with open_regular(file) as stream:
            said = json.loads(stream.read(_LARGEST))
        # Before there were several objectives the only one was at the top.
        by_objective = said["objectives"].values() if "objectives" in said else [said]
        attempts = sum(int(row["attempts"]) for one in by_objective for row in one["per_safe_trajectory"])
        return attempts, int(said["collision_runs"])
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError, OSError):
        return None


def _some(numbers: set[int]) -> str:
    """Return the first few of some numbers, and how many there are."""
    first = ", ".join(str(number) for number in sorted(numbers)[:5])
    return first if len(numbers) <= 5 else f"{first}, … ({len(numbers)} in all)"
