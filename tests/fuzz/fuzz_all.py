"""Fuzzes every target in turn until each has had its hours: `scripts/fuzz all --hours 2`, in a night, or in several.

Each run of a target takes ten minutes of processor time; who has had least is next, and runs before count: those in
`.fuzz/runs.csv`, and those that the repository knows of (`runs.csv` beside this module). A target that finds something
is left alone from then on, and the exit code is 1 in the end.
"""

from __future__ import annotations

import argparse
import csv
import os
import subprocess
import sys
from collections import Counter
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from pathlib import Path

HERE = Path(__file__).resolve().parent
KEPT = HERE.parents[1] / ".fuzz"
RUNS = "runs.csv"
LEDGER = HERE / RUNS
"""What earlier runs came to, on this machine or another one; `scripts/fuzz keep` moves `.fuzz/runs.csv` into it."""
HEADER = "target,processor_minutes,inputs,new,last_new_minute\n"
_MINUTES = 10.0  # of a run


def minutes_of(*tables: Path) -> Counter[str]:
    """Return the processor minutes that each target has had without a finding, as tables of runs have them."""
    found: Counter[str] = Counter()
    for path in tables:
        if path.exists():
            with path.open(newline="") as file:
                for row in csv.DictReader(file):
                    found[row["target"]] += float(row["processor_minutes"])  # type: ignore[assignment]
    return found


def next_of(targets: list[str], had: Counter[str], busy: set[str], wanted: float) -> tuple[str, float] | None:
    """Return which target is next, and for how many minutes; None: nobody who is not busy wants any more."""
    waiting = [one for one in targets if one not in busy and had[one] < wanted - 1e-6]
    if not waiting:
        return None
    target = min(waiting, key=lambda one: had[one])
    return target, min(_MINUTES, wanted - had[target])


def run(target: str, minutes: float) -> tuple[str, bool]:
    """Fuzz a target for some processor minutes; return it, and whether it has had as many without a finding."""
    had = minutes_of(LEDGER, KEPT / RUNS)[target]
    log = KEPT / f"{target}.log"
    with log.open("wb") as file:
        words = [sys.executable, str(HERE / "fuzz_long.py"), target, "--hours", repr(minutes / 60.0)]
        subprocess.run(words, stdout=file, stderr=subprocess.STDOUT, check=False)
    return target, minutes_of(LEDGER, KEPT / RUNS)[target] > had


def main(targets: list[str]) -> int:
    """Fuzz all targets; return the exit code."""
    parser = argparse.ArgumentParser(prog="scripts/fuzz all", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--hours", type=float, default=2.0, help="of processor time, each (default: %(default)s)")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="at once (default: one per core)")
    given = parser.parse_args(sys.argv[2:])
    KEPT.mkdir(exist_ok=True)
    failed: list[str] = []
    running: set[Future[tuple[str, bool]]] = set()
    busy: set[str] = set()
    with ThreadPoolExecutor(given.workers) as pool:
        while True:
            had = minutes_of(LEDGER, KEPT / RUNS)
            while len(running) < given.workers and (one := next_of(targets, had, busy, 60.0 * given.hours)):
                busy.add(one[0])
                running.add(pool.submit(run, *one))
            if not running:
                break
            done, running = wait(running, return_when=FIRST_COMPLETED)
            had = minutes_of(LEDGER, KEPT / RUNS)
            for target, fine in (one.result() for one in done):
                if fine:
                    busy.remove(target)
                    print(f"{target}: {had[target]:.1f} processor minutes without a finding")
                else:
                    failed.append(target)  # and stays busy: it would find the same again
                    print(f"{target}: a finding after {had[target]:.1f} minutes; {KEPT / target}.log says which")
                sys.stdout.flush()
    return 1 if failed else 0
