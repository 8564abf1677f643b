"""Whether anything grows over many episodes: `python benchmarks/soak.py --episodes 20000`.

Runs assessments in process, one after the other in one Python, with a controller of its own in a process apart; after
each it looks at memory, open files, threads, children, `/dev/shm` and temporary files. `--graph` runs them through one
graph of nodes each, `--reset restart` with a stack that is started anew for each episode. The first quarter is for what
is made once; what grows after it is said, and is a failure.

Memory is what the kernel counts (`VmRSS`). Beside it stands what of it the C library has handed out and not got back,
what it keeps free, and how many objects Python holds: they tell a leak from memory that is kept for the next time.
Objects are counted when caches that have a greatest size (`functools.lru_cache`, and CPython's own of attributes) were
emptied: they grow up to it.
"""

from __future__ import annotations

import argparse
import ctypes
import functools
import gc
import json
import os
import shutil
import sys
import tempfile
import threading
from pathlib import Path

from skd_evaluator.cli.main import main as skd

HERE = Path(__file__).resolve().parent

FEWEST, ROUNDS = 40, 100
"""Episodes of one assessment, at the least, half of them kamikazes along two φ; and assessments, at the most."""
CONTROLLER = "cars.required_brake:RequiredDecelerationBrake"
MOST_MEMORY = 5e-4
"""MB for each episode: ten in 20,000."""


class Heap(ctypes.Structure):
    """What `mallinfo2(3)` answers: bytes of all arenas of the C library."""

    _fields_ = [
        ("arena", ctypes.c_size_t),
        ("ordblks", ctypes.c_size_t),
        ("smblks", ctypes.c_size_t),
        ("hblks", ctypes.c_size_t),
        ("hblkhd", ctypes.c_size_t),
        ("usmblks", ctypes.c_size_t),
        ("fsmblks", ctypes.c_size_t),
        ("uordblks", ctypes.c_size_t),
        ("fordblks", ctypes.c_size_t),
        ("keepcost", ctypes.c_size_t),
    ]


def heap() -> Heap:
    """Return what the C library has handed out and keeps, of all threads."""
    library = ctypes.CDLL(None)
    library.mallinfo2.restype = Heap
    found: Heap = library.mallinfo2()
    return found


def empty_caches() -> int:
    """Empty the caches of functions that have a greatest size; return how many entries they had.

    Modules are looked through: what was imported for good is hidden from `gc.get_objects` (`gc.freeze`).
    """
    named = [one for module in list(sys.modules.values()) for one in list(vars(module).values())]
    caches = {id(one): one for one in named if type(one) is functools._lru_cache_wrapper}
    bounded = [one for one in caches.values() if one.cache_info().maxsize is not None]
    entries = sum(one.cache_info().currsize for one in bounded)
    for one in bounded:
        one.cache_clear()
    return entries


def state(scratch: Path) -> dict[str, float]:
    """Return what there is now of everything that can leak."""
    cached = empty_caches()
    sys._clear_type_cache()  # of CPython: up to 4,096 names by which attributes were looked up
    gc.collect()
    status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines() if ":" in line)
    children = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
    of_c = heap()
    return {
        "memory, MB": int(status["VmRSS"].split()[0]) / 1024,
        "handed out, MB": round((of_c.uordblks + of_c.hblkhd) / 2**20, 2),
        "kept free, MB": round(of_c.fordblks / 2**20, 2),
        "objects": sys.getallocatedblocks(),
        "cached": cached,
        "descriptors": len(list(Path("/proc/self/fd").iterdir())),
        "threads": threading.active_count(),
        "children": len(children),
        "/dev/shm": len(list(Path("/dev/shm").iterdir())),
        "temporary files": len(list(scratch.rglob("*"))),
    }


def main() -> int:
    """Run; return 1 if something has grown."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=20_000)
    parser.add_argument("--graph", action="store_true")
    parser.add_argument("--reset", default="", help="with --graph, how a stack is reset")
    parser.add_argument("--graphs", default="1", help="with --graph, how many graphs run side by side")
    parser.add_argument("--behaviour", default="walkers", help="none: no crossings of the risk besides")
    given = parser.parse_args()
    sys.path.insert(0, str(HERE))
    os.environ["PYTHONPATH"] = str(HERE)
    each = max(FEWEST, -(-given.episodes // ROUNDS))
    each += -each % 4
    rounds = max(4, given.episodes // each)
    with tempfile.TemporaryDirectory() as name:
        scratch = Path(name)
        os.environ["TMPDIR"] = tempfile.tempdir = str(scratch / "temporary")
        (scratch / "temporary").mkdir()
        words = ["assess", "--safe-count", "2", "--kamikaze-count", f"{each // 4}", "--collision-runs", f"{each // 2}"]
        words += [
            "--quiet",
            "--behaviour",
            given.behaviour,
            "--simulations",
            "20",
            "--margin-limit",
            "0",
            "--knowledge",
            "nothing",
            "--out",
            str(scratch / "out"),
        ]
        if given.graph:
            words += ["--graph", "--graphs", given.graphs, *(["--reset", given.reset] if given.reset else [])]
        else:
            words += ["--controller", CONTROLLER, "--workers", "1"]
        seen: list[dict[str, float]] = []
        aborted = 0
        for number in range(rounds):
            assert skd([*words, "--seed", str(number)]) in (0, 1)
            told = json.loads((scratch / "out" / "assessment.json").read_text())
            aborted += told["aborted"]
            shutil.rmtree(scratch / "out")
            seen.append(state(scratch))
            if number % max(1, rounds // 20) == 0:
                print(f"{(number + 1) * each}: {seen[-1]}", flush=True)
    first, last = seen[rounds // 4], seen[-1]
    episodes = (rounds - 1 - rounds // 4) * each
    grown = {name: last[name] - first[name] for name in first if last[name] > first[name]}
    print(f"from {(rounds // 4 + 1) * each} to {rounds * each} episodes grown by {grown}; {aborted} were aborted")
    grown = {
        name: grown[name] for name in grown if name not in ("handed out, MB", "kept free, MB", "objects", "cached")
    }
    grown.pop("/dev/shm", None)  # in which others of this machine have files, too
    slow = grown.pop("memory, MB", 0.0) <= max(5.0, MOST_MEMORY * episodes)
    return 0 if slow and not grown and aborted <= 0.01 * rounds * each else 1


if __name__ == "__main__":
    raise SystemExit(main())
