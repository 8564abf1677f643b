"""Fuzzes one target for long: `scripts/fuzz TARGET --hours 2`, in one process, led by what code an input reaches.

`TARGET` gets bytes. `TARGET-structure` gets inputs that are put together as right ones are and then changed
(`fuzz_structures.py`), from choices that are led in the same way. Inputs that reach something new are kept below
`.fuzz/`, where the next run begins; what ends a run is written there as `TARGET-crash-…`, `…-timeout-…` or `…-oom-…`.
Give it back with `scripts/fuzz TARGET FILE`. What each run came to is a line of `.fuzz/runs.csv`. `scripts/fuzz all` is
all targets in turn (`fuzz_all.py`); `scripts/fuzz keep` leaves in the repository what they came to (`fuzz_keep.py`).
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import random
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import atheris

_INSTRUMENTED = [
    "csv", "json", "mcap", "rosbags.typesys", "skd_adversary.car_model_file", "skd_adversary.safe_trajectories",
    "skd_evaluator.arrays", "skd_evaluator.bags", "skd_evaluator.campaign.store", "skd_evaluator.campaigns",
    "skd_evaluator.fusion", "skd_evaluator.measure.behaviour", "skd_evaluator.ncap", "skd_evaluator.risk.behaviour",
    "skd_sim.choices.options", "skd_sim.encounter", "skd_sim.episode", "skd_sim.inputs",
    "skd_sim.messages", "yaml", "zipfile",
]  # fmt: skip
"""Packages of readers."""
_PACKAGES = Path(__file__).resolve().parents[2] / "ros_ws" / "src"
_KERNELS = [
    ".".join(path.relative_to(package).with_suffix("").parts)
    for package in _PACKAGES.iterdir()
    for path in (package / package.name).rglob("*.py")
    if "kernel" in path.read_text(encoding="utf-8")
]
"""Modules among them that numba compiles, which it cannot where they have been instrumented."""

with (
    contextlib.redirect_stderr(io.StringIO()),  # a line for each module
    atheris.instrument_imports(include=_INSTRUMENTED, exclude=_KERNELS, enable_loader_override=False),
):
    from fuzz_all import HEADER, RUNS
    from fuzz_all import main as fuzz_all
    from fuzz_keep import main as fuzz_keep
    from fuzz_keep import unpack
    from fuzz_structures import STRUCTURES
    from fuzz_targets import HERE, TARGETS, Target
    from numba.core.event import install_recorder

_LONGEST = 20.0
"""s of processor time that an input may take."""
_STUCK = 300
"""s after which an input is taken for one that never ends, on however busy a machine."""
_MEMORY = 2000
"""MB that the process may have."""


class _Reading:
    """Reads inputs until the processor time is used up."""

    def __init__(self, name: str, target: Target, seconds: float, kept: Path) -> None:
        self._name = name
        self._target = target
        self._folder = Path(tempfile.mkdtemp(dir="/dev/shm" if Path("/dev/shm").is_dir() else None))
        self._seconds = seconds
        self._count = 0
        self._kept = kept
        self._known = _files(kept)
        self._first = self._known
        self._latest = self._looked = 0.0  # processor time at which something new was seen, and was looked for

    def of_bytes(self, data: bytes) -> None:
        with self._timed():
            self._target.run(data, self._folder)

    def of_structures(self, data: bytes) -> None:
        with self._timed():
            STRUCTURES[self._target.name](self._target, self._folder).hypothesis.fuzz_one_input(data)

    @contextlib.contextmanager
    def _timed(self) -> Iterator[None]:
        begin = time.process_time()
        with install_recorder("numba:compile") as compiled:
            yield
        end = time.process_time()
        if not compiled.buffer:  # whichever input comes first to a kernel pays for it, on a machine that has none
            assert end - begin <= _LONGEST, f"an input took {end - begin:.0f} s of processor time"
        self._count += 1
        if end - self._looked >= self._seconds / 200:
            self._looked, count = end, _files(self._kept)
            if count > self._known:
                self._known, self._latest = count, end
        if end > self._seconds:
            self._tell()
            self.close()
            raise KeyboardInterrupt  # libFuzzer ends with what it knows

    def _tell(self) -> None:
        minutes, latest, new = self._seconds / 60.0, self._latest / 60.0, self._known - self._first
        print(
            f"{self._name}: {self._count} inputs in {minutes:.1f} processor minutes, no finding; {new} reached "
            f"something new, the last of them after {latest:.1f} minutes"
        )
        sys.stdout.flush()
        runs = self._kept.parent / RUNS
        if not runs.exists():
            runs.write_text(HEADER)
        with runs.open("a") as file:
            file.write(f"{self._name},{minutes:.3f},{self._count},{new},{latest:.1f}\n")

    def close(self) -> None:
        shutil.rmtree(self._folder, ignore_errors=True)


def _files(folder: Path) -> int:
    return sum(1 for _ in os.scandir(folder))


def main() -> None:
    names = [*TARGETS, *(f"{name}-structure" for name in STRUCTURES)]
    if sys.argv[1:2] == ["all"]:
        sys.exit(fuzz_all(names))
    if sys.argv[1:2] == ["keep"]:
        sys.exit(fuzz_keep(names))
    parser = argparse.ArgumentParser(prog="scripts/fuzz", description=(__doc__ or "").partition("\n")[0])
    said = f"{', '.join(names)}; or all, in turn; or keep, what they came to"
    parser.add_argument("target", choices=names, metavar="TARGET", help=said)
    parser.add_argument("inputs", nargs="*", metavar="FILE", help="only read these inputs")
    parser.add_argument("--hours", type=float, default=2.0, help="of processor time (default: %(default)s)")
    parser.add_argument("--as", dest="name", help=argparse.SUPPRESS)  # of fuzz_keep's, with words of libFuzzer's
    end = sys.argv.index("--") if "--" in sys.argv else len(sys.argv)
    given = parser.parse_args(sys.argv[1:end])
    given.inputs += sys.argv[end + 1 :]
    name, _, structured = given.target.partition("-")
    found = HERE.parents[1] / ".fuzz" / given.target
    found.mkdir(parents=True, exist_ok=True)
    reading = _Reading(given.target, TARGETS[name], 3600.0 * given.hours, found)
    one = reading.of_structures if structured else reading.of_bytes
    if given.inputs:
        words = given.inputs
    else:
        unpack(given.target, found)
        seeds = [str(HERE / "corpus" / name)]
        if structured:
            seeds = []
            for number in range(32):  # choices, of which hypothesis needs some thousands
                content = random.Random(number).randbytes(256 << number % 6)
                (found / f"random-{number}").write_bytes(content)
        words = [
            f"-artifact_prefix={found.parent}/{given.target}-", f"-timeout={_STUCK}", f"-rss_limit_mb={_MEMORY}",
            "-max_len=65536", "-print_final_stats=1", "-len_control=0", str(found), *seeds,
        ]  # fmt: skip
    atheris.Setup([given.name or sys.argv[0], *words], one)
    try:
        atheris.Fuzz()
    finally:
        reading.close()


if __name__ == "__main__":
    main()
