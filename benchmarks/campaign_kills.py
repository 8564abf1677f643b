"""Kills a campaign at random moments, resumes it, and holds what comes out against a campaign that nobody disturbed.

Identical means: episodes.npz of every cell to the last bit, assessment.json but for times and provenance, campaign.csv
but for its column of seconds. Counted, too, is that a resumed campaign runs no episode that was stored, and all others.
"""

from __future__ import annotations

import argparse
import csv
import json
import operator
import os
import random
import shutil
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from local_dask import local_cluster, start_worker
from skd_evaluator.campaigns.store import FILE_NAME
from skd_evaluator.cli.arguments import whole_number

CAMPAIGN = """
defaults: {safe_count: 1, kamikaze_count: 100, collision_runs: 50, simulations: 500, objective: deformation}
cars:
  - {controller: basic, sweep: {multiplier: [0.75, 1.0]}}
"""
_PATIENCE = 900.0  # s for what must end
_POLL = 0.02
_EMPTY = 20_000
"""Bytes that a store without episodes has at most."""
_OF_THE_CLOCK = ("seconds", "provenance", "command_age")
"""What says how a result was made, and how long it and the commands of a graph took."""
_TRIES = 3
"""So often a campaign is resumed at most: a cluster that has just been started anew may still be unwell."""


@dataclass(frozen=True)
class Killed:
    """One campaign that was disturbed.

    Attributes:
        after: s since its start at which it was.
        state: of it then: how many cells were done, and how many episodes of the others stored.
        resumed: whether it had to be.
        differences: to the undisturbed one; none: it is identical.
    """

    after: float
    state: str
    resumed: bool
    differences: tuple[str, ...]


class Processes:
    """What a campaign runs on: workers of its own, of which one can be killed, and so can it itself."""

    targets = ("parent", "worker")

    def __init__(self, workers: int) -> None:
        """Let a campaign have so many workers."""
        self._workers = workers

    @property
    def words(self) -> list[str]:
        """Options of the command line."""
        return ["--workers", str(self._workers)]

    def victim(self, what: str, process: subprocess.Popen[bytes], draws: random.Random) -> int | None:
        """Return whom to kill, or None where there is nobody yet."""
        if what == "parent":
            return process.pid
        found = workers_of(process.pid)
        return draws.choice(found) if found else None

    def repair(self) -> None:
        """Have again what was killed: a worker of its own a campaign replaces itself."""


class Cluster(Processes):
    """A Dask cluster: of a scheduler and workers, which somebody else replaces when they die."""

    targets = ("parent", "worker", "scheduler")

    def __init__(self, workers: int, folder: Path, stack: ExitStack) -> None:
        """Start it; it ends with `stack`."""
        super().__init__(workers)
        self._folder, self._stack = folder, stack
        self._start()

    def _start(self) -> None:
        folder = Path(tempfile.mkdtemp(prefix="cluster-", dir=self._folder))
        self._cluster = self._stack.enter_context(local_cluster(self._workers, folder))
        self._place = folder

    @property
    def words(self) -> list[str]:
        """Options of the command line."""
        return ["--scheduler", self._cluster.address]

    def victim(self, what: str, process: subprocess.Popen[bytes], draws: random.Random) -> int | None:
        """Return whom to kill."""
        if what == "worker":
            return draws.choice(self._cluster.workers).pid
        return self._cluster.scheduler.pid if what == "scheduler" else process.pid

    def repair(self) -> None:
        """Start another worker, or another cluster, where one has ended."""
        time.sleep(0.2)
        if self._cluster.scheduler.poll() is not None:
            self._start()
            return
        for number, one in enumerate(self._cluster.workers):
            if one.poll() is not None:
                self._cluster.workers[number] = start_worker(self._cluster.address, self._place)


def command(file: Path, out: Path, where: Processes, *more: str) -> list[str]:
    """Return the command line of a campaign."""
    words = ["campaign", str(file), "--out", str(out), "-q", *where.words, *more]
    return [sys.executable, "-m", "skd_evaluator", *words]


def workers_of(pid: int) -> list[int]:
    """Return the workers of a process, each of which runs the same program below a keeper (Linux)."""
    try:
        own = Path(f"/proc/{pid}/cmdline").read_bytes()
        below = [worker for keeper in _children(pid) for worker in _children(keeper)]
        return [worker for worker in below if Path(f"/proc/{worker}/cmdline").read_bytes() == own]
    except OSError:
        return []


def _children(pid: int) -> list[int]:
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="utf-8").split()]


def progress(out: Path) -> tuple[dict[str, int], int]:
    """Return how many episodes each cell that is done had, and how many of the others are stored."""
    try:
        rows = json.loads((out / "campaign.json").read_text(encoding="utf-8"))["cells"]
    except FileNotFoundError:
        return {}, 0
    done = {row["name"]: row["episodes"] for row in rows if row["state"] == "done"}
    if not (out / FILE_NAME).exists():
        return done, 0
    with tempfile.TemporaryDirectory() as copy:  # to look at it is to tidy up in it
        for path in out.glob(f"{FILE_NAME}*"):
            shutil.copy(path, copy)
        connection = sqlite3.connect(Path(copy) / FILE_NAME)
        try:
            ((tables,),) = connection.execute("SELECT count(*) FROM sqlite_master")
            ((count,),) = connection.execute("SELECT count(*) FROM episodes") if tables else ((0,),)
        finally:
            connection.close()
    return done, int(count)


def _crossings(whole: Path) -> int:
    """Return how many safe trajectories each cell has driven itself: episodes, too, which its row does not count."""
    content = json.loads((whole / "campaign.json").read_text(encoding="utf-8"))
    rows = content["cells"]
    return int((content["episodes_run"] - sum(row["episodes"] for row in rows)) // len(rows))


def differences(out: Path, whole: Path) -> list[str]:
    """Return in what two campaigns differ."""
    found = []
    cells = sorted(path.name for path in whole.iterdir() if path.is_dir())
    others = sorted(path.name for path in out.iterdir() if path.is_dir())
    if cells != others:
        return [f"cells {others}, not {cells}"]
    for cell in cells:
        if (out / cell / "episodes.npz").read_bytes() != (whole / cell / "episodes.npz").read_bytes():
            found.append(f"{cell}/episodes.npz")
        if _figures(out / cell) != _figures(whole / cell):
            found.append(f"{cell}/assessment.json")
    if _rows(out) != _rows(whole):
        found.append("campaign.csv")
    found.extend(f"{path.name} is left" for path in out.glob(f"{FILE_NAME}*"))
    return found


def _figures(folder: Path) -> dict[str, Any]:
    content = json.loads((folder / "assessment.json").read_text(encoding="utf-8"))
    return {name: value for name, value in content.items() if name not in _OF_THE_CLOCK}


def _rows(out: Path) -> list[dict[str, str]]:
    with (out / "campaign.csv").open(encoding="utf-8", newline="") as file:
        return [{name: text for name, text in row.items() if name != "seconds"} for row in csv.DictReader(file)]


def undisturbed(file: Path, out: Path, where: Processes) -> tuple[float, float]:
    """Run a campaign to its end, and return after how long its first episode was stored, and it was done, s."""
    begin, first = time.monotonic(), 0.0
    wal = out / f"{FILE_NAME}-wal"
    with subprocess.Popen(command(file, out, where)) as process:
        while process.poll() is None:
            if not first and wal.exists() and wal.stat().st_size > _EMPTY:
                first = time.monotonic() - begin
            time.sleep(_POLL)
    if process.returncode != 0:
        raise RuntimeError(f"a campaign that nobody disturbed ended with {process.returncode}")
    return first, time.monotonic() - begin


def disturbed(
    file: Path,
    out: Path,
    whole: Path,
    what: str,
    where: Processes,
    moments: Sequence[Callable[[float], bool]],
    draws: random.Random,
) -> Killed | None:
    """Run a campaign, kill a process, resume it where it ended and kill again, resume it to its end, and compare.

    Args:
        file: of the campaign.
        out: a folder that is not there.
        whole: that of a campaign that nobody disturbed.
        what: whom to kill.
        where: it runs.
        moments: of each kill whether it is time, by the seconds since the start.
        draws: which of several.

    Returns:
        What came of it; None where there was nobody to kill any more.
    """
    for number, is_time in enumerate(moments):
        killed, code = _kill(command(file, out, where, *(["--resume"] if number else [])), what, where, is_time, draws)
        if killed is None:
            return None
        done, kept = progress(out)
        state = f"{len(done)} cells done, {kept} episodes kept"
        if code == 0:
            return Killed(killed, state, False, tuple(differences(out, whole)))
    for _ in range(_TRIES):
        ended = subprocess.run(command(file, out, where, "--resume"), stderr=subprocess.PIPE, timeout=_PATIENCE)
        if ended.returncode == 0:
            break
        print(f"the resumed campaign ended with {ended.returncode}: {ended.stderr.decode().strip()}", flush=True)
        where.repair()
        done, kept = progress(out)
    else:
        return Killed(killed, state, True, (f"it could not be resumed in {_TRIES} tries",))
    found = differences(out, whole)
    content = json.loads((out / "campaign.json").read_text(encoding="utf-8"))
    open_cells = [row for row in content["cells"] if row["name"] not in done]
    expected = sum(row["episodes"] for row in open_cells) + len(open_cells) * _crossings(whole) - kept
    if content["episodes_run"] != expected:
        found.append(f"{content['episodes_run']} episodes run, {expected} were missing")
    return Killed(killed, state, True, tuple(found))


def _kill(
    words: list[str], what: str, where: Processes, is_time: Callable[[float], bool], draws: random.Random
) -> tuple[float | None, int]:
    """Run a campaign and kill a process; return when, None where there was nobody, and the campaign's exit code."""
    with subprocess.Popen(words, stderr=subprocess.DEVNULL) as process:
        begin = time.monotonic()
        victim = None
        while process.poll() is None and victim is None:
            if is_time(time.monotonic() - begin):
                victim = where.victim(what, process, draws)
            time.sleep(_POLL)
        killed: float | None = None
        if victim is not None:
            with suppress(ProcessLookupError):
                os.kill(victim, signal.SIGKILL)
                killed = time.monotonic() - begin
                where.repair()
        return killed, process.wait(_PATIENCE)


def main(argv: Sequence[str] | None = None) -> int:
    """Kill and compare; exit code 1 where something differs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--what", choices=Cluster.targets, default="parent", help="whom to kill (default parent)")
    parser.add_argument("--cluster", action="store_true", help="on a Dask cluster of this machine, as for scheduler")
    parser.add_argument("--kills", type=whole_number(1), default=20, metavar="N", help="how often (default 20)")
    parser.add_argument("--workers", type=whole_number(1), default=2, metavar="N", help="how many (default 2)")
    parser.add_argument("--seed", type=whole_number(0), default=0, metavar="N", help="of the moments (default 0)")
    parser.add_argument("--file", type=Path, help="another campaign than this benchmark's own")
    arguments = parser.parse_args(argv)
    draws = random.Random(arguments.seed)
    failed = count = 0
    with tempfile.TemporaryDirectory(prefix="skd-kills-") as name, ExitStack() as stack:
        folder = Path(name)
        file = arguments.file or folder / "campaign.yaml"
        if arguments.file is None:
            file.write_text(CAMPAIGN, encoding="utf-8")
        on_cluster = arguments.cluster or arguments.what not in Processes.targets
        where = Cluster(arguments.workers, folder, stack) if on_cluster else Processes(arguments.workers)
        undisturbed(file, folder / "first", where)  # compiles
        first, seconds = undisturbed(file, folder / "whole", where)
        print(f"undisturbed: {seconds:.1f} s, the first episode stored after {first:.1f} s", flush=True)
        if found := differences(folder / "first", folder / "whole"):
            print(f"two undisturbed ones differ: {found}")
            return 1
        while count < arguments.kills:
            out, after = folder / "out", draws.uniform(0.8 * first, seconds)
            killed = disturbed(file, out, folder / "whole", arguments.what, where, [partial(operator.le, after)], draws)
            shutil.rmtree(out, ignore_errors=True)
            if killed is None:
                continue  # it had ended before
            count += 1
            failed += bool(killed.differences)
            end = "resumed" if killed.resumed else "went on"
            verdict = "; ".join(killed.differences) or "identical"
            print(f"{arguments.what} killed after {killed.after:5.1f} s: {killed.state}; {end}: {verdict}", flush=True)
    print(f"{arguments.what}: {count} kills, {count - failed} identical")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
