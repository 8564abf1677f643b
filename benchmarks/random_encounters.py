"""Assesses cars in encounters that nobody has written: `.venv/bin/python benchmarks/random_encounters.py --count 60`.

Each is one of SKD's encounters of which a few numbers have been changed, a little or a lot, with a car of SKD's or a
class in `benchmarks/cars`, and some options by lot. `skd assess` runs it with one worker and with two. Right is an exit
code of 0, 1 or 2 within the time, with 2 one line and nothing written; the same figures from any number of workers; a
result that `skd verify` finds right; figures that can be (`impossible_figures`); and no doubt of any of these cars.
Whatever is not right is printed with the encounter, and the exit code is then 1.
"""

from __future__ import annotations

import argparse
import collections
import itertools
import json
import math
import os
import random
import shutil
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import skd_sim
import yaml
from odd_values import Run, import_commands, run, wrongs
from skd_evaluator.cli.arguments import whole_number
from skd_evaluator.measure.doubt import in_doubt

SCENARIOS = Path(skd_sim.__file__).parent / "scenarios"
FACTORS = (0.0, 0.1, 0.5, 0.8, 0.95, 1.05, 1.25, 2.0, 5.0, -1.0)
CARS = (
    *(["--multiplier", str(multiplier)] for multiplier in (0.25, 0.5, 1, 1.5, 3)),
    ["--controller", "carla"],
    ["--controller", "cal"],
    ["--controller", "cars.collision_time:LatchedBrake"],
    ["--controller", "cars.idm:IntelligentDriver"],
    ["--controller", "cars.planner:SamplingPlanner"],
    ["--controller", "cars.stop_and_go:StopAndGo"],
)
"""SKD's own, and honest classes of a user's, which run in processes of their own and are asked again."""
SELDOM: tuple[tuple[tuple[str, ...], tuple[Any, ...]], ...] = (
    (("eta_max",), (0.3, 1.0, 2.0, 20.0)),
    (("collision", "hit_speed"), (0.0, 0.1, 2.0, 6.0)),
    (("collision", "minimum_impact_speed"), (0.2, 1.0)),
    (("time_step",), (0.1, 0.2, 0.5)),
    (("control_period",), (0.05, 0.1, 0.15)),
    (("car", "dynamics"), ("multi_body", "basic")),
    (("car", "speed_noise"), (0.0, 0.2)),
    (("car", "acceleration_noise"), (0.0, 0.5)),
    (("road", "friction"), (0.1, 0.5)),
    (("adversary", "position_noise"), (0.0, 5.0)),
)
"""What encounters leave to be as by default, or have in common: its place, and what it may be."""
_SMALL = ["--safe-count", "2", "--kamikaze-count", "2", "--collision-runs", "4", "--simulations", "20", "--quiet"]
_TOLERANCE = 1e-9
_NOT_COMPARED = ("seconds", "provenance")


def numbers_in(content: Any, place: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the place of each number below a mapping or list."""
    if isinstance(content, dict | list):
        for key, value in content.items() if isinstance(content, dict) else enumerate(content):
            yield from numbers_in(value, (*place, key))
    elif isinstance(content, int | float) and not isinstance(content, bool):
        yield place


def changed(content: dict[str, Any], rng: random.Random) -> dict[str, Any]:
    """Return an encounter of which one to four numbers are others, and up to two further settings."""
    places = [place for place in numbers_in(content) if place[0] != "protocol"]
    for place in rng.sample(places, min(len(places), rng.randint(1, 4))):
        inner: Any = content
        for key in place[:-1]:
            inner = inner[key]
        factor = rng.choice(FACTORS) if rng.random() < 0.15 else rng.uniform(0.6, 1.6)
        inner[place[-1]] = type(inner[place[-1]])(inner[place[-1]] * factor)
    for place, values in rng.sample(SELDOM, rng.choice([0, 1, 1, 2])):
        inner = content
        for key in place[:-1]:
            inner = inner.setdefault(key, {})
        inner[place[-1]] = rng.choice(values)
    return content


def options(rng: random.Random) -> list[str]:
    """Return a car and how it is assessed."""
    car = rng.choice(CARS)
    knowledge = rng.choice(["nothing", "itself"] if "--controller" in car else ["nothing", "known", "itself"])
    more = [
        *("--knowledge", knowledge),
        *("--safe", rng.choice(["synthetic", "own"])),
        *("--objective", rng.choice(["both", "paper", "deformation", "frechet"])),
        *("--actions", rng.choice(["listed", "drawn"])),
        *("--margin-limit", rng.choice(["0", "64", "512"])),
        *("--seed", str(rng.randrange(10_000))),
    ]
    seldom: list[list[str]] = [
        ["--curve"],
        ["--told"] if knowledge == "itself" else [],
        ["--controller-calls", "2000"] if knowledge == "itself" else [],
        ["--max-distance", str(rng.choice([0.5, 2, 8]))],
        ["--particles", "50"],
        ["--until-width", "4"],
        ["--risk-runs", "200"],
        ["--risk-subset"],
        ["--behaviour", "none"],
    ]
    return [*car, *more, *itertools.chain(*rng.sample(seldom, rng.randint(0, 3)))]


def _numbers(content: Any) -> Iterator[tuple[str, float]]:
    for inner in numbers_in(content):
        value: Any = content
        for key in inner:
            value = value[key]
        yield ".".join(map(str, inner)), float(value)


def _intervals(figures: Mapping[str, Any], place: str = "") -> Iterator[tuple[str, float, list[float]]]:
    """Yield each figure that has an interval: its name, its value, and both ends."""
    for name, value in figures.items():
        if isinstance(value, dict):
            yield from _intervals(value, f"{place}{name}.")
        key, mark, _ = name.partition("_ci95")
        if mark and isinstance(value, list) and isinstance(figures.get(key), int | float):
            yield f"{place}{name}", float(figures[key]), value


def impossible_figures(figures: Mapping[str, Any]) -> list[str]:
    """Return what cannot be of the figures of a result, a line each."""
    found = [f"{name} is {value}" for name, value in _numbers(figures) if not math.isfinite(value)]
    eta_max = figures["eta_max"]
    for name, value, ends in _intervals(figures):
        low, high = (math.nan if end is None else end for end in ends)
        if low > value + _TOLERANCE or high < value - _TOLERANCE or low > high:
            found.append(f"{name}: {value} is not within {ends}")
    for name in ("margin", "deformation"):
        value = figures.get(name)
        if value is not None and not 0.0 <= value <= eta_max + _TOLERANCE:
            found.append(f"{name} is {value}, beyond 0 to {eta_max}")
    for name in ("hit_rate", "collision_rate", "kamikaze_success_rate", "risk_1", "risk_2", "risk_3"):
        if figures.get(name) is not None and not 0.0 <= figures[name] <= 1.0:
            found.append(f"{name} is {figures[name]}")
    margin, deformation = figures.get("margin"), figures.get("deformation")
    # Kamikazes of some objectives try again where they are not hit, in attempts that the margin does not have.
    same = all(one["attempts"] == figures.get("margin_attempts") for one in figures["objectives"].values())
    if same and margin is not None and deformation is not None and margin > deformation + 1e-6:
        found.append(f"the margin {margin} is above the planned deformation {deformation}")
    if figures.get("skd") is not None and figures["skd"] < 0.0:
        found.append(f"the SKD is {figures['skd']}")
    for which, curve in figures["vulnerability_curve"].items():
        points = [one["probability"] for one in curve["points"]] if isinstance(curve, dict) else []
        if any(later < earlier for earlier, later in itertools.pairwise(points)):
            found.append(f"the vulnerability curve of {which} falls: {points}")
    if in_doubt(figures["warnings"]):
        found.append(f"in doubt: {[line[:200] for line in figures['warnings']]}")
    return found


def tried(words: list[str], folder: Path, limit: float) -> tuple[Run, list[str]]:
    """Assess an encounter, and return how that ended and what is not right about it."""
    found = run(["assess", *words, "--workers", "1", "--out", "../one"], folder, limit)
    said = wrongs(found)
    result = folder.parent / "one"
    if found.code == 2 and result.exists():
        said.append("written although refused")
    if found.code in (0, 1) and (result / "assessment.json").exists():
        other = run(["assess", *words, "--workers", "2", "--out", "../two"], folder, limit)
        first, second = (json.loads((folder.parent / name / "assessment.json").read_text()) for name in ("one", "two"))
        for name in _NOT_COMPARED:
            first.pop(name), second.pop(name)
        if other.code != found.code or first != second:
            said.append(f"otherwise with two workers: {[name for name in first if first[name] != second.get(name)]}")
        said += impossible_figures(first)
        verified = run(["verify", "../one"], folder, limit)
        if verified.code != 0:
            said.append(f"skd verify: {(verified.error + verified.output)[-2000:]}")
    elif found.code == 0 or (found.code == 1 and "error:" not in found.error):
        said.append("nothing written")
    for name in ("one", "two"):
        shutil.rmtree(folder.parent / name, ignore_errors=True)
    return found, said


def main() -> int:
    """Run; return 1 if something is not right."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=whole_number(1), default=60, metavar="N", help="encounters (default 60)")
    parser.add_argument("--seed", type=whole_number(0), default=0, metavar="N")
    parser.add_argument("--only", type=whole_number(0), metavar="N", help="only the encounter of this number")
    parser.add_argument("--limit", type=float, default=300.0, metavar="S", help="time of a command (default 300)")
    arguments = parser.parse_args()
    import_commands()
    counts: collections.Counter[int | None] = collections.Counter()
    bad = 0
    with tempfile.TemporaryDirectory() as name:
        here = Path(name) / "here"
        here.mkdir()
        os.chdir(here)
        for number in range(arguments.count) if arguments.only is None else [arguments.only]:
            rng = random.Random(f"{arguments.seed}, {number}")
            path = rng.choice(sorted(SCENARIOS.glob("*.yaml")))
            text = yaml.safe_dump(changed(yaml.safe_load(path.read_text(encoding="utf-8")), rng))
            (here / "encounter.yaml").write_text(text)
            words = [*options(rng), *_SMALL, "--scenario", "encounter.yaml"]
            found, said = tried(words, here, arguments.limit)
            counts[found.code] += 1
            if sys.stderr.isatty():
                print(f"{number + 1} of {arguments.count}", end="\r", file=sys.stderr, flush=True)
            if arguments.only is not None:
                print(text, found.output, found.error, sep="\n")
            if said:
                bad += 1
                print(f"{number} ({path.stem}): skd assess {' '.join(words)}", *said, sep="\n    ", flush=True)
                print(f"    {found.error.strip()[-300:]}", flush=True)
        os.chdir("/")
    print(f"{counts.total()} encounters, by exit code {dict(counts)}; {bad} not right")
    return 1 if bad else 0


if __name__ == "__main__":
    raise SystemExit(main())
