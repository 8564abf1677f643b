"""Odd values for every option of every command: `.venv/bin/python benchmarks/odd_values.py --each 3 --seed 0`.

Each option gets some of `VALUES` (and of its own choices), in a small run of its command, and each key of a campaign's
file some of them, too; each run is a process that is
forked from one with all imports. Right is an exit code of 0, 1 or 2 within the time, with 2 one line and nothing
written, no traceback, and no temporary folder left. Whatever is not right is printed, and the exit code is then 1.
Commands that need a graph or a terminal (`episode`, `drive`) are left out, and options that name a server.
"""

from __future__ import annotations

import argparse
import collections
import gc
import importlib
import itertools
import json
import os
import pkgutil
import random
import shutil
import sys
import tempfile
import traceback
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np
import skd_evaluator.cli
import yaml
from bag_forge import campaign_messages, write_mcap
from forked_child import end_of
from mutations import CROSSING, campaign
from skd_evaluator.campaign.plan.options import CampaignOptions
from skd_evaluator.cli.arguments import whole_number
from skd_evaluator.cli.main import main as skd
from skd_evaluator.cli.parser import commands_of, make_parser
from skd_evaluator.measure.behaviour.model import load_behaviour
from skd_evaluator.measure.behaviour.walking import normals_of
from skd_evaluator.risk.behaviour.fit import LEAST_TRACKS, simulated
from skd_sim.choices.options import options_of

NUMBERS = (
    "0",
    "-1",
    "1",
    "2",
    "nan",
    "inf",
    "-inf",
    "1e308",
    "1e-308",
    "-0",
    "0.5",
    "0x10",
    "1_000",
    "1e3",
    "100000",
    "1e20",
)
WORDS = (
    "x",
    "a,b",
    "1,2",
    ",",
    "..",
    "*",
    "%",
    "%s",
    "{}",
    "[1,2]",
    "--",
    "=",
    "a=b",
    "a:b",
    "a.b:C",
    "os:getcwd",
    "None",
    "true",
)
OF_SKD = ("margin=nan", "margin=0.5", "0:60:0", "60:10:-5", "nan:nan:nan", "0,0,nan")
FILES = ("~nobody/x", "/nonexistent/a", "pipe", "folder", "empty", "text", "bytes", "link", "result")
TEXTS = ("", "  ", " 1", "\u0665", "9" * 400, "x" * 5000, "\x1b[2J\u202e", "\udcff")
VALUES = (*NUMBERS, *WORDS, *OF_SKD, *FILES, *TEXTS)
_NO_TEXTS: tuple[object, ...] = (0, -1, 1, 2, 0.5, 1e308, float("nan"), True, None, [], [1, 1], {}, {"a": 1}, 10**30)
_KEYS = (
    "cars", "encounters", "defaults", "sweep", "sweep/seed", "sweep/multiplier", "sweep/scenario", "sweep/controller",
    "sweep/scenario.eta_max", "name", "scenario", "scenario.eta_max", "scenario.car.start_speed", "scenario.road",
    "scenario.car", "scenario.", "graph", "curve", "reference", "/", "x",
)  # fmt: skip
"""What stands in a campaign's file besides options; section/key."""
_LEFT_OUT = {"graph", "scheduler", "mlflow", "verbose"}
_FEW = ["--safe-count", "2", "--kamikaze-count", "1", "--collision-runs", "2"]
_SMALL = [*_FEW, "--simulations", "5", "--workers", "1"]
_LITTLE = ["--margin-limit", "0", "--behaviour", "none", "--quiet"]
_QUICK = [*_SMALL, *_LITTLE]
_FEW_TESTS = ["--encounters", "cpna", "--speeds", "20:30:10", "--kamikaze-count", "1"]
GIVEN: dict[str, list[str]] = {
    "assess": _QUICK,
    "sweep": [*_SMALL, "--margin-limit", "0", "--behaviour", "none", "--multipliers", "1"],
    "campaign": ["campaign.yaml"],
    "replay": ["recorded"],
    "compare": ["result", "other"],
    "verify": ["result"],
    "plan": ["rated", "--width", "0.1", "--figure", "deformation"],
    "report": ["result"],
    "show": ["result"],
    "encounters show": ["crossing"],
    "encounters check": ["crossing"],
    "ncap": [*_FEW_TESTS, "--margin-limit", "0", "--workers", "1"],
    "probe": ["--episodes", "2", "--workers", "1"],
    "fit": ["result"],
    "fuse": ["rated", "trials.csv"],
    "behaviour fit": ["people"],
    "export": ["result", "--format", "csv"],
    "import": ["phi.csv"],
    "list": ["."],
    "trend": ["result", "other"],
    "completion": ["bash"],
}
"""What a command takes besides the option that is tried."""


class Run(NamedTuple):
    """How a command ended: exit code (None: not within the time), what it said, and what it left."""

    code: int | None
    output: str
    error: str
    left: set[str]


def prepare(folder: Path) -> None:
    """Make the files and results that commands are given."""
    assert skd(["assess", *_QUICK, "--out", "result"]) in (0, 1)
    assert skd(["assess", *_QUICK, "--multiplier", "0.5", "--out", "other"]) in (0, 1)
    rated = ["--safe-count", "6", "--kamikaze-count", "2", "--collision-runs", "60", "--simulations", "5"]
    assert skd(["assess", *rated, "--workers", "1", *_LITTLE, "--out", "rated"]) in (0, 1)
    figures = json.loads((folder / "rated" / "assessment.json").read_text())
    names = [one["name"] for one in figures["per_safe_trajectory"]]
    trials = "".join(f"{name},{0.3 + 0.1 * number}\n" for number, name in enumerate(names))
    (folder / "trials.csv").write_text("phi,clearance\n" + trials)
    episodes = campaign_messages(campaign(0, CROSSING)[2])
    write_mcap(folder / "recorded" / "all.mcap", list(itertools.chain.from_iterable(episodes)))
    lengths = [28] * 2 * LEAST_TRACKS
    chance = np.random.default_rng(0).standard_normal((len(lengths), normals_of(27)))
    (folder / "people").mkdir()
    for number, way in enumerate(simulated(load_behaviour("walkers").values, lengths, 1.25, 0.3, chance)):
        track = "".join(f"{0.3 * tick},{x},{y}\n" for tick, (x, y) in enumerate(way.tolist()))
        (folder / "people" / f"{number}.csv").write_text("t,x,y\n" + track)
    rows = "".join(f"{0.3 * tick},{-4.0 + 0.4 * tick},1\n" for tick in range(20))
    (folder / "phi.csv").write_text("t,x,y\n" + rows)
    (folder / "campaign.yaml").write_text(
        "cars: [{controller: basic}]\nencounters: [{scenario: crossing}]\n"
        "defaults: {safe_count: 2, kamikaze_count: 1, collision_runs: 2, simulations: 5, margin_limit: 0, "
        "behaviour: none}\n"
    )
    os.mkfifo(folder / "pipe")
    (folder / "folder").mkdir()
    (folder / "empty").touch()
    (folder / "text").write_text("a: [1\n")
    (folder / "bytes").write_bytes(bytes(range(256)))
    (folder / "link").symlink_to("nowhere")


def cases(each: int, rng: random.Random) -> Iterator[list[str]]:
    """Yield command lines, without `skd`."""
    for name, parser in commands_of(make_parser()).items():
        if name not in ("drive", "episode"):
            yield from _cases_of([name], parser, each, rng)


def campaign_files(folder: Path, each: int, rng: random.Random) -> Iterator[list[str]]:
    """Yield command lines of campaigns whose files have a value that a key, or a section, is not for."""
    content = yaml.safe_load((folder / "campaign.yaml").read_text())
    keys = sorted({*content["defaults"], *(one.name for one in options_of(CampaignOptions)), *_KEYS})
    for key in keys:
        for value in rng.sample([*_NO_TEXTS, *VALUES], each):
            odd = yaml.safe_load(yaml.safe_dump(content))
            place, _, name = key.partition("/")
            if place in content and not name:
                odd[place] = value
            elif name:
                odd[place] = {name: value}
            else:
                odd["cars"][0][key] = value
            with suppress(UnicodeEncodeError):  # no such file can be written
                (folder / "odd.yaml").write_text(yaml.safe_dump(odd, allow_unicode=True))
                yield ["campaign", "odd.yaml", "--workers", "1", "--quiet"]


def _cases_of(words: list[str], parser: argparse.ArgumentParser, each: int, rng: random.Random) -> Iterator[list[str]]:
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for name, below in action.choices.items():
                yield from _cases_of([*words, name], below, each, rng)
            return
    given = GIVEN.get(" ".join(words), [])
    for action in parser._actions:
        if isinstance(action, argparse._HelpAction) or action.dest in _LEFT_OUT:
            continue
        if action.option_strings and action.nargs == 0:
            yield [*words, *given, action.option_strings[-1]]
            continue
        values = [*VALUES, *map(str, action.choices or ())]
        for value in rng.sample(values, min(each, len(values))):
            with_it = [f"{action.option_strings[-1]}={value}", *given] if action.option_strings else [value, *given[1:]]
            yield [*words, *with_it]


def import_commands() -> None:
    """Import all commands, so that no process that is forked has to."""
    for module in pkgutil.walk_packages(skd_evaluator.cli.__path__, "skd_evaluator.cli."):
        importlib.import_module(module.name)
    gc.freeze()


def run(words: Sequence[str], folder: Path, limit: float) -> Run:
    """Run a command in a process of its own, and remove what it has written."""
    before = {path.name for path in folder.iterdir()}
    said = [tempfile.TemporaryFile(), tempfile.TemporaryFile()]  # noqa: SIM115 - for both ends of the fork
    child = os.fork()
    if child == 0:
        os.setsid()
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        for number, file in enumerate(said, start=1):
            os.dup2(file.fileno(), number)
        _be(words)
    code = end_of(child, limit)
    left = {path.name for path in folder.iterdir()} - before
    for name in left:
        path = folder / name
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink()
    texts = []
    for file in said:
        file.seek(0)
        texts.append(file.read().decode(errors="replace"))
        file.close()
    return Run(code, texts[0], texts[1], left)


def _be(words: Sequence[str]) -> None:
    """Be a command, to this process's end."""
    code: object = 99
    try:
        code = skd(words)
    except SystemExit as end:
        code = end.code
    except BaseException:
        traceback.print_exc()
    with suppress(Exception):
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(code if isinstance(code, int) else 99)


def wrongs(found: Run) -> list[str]:
    """Return what is not right of how a command ended, in a word or two each."""
    return [
        wrong
        for wrong, is_so in (
            ("not within the time", found.code is None),
            (f"exit code {found.code}", found.code not in (None, 0, 1, 2)),
            ("a traceback", "Traceback" in found.error + found.output),
            ("more than a line", found.code == 2 and len(found.error.strip().splitlines()) != 1),
            ("written although refused", found.code == 2 and bool(found.left)),
            ("a temporary folder left", found.code is not None and any(name.startswith(".skd") for name in found.left)),
            ("control characters", any(mark in found.error + found.output for mark in "\x1b\u202e")),
        )
        if is_so
    ]


def main() -> int:
    """Run; return 1 if something is not right."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--each", type=whole_number(1), default=2, metavar="N", help="values of an option (default 2)")
    parser.add_argument("--seed", type=whole_number(0), default=0, metavar="N")
    parser.add_argument("--limit", type=float, default=60.0, metavar="S", help="time of a command (default 60)")
    parser.add_argument("--command", action="append", help="only this one; may be given several times")
    arguments = parser.parse_args()
    import_commands()
    counts: collections.Counter[int | None] = collections.Counter()
    bad = 0
    with tempfile.TemporaryDirectory() as name:
        os.chdir(name)
        prepare(Path(name))
        gc.freeze()  # what that has loaded, too
        rng = random.Random(arguments.seed)
        plain = [[*command.split(), *given] for command, given in GIVEN.items()]
        odd = itertools.chain(cases(arguments.each, rng), campaign_files(Path(name), arguments.each, rng))
        for words in itertools.chain(plain, odd):
            if arguments.command and words[0] not in arguments.command:
                continue
            found = run(words, Path(name), arguments.limit)
            counts[found.code] += 1
            said = wrongs(found)
            if words in plain and found.code not in (0, 1):
                said.append("refused, though nothing is odd")
            if said:
                bad += 1
                print(f"{', '.join(said)}: skd {' '.join(word[:60] for word in words)!a}", flush=True)
                print(f"    {found.error.strip()[-300:]!a}", flush=True)
        os.chdir("/")
    print(f"{counts.total()} command lines, by exit code {dict(counts)}; {bad} not right")
    return 1 if bad else 0


if __name__ == "__main__":
    raise SystemExit(main())
