"""Keeps what fuzzing came to in the repository: `scripts/fuzz keep`, after a run.

Of the inputs below `.fuzz/TARGET` those are chosen that together reach as much as all of them (libFuzzer's merge);
they become `tests/fuzz/grown/TARGET.zip`, where the next run begins, on whichever machine. The lines of
`.fuzz/runs.csv` move into `tests/fuzz/runs.csv`, so that processor time adds up over machines.
"""

from __future__ import annotations

import argparse
import os
import shlex
import subprocess
import sys
import tempfile
import zipfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from fuzz_all import HEADER, HERE, KEPT, LEDGER, RUNS

GROWN = HERE / "grown"
_LARGEST = 4096
"""Bytes of an input that is kept."""
_WHEN = (1980, 1, 1, 0, 0, 0)  # the same inputs are the same file


def unpack(target: str, folder: Path) -> None:
    """Write the inputs that the repository keeps for a target into a folder."""
    if (GROWN / f"{target}.zip").exists():
        with zipfile.ZipFile(GROWN / f"{target}.zip") as archive:
            archive.extractall(folder)


def _pack(folder: Path, path: Path) -> int:
    inputs = sorted(one for one in folder.iterdir() if one.stat().st_size <= _LARGEST)
    new = path.with_suffix(".new")
    with zipfile.ZipFile(new, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for one in inputs:
            archive.writestr(zipfile.ZipInfo(one.name, _WHEN), one.read_bytes(), zipfile.ZIP_DEFLATED)
    new.replace(path)
    return len(inputs)


def merge(target: str) -> str:
    """Choose and pack the inputs of a target; return a line that says how many they are."""
    all_inputs = KEPT / target
    unpack(target, all_inputs)
    with tempfile.TemporaryDirectory() as held:
        chosen, again = Path(held, "chosen"), Path(held, "again")
        chosen.mkdir()
        # libFuzzer reads them in a process that it begins by its own first word, and again where one ended it.
        words = shlex.join([sys.executable, str(HERE / "fuzz_long.py"), target, "--as", str(again)])
        again.write_text(f'#!/bin/sh\nexec {words} -- "$@"\n')
        again.chmod(0o755)
        done = subprocess.run(
            [str(again), "-merge=1", "-max_len=65536", str(chosen), str(all_inputs)],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            check=False,
        )
        if done.returncode:
            return f"{target}: not kept: {done.stdout.decode(errors='replace')[-400:]}"
        GROWN.mkdir(exist_ok=True)
        count = _pack(chosen, GROWN / f"{target}.zip")
    size = (GROWN / f"{target}.zip").stat().st_size
    return f"{target}: {count} of {len(list(all_inputs.iterdir()))} inputs are kept, {size / 1000:.0f} kB"


def main(targets: list[str]) -> None:
    """Keep what all targets, or those that are named, came to."""
    parser = argparse.ArgumentParser(prog="scripts/fuzz keep", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("targets", nargs="*", metavar="TARGET", help="by default all that have run here")
    given = parser.parse_args(sys.argv[2:])
    for one in given.targets:
        if one not in targets:
            parser.error(f"there is no target {one}; there are {', '.join(targets)}")
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for line in pool.map(merge, given.targets or [one for one in targets if (KEPT / one).is_dir()]):
            print(line, flush=True)
    if (KEPT / RUNS).exists():
        header, *lines = (KEPT / RUNS).read_text().splitlines(keepends=True)
        before = LEDGER.read_text() if LEDGER.exists() else HEADER
        assert header == HEADER, f"{KEPT / RUNS} begins with another line than {HEADER.strip()}"
        LEDGER.with_suffix(".new").write_text(before + "".join(lines))
        LEDGER.with_suffix(".new").replace(LEDGER)
        (KEPT / RUNS).unlink()
