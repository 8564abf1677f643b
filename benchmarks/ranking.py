"""Whether the measures rank cars: by each, beside how often the cars hit somebody when encounters vary widely.

The truth is the collision rate under a perturbation much larger than kamikazes are planned with (wide_encounters.py),
contacts with a standing car left out; a second one lets everybody change his pace on the way, a third one lets
everybody stop once for up to a second. The cars: the basic one at five C, CAL, CARLA 0.8's agent, a multi-body car on
three roads, the vendor's example, an Intelligent Driver Model. All on the same five synthetic safe trajectories.
Kamikazes know C of the basic car; of every other car they have a model that is fitted to a probe of it, as `skd probe`,
`skd fit` and `skd assess --car-model` do. Floors are of the first attempts of each φ: exact for the basic car, for the
others the least that a search against the car itself has found. Kendall's τ compares the orders.

A kamikaze that walks into a standing car counts as a hit in an assessment, and not in the truth. So both deformations
are there a second time with the truth's idea of a hit, "car moving": such contacts are none, in planning either.

    python benchmarks/ranking.py --out FILE [--runs 5000] [--kamikaze-count 100] [--floor-count 20]
        [--again PART ...] [--json]

FILE keeps what has been computed; the same command goes on from there.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from cars.vendor import vendor_module
from scipy.stats import kendalltau
from skd_adversary.car_fit import fit_car, observe
from skd_adversary.car_model_file import car_model_text
from skd_adversary.warm_up import warm_up_episodes
from skd_evaluator.bags.logs import recording_of
from skd_evaluator.campaign.assessment import assess, standing_contacts
from skd_evaluator.campaign.plan import Plan, safe_trajectories
from skd_evaluator.campaign.probe import probe_episodes
from skd_evaluator.campaign.runner import run_episode
from skd_evaluator.campaign.workers import InProcessRunner, available_workers
from skd_evaluator.floor.anytime import actions_of, anytime_floor
from skd_evaluator.margin.exact import exact_margin
from skd_evaluator.measure.statistics import normal_interval, wilson_interval
from skd_sim.encounter.road import HEADING_NORTH
from skd_sim.encounter.scenario import load_scenario
from skd_sim.episode import Episode, EpisodeLog, Mode, Outcome
from skd_sim.geometry import first_contact, to_car_frame
from skd_sim.objective import Objective
from skd_sim.ros_environment import enter_ros, is_ready
from skd_sim.trajectory import Trajectory
from wide_encounters import STANDING, Car, hit_rate

MULTIPLIERS = (0.5, 0.75, 1.0, 1.15, 1.5)
FRICTIONS = (1.0, 0.3, 0.15)
"""Dry, snow and ice; above about 0.35 the road holds all that the controller asks of it."""
PROBES = 1000
LONGEST = 10.0  # s: a longer time to collision counts as this
MEASURES = {
    "planned": ("deformation, planned", +1),
    "floor": ("deformation, floor", +1),
    "planned_moving": ("deformation, planned, car moving", +1),
    "floor_moving": ("deformation, floor, car moving", +1),
    "skd_paper": ("SKD, paper", +1),
    "prefix_paper": ("prefix, paper", +1),
    "skd_frechet": ("SKD, frechet", +1),
    "prefix_frechet": ("prefix, frechet", +1),
    "least_ttc": ("min. TTC (s)", +1),
    "along": ("hit along φ", -1),
}
"""Figures that rank, and whether more of them is safer."""


TRUTHS: dict[str, tuple[str, dict[str, bool]]] = {
    "truth": ("hit_rate", {}),
    "truth_changing": ("hit_rate_changing", {"changing": True}),
    "truth_hesitating": ("hit_rate_hesitating", {"hesitating": True}),
}
"""Part of the file, key of the hit rate, and how the pedestrians walk."""


def cars() -> tuple[list[Car], list[str]]:
    """Return the cars, and what is left out and why."""
    crossing, multi_body = load_scenario("crossing"), load_scenario("crossing_multi_body")
    found = [Car(f"basic, C = {one:g}", "basic", one, crossing) for one in MULTIPLIERS]
    found += [Car("CAL", "cal", 1.0, crossing), Car("CARLA 0.8", "carla", 1.0, crossing)]
    for friction in FRICTIONS:
        road = replace(multi_body.road, friction=friction)
        found.append(Car(f"multi-body, friction {friction:g}", "basic", 1.0, replace(multi_body, road=road)))
    found.append(Car("Intelligent Driver Model", "cars.idm:IntelligentDriver", 1.0, crossing))
    try:
        vendor_module()
    except ImportError as error:
        return found, [f"vendor's example: {error}; it comes with the first graph command (scripts/skd episode)"]
    return [*found, Car("vendor's example", "cars.vendor:VendorCar", 1.0, crossing)], []


def is_basic(car: Car) -> bool:
    """Return whether kamikazes know how the car drives."""
    return car.controller == "basic" and car.scenario.car.dynamics == "basic"


def least_time_to_collision(log: EpisodeLog) -> float:
    """Return the least time (s) to a contact with both velocities kept, over all ticks of a run; 0: they touched."""
    if log.outcome == Outcome.COLLISION:
        return 0.0
    scenario = log.episode.scenario
    footprint = (scenario.car.front, scenario.car.rear, scenario.car.half_width, scenario.pedestrian.radius)
    least = LONGEST
    velocities = np.diff(log.pedestrian, axis=0) / scenario.time_step
    for (x, y), (vx, vy), (car_x, car_y, speed) in zip(log.pedestrian[:-1], velocities, log.car[:-1], strict=True):
        here = to_car_frame(x, y, car_x, car_y, HEADING_NORTH)
        there = to_car_frame(x + LONGEST * vx, y + LONGEST * vy, car_x, car_y + LONGEST * speed, HEADING_NORTH)
        least = min(least, LONGEST * first_contact(*here, *there, *footprint))
    return float(least)


def fitted_model(car: Car, runner: InProcessRunner) -> str:
    """Return the car model that a probe gives; none of the basic car, of which all is known."""
    if is_basic(car):
        return ""
    episodes = probe_episodes(car.scenario, PROBES, seed=1, controller=car.controller, multiplier=car.multiplier)
    return str(car_model_text(fit_car(observe([recording_of(log) for log in runner.run(episodes)]))))


def planned(plan: Plan, safe: Sequence[Trajectory], runner: InProcessRunner) -> dict[str, Any]:
    """Return the figures of planned kamikazes of one objective; of `deformation` also those of the runs along φ."""
    ranks = plan.objective == Objective.DEFORMATION
    result = assess(plan if ranks else replace(plan, collision_runs=len(safe)), safe, runner, lambda *_: None)
    if not ranks:
        return {f"skd_{plan.objective}": result.skd.skd, f"prefix_{plan.objective}": result.skd.skd_prefix}
    logs = [log for kamikaze in result.kamikaze for log in kamikaze.logs]
    return {
        "planned": result.deformation.mean,
        "planned_ci95": result.deformation.ci95,
        "success": result.success_rate,
        "standing": standing_contacts(logs) / max(1, sum(log.outcome == Outcome.COLLISION for log in logs)),
        "along": sum(log.outcome == Outcome.COLLISION for log in result.replays) / len(result.replays),
        "least_ttc": float(np.mean([least_time_to_collision(log) for log in result.replays])),
    }


def least_deformation(episode: Episode) -> float:
    """Return the least deformation (m) of an episode, at most η_max: exact for the basic car, else the least found."""
    eta_max = episode.scenario.eta_max
    if episode.controller == "basic" and episode.scenario.car.dynamics == "basic":
        exact = exact_margin(episode, eta_max)
        return eta_max if exact is None else exact.distance
    found = anytime_floor(episode, start=actions_of(run_episode(episode)))
    return eta_max if found is None else min(found.distance, eta_max)


def floors(plan: Plan, safe: Sequence[Trajectory], count: int, runner: InProcessRunner) -> dict[str, Any]:
    """Return the mean least deformation over the first `count` attempts of each φ."""
    episodes = [
        plan.episode(Mode.KAMIKAZE, index, attempt, phi) for index, phi in enumerate(safe) for attempt in range(count)
    ]
    values = np.array(list(runner.map(least_deformation, episodes)))
    return {"floor": float(values.mean()), "floor_ci95": normal_interval(values)}


def without_standing_contacts(plan: Plan) -> Plan:
    """Return the plan with the truth's idea of a hit: the car moves. Hardly any runs along φ, which are known."""
    collision = replace(plan.scenario.collision, minimum_impact_speed=STANDING)
    scenario = replace(plan.scenario, collision=collision)
    return replace(plan, scenario=scenario, collision_runs=plan.safe_count)


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
            for part in again:
                known.pop(part, None)

    def once(self, car: str, part: str, work: Callable[[], Any]) -> Any:
        """Return a part of a car's figures, computed at the first time."""
        known = self._content["cars"].setdefault(car, {})
        if part not in known:
            begin = time.perf_counter()
            known[part] = work()
            temporary = self._path.with_suffix(".part")
            temporary.write_text(json.dumps(self._content, indent=1, ensure_ascii=False), encoding="utf-8")
            temporary.replace(self._path)
            print(f"{car}: {part}, {time.perf_counter() - begin:.0f} s", flush=True)
        return known[part]


def kendall(
    rows: Sequence[dict[str, Any]], measure: str, truth: str = "hit_rate", *, told_apart: bool = False
) -> float:
    """Return Kendall's τ of a measure with the safety that the hit rates say.

    Args:
        rows: of the cars.
        measure: key of the figure.
        truth: key of the hit rate.
        told_apart: over those pairs of cars alone whose hit rates have intervals that do not overlap: the share of
            them in the same order less the share in the other; else τ-b over all.
    """
    sign = MEASURES[measure][1]
    if not told_apart:
        return float(kendalltau([-row[truth] for row in rows], [sign * row[measure] for row in rows]).statistic)
    orders = [
        np.sign(one[truth] - other[truth]) * np.sign(sign * (other[measure] - one[measure]))
        for one, other in combinations(rows, 2)
        if max(one[f"{truth}_ci95"][0], other[f"{truth}_ci95"][0])
        > min(one[f"{truth}_ci95"][1], other[f"{truth}_ci95"][1])
    ]
    return float(np.mean(orders))


TAUS: dict[str, dict[str, Any]] = {
    "Kendall's τ": {},
    "τ, pairs told apart": {"told_apart": True},
    "τ, changing pace": {"truth": "hit_rate_changing"},
    "τ, changing pace, pairs told apart": {"truth": "hit_rate_changing", "told_apart": True},
    "τ, hesitating": {"truth": "hit_rate_hesitating"},
    "τ, hesitating, pairs told apart": {"truth": "hit_rate_hesitating", "told_apart": True},
}


def row_of(label: str, truths: dict[str, dict[str, int]], figures: dict[str, Any]) -> dict[str, Any]:
    """Return a car's row of the table."""
    row: dict[str, Any] = {"car": label}
    for name, counts in truths.items():
        row[name] = counts["hits"] / counts["runs"]
        row[f"{name}_ci95"] = wilson_interval(counts["hits"], counts["runs"])
        row[f"{name}_standing"] = counts["standing"]
    return {**row, **figures}


def show(rows: Sequence[dict[str, Any]], taus: dict[str, dict[str, float]]) -> None:
    """Print the table, the car that is hit most first."""
    shown = [name for name in MEASURES if name in rows[0]]
    names = " | ".join(MEASURES[name][0] for name in shown)
    print(f"| car | hit rate | changing pace | hesitating | {names} | success | into a standing car |")
    print("|---|---|---|---|" + "---|" * (len(shown) + 2))
    for row in sorted(rows, key=lambda one: -one["hit_rate"]):
        cells = [f"{100 * row[name]:.1f} %" if name == "along" else f"{row[name]:.2f}" for name in shown]
        rates = " | ".join(f"{100 * row[name]:.1f} %" for name, _ in TRUTHS.values())
        shares = f"{100 * row['success']:.0f} % | {100 * row['standing']:.0f} %"
        print(f"| {row['car']} | {rates} | {' | '.join(cells)} | {shares} |")
    for name, values in taus.items():
        print(f"| **{name}** | | | | " + " | ".join(f"**{values[one]:.2f}**" for one in shown) + " | | |")


def main() -> None:
    """Compute what is missing, and print the table or JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="keeps what has been computed")
    parser.add_argument("--runs", type=int, default=5000, metavar="N", help="per car, of the truth (default 5000)")
    parser.add_argument("--kamikaze-count", type=int, default=100, metavar="N", help="per φ (default 100)")
    parser.add_argument("--floor-count", type=int, default=20, metavar="N", help="per φ; 0: no floors (default 20)")
    parser.add_argument(
        "--again",
        nargs="+",
        default=[],
        choices=(*TRUTHS, "car_model", "floor", "moving", "floor_moving", *map(str, Objective)),
        help="compute these parts anew",
    )
    parser.add_argument("--seed", type=int, default=0, metavar="N")
    parser.add_argument("--workers", type=int, default=available_workers(), metavar="N")
    parser.add_argument("--json", action="store_true", help="print JSON")
    arguments = parser.parse_args()
    if is_ready():
        enter_ros()  # begins this process anew, with the libraries of the vendor's messages
    settings = {name: getattr(arguments, name) for name in ("runs", "kamikaze_count", "floor_count", "seed")}
    store = Store(arguments.out, settings, arguments.again)
    rows = []
    chosen, missing = cars()
    with InProcessRunner(arguments.workers, isolated=True) as runner:
        runner.start([episode for objective in Objective for episode in warm_up_episodes(objective=objective)])
        safe = safe_trajectories(Plan(load_scenario("crossing"), seed=arguments.seed), runner)
        for car in chosen:
            truths = {
                name: store.once(
                    car.label,
                    part,
                    lambda car=car, how=how: hit_rate(car, safe, arguments.runs, arguments.seed, runner, **how),
                )
                for part, (name, how) in TRUTHS.items()
            }
            model = store.once(car.label, "car_model", lambda car=car: fitted_model(car, runner))
            plan = Plan(
                car.scenario,
                controller=car.controller,
                multiplier=car.multiplier,
                kamikaze_count=arguments.kamikaze_count,
                seed=arguments.seed,
                objective=Objective.DEFORMATION,
                car_model=model,
            )
            figures: dict[str, Any] = {}
            for objective in Objective:
                part = replace(plan, objective=objective)
                figures |= store.once(car.label, str(objective), lambda part=part: planned(part, safe, runner))
            moving = without_standing_contacts(plan)
            figures |= store.once(
                car.label, "moving", lambda moving=moving: {"planned_moving": planned(moving, safe, runner)["planned"]}
            )
            if arguments.floor_count:
                figures |= store.once(
                    car.label, "floor", lambda plan=plan: floors(plan, safe, arguments.floor_count, runner)
                )
                figures |= store.once(
                    car.label,
                    "floor_moving",
                    lambda moving=moving: {
                        "floor_moving": floors(moving, safe, arguments.floor_count, runner)["floor"]
                    },
                )
            rows.append(row_of(car.label, truths, figures))
    taus = {
        name: {measure: kendall(rows, measure, **how) for measure in MEASURES if measure in rows[0]}
        for name, how in TAUS.items()
    }
    if arguments.json:
        print(json.dumps({"cars": rows, "left_out": missing, "kendall_tau": taus}, indent=2, ensure_ascii=False))
        return
    show(rows, taus)
    for line in missing:
        print(f"left out: {line}")


if __name__ == "__main__":
    main()
