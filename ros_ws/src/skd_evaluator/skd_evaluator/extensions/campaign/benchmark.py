"""`skd benchmark`: cars rated in frozen trials, ranked with uncertainty, with digests that make two runs comparable."""

from __future__ import annotations

import argparse
import hashlib
import itertools
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skd_sim.options.car_and_adversary import CarUnderTest

from skd_evaluator.cli.arguments import Parser
from skd_evaluator.cli.output import EXIT_INTERRUPTED, finish

if TYPE_CHECKING:
    from skd_evaluator.assessment.files.results import StoredResult

FILE = Path(__file__).with_name("benchmark_v1.yaml")
RESULT, PAGE, PICTURE = "benchmark.json", "benchmark.md", "price.png"
RISKS = ("risk_1", "risk_2", "risk_3")
RANKED = {"margin": 1, "risk_2": -1}
"""Figures that rank cars: 1 where more is better, −1 where less is."""
PRICE = ("time_lost", "needless", "deadlock")


def add_benchmark(parser: Parser) -> None:
    """Rate 17 public controllers, and yours beside them, in frozen trials.

    Rate a league of public controllers, and cars of your own beside them, in trials that never change. The page that
    it writes has margin, risk, price of caution and impact speed of each, and ranks with their uncertainty. Anybody who
    runs it gets the same digests.
    """
    parser.set_defaults(group="rate")
    text = "further cars: file.py:Class, package.module:Class or a registered name"
    parser.add_argument("cars", nargs="*", metavar="CAR", help=text)
    parser.add_flag("--resume", "go on with the benchmark in --out, or begin it if there is none")
    parser.add_runner()
    parser.add_max_aborted()
    parser.add_output()


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    from skd_evaluator.assessment.files.result_folder import write_json
    from skd_evaluator.assessment.files.results import read_result
    from skd_evaluator.extensions.campaign.cells import read_campaign
    from skd_evaluator.extensions.campaign.results import run_combinations
    from skd_evaluator.report.charts import PRICE_CAPTION, ChartedCar, coloured, price_chart, save_charts

    done = run_combinations(read_campaign(FILE, [_entry(car) for car in arguments.cars]), arguments)
    if done is None:
        return EXIT_INTERRUPTED
    campaign, out = done
    results = [read_result(out / row["name"]) for row in campaign["cells"] if row["sha256"]]
    content = benchmark_content(results)
    page = page_of(content, campaign["seconds"])
    write_json(out / RESULT, content)
    (out / PAGE).write_text(page, encoding="utf-8")
    cars = coloured([ChartedCar(str(one.figures["car"]), one.figures) for one in results])
    save_charts(out / PICTURE, [price_chart(cars)], PRICE_CAPTION)
    failures = [f"{row['name']}: {line}" for row in campaign["cells"] for line in row["problems"]]
    warnings = [f"{row['name']}: {line}" for row in campaign["cells"] for line in row["warnings"]]
    return finish(arguments, content, lambda: print(f"{page}\nresults in {out}"), warnings, failures)


def _entry(car: str) -> dict[str, str]:
    """Return a car's entry in a campaign's file."""
    known = CarUnderTest(car)
    simulator = {"simulator": known.kind.simulator} if known.kind.simulator else {}
    return {"controller": str(known.controller), **simulator}


def benchmark_content(results: Sequence[StoredResult]) -> dict[str, Any]:
    """Return the content of benchmark.json, the car with the greatest margin first."""
    from skd_evaluator.version import version

    rows: list[dict[str, Any]] = [{"car": str(one.figures["car"]), **figures_of(one)} for one in results]
    rows = [{**row, "digest": digest_of(row)} for row in rows]
    for name, better in RANKED.items():
        places = ranks([row[name]["value"] for row in rows], better, _directions(results, name))
        rows = [{**row, f"{name}_rank": place} for row, place in zip(rows, places, strict=True)]
    file = hashlib.sha256(FILE.read_bytes()).hexdigest()
    return {
        "benchmark": FILE.stem,
        "file": file,
        "version": version(),
        "digest": digest_of([file, *(row["digest"] for row in rows)]),
        "rows": sorted(rows, key=lambda row: row["margin_rank"]),
    }


def figures_of(result: StoredResult) -> dict[str, dict[str, Any]]:
    """Return value and 95 % interval of each figure; that of the impact speed is by φ, of the trials that hit."""
    from skd_evaluator.metrics.clustered import clustered_mean
    from skd_evaluator.report.charts import risk_of

    figures = result.figures
    found = {name: {"value": figures[name], "ci95": figures[f"{name}_ci95"]} for name in ("margin", *PRICE)}
    found["margin"]["converged"] = figures["margin_converged"]
    for name, scale in zip(RISKS, (1.0, 2.0, 3.0), strict=True):
        value, low, high = risk_of(figures, scale)
        found[name] = {"value": value, "ci95": [low, high]}
    speeds = [group[group == group] for group in result.groups["impact_speed"]]
    known = clustered_mean(speeds) if any(group.size for group in speeds) else None
    found["impact_speed"] = {"value": known and known.value, "ci95": known and known.interval}
    return found


def digest_of(figures: Any) -> str:
    """Return the SHA-256 of figures, of floats every bit."""

    def exact(value: Any) -> Any:
        if isinstance(value, Mapping):
            return {key: exact(one) for key, one in value.items()}
        if isinstance(value, (list, tuple)):
            return [exact(one) for one in value]
        return float(value).hex() if isinstance(value, float) else value

    return hashlib.sha256(json.dumps(exact(figures), sort_keys=True).encode()).hexdigest()


def ranks(values: Sequence[float], better: int, directions: Mapping[tuple[int, int], int]) -> list[list[int]]:
    """Return each car's rank by a figure, and the first and the last that it may have.

    Args:
        values: the figure of each car.
        better: 1 where more is better, −1 where less is.
        directions: of each pair of cars, i < j: 1 where the second surely has more, −1 less, 0 neither.
    """
    found = []
    for car, value in enumerate(values):
        own = [better * (more if pair[1] == car else -more) for pair, more in directions.items() if car in pair]
        ahead = sum(better * (other - value) > 0.0 for other in values)
        found.append([1 + ahead, 1 + own.count(-1), len(values) - own.count(1)])
    return found


def _directions(results: Sequence[StoredResult], figure: str) -> dict[tuple[int, int], int]:
    """Return what `skd compare` finds of each pair by one figure; Bonferroni's share for each of a car's pairs."""
    from skd_evaluator.assessment.compare.comparison import compare

    confidence = 1.0 - 0.05 / max(1, len(results) - 1)
    found = {}
    for i, j in itertools.combinations(range(len(results)), 2):
        differences = compare(results[i], results[j], confidence).differences
        found[i, j] = differences[figure].direction if figure in differences else 0
    return found


HEADS = (
    "rank", "car", "margin (m)", "rank by R(2)", "R(2)", "time lost (s)", "needless", "deadlock", "impact (m/s)",
    "digest",
)  # fmt: skip
NOTES = (
    "Brackets: 95 % intervals. Ranks: first and last that a car may have, by the intervals of all its pairs together, "
    "paired over trials. ≤: the search had not converged; ranks compare what equal effort found. Impact: mean speed "
    "of the hits in the trials of the margin."
)


def page_of(content: Mapping[str, Any], seconds: float) -> str:
    """Return the page, as Markdown."""
    lines = [f"| {' | '.join(HEADS)} |", "|---" * len(HEADS) + "|"]
    for row in content["rows"]:
        places = ["{} ({}–{})".format(*row[f"{name}_rank"]) for name in RANKED]
        cells = [places[0], row["car"], _cell(row["margin"], 2), places[1], _cell(row["risk_2"], 3)]
        cells += [_cell(row[name], 2) for name in (*PRICE, "impact_speed")]
        lines.append(f"| {' | '.join(cells)} | `{row['digest'][:12]}` |")
    name, file = content["benchmark"], content["file"][:12]
    head = f"`{name}.yaml` (SHA-256 `{file}`), SKD {content['version']}, {seconds:.0f} s."
    table = "\n".join(lines)
    return f"{head}\nDigest of all: `{content['digest']}`\n\n{table}\n\n{NOTES}\n\n![Margin against price]({PICTURE})\n"


def _cell(figure: Mapping[str, Any], digits: int) -> str:
    """Return a figure with its interval."""
    from skd_evaluator.report.formats import TERMINAL

    bound = "≤ " if figure.get("converged") is False else ""
    ends = "" if figure["ci95"] is None else f" {TERMINAL.number(figure['ci95'], digits)}"
    return f"{bound}{TERMINAL.number(figure['value'], digits)}{ends}"
