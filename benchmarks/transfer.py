"""Whether what is found of a car in one world holds in another: the same cars, rated in several worlds.

A world is a simulator and, after a slash, the dynamics of its car: `world` (SKD's own, with the basic car),
`world/multi_body`, `metadrive`. In each, every car of the list is assessed by the command that a user has, against the
same safe trajectories φ, which are planned in SKD's own world and then handed to all. Kamikazes know the same of every
car in every world (--adversary-model, by default generic), for otherwise planned figures would not compare.

Printed are, for each car, margin, planned deviation, SKD and the equivalent multiplier in each world: the C of the
basic car with the same margin in that world, read off the basic cars of the list. Then, for each two worlds, Kendall's
τ of each figure, with the intervals of rank_agreement.py.

    python benchmarks/transfer.py --out DIR [--worlds NAME ...] [--cars LABEL ...] [--safe-count N]
        [--kamikaze-count N] [--adversary-model KIND] [--margin-limit N] [--seed N] [--workers N]

Cars are labels of cars/catalogue.py. DIR keeps every assessment, and the same command goes on from there.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import numpy as np
import yaml
from cars.catalogue import CARS, Car
from rank_agreement import Agreement, agreement
from skd_evaluator.assessment.files.assessment_json import ASSESSMENT
from skd_evaluator.assessment.files.results import StoredResult, read_result
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories
from skd_evaluator.metrics.clustered import clustered_mean
from skd_evaluator.metrics.margins import EquivalentMultiplier, equivalent_multiplier
from skd_sim.options.car_and_adversary import BASIC, DYNAMICS
from skd_sim.scenario.scenario import Scenario, load_scenario

TEN = (
    "basic, C = 0.5",
    "basic, C = 0.75",
    "basic, C = 1",
    "basic, C = 1.15",
    "basic, C = 1.5",
    "CARLA 0.8",
    "CAL",
    "Intelligent Driver Model",
    "time to collision",
    "latched and delayed",
)
FIGURES = {"margin": "margin (m)", "deviation": "planned deviation (m)", "skd": "SKD (m)"}
"""Of the groups of a stored result, with a name for people; of all of them more is safer."""


@dataclass(frozen=True)
class TestWorld:
    """Where cars are rated.

    Attributes:
        name: simulator, or simulator and dynamics with a slash in between.
    """

    name: str

    @property
    def simulator(self) -> str:
        """Name of the simulator."""
        return self.name.partition("/")[0]

    @property
    def scenario(self) -> Scenario:
        """The crossing with its car, which has the laser that cars of SKD's own world have."""
        found = load_scenario(DYNAMICS[self.name.partition("/")[2] or BASIC].scenario)
        if found.sensor is not None:
            return found
        sensor = load_scenario(DYNAMICS[BASIC].scenario).sensor
        return replace(found, sensor=sensor and replace(sensor, mount_ahead=found.car.front))


def world(name: str) -> TestWorld:
    """Return a world by its name.

    Raises:
        ValueError: its car has dynamics that there are not.
    """
    if (name.partition("/")[2] or BASIC) not in DYNAMICS:
        raise ValueError(f"{name}: the dynamics of a car are {', '.join(DYNAMICS)}")
    return TestWorld(name)


def write_phi(folder: Path, count: int, seed: int) -> None:
    """Write synthetic φ of SKD's own world as csv files, whole or not at all; what is there stays."""
    if folder.exists():
        return
    plan = Plan(load_scenario(DYNAMICS[BASIC].scenario), safe_count=count, seed=seed)
    with InProcessRunner(1) as runner:
        found = safe_trajectories(plan, runner)
    part = folder.with_suffix(".part")
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    for number, phi in enumerate(found):
        rows = [f"{phi.time_step * tick!r},{x!r},{y!r}" for tick, (x, y) in enumerate(phi.positions.tolist())]
        (part / f"{number:03}.csv").write_text("\n".join(["t,x,y", *rows, ""]), encoding="utf-8")
    part.rename(folder)


def assess(car: Car, where: TestWorld, arguments: argparse.Namespace) -> StoredResult:
    """Return the assessment of a car in a world, made if it is not there.

    Raises:
        SystemExit: it cannot be assessed there.
    """
    name = where.name.replace("/", "-")
    out: Path = arguments.out / name / car.label.replace(" ", "_").replace("/", "-")
    if not (out / ASSESSMENT).exists():  # the folder alone may be of a run that was ended
        scenario: Path = arguments.out / f"{name}.yaml"
        scenario.write_text(yaml.safe_dump(where.scenario.as_dict(), sort_keys=False), encoding="utf-8")
        words = ["--controller", car.controller, "--simulator", where.simulator, "--scenario", str(scenario)]
        words += ["--safe", str(arguments.out / "phi")]
        words += ["--multiplier", str(car.multiplier)] if car.has_multiplier else []
        words += ["--safe-count", str(arguments.safe_count), "--kamikaze-count", str(arguments.kamikaze_count)]
        words += ["--collision-runs", str(arguments.safe_count), "--behaviour", "none", "--objective", "both"]
        words += ["--adversary-model", arguments.adversary_model, "--margin-limit", str(arguments.margin_limit)]
        words += ["--seed", str(arguments.seed), "--workers", str(arguments.workers), "--no-pictures", "--quiet"]
        searched = [str(Path(__file__).resolve().parent), *filter(None, [os.environ.get("PYTHONPATH")])]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(searched)}
        command = [sys.executable, "-m", "skd_evaluator", "assess", *words, "--out", str(out)]
        print(f"{where.name}: {car.label}", file=sys.stderr, flush=True)
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        if not (out / ASSESSMENT).exists():
            raise SystemExit(f"{' '.join(command)}\n{done.stderr.strip()[-2000:]}")
        if done.returncode != 0:
            print(done.stderr.strip()[-500:], file=sys.stderr, flush=True)
    return read_result(out)


@dataclass(frozen=True)
class Found:
    """What was found of a car in a world.

    Attributes:
        result: its assessment.
        multiplier: C of the basic car with its margin there; None where nobody can say.
    """

    result: StoredResult
    multiplier: EquivalentMultiplier | None

    def mean(self, figure: str) -> float:
        """Return a figure: the mean over all trials; nan where there is none."""
        groups = self.result.groups.get(figure)
        found = None if groups is None else clustered_mean([group[~np.isnan(group)] for group in groups])
        return float("nan") if found is None else found.value

    @property
    def converged(self) -> bool:
        """Whether its margin is exact, or the search for it has converged."""
        return self.result.figures["margin_converged"] is not False


Table = Mapping[str, Mapping[str, Found]]
"""What was found, by world and car."""


def rated(cars: Sequence[Car], worlds: Sequence[TestWorld], arguments: argparse.Namespace) -> Table:
    """Return what was found of all cars in all worlds; what is missing is computed.

    Raises:
        SystemExit: a car cannot be assessed, or was against other φ.
    """
    write_phi(arguments.out / "phi", arguments.safe_count, arguments.seed)
    table: dict[str, dict[str, Found]] = {}
    safe = None
    for where in worlds:
        results = {car.label: assess(car, where, arguments) for car in cars}
        for label, result in results.items():
            safe = safe or result.safe
            if not result.same_safe(safe):
                raise SystemExit(f"{result.folder}: {label} has met other φ than the first car")
        basic = {
            car.multiplier: results[car.label].groups["margin"]
            for car in cars
            if car.has_multiplier and "margin" in results[car.label].groups
        }
        table[where.name] = found = {}
        for label, result in results.items():
            known = len(basic) > 1 and "margin" in result.groups
            found[label] = Found(result, equivalent_multiplier(result.groups["margin"], basic) if known else None)
    return table


def agreements(table: Table, seed: int = 0) -> dict[tuple[str, str], dict[str, Agreement]]:
    """Return how alike each two worlds order the cars, by each figure that both have of all cars."""
    found: dict[tuple[str, str], dict[str, Agreement]] = {}
    for one, other in combinations(table, 2):
        groups = [[car.result.groups for car in table[name].values()] for name in (one, other)]
        found[one, other] = {
            figure: agreement(*([car[figure] for car in cars] for cars in groups), seed)
            for figure in FIGURES
            if all(figure in car for cars in groups for car in cars)
        }
    return found


def show(table: Table, alike: Mapping[tuple[str, str], Mapping[str, Agreement]]) -> None:
    """Print a table of the cars for each figure's worlds, and one of the agreements."""
    names = list(table)
    for figure, title in FIGURES.items():
        print(f"\n| {title} | {' | '.join(names)} |\n|---|{'---|' * len(names)}")
        for label in next(iter(table.values())):
            cells = []
            for name in names:
                found = table[name][label]
                star = "*" if figure == "margin" and not found.converged else ""
                cells.append("–" if np.isnan(found.mean(figure)) else f"{found.mean(figure):.2f}{star}")
            print(f"| {label} | {' | '.join(cells)} |")
    print(f"\n| C with the same margin there | {' | '.join(names)} |\n|---|{'---|' * len(names)}")
    for label, one in next(iter(table.values())).items():
        if one.result.figures["multiplier"] is not None:
            continue  # the yardstick itself
        multipliers = [table[name][label].multiplier for name in names]
        cells = ["–" if found is None else _with_interval(found) for found in multipliers]
        print(f"| {label} | {' | '.join(cells)} |")
    print("\n| worlds | figure | cars | Kendall's τ | 95 % over φ | 95 % over cars |\n|---|---|---|---|---|---|")
    for (first, second), figures in alike.items():
        for figure, one in figures.items():
            ends = ["–" if end is None else "{:.2f} to {:.2f}".format(*end) for end in (one.by_phi, one.by_cars)]
            print(f"| {first}, {second} | {FIGURES[figure]} | {one.cars} | {one.tau:.2f} | {' | '.join(ends)} |")


def _with_interval(one: EquivalentMultiplier) -> str:
    return one.text if one.ci95 is None else f"{one.text} {one.interval_text(one.ci95)}"


def main() -> None:
    """Rate what is missing, and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="keeps φ and assessments")
    parser.add_argument("--worlds", nargs="+", type=world, default=[world("world"), world("world/multi_body")])
    parser.add_argument("--cars", nargs="+", default=list(TEN), choices=[car.label for car in CARS], metavar="LABEL")
    parser.add_argument("--safe-count", type=int, default=10, metavar="N", help="φ (default 10)")
    parser.add_argument("--kamikaze-count", type=int, default=5, metavar="N", help="per φ and objective (default 5)")
    parser.add_argument("--adversary-model", default="generic", choices=("generic", "learned"))
    parser.add_argument("--margin-limit", type=int, default=512, metavar="N", help="as in skd assess (default 512)")
    parser.add_argument("--seed", type=int, default=0, metavar="N")
    parser.add_argument("--workers", type=int, default=2, metavar="N")
    arguments = parser.parse_args()
    arguments.out = arguments.out.resolve()
    cars = [car for car in CARS if car.label in arguments.cars]
    table = rated(cars, arguments.worlds, arguments)
    show(table, agreements(table, arguments.seed))


if __name__ == "__main__":
    main()
