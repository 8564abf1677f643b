"""Does a figure predict how cars fare? Kendall's τ of each figure of a league with each of four truths.

    skd benchmark --out DIR
    .venv/bin/python benchmarks/prediction.py DIR [--runs 600]

The truths are those of wide_scenarios.py, fixed before any figure was seen, on the same φ. Time to collision, PET and
required deceleration are of the runs along φ; the share of Euro NCAP's tests is a mean of colours (green 1, red 0) over
CPNA, CPFA and CPNCO, for its calculator is not public. Intervals: rank_agreement.py.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from cars.catalogue import Car
from rank_agreement import Groups, agreement
from skd_evaluator.assessment.files.results import StoredResult, read_checked, read_result, result_folders
from skd_evaluator.assessment.plan import Plan, split_episode_id
from skd_evaluator.assessment.run.workers import InProcessRunner, available_workers
from skd_evaluator.extensions.protocols.evaluation import ProtocolRequest, evaluated_grid
from skd_evaluator.extensions.protocols.matrices import COLOURS
from skd_sim.scenario.scenario_file import REGULATORY
from skd_sim.world.state import Trajectory
from wide_scenarios import TRUTHS, Manner, outcomes

MORE, LESS = 1.0, -1.0
STORED = {
    "margin": MORE, "risk_1": LESS, "risk_2": LESS, "risk_3": LESS, "skd": MORE, "deviation": MORE,
    "nominal_collision_rate": LESS,
}  # fmt: skip
"""Figures of trials, and which way is better."""
SURROGATES = {"time_to_collision": MORE, "post_encroachment_time": MORE, "required_deceleration": LESS}
NCAP = "Euro NCAP, share"
SCENARIOS = ("cpna", "cpfa", "cpnco")


def figures_of(result: StoredResult, runner: InProcessRunner) -> dict[str, Groups]:
    """Return the figures of a car by φ, of all of which more is better."""
    count = len(result.safe)
    found: dict[str, Groups] = {
        name: [better * np.asarray(group, float) for group in result.groups[name]] for name, better in STORED.items()
    }
    measures = read_checked(result.folder)[2].surrogates
    along = [not objective for objective in measures.objectives]
    place = np.array([split_episode_id(log.episode.episode_id)[1] for log in measures.logs])[along]
    for name, better in SURROGATES.items():
        values = better * measures.values[name][along]
        found[name] = [values[place == phi] for phi in range(count)]
    return found | {NCAP: [[ncap_share(result, runner)]] * count}


def ncap_share(result: StoredResult, runner: InProcessRunner) -> float:
    """Return the mean colour of a car in Euro NCAP's crossings."""
    car = car_of(result)
    plan = Plan(car.scenario, controller=car.controller, multiplier=car.multiplier, safe=REGULATORY, safe_count=1)
    request = ProtocolRequest(replace(plan, kamikaze_count=1), car.scenario.control_period, None, 0)
    cells = [cell for name in SCENARIOS for cell in evaluated_grid(name, request, runner, lambda *_: None)[0].cells]
    return float(np.mean([1.0 - COLOURS.index(cell.colour) / (len(COLOURS) - 1) for cell in cells if cell.colour]))


def car_of(result: StoredResult) -> Car:
    """Return the car of a result."""
    multiplier = result.figures["multiplier"]
    return Car(str(result.figures["car"]), "", str(result.figures["controller"]), multiplier or 1.0)


def truths_of(result: StoredResult, runs: int, runner: InProcessRunner) -> dict[str, Groups]:
    """Return of each truth, by φ, −1 for each run that is a hit, else 0."""
    safe = [Trajectory(one, result.scenario["time_step"], str(place)) for place, one in enumerate(result.safe)]
    walked = {manner: outcomes(car_of(result), safe, runs, 0, manner, runner) for manner in Manner}
    found: dict[str, Groups] = {}
    for name, truth in TRUTHS.items():
        hits = -truth.hits(walked).astype(float).reshape(-1, runs)
        found[name] = [hits[:, phi :: len(safe)].ravel() for phi in range(len(safe))]
    return found


def show(figures: Sequence[dict[str, Groups]], truths: Sequence[dict[str, Groups]]) -> None:
    """Print the table: τ, and its 95 % interval over cars, which is the wider one."""
    print(f"| figure | cars | {' | '.join(TRUTHS)} |")
    print("|---|---|" + "---|" * len(TRUTHS))
    for name in figures[0]:
        found = [agreement([one[name] for one in figures], [one[truth] for one in truths]) for truth in TRUTHS]
        cells = [f"{one.tau:.2f} [{', '.join(f'{end:.2f}' for end in one.by_cars or ())}]" for one in found]
        print(f"| {name} | {found[0].cars} | {' | '.join(cells)} |")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, metavar="DIR", help="of skd benchmark")
    parser.add_argument("--runs", type=int, default=600, metavar="N", help="per car and manner (default 600)")
    parser.add_argument("--workers", type=int, default=available_workers(), metavar="N")
    arguments = parser.parse_args()
    results = [read_result(path) for path in result_folders([arguments.folder])]
    with InProcessRunner(arguments.workers) as runner:
        runner.start([])
        truths = [truths_of(one, arguments.runs, runner) for one in results]
        figures = [figures_of(one, runner) for one in results]
    show(figures, truths)


if __name__ == "__main__":
    main()
