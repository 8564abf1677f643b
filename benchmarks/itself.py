"""How near kamikazes that know the car itself come to the least deformation found, by the sensor and told the state.

Per car: the mean deformation over all attempts (one without a hit by the moving car counts as η_max), the mean of the
least found in the same episodes, closeness = the first over the second, the share of attempts that hit, calls of copies
of the controller and processor seconds an episode. The least is found by a search that starts from the nearer of the
two kamikazes' ways; it knows every draw, which a kamikaze does not, so closeness is above 1 for whoever plans as well
as can be.

    python benchmarks/itself.py [--cars LABEL ...] [--safe DIR] [--safe-count N] [--episodes N] [--calls N] [--json]

Cars are labels of `cars/catalogue.py`; by default one of each of eight families.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from cars.catalogue import CARS, Car
from skd_adversary.adversary import car_model_for
from skd_adversary.itself.adversary import ItselfAdversary
from skd_evaluator.campaign.options import SYNTHETIC
from skd_evaluator.campaign.plan import Plan, safe_trajectories
from skd_evaluator.campaign.runner import run_episode
from skd_evaluator.campaign.workers import InProcessRunner
from skd_evaluator.margin.search import search_margin
from skd_evaluator.measure.deformation import deformation
from skd_evaluator.measure.statistics import ratio_interval
from skd_sim.controllers import make_controller
from skd_sim.encounter.scenario import load_scenario
from skd_sim.episode import Episode, EpisodeLog, Mode, Outcome
from skd_sim.knowledge import Knowledge
from skd_sim.objective import Objective
from skd_sim.simulator import WorldSimulator
from skd_sim.state import CarState

EIGHT = (
    "time to collision",
    "latched and delayed",
    "slows near anybody",
    "Intelligent Driver Model",
    "required deceleration",
    "encroachment",
    "CAL",
    "basic, C = 1",
)
RECORDED = "citr_crossing"
"""Scenario whose car is the one that recorded pedestrians met."""


@dataclass(frozen=True)
class Attempt:
    """What became of an episode.

    Attributes:
        reached: its deformation, m; η_max without a hit.
        hit: whether the moving car hit.
        calls: of copies of the controller.
        seconds: of the processor.
        log: of the episode.
    """

    reached: float
    hit: bool
    calls: int
    seconds: float
    log: EpisodeLog


class _Counted:
    """The adversary of an episode, which is asked at its end how many calls it made; it is made when it is needed."""

    depletions = 0

    def __init__(self, episode: Episode, controller: Any, simulator: WorldSimulator) -> None:
        self._made: ItselfAdversary | None = None
        self._episode, self._controller, self._simulator = episode, controller, simulator

    @property
    def calls(self) -> int:
        return 0 if self._made is None else self._made.calls

    def act(self, car: CarState) -> tuple[float, float]:
        if self._made is None:  # the controller has been reset by now
            episode = self._episode
            world = self._simulator.world if episode.told else None
            known, calls = car_model_for(episode.car), episode.controller_calls or 0
            self._made = ItselfAdversary(episode, self._controller, known, told=world, calls=calls)
        return self._made.act(car)


def attempt(episode: Episode) -> Attempt:
    """Run an episode of knowledge itself."""
    begin = time.process_time()
    controller, simulator = make_controller(episode.controller, episode.multiplier), WorldSimulator()
    adversary = _Counted(episode, controller, simulator)
    log = run_episode(episode, controller, adversary, simulator)
    seconds = time.process_time() - begin
    scenario = episode.scenario
    hit = log.outcome == Outcome.COLLISION and scenario.collision.is_hit(log.impact_speed)
    reached = scenario.eta_max
    if hit:
        assert episode.safe_trajectory is not None
        ticks = log.impact_time / scenario.time_step
        strayed = deformation(episode.safe_trajectory.positions, log.trajectory.positions, ticks)
        reached = min(reached, strayed)
    return Attempt(reached, hit, adversary.calls, seconds, log)


def _least(tried: Sequence[Attempt], budget: int) -> float:
    """Return the least deformation (m) that is found for an episode in which several adversaries tried."""
    episode = min(tried, key=lambda one: one.reached).log
    least = min(one.reached for one in tried)
    found = search_margin(episode.episode, budget, [episode.trajectory.positions]).way if budget else None
    return least if found is None else min(least, found.distance)


def _episodes(car: Car, arguments: argparse.Namespace) -> list[Episode]:
    scenario = car.scenario
    if arguments.safe != SYNTHETIC:
        recorded = load_scenario(RECORDED)
        scenario = replace(recorded, control_period=scenario.control_period)
    plan = Plan(
        scenario,
        controller=car.controller,
        multiplier=car.multiplier,
        safe=arguments.safe,
        safe_count=arguments.safe_count,
        seed=arguments.seed,
        objective=Objective.DEFORMATION,
        knowledge=Knowledge.ITSELF,
        controller_calls=arguments.calls,
    )
    safe = safe_trajectories(plan, InProcessRunner(1))
    per_phi = math.ceil(arguments.episodes / len(safe))
    return [plan.episode(Mode.KAMIKAZE, index, one, phi) for index, phi in enumerate(safe) for one in range(per_phi)]


def _row(car: Car, arguments: argparse.Namespace) -> dict[str, Any]:
    kinds = ("told", "sensor")
    episodes = _episodes(car, arguments)
    tried = {kind: [attempt(replace(episode, told=kind == "told")) for episode in episodes] for kind in kinds}
    pairs = list(zip(*tried.values(), strict=True))
    least = np.array([_least(pair, arguments.search) for pair in pairs])
    row: dict[str, Any] = {"car": car.label, "episodes": len(episodes), "least": float(least.mean())}
    for kind in kinds:
        reached = np.array([one.reached for one in tried[kind]])
        row[kind] = {
            "deformation": float(reached.mean()),
            "closeness": float(reached.mean() / least.mean()),
            "closeness_ci95": ratio_interval(reached, least),
            "success_rate": float(np.mean([one.hit for one in tried[kind]])),
            "calls": float(np.mean([one.calls for one in tried[kind]])),
            "seconds": float(np.mean([one.seconds for one in tried[kind]])),
            "seconds_worst": float(np.max([one.seconds for one in tried[kind]])),
        }
    return row


def _show(row: dict[str, Any]) -> None:
    print(f"{row['car']}: least found {row['least']:.3f} m in {row['episodes']} episodes")
    for kind in ("told", "sensor"):
        one = row[kind]
        low, high = one["closeness_ci95"] or (math.nan, math.nan)
        print(
            f"  {kind:<7} {one['deformation']:.3f} m, closeness {one['closeness']:.3f} [{low:.3f}, {high:.3f}], hits "
            f"{one['success_rate']:.1%}, {one['calls']:.0f} calls and {one['seconds']:.2f} s an episode "
            f"(worst {one['seconds_worst']:.2f})",
            flush=True,
        )


def main() -> None:
    """Measure, and print a table or JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cars", nargs="+", default=list(EIGHT), choices=[car.label for car in CARS], metavar="LABEL")
    parser.add_argument("--safe", default=SYNTHETIC, metavar="DIR")
    parser.add_argument("--safe-count", type=int, default=10, metavar="N")
    parser.add_argument("--episodes", type=int, default=50, metavar="N", help="per car (default 50)")
    parser.add_argument(
        "--calls", type=int, metavar="N", help="of copies, an episode; by default as --controller-calls"
    )
    parser.add_argument("--search", type=int, default=1000, metavar="N", help="ticks of the search; 0: no search")
    parser.add_argument("--seed", type=int, default=0, metavar="N")
    parser.add_argument("--json", action="store_true", help="print JSON")
    arguments = parser.parse_args()
    rows = []
    for car in CARS:
        if car.label in arguments.cars:
            rows.append(_row(car, arguments))
            if not arguments.json:
                _show(rows[-1])
    if arguments.json:
        print(json.dumps(rows, indent=2))


if __name__ == "__main__":
    main()
