"""Which figures rank cars: of the pairs of cars that all truths order alike, the share that each figure orders so.

The cars are those of cars/catalogue.py. The truths, fixed beforehand, are contact rates under a perturbation much
larger than kamikazes are planned with (wide_scenarios.py): everybody walks at a pace of his own; changes his pace on
the way; hesitates once; and, of all these runs, those alone that the front of the car hits. A hit is a contact at the
scenario's `collision.hit_speed` or more. Which pairs count, and what the intervals are, is said in pair_orders.py.

All figures are of the same safe trajectories and of the same trials, numbers 0 … N − 1 of each φ; a trial without
a hit counts as η_max. "planned, generic" is by kamikazes that take every car for a basic one, but for the basic car,
whose C they know. SKD is the paper's, with `objective: paper`, of trials that touch the car. What each is computed
from stands in ranking_figures.py.

    python benchmarks/ranking.py --out FILE [--runs 3000] [--safe-count 20] [--trials 5] [--figures NAME ...]
        [--limit N] [--crossings N] [--again PART ...]

The scale of the risk that is to rank, fixed beforehand, is 2: R(2).

The margin is exact for the basic car, else searched for with up to --limit candidates a trial; a star says that the
search has not converged.

FILE keeps what has been computed; the same command goes on from there.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from cars.catalogue import CARS, Car, available
from contacts import Run
from pair_orders import Pair, Share, agreed_pairs, ordered_share
from ranking_figures import FIGURES, Found, Work
from skd_adversary.adversary import warm_up_episodes
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.workers import InProcessRunner, available_workers
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories
from skd_evaluator.metrics.clustered import clustered_mean
from skd_evaluator.metrics.difference import Difference, difference
from skd_sim.options.car_and_adversary import Objective
from skd_sim.ros_environment.installation import enter_ros, is_ready
from skd_sim.scenario.scenario import load_scenario
from wide_scenarios import HITS, TRUTHS, Manner, Truth, outcomes


class Store:
    """What has been computed, on disk after every step."""

    def __init__(self, path: Path, settings: dict[str, Any], again: Sequence[str] = ()) -> None:
        """Read what is there, but for the parts that are to be computed again.

        Raises:
            SystemExit: it was computed with other settings.
        """
        self._path = path
        self._content: dict[str, Any] = {"settings": settings, "cars": {}}
        if path.exists():
            self._content = json.loads(path.read_text(encoding="utf-8"))
            if self._content["settings"] != settings:
                raise SystemExit(f"{path}: computed with {self._content['settings']}; give another file")
        for known in self._content["cars"].values():
            for part in list(known):
                if part.partition("/")[0] in again:
                    del known[part]

    def once(self, car: str, part: str, work: Callable[[], Any]) -> Any:
        """Return a part of a car's figures, computed at the first time."""
        known = self._content["cars"].setdefault(car, {})
        if part not in known:
            begin = time.perf_counter()
            known[part] = work()
            temporary = self._path.with_suffix(".part")
            temporary.write_text(json.dumps(self._content, ensure_ascii=False), encoding="utf-8")
            temporary.replace(self._path)
            print(f"{car}: {part}, {time.perf_counter() - begin:.0f} s", flush=True)
        return known[part]


@dataclass(frozen=True)
class Row:
    """What is known of a car: letters of its runs by manner, values by figure."""

    car: Car
    runs: dict[Manner, str]
    found: dict[str, Found]

    def _groups(self, figure: str) -> list[np.ndarray]:
        return [np.array(one, dtype=float) for one in self.found[figure]["values"]]

    def mean(self, figure: str) -> float:
        """Return a figure: the mean over all trials; nan where none has a value."""
        numbers = np.concatenate(self._groups(figure))
        numbers = numbers[~np.isnan(numbers)]
        return float(numbers.mean()) if numbers.size else float("nan")

    def shown(self, figure: str) -> str:
        """Return a figure as it stands in the table."""
        star = "*" if "not converged" in self.found[figure]["note"] else ""
        return f"{self.mean(figure):.{FIGURES[figure].digits}f}{star}"

    def beside(self, other: Row, figure: str) -> Difference:
        """Return how far its figure is above another car's, as `skd compare` has it."""
        held = difference(other._groups(figure), self._groups(figure), paired=True)
        assert held is not None
        return held

    def above(self, other: Row, figure: str) -> tuple[float, tuple[float, float] | None]:
        """Return how far its figure is above another car's, in pairs of trials, and the 95 % interval over φ."""
        pairs = zip(self._groups(figure), other._groups(figure), strict=True)
        return _clustered([mine - others for mine, others in pairs])


def _clustered(groups: Sequence[np.ndarray]) -> tuple[float, tuple[float, float] | None]:
    known = [group[~np.isnan(group)] for group in groups]
    if not any(group.size for group in known):
        return float("nan"), None
    found = clustered_mean(known)
    return found.value, found.interval


@dataclass(frozen=True)
class Ranking:
    """The rows of all cars, the pairs that count, and the share of each figure."""

    rows: tuple[Row, ...]
    pairs: tuple[Pair, ...]
    shares: dict[str, Share]


def ranked(rows: Sequence[Row], figures: Sequence[str], seed: int = 0) -> Ranking:
    """Return which pairs of cars all truths order alike, and how many of them each figure orders so."""
    pairs = agreed_pairs([[truth.hits(row.runs) for row in rows] for truth in TRUTHS.values()])
    shares = {}
    for name in figures:
        means = {number: row.mean(name) for number, row in enumerate(rows)}
        known = {number: value for number, value in means.items() if value == value}
        shares[name] = ordered_share(pairs, known, FIGURES[name].better, seed)
    return Ranking(tuple(rows), tuple(pairs), shares)


def exceptions(ranking: Ranking, figure: str) -> list[tuple[Row, Row, float, tuple[float, float] | None]]:
    """Return each pair that a figure does not order as the truths do: the safer car, the other, and the difference."""
    pairs = [(ranking.rows[one.safer], ranking.rows[one.other]) for one in ranking.shares[figure].exceptions]
    return [(safer, other, *safer.above(other, figure)) for safer, other in pairs]


class Rule(Enum):
    """When a car is called safer by margin and risk."""

    ONE = "one of margin and R(2), not contradicted,"
    UNOPPOSED = "one of margin and R(2), whose other's estimate does not point the other way (skd compare),"
    BOTH = "both, margin and R(2),"


VERDICTS = (
    "the safer", "neither, for they contradict", "neither, for the other points elsewhere",
    "neither, told apart by too few", "the other",
)  # fmt: skip


def verdicts(ranking: Ranking, margin: str, risk: str, rule: Rule) -> dict[str, int]:
    """Return in how many pairs margin and risk together call the safer car so, the other one, or neither.

    A figure says that a car is safer where it tells the cars apart by its interval over φ. One may be enough, where the
    other does not say the opposite; or where the other's estimate does not point there, either, by what is more than a
    tie; or both have to say so.
    """
    found = dict.fromkeys(VERDICTS, 0)
    for pair in ranking.pairs:
        safer, other = ranking.rows[pair.safer], ranking.rows[pair.other]
        held = [(safer.beside(other, figure), FIGURES[figure].better > 0) for figure in (margin, risk)]
        votes = {(one.direction > 0) == more for one, more in held if one.direction}
        points = {(one.leaning > 0) == more for one, more in held if one.leaning}
        told = sum(one.direction != 0 for one, _ in held)
        if len(votes) == 2:
            found[VERDICTS[1]] += 1
        elif told < (2 if rule is Rule.BOTH else 1):
            found[VERDICTS[3]] += 1
        elif rule is Rule.UNOPPOSED and len(points) == 2:
            found[VERDICTS[2]] += 1
        else:
            found["the safer" if votes == {True} else "the other"] += 1
    return found


def flank_share(row: Row) -> float:
    """Return which share of a car's hits were not by its front; nan without a hit."""
    letters = "".join(row.runs.values())
    hits = sum(letters.count(kind) for kind in HITS)
    return 1.0 - letters.count(Run.FRONT) / hits if hits else float("nan")


def show(ranking: Ranking, figures: Sequence[str], explained: Sequence[str]) -> None:
    """Print the table, the car that is hit most first; the shares; and the exceptions of some figures."""
    names = [*TRUTHS, "not by the front", *(FIGURES[name].label for name in figures)]
    print(f"| car | {' | '.join(names)} |")
    print("|---|" + "---|" * len(names))
    rates = {row.car.label: [truth.hits(row.runs).mean() for truth in TRUTHS.values()] for row in ranking.rows}
    for row in sorted(ranking.rows, key=lambda one: -float(np.mean(rates[one.car.label]))):
        cells = [f"{100 * rate:.1f} %" for rate in (*rates[row.car.label], flank_share(row))]
        cells += [row.shown(name) for name in figures]
        print(f"| {row.car.label} | {' | '.join(cells)} |")
    total = len(ranking.rows) * (len(ranking.rows) - 1) // 2
    print(f"\n{len(ranking.pairs)} of {total} pairs are ordered alike by all truths.\n")
    print("| figure | pairs | ordered so | share | 95 % over cars | of the exceptions, told apart |")
    print("|---|---|---|---|---|---|")
    for name in figures:
        share, wrong = ranking.shares[name], exceptions(ranking, name)
        low, high = share.interval or (float("nan"), float("nan"))
        apart = sum(ends is not None and (ends[0] > 0.0 or ends[1] < 0.0) for *_, ends in wrong)
        print(
            f"| {FIGURES[name].label} | {share.pairs} | {share.right} | {100 * share.value:.1f} % | "
            f"{100 * low:.1f} to {100 * high:.1f} % | {apart} of {len(wrong)} |"
        )
    if "margin" in figures and "risk_2" in figures:
        for rule in Rule:
            counts = verdicts(ranking, "margin", "risk_2", rule)
            print(f"\nCalled safer by {rule.value} {'; '.join(f'{name}: {count}' for name, count in counts.items())}")
    for name in explained:
        print(f"\n{FIGURES[name].label}, not as the truths: the safer car, the other; difference [95 % over φ]")
        for safer, other, value, ends in exceptions(ranking, name):
            low, high = ends or (float("nan"), float("nan"))
            rates = (f"{key} {' / '.join(rate(row, truth) for row in (safer, other))}" for key, truth in TRUTHS.items())
            print(
                f"  {safer.car.label} ({safer.mean(name):.3f}), {other.car.label} ({other.mean(name):.3f}): "
                f"{value:+.3f} [{low:+.3f}, {high:+.3f}]; {', '.join(rates)}"
            )


def rate(row: Row, truth: Truth) -> str:
    """Return the share of a car's runs that are hits."""
    return f"{100 * truth.hits(row.runs).mean():.1f} %"


def rows_of(
    cars: Sequence[Car], figures: Sequence[str], arguments: argparse.Namespace, store: Store
) -> tuple[Row, ...]:
    """Compute what is missing, and return the rows of the cars."""
    rows = []
    with InProcessRunner(arguments.workers, isolated=True) as runner:
        runner.start([episode for objective in Objective for episode in warm_up_episodes(objective=objective)])
        plan = Plan(load_scenario("crossing"), safe_count=arguments.safe_count, seed=arguments.seed)
        safe = safe_trajectories(plan, runner)
        for car in cars:
            work = Work(car, safe, arguments.trials, arguments.seed, runner, arguments.limit, arguments.crossings)
            runs, found = {}, {}
            for manner in Manner:
                run = partial(outcomes, car, safe, arguments.runs, arguments.seed, manner, runner)
                runs[manner] = store.once(car.label, manner, run)
            for name in figures:
                size = arguments.crossings if name.startswith("risk") else arguments.trials
                found[name] = store.once(car.label, f"{name}/{size}", partial(FIGURES[name].compute, work))
            rows.append(Row(car, runs, found))
    return tuple(rows)


def main() -> None:
    """Compute what is missing, and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="keeps what has been computed")
    parser.add_argument("--runs", type=int, default=3000, metavar="N", help="per car and manner (default 3000)")
    parser.add_argument("--safe-count", type=int, default=20, metavar="N", help="φ (default 20)")
    parser.add_argument("--trials", type=int, default=5, metavar="N", help="per φ (default 5)")
    parser.add_argument("--limit", type=int, default=512, metavar="N", help="of the margin's search")
    parser.add_argument("--crossings", type=int, default=25, metavar="N", help="of the risk, per φ (default 25)")
    parser.add_argument("--figures", nargs="*", default=list(FIGURES), choices=tuple(FIGURES), metavar="NAME")
    parser.add_argument("--exceptions", nargs="*", default=["margin"], choices=tuple(FIGURES), metavar="NAME")
    parser.add_argument("--again", nargs="+", default=[], choices=(*map(str, Manner), *FIGURES), help="compute anew")
    parser.add_argument("--seed", type=int, default=0, metavar="N")
    parser.add_argument("--workers", type=int, default=available_workers(), metavar="N")
    arguments = parser.parse_args()
    if is_ready():
        enter_ros()  # begins this process anew, with the libraries of the vendor's messages
    settings = {name: getattr(arguments, name) for name in ("runs", "safe_count", "seed")}
    store = Store(arguments.out, settings, arguments.again)
    cars, missing = available(CARS)
    ranking = ranked(rows_of(cars, arguments.figures, arguments, store), arguments.figures, arguments.seed)
    show(ranking, arguments.figures, [name for name in arguments.exceptions if name in arguments.figures])
    for line in missing:
        print(f"left out: {line}")


if __name__ == "__main__":
    main()
