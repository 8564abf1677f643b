"""Whether SKD has become slower: figures of each revision as ratios to a loop that is measured beside them.

A figure is processor time of one core, divided by that of a loop of fixed work which runs before and after it: what
else the machine does, and how fast it is today, concerns both. Each of three runs measures every figure five times and
keeps the median. What was found goes to the end of a file of JSON lines, one for each revision and machine.

    python benchmarks/track.py                          # measure this revision, and keep what was found
    python benchmarks/track.py --check                  # and fail where it is slower than the last one that was kept
    python benchmarks/track.py --check --against v0.9   # or than a certain one
    python benchmarks/track.py --picture track.png --no-measuring

A check compares the medians of the three runs with those of the last record of the same machine at another revision.
It fails where a figure has grown by more than `--loss` (0.05: 5 %), with exit code 1; with 2 where there is nothing to
compare with. Between runs of one revision on a busy machine medians differ by some per cent: check before a release on
one that is idle.
"""

from __future__ import annotations

import argparse
import json
import math
import platform
import statistics
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from skd_sim.errors import UsageError

FILE: Final = Path(__file__).with_name("track.jsonl")
RUNS: Final = 3
LOSS: Final = 0.05
_TIMES = 5  # that a run measures each figure
_LOOP = 150_000  # rounds of the calibration loop


@dataclass(frozen=True)
class Record:
    """What was measured at a revision.

    Attributes:
        revision: full name of the commit.
        changed: whether there was more than that commit.
        date: when it was measured (ISO 8601, UTC).
        machine: what has to be alike for ratios to be compared: processor, Python, numpy and numba.
        loop_ms: processor time of the calibration loop, ms, the median of all.
        figures: name → the ratio to the loop of each run.
    """

    revision: str
    changed: bool
    date: str
    machine: str
    loop_ms: float
    figures: Mapping[str, Sequence[float]]

    def median(self, name: str) -> float:
        """Return a figure: the median of its runs."""
        return statistics.median(self.figures[name])


@dataclass(frozen=True)
class Change:
    """How a figure has changed.

    Attributes:
        name: of the figure.
        before: its ratio to the loop.
        after: likewise.
        spread: of the runs of both, the greatest by its least, less 1.
    """

    name: str
    before: float
    after: float
    spread: float

    @property
    def loss(self) -> float:
        """By what share it takes longer; negative where it takes less."""
        return self.after / self.before - 1.0


def read(path: Path) -> list[Record]:
    """Return the records of a file, in their order; none of a file that is not there.

    Raises:
        UsageError: a line is no record.
    """
    if not path.exists():
        return []
    found = []
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
        if not line.strip():
            continue
        try:
            record = Record(**json.loads(line))
            texts = [record.revision, record.date, record.machine]
            ratios = [ratio for runs in record.figures.values() for ratio in runs]
            whole = all(isinstance(text, str) for text in texts) and isinstance(record.changed, bool)
            if not whole or not all(record.figures.values()) or not all(0.0 < one < math.inf for one in ratios):
                raise ValueError("a key has a value of another kind")
        except (ValueError, TypeError, AttributeError) as error:
            raise UsageError(f"{path}, line {number}: no record of track.py ({error}); remove it") from None
        found.append(record)
    return found


def append(path: Path, record: Record) -> None:
    """Put a record at the end of a file, whole or not at all."""
    before = path.read_text(encoding="utf-8") if path.exists() else ""
    new = path.with_name(f"{path.name}.new")
    new.write_text(before + json.dumps(asdict(record)) + "\n", encoding="utf-8")
    new.replace(path)


def baseline(records: Sequence[Record], now: Record, against: str = "") -> Record:
    """Return with which record a new one is compared.

    Args:
        records: of the file, the latest last.
        now: the new one.
        against: beginning of a revision's name; empty: the last one but that of `now`.

    Raises:
        UsageError: there is none of this machine.
    """
    fits = [
        one
        for one in records
        if one.machine == now.machine
        and (one.revision.startswith(against) if against else one.revision != now.revision)
    ]
    if not fits:
        which = f"of revision {against}" if against else "of another revision"
        raise UsageError(f"no record {which} on this machine ({now.machine}): run track.py at that revision first")
    return fits[-1]


def compare(before: Record, after: Record) -> list[Change]:
    """Return how the figures that both have changed."""
    changes = []
    for name in after.figures:
        if name in before.figures:
            spread = max(max(one.figures[name]) / min(one.figures[name]) for one in (before, after)) - 1.0
            changes.append(Change(name, before.median(name), after.median(name), spread))
    return changes


def slower(changes: Sequence[Change], limit: float) -> list[Change]:
    """Return those that have grown by more than a share."""
    return [one for one in changes if one.loss > limit]


def calibrate() -> float:
    """Return the processor time of a loop of fixed work, s: arithmetic of the interpreter, and of small arrays."""
    import numpy as np

    begin = time.process_time()
    state = 1
    for _ in range(_LOOP):
        state = (1_103_515_245 * state + 12_345) % 2_147_483_648
    row = np.arange(64.0)
    for _ in range(_LOOP // 50):
        row = np.sqrt(row * row + 1.0)
    assert state + row.sum() > 0.0
    return time.process_time() - begin


def tasks() -> dict[str, Callable[[], object]]:
    """Return what is measured, by name; each has been done once, so that all is compiled."""
    from dataclasses import replace

    from skd_evaluator.campaign.judge.rating import judge_all
    from skd_evaluator.campaign.plan.plan import Plan, kamikaze_set, safe_trajectories
    from skd_evaluator.campaign.run.runner import run_episode
    from skd_evaluator.campaign.run.workers import InProcessRunner
    from skd_evaluator.margin.exact.exact import exact_margin
    from skd_evaluator.margin.search.search import search_margin
    from skd_evaluator.measure.behaviour.model import load_behaviour
    from skd_evaluator.risk.assessment_risk import crude_crossings, draws_of
    from skd_evaluator.risk.crossings import Encounter
    from skd_evaluator.risk.known_car import KnownCar
    from skd_sim.choices.objective import Objective
    from skd_sim.encounter.scenario import load_scenario
    from skd_sim.episode.episode import Mode

    plan = Plan(load_scenario("crossing"), safe_count=4, seed=1)
    safe = safe_trajectories(plan, InProcessRunner(1))

    def attempts(mode: Mode, objective: Objective, count: int) -> list[Any]:
        mine = replace(plan, objective=objective)
        return [mine.episode(mode, run % 4, run // 4, safe[run % 4]) for run in range(count)]

    objectives = Objective.PAPER, Objective.FRECHET, Objective.DEFORMATION
    pairs = {one: attempts(Mode.KAMIKAZE, one, 24) for one in objectives}
    walks = attempts(Mode.REPLAY, Objective.PAPER, 120)
    logs = [run_episode(one) for one in pairs[Objective.DEFORMATION]]
    sets = [kamikaze_set(phi, logs[index::4]) for index, phi in enumerate(safe)]
    here = Encounter(plan, tuple(safe), load_behaviour("walkers").values)
    crossings = crude_crossings(here, 2000)
    draws = draws_of(here, crossings)
    found: dict[str, Callable[[], object]] = {
        f"24 kamikaze episodes, {objective}": lambda mine=mine: [run_episode(one) for one in mine]  # type: ignore[misc]
        for objective, mine in pairs.items()
    }
    found |= {
        "120 runs along φ": lambda: [run_episode(one) for one in walks],
        "24 exact margins": lambda: [exact_margin(one) for one in pairs[Objective.DEFORMATION]],
        "8 searches for a margin": lambda: [search_margin(one, 64) for one in pairs[Objective.DEFORMATION][:8]],
        "30,000 compiled crossings": lambda: [KnownCar(here).run_drawn(crossings, draws, 1.0) for _ in range(15)],
        "judging 24 episodes": lambda: judge_all(plan, safe, {Objective.DEFORMATION: sets}, (), 0.0).as_dict(),
    }
    for do in found.values():
        do()
    return found


def one_run(found: Mapping[str, Callable[[], object]], loops: list[float]) -> dict[str, float]:
    """Measure every figure some times, each between two loops; return medians of the ratios, and keep the loops."""
    ratios: dict[str, list[float]] = {name: [] for name in found}
    for _ in range(_TIMES):
        before = calibrate()
        for name, do in found.items():
            begin = time.process_time()
            do()
            took = time.process_time() - begin
            after = calibrate()
            ratios[name].append(2.0 * took / (before + after))
            loops.append(after)
            before = after
    return {name: statistics.median(all_of_it) for name, all_of_it in ratios.items()}


def machine() -> str:
    """Return what has to be alike for ratios to be compared."""
    import numba
    import numpy as np

    model = platform.processor() or platform.machine()
    cpus = Path("/proc/cpuinfo")
    if cpus.exists():
        names = [
            line.split(":", 1)[1].strip() for line in cpus.read_text().splitlines() if line.startswith("model name")
        ]
        model = names[0] if names else model
    return f"{model}; Python {platform.python_version()}, numpy {np.__version__}, numba {numba.__version__}"


def measure(runs: int) -> Record:
    """Measure this revision.

    Raises:
        UsageError: it is no revision: these are no files of git's.
    """
    from skd_evaluator.provenance import git_revision

    revision = git_revision()
    if revision is None:
        raise UsageError("track.py keeps figures by revision: run it in a checkout of git's")
    found, loops = tasks(), []
    each = [one_run(found, loops) for _ in range(runs)]
    return Record(
        str(revision["revision"]),
        bool(revision["modified"]),
        datetime.now(UTC).isoformat(timespec="seconds"),
        machine(),
        1e3 * statistics.median(loops),
        {name: [one[name] for one in each] for name in found},
    )


def draw(records: Sequence[Record], path: Path) -> None:
    """Draw each figure over the revisions of the machine of the last record."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib.figure import Figure

    mine = [one for one in records if one.machine == records[-1].machine]
    names = list(dict.fromkeys(name for one in mine for name in one.figures))
    figure = Figure(figsize=(9.0, 1.0 + 1.25 * math.ceil(len(names) / 2)), layout="constrained")
    axes = figure.subplots(math.ceil(len(names) / 2), 2, squeeze=False, sharex=True).ravel()
    for name, panel in zip(names, axes, strict=False):
        having = [(place, one) for place, one in enumerate(mine) if name in one.figures]
        first = having[0][1].median(name)
        for place, one in having:
            panel.plot(
                [place] * len(one.figures[name]), [ratio / first for ratio in one.figures[name]], ".", color="0.7"
            )
        panel.plot([place for place, _ in having], [one.median(name) / first for _, one in having], "-o", markersize=3)
        panel.axhline(1.0, color="0.85", linewidth=0.8, zorder=0)
        panel.set_title(name, fontsize=9, loc="left")
        low, high = panel.get_ylim()
        panel.set_ylim(min(low, 0.85), max(high, 1.15))
        panel.set_xticks(
            range(len(mine)), [one.revision[:8] + "*" * one.changed for one in mine], rotation=60, fontsize=7
        )
        panel.tick_params(axis="y", labelsize=8)
    for panel in axes[len(names) :]:
        panel.set_axis_off()
    figure.suptitle("Processor time by that of the calibration loop; 1: as at the first revision", fontsize=10)
    figure.savefig(path, dpi=110)


def _say(changes: Sequence[Change], before: Record, limit: float) -> None:
    print(f"against {before.revision[:12]} of {before.date}; a figure may grow by {100 * limit:g} %")
    print(f"{'':34}{'before':>9}{'now':>9}{'change':>9}{'runs differ by':>16}")
    for one in changes:
        verdict = "  SLOWER" if one.loss > limit else ""
        print(
            f"{one.name:34}{one.before:9.3f}{one.after:9.3f}{100 * one.loss:+8.1f} %{100 * one.spread:14.1f} %{verdict}"
        )


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, keep, compare and draw; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--file", type=Path, default=FILE, help=f"where figures are kept (default {FILE.name} beside it)"
    )
    parser.add_argument("--check", action="store_true", help="fail where a figure has grown")
    parser.add_argument("--against", default="", metavar="REVISION", help="compare with this one, not with the last")
    parser.add_argument("--loss", type=float, default=LOSS, help=f"share by which a figure may grow (default {LOSS})")
    parser.add_argument("--runs", type=int, default=RUNS, help=f"of which medians are taken (default {RUNS})")
    parser.add_argument("--picture", type=Path, metavar="FILE", help="draw the figures over the revisions")
    parser.add_argument("--no-measuring", action="store_true", help="take the last record for this revision's")
    given = parser.parse_args(arguments)
    if given.runs < 1 or not 0.0 <= given.loss < math.inf:
        parser.error("--runs must be at least 1, and --loss must not be negative")
    try:
        records = read(given.file)
        if given.no_measuring:
            if not records:
                raise UsageError(f"{given.file}: no record; leave out --no-measuring")
            now, records = records[-1], records[:-1]
        else:
            now = measure(given.runs)
            append(given.file, now)
            print(f"{now.revision[:12]}{' with changes' * now.changed}: loop {now.loop_ms:.1f} ms, {now.machine}")
            for name in now.figures:
                print(f"{name:34}{now.median(name):9.3f} times the loop")
        if given.picture is not None:
            draw([*records, now], given.picture)
        if not given.check:
            return 0
        before = baseline(records, now, given.against)
    except UsageError as error:
        print(f"track.py: error: {error}", file=sys.stderr)
        return 2
    changes = compare(before, now)
    _say(changes, before, given.loss)
    lost = [name for name in before.figures if name not in now.figures]
    if lost:
        print(f"no longer measured: {', '.join(lost)}")
    return 1 if slower(changes, given.loss) or not changes else 0


if __name__ == "__main__":
    sys.exit(main())
