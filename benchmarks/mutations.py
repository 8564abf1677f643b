"""What becomes of damaged and forged recordings: `python benchmarks/mutations.py --count 1000 --seed 0 --commands`.

Draws mutations of bags and of episodes.npz, reads each in a child of its own, as `skd replay` and `skd fit` read it,
and counts by class: tracebacks, hangs, memory, and numbers that changed without a word. Every mutation is read twice,
with and without --skip-damaged. `--commands` runs the commands themselves on every twentieth. `--forged` forges whole
recordings instead, so that their messages agree with each other (`forgeries.py`); those that agree so well that replay
alone believes them are replayed once more with `--verify`, which plans their kamikazes again. `--scenario NAME` takes
another of SKD's encounters.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import tempfile
from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from bag_forge import Sent, campaign_messages, write_mcap
from foreign_recorders import FOREIGN
from forgeries import FORGING, FOUND_OTHERWISE, OF_SEVERAL
from mcap.writer import CompressionType
from mutators import MUTATORS, NPZ_MUTATORS, Mutator
from recorders import METADATA, RECORDERS
from skd_evaluator.bags.acceptance import Damage
from skd_evaluator.bags.logs import read_recordings, write_logs
from skd_evaluator.bags.reader import read_bags
from skd_evaluator.bags.replay import rating_from
from skd_evaluator.campaign.judge.rating import judge_all
from skd_evaluator.campaign.plan.plan import Plan, kamikaze_set, safe_trajectories
from skd_evaluator.campaign.plan.probe import probe_episodes
from skd_evaluator.campaign.run.runner import run_episode
from skd_evaluator.campaign.run.workers import InProcessRunner
from skd_evaluator.campaign.store.results import write_assessment, write_json
from skd_evaluator.cli.main import main as skd
from skd_sim.encounter.scenario import load_scenario
from skd_sim.episode.episode import EpisodeLog, Mode, Outcome
from skd_sim.errors import UsageError
from skd_sim.geometry.trajectory import Trajectory
from watched import Ended, watched

CROSSING = "crossing"
MOST_ATTEMPTS = 12
LIMIT_SECONDS = 20.0
LIMIT_MEMORY = 500 * 10**6
_NUMBER = r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?"
_WORDS = ("seconds", "left_out", "warnings", "safe", "version")
_FORMS: dict[str, dict[str, Any]] = {
    "bags, one an episode": {},
    "the same without checksums": {"checksums": False},
    "one recording, zstd": {"compression": CompressionType.ZSTD, "chunk_size": 4096},
    "one recording, no chunks, no checksums": {"chunks": False, "checksums": False},
}


@dataclass(frozen=True)
class Source:
    """Right files, and what is read from them.

    Attributes:
        name: of the kind.
        files: all that belong together.
        read: returns the numbers, and what is said beside them; the arguments are paths and whether to skip.
        right: what it returns for the right files.
        command: of `skd` that reads them.
        mutators: what can be done to one of the files.
        sent: what each file holds, as messages; none for arrays.
        options: how the file was written.
    """

    name: str
    files: list[Path]
    read: Callable[[Sequence[Path], bool], Reading]
    right: Any
    command: str
    mutators: dict[str, Mutator]
    sent: list[list[Sent]]
    options: dict[str, Any]


@dataclass(frozen=True)
class Reading:
    """What came of reading: numbers, or why they were refused; and what was said of them."""

    numbers: Any
    refused: str
    words: int
    unchecked: bool


def campaign(seed: int, scenario: str) -> tuple[Plan, list[Trajectory], list[EpisodeLog]]:
    """Return a small campaign, in `crossing` with an attempt that fails."""
    plan = Plan(load_scenario(scenario), multiplier=1.1, simulations=3, seed=seed, safe_count=2)
    safe = [
        Trajectory(np.array([(-3.5 + pace * tick, 0.1) for tick in range(ticks)]), 0.3, f"pace {pace}")
        for pace, ticks in ((0.75, 10), (0.6, 13))
    ]
    if scenario != CROSSING:
        found = safe_trajectories(replace(plan, simulations=100, safe_count=16), InProcessRunner(1))
        safe = list({one.positions.tobytes(): one for one in found[::-1]}.values())[:2]
        assert len(safe) == 2
    logs = []
    for index, phi in enumerate(safe):
        hits = attempt = 0
        while hits < 3 and attempt < MOST_ATTEMPTS:
            logs.append(run_episode(plan.episode(Mode.KAMIKAZE, index, attempt, phi)))
            hits += logs[-1].outcome == Outcome.COLLISION
            attempt += 1
    logs += [run_episode(plan.episode(Mode.REPLAY, run % 2, run // 2, safe[run % 2])) for run in range(4)]
    return plan, safe, logs


def replayed(paths: Sequence[Path], skip: bool) -> Reading:
    """Read bags as `skd replay` does."""
    damage = Damage(skip=skip)
    try:
        rating = rating_from(read_bags(paths, damage), damage=damage)
    except UsageError as error:
        return Reading(None, str(error), len(damage.left_out), bool(damage.unchecked))
    figures = {key: value for key, value in rating.as_dict().items() if key not in _WORDS}
    kamikazes = [log for one in rating.assessments for group in one.kamikaze for log in (*group.logs, *group.misses)]
    logs = [*kamikazes, *rating.replays]
    states = [
        (str(log.episode.objective), log.episode.episode_id, log.adversary.tobytes(), log.car.tobytes()) for log in logs
    ]
    numbers = json.dumps(figures, allow_nan=False), states
    return Reading(numbers, "", len(damage.left_out) + len(damage.warnings), bool(damage.unchecked))


def fitted(paths: Sequence[Path], skip: bool) -> Reading:
    """Read logs as `skd fit` does."""
    damage = Damage(skip=skip)
    try:
        found = read_recordings(paths, damage)
    except UsageError as error:
        return Reading(None, str(error), len(damage.left_out), False)
    numbers = [(one.adversary.tobytes(), one.car.tobytes(), one.time_step, one.front, one.rear) for one in found]
    return Reading(numbers, "", len(damage.left_out) + len(damage.warnings), False)


def sources(folder: Path, seed: int, scenario: str) -> list[Source]:
    """Write the right files."""
    plan, safe, logs = campaign(seed, scenario)
    episodes = campaign_messages(logs)
    made = []
    for number, (name, options) in enumerate(_FORMS.items()):
        parts = episodes if name.startswith(("bags", "the same")) else [[one for each in episodes for one in each]]
        files = [
            write_mcap(folder / str(number) / f"{part:02d}.mcap", sent, **options) for part, sent in enumerate(parts)
        ]
        made.append(Source(name, files, replayed, replayed(files, False), "replay", MUTATORS, parts, options))
    groups = [
        [log for log in logs if log.episode.mode == Mode.KAMIKAZE and log.episode.safe_trajectory is phi]
        for phi in safe
    ]
    sets = [kamikaze_set(phi, group) for phi, group in zip(safe, groups, strict=True)]
    replays = [log for log in logs if log.episode.mode == Mode.REPLAY]
    (folder / "assessed").mkdir()
    write_assessment(folder / "assessed", judge_all(plan, safe, {plan.objective: sets}, replays, 0.0))
    probes = [run_episode(episode) for episode in probe_episodes(plan.scenario, 24, seed=seed, multiplier=0.75)]
    (folder / "probe").mkdir()
    summary = {"controller": "basic", "multiplier": 0.75, "seed": seed}
    write_json(folder / "probe" / "probe.json", {**summary, "scenario": probes[0].episode.scenario.as_dict()})
    write_logs(folder / "probe" / "episodes.npz", probes)
    for name in ("assessed", "probe"):
        files = [folder / name / "episodes.npz"]
        made.append(Source(f"npz, {name}", files, fitted, fitted(files, False), "fit", NPZ_MUTATORS, [], {}))
    for source in made:
        assert source.right.numbers, source.right.refused
        assert scenario != CROSSING or not source.right.words  # a car may be known to be checked roughly
    return made


def judged(source: Source, ended: Ended, name: str) -> str:
    """Return the class of what became of a mutation."""
    if not ended.in_time or ended.seconds > LIMIT_SECONDS:
        return "hang"
    if ended.traceback:
        return "traceback"
    if ended.resident > LIMIT_MEMORY:
        return "memory"
    reading: Reading = ended.value
    if reading.refused:
        return "refused"
    told = reading.words > source.right.words
    if reading.numbers == source.right.numbers:
        return "same numbers, told" if told else "same numbers"
    if told:
        return "changed, told"
    if _within_rounding(reading.numbers, source.right.numbers):
        return "changed by less than 1e-10"
    if name in FOUND_OTHERWISE:
        return "consistent forgery"
    return "changed, only told that there is no checksum" if reading.unchecked else "changed silently"


def _within_rounding(numbers: Any, right: Any) -> bool:
    """Tell whether figures of `replayed` differ by what rounding may change, and states by nothing."""
    if not isinstance(numbers, tuple) or numbers[1] != right[1]:
        return False
    said, known = (re.split(_NUMBER, one[0]) for one in (numbers, right))
    values = [[float(number) for number in re.findall(_NUMBER, one[0])] for one in (numbers, right)]
    return said == known and np.allclose(*values, rtol=1e-10, atol=1e-10)


def mutated(source: Source, rng: np.random.Generator, name: str, folder: Path) -> tuple[list[Path], str]:
    """Write a mutation of one of the files; return what is to be read and what was done."""
    chosen = int(rng.integers(len(source.files)))
    original = source.files[chosen]
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(original.parent, folder, ignore=lambda _, names: [one for one in names if one.endswith(".mcap")])
    file = folder / original.name
    what = source.mutators[name](original, file, source.sent[chosen] if source.sent else [], source.options, rng)
    others = [one for one in source.files if one != original]
    several = (folder / METADATA).exists() or len(list(folder.glob("*.mcap"))) > 1
    given = folder if several else file  # metadata is looked at in a folder alone
    return [*others[:chosen], given, *others[chosen:]], f"{original.name}: {what}"


def main() -> int:
    """Run all mutations; return 1 if one of them is not as it has to be."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--scenario", default=CROSSING, help=f"name of an encounter (default {CROSSING})")
    parser.add_argument("--forged", action="store_true", help="forge whole recordings")
    parser.add_argument("--only", nargs="*", default=[""], help="those alone whose names hold one of these texts")
    parser.add_argument("--commands", action="store_true", help="run skd itself on every twentieth")
    parser.add_argument("--verbose", action="store_true", help="print every mutation and what became of it")
    arguments = parser.parse_args()
    counts: dict[tuple[str, str], Counter[str]] = defaultdict(Counter)
    by_class: dict[str, Counter[str]] = defaultdict(Counter)
    wrong, worst_memory, worst_time, commands = [], 0, 0.0, Counter[int]()
    with tempfile.TemporaryDirectory() as scratch:
        made = sources(Path(scratch), seed=2, scenario=arguments.scenario)
        if arguments.forged:
            made = [replace(one, mutators=FORGING | RECORDERS | FOREIGN) for one in made if one.command == "replay"]
            few = {name: one for name, one in (FORGING | RECORDERS | FOREIGN).items() if name not in OF_SEVERAL}
            made = [one if len(one.files) == 1 else replace(one, mutators=few) for one in made]
        turns = [(one, name) for one in made for name in one.mutators if any(part in name for part in arguments.only)]
        for number in range(arguments.count):
            source, name = turns[number % len(turns)]
            rng = np.random.default_rng((arguments.seed, number))
            paths, what = mutated(source, rng, name, Path(scratch) / "mutation")
            for skip in (False, True):
                ended = watched(lambda s=source, p=paths, k=skip: s.read(p, k), seconds=LIMIT_SECONDS)
                verdict = judged(source, ended, name)
                if verdict == "consistent forgery":
                    found = _command(["replay", *map(str, paths), "--verify"], Path(scratch) / "out") == 1
                    verdict += ", found by --verify" if found else ", not found"
                mode = "skipping" if skip else "refusing"
                counts[source.name, mode][verdict] += 1
                by_class[f"{'npz' if source.command == 'fit' else 'bag'}: {name}"][f"{mode}: {verdict}"] += 1
                worst_memory, worst_time = max(worst_memory, ended.resident), max(worst_time, ended.seconds)
                if arguments.verbose or verdict in ("hang", "traceback", "memory", "changed silently"):
                    said = ended.traceback.strip().splitlines()[-1:] or [getattr(ended.value, "refused", "")]
                    print(f"{number} {source.name} | {name} | {mode} | {what} | {verdict} | {said[0]}")
                if verdict in ("hang", "traceback", "memory", "changed silently"):
                    wrong.append(number)
            if arguments.commands and number % 20 == 0:
                call = [source.command, *map(str, paths), "--skip-damaged"]
                commands[_command(call, Path(scratch) / "out")] += 1
    _print(counts, by_class)
    print(f"most memory {worst_memory / 1e6:.0f} MB, longest {worst_time:.2f} s; wrong: {len(wrong)}")
    if arguments.commands:
        print(f"commands by exit code: {dict(sorted(commands.items()))}")
    return 1 if wrong or set(commands) - {0, 1, 2} else 0


def _command(words: Sequence[str], out: Path) -> int:
    """Run a command itself; return its exit code, −1 where it did not end as a command does."""
    shutil.rmtree(out, ignore_errors=True)
    call = [*words, "--out", str(out)]
    ended = watched(lambda: skd(call), seconds=10 * LIMIT_SECONDS)
    if ended.traceback or not ended.in_time:
        print(f"{call}: {ended.traceback}")
        return -1
    return int(ended.value)


def _print(counts: dict[tuple[str, str], Counter[str]], by_class: dict[str, Counter[str]]) -> None:
    verdicts = sorted({verdict for row in counts.values() for verdict in row})
    print("| files | " + " | ".join(verdicts) + " |")
    print("|---" * (len(verdicts) + 1) + "|")
    for (name, mode), row in counts.items():
        print(f"| {name}, {mode} | " + " | ".join(str(row[verdict]) for verdict in verdicts) + " |")
    print()
    for name, row in sorted(by_class.items()):
        print(f"{name}: " + ", ".join(f"{count} {verdict}" for verdict, count in sorted(row.items())))


if __name__ == "__main__":
    raise SystemExit(main())
