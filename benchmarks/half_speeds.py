"""How much of closeness is that the margin's ways have half speeds, which kamikazes have not.

Of each car: the margin that the search finds, and what it finds where half speeds are left out, as they are of every
kamikaze. No kamikaze can do better than the second.

    python benchmarks/half_speeds.py [--cars LABEL ...] [--safe DIR] [--safe-count N] [--attempts N] [--budget TICKS]
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any
from unittest.mock import patch

import numpy as np
from cars.catalogue import CARS
from margin_search import episodes_of
from skd_evaluator.campaign.plan.options import SYNTHETIC
from skd_evaluator.margin.search import tree
from skd_evaluator.margin.search.search import search_margin
from skd_evaluator.margin.ways.ways import FIRST_HALF, velocities
from skd_sim.episode.episode import Episode


def whole_speeds(*of_a_tick: Any) -> Any:
    """Return the ways of a tick, those at half speed being as the first of all: the search takes equal ones for one."""
    ways = velocities(*of_a_tick)
    ways[FIRST_HALF:] = ways[0]
    return ways


def mean_margin(episodes: Sequence[Episode], budget: int) -> float:
    """Return the mean of what a search finds, m; η_max where that is nothing."""
    found = [(episode.scenario.eta_max, search_margin(episode, budget).way) for episode in episodes]
    return float(np.mean([most if way is None else way.distance for most, way in found]))


def main() -> None:
    """Print a line a car."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    cars = ["time to collision", "slows near anybody"]
    parser.add_argument("--cars", nargs="+", default=cars, choices=[car.label for car in CARS], metavar="LABEL")
    parser.add_argument("--safe", default=SYNTHETIC, metavar="DIR")
    parser.add_argument("--safe-count", type=int, default=10, metavar="N")
    parser.add_argument("--attempts", type=int, default=5, metavar="N", help="of each safe trajectory")
    parser.add_argument("--budget", type=int, default=512, metavar="TICKS", help="of each search")
    arguments = parser.parse_args()
    for car in CARS:
        if car.label in arguments.cars:
            episodes = episodes_of(car, arguments)
            margin = mean_margin(episodes, arguments.budget)
            with patch.object(tree, "velocities", whole_speeds):
                whole = mean_margin(episodes, arguments.budget)
            print(f"{car.label}: margin {margin:.3f} m, without half speeds {whole:.3f} m, {whole / margin:.2f} times")


if __name__ == "__main__":
    main()
