"""Kills a campaign at random moments, resumes it, and holds what comes out against a campaign that nobody disturbed.

Identical means: episodes.npz of every cell to the last bit, assessment.json but for time and provenance, campaign.csv
but for its column of seconds. Counted, too, is that a resumed campaign runs no episode that was stored, and all others.
"""

from __future__ import annotations

import argparse
import csv
import json
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
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from skd_evaluator.cells.store import FILE_NAME
from skd_evaluator.cli.arguments import whole_number

CAMPAIGN = """
defaults: {safe_count: 2, kamikaze_count: 20, collision_runs: 20, simulations: 200}
cars:
  - {controller: basic, sweep: {multiplier: [0.75, 1.0]}}
sweep:
  scenario.car.start_speed: [7.0, 8.0]
"""
_PATIENCE = 900.0  # s for what must end
_POLL = 0.02


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


def command(file: Path, out: Path, workers: int, *more: str) -> list[str]:
    """Return the command line of a campaign."""
    words = ["campaign", str(file), "--out", str(out), "--workers", str(workers), "-q", *more]
    return [sys.executable, "-m", "skd_evaluator", *words]


def children(pid: int) -> list[int]:
    """Return the processes that a process has started (Linux)."""
    try:
        return [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="utf-8").split()]
    except OSError:
        return []


def parent(process: subprocess.Popen[bytes], _draws: random.Random) -> int | None:
    """Choose the campaign's own process."""
    return process.pid


def worker(process: subprocess.Popen[bytes], draws: random.Random) -> int | None:
    """Choose one of its workers, where there is one."""
    found = children(process.pid)
    return draws.choice(found) if found else None


TARGETS: dict[str, Callable[[subprocess.Popen[bytes], random.Random], int | None]] = {
    "parent": parent,
    "worker": worker,
}


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
    return {name: value for name, value in content.items() if name not in ("seconds", "provenance")}


def _rows(out: Path) -> list[dict[str, str]]:
    with (out / "campaign.csv").open(encoding="utf-8", newline="") as file:
        return [{name: text for name, text in row.items() if name != "seconds"} for row in csv.DictReader(file)]


def undisturbed(file: Path, out: Path, workers: int) -> float:
    """Run a campaign to its end, and return how long it took, s."""
    begin = time.monotonic()
    subprocess.run(command(file, out, workers), check=True, timeout=_PATIENCE)
    return time.monotonic() - begin


def disturbed(
    file: Path, out: Path, whole: Path, what: str, after: float, workers: int, draws: random.Random
) -> Killed | None:
    """Run a campaign, kill a process of it, resume it where it ended, and compare; None: there was none to kill."""
    with subprocess.Popen(command(file, out, workers), stderr=subprocess.DEVNULL) as process:
        begin = time.monotonic()
        victim = None
        while process.poll() is None and victim is None:
            if time.monotonic() - begin >= after:
                victim = TARGETS[what](process, draws)
            time.sleep(_POLL)
        if victim is None:
            return None
        killed = time.monotonic() - begin
        try:
            os.kill(victim, signal.SIGKILL)
        except ProcessLookupError:
            return None
        code = process.wait(_PATIENCE)
    done, kept = progress(out)
    state = f"{len(done)} cells done, {kept} episodes kept"
    if code == 0:
        return Killed(killed, state, False, tuple(differences(out, whole)))
    subprocess.run(command(file, out, workers, "--resume"), check=True, timeout=_PATIENCE)
    found = differences(out, whole)
    content = json.loads((out / "campaign.json").read_text(encoding="utf-8"))
    open_cells = [row for row in content["cells"] if row["name"] not in done]
    expected = sum(row["episodes"] for row in open_cells) - kept
    if content["episodes_run"] != expected:
        found.append(f"{content['episodes_run']} episodes run, {expected} were missing")
    return Killed(killed, state, True, tuple(found))


def main(argv: Sequence[str] | None = None) -> int:
    """Kill and compare; exit code 1 where something differs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--what", choices=tuple(TARGETS), default="parent", help="whom to kill (default parent)")
    parser.add_argument("--kills", type=whole_number(1), default=20, metavar="N", help="how often (default 20)")
    parser.add_argument("--workers", type=whole_number(1), default=2, metavar="N", help="of the campaign (default 2)")
    parser.add_argument("--seed", type=whole_number(0), default=0, metavar="N", help="of the moments (default 0)")
    parser.add_argument("--file", type=Path, help="another campaign than this benchmark's own")
    arguments = parser.parse_args(argv)
    draws = random.Random(arguments.seed)
    failed = count = 0
    with tempfile.TemporaryDirectory(prefix="skd-kills-") as name:
        folder = Path(name)
        file = arguments.file or folder / "campaign.yaml"
        if arguments.file is None:
            file.write_text(CAMPAIGN, encoding="utf-8")
        undisturbed(file, folder / "first", arguments.workers)  # compiles
        seconds = undisturbed(file, folder / "whole", arguments.workers)
        print(f"undisturbed: {seconds:.1f} s", flush=True)
        if found := differences(folder / "first", folder / "whole"):
            print(f"two undisturbed ones differ: {found}")
            return 1
        while count < arguments.kills:
            out = folder / "out"
            after = draws.uniform(0.0, seconds)
            killed = disturbed(file, out, folder / "whole", arguments.what, after, arguments.workers, draws)
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
