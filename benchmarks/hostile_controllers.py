"""Hostile controllers: `.venv/bin/python benchmarks/hostile_controllers.py [NAME...]`; by default all of them.

Each is a class that attacks what runs it: `commands` and `command` of two cars, copies that are others or share what
they keep, answers that are no numbers, a process that stops, sleeps or ends, one that says something behind the guard,
looks into other processes, remembers. Each is assessed in small, in a process that is forked from one with all imports;
its figures stand beside those of the honest car, with what was said. A traceback, a hang or a process that is left is
a failure. Some are just another car, the same to whoever asks, and no cheats: `ListsParent`, `TwoFloats`, `MinusZero`.
Options that are not its own go to `skd assess`: `--scenario=cyclist` lets them meet a cyclist.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import importlib
import json
import os
import pkgutil
import shutil
import sys
import tempfile
import time
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import skd_evaluator.cli
from forked_child import end_of
from hostile_cars_further import FURTHER
from hostile_cars_source import CARS as FIRST
from hostile_cars_whole import WHOLE
from skd_evaluator.cli.main import main as skd
from skd_evaluator.start import skd as program

CARS = FIRST + FURTHER + WHOLE
BASES = ("Honest", "Batch")
_HELPERS = ("Copied", "Mad", "Says")
_COUNTS = ["--safe-count", "3", "--kamikaze-count", "5", "--collision-runs", "30", "--risk-runs", "150"]
_SMALL = ["--simulations", "60", "--knowledge", "nothing", "--margin-limit", "32", "--startup-timeout", "6"]
_OPTIONS = [*_COUNTS, *_SMALL, "--workers", "1", "--no-pictures", "--quiet"]
_FIGURES = ("margin", "deformation", "risk_1", "risk_2")
_LIMIT = 600.0  # s for an assessment
_CHILD = b"sleep\x001000\x00"  # command line of what one of them starts


def assessed(name: str, folder: Path, further: Sequence[str] = ()) -> tuple[int | None, str, dict[str, Any]]:
    """Assess a controller; return the exit code (None: not within the time), what was said, and the result."""
    out, error = folder / name, folder / "error"
    error.write_bytes(b"")
    child = os.fork()
    if child == 0:
        os.setsid()
        nowhere = os.open(os.devnull, os.O_RDWR)
        for number, file in enumerate((nowhere, nowhere, os.open(error, os.O_WRONLY))):
            os.dup2(file, number)
        sys.argv = ["skd", "assess", "--controller", f"hostile_cars:{name}", *_OPTIONS, *further, "--out", str(out)]
        code: object = 99
        try:
            code = program()
        except SystemExit as end:
            code = end.code
        except BaseException:
            traceback.print_exc()
        os._exit(code if isinstance(code, int) else 99)
    code_of = end_of(child, _LIMIT)
    result = json.loads((out / "assessment.json").read_text()) if (out / "assessment.json").exists() else {}
    return code_of, error.read_text(errors="replace"), result


def _left() -> list[str]:
    """Return the processes that a controller has started and that are still there."""
    found = []
    for file in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):
            if file.read_bytes() == _CHILD:
                found.append(file.parent.name)
    return found


def main() -> int:
    """Assess them; return 1 if one of them broke something."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    known = [line.split("(")[0].split()[1] for line in CARS.splitlines() if line.startswith("class ") and "(" in line]
    parser.add_argument("name", nargs="*", help="of a controller")
    given, further = parser.parse_known_args()
    names = given.name or [name for name in known if name not in (*_HELPERS, *BASES)]
    for module in pkgutil.walk_packages(skd_evaluator.cli.__path__, "skd_evaluator.cli."):
        importlib.import_module(module.name)
    broken = 0
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        (folder / "hostile_cars.py").write_text(CARS)
        sys.path.insert(0, temporary)
        os.environ["PYTHONPATH"] = temporary
        assert skd(
            ["assess", "--controller", "hostile_cars:Batch", *_OPTIONS, *further, "--out", str(folder / "first")]
        ) in (
            0,
            1,
        )
        gc.freeze()
        for name in (*BASES, *names):
            begin = time.monotonic()
            code, error, result = assessed(name, folder, further)
            left = _left()
            wrong = code not in (0, 1, 2) or "Traceback" in error or bool(left)
            broken += wrong
            figures = "".join(f"{result[key]:9.3f}" if result.get(key) is not None else "        –" for key in _FIGURES)
            said = (
                [*result["warnings"], result["margin_note"], result["risk_note"]] if result else [error.strip()[-200:]]
            )
            said = [
                " ".join(line.split())[:110]
                for line in said
                if line and "converged" not in line and "times the" not in line
            ]
            mark = "BROKEN" if wrong else ""
            print(
                f"{name:20}{code!s:>5}{time.monotonic() - begin:6.0f} s{figures}  {mark} {' | '.join(said)}", flush=True
            )
            shutil.rmtree(folder / name, ignore_errors=True)
    print(f"{len(names)} controllers, {broken} broke something")
    return 1 if broken else 0


if __name__ == "__main__":
    raise SystemExit(main())
