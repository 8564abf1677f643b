"""What the tests of exchanged files share: episodes of any scenario without a simulation, and a checker's verdict."""

import logging
import os
from functools import cache
from pathlib import Path

import numpy as np
from skd_evaluator.extensions.exchange.scene import ExportedEpisode, actors_of, start_of
from skd_evaluator.metrics.surrogate_scenes import EpisodeMotion, course_of
from skd_sim.scenario.scenario import Scenario, load_scenario
from skd_sim.scenario.scenario_file import SCENARIOS

ROOT = Path(__file__).resolve().parents[2]
READERS = Path(os.environ.get("SKD_READERS", ROOT / ".venv-readers")) / "bin" / "python"
"""Python of an environment with commonroad-io and omega-prime, which cannot be in one with OSI's own library."""
DATE = "2026-01-02T03:04:05Z"
TICKS = 9


@cache
def scenarios() -> tuple[str, ...]:
    return tuple(SCENARIOS.own)


@cache
def course(name: str, contact: bool = True, whole_ticks: bool = False) -> EpisodeMotion:
    """A car on its lane that brakes a little, and an adversary that turns a little, until a contact within a tick."""
    scenario = load_scenario(name)
    step, user = scenario.time_step, scenario.adversary
    towards = user.start_heading or 0.0
    speed = 0.5 * user.speed
    times = step * np.arange(TICKS)
    turned = towards + 0.05 * np.arange(TICKS - 1)
    moved = speed * step * np.column_stack([np.cos(turned), np.sin(turned)])
    adversary = np.array([user.start_x, user.start_y]) + np.vstack([np.zeros(2), np.cumsum(moved, axis=0)])
    begin = -(scenario.car.start_gap + scenario.car.front)
    along = begin + scenario.car.start_speed * times - 0.25 * times**2
    poses = np.array([scenario.road.place(0, s) for s in along.tolist()])
    car = np.column_stack([poses, scenario.car.start_speed - 0.5 * times])
    impact = (times[-2] + 0.37 * step, car[-1, 3]) if contact and not whole_ticks else ()
    return course_of(scenario, adversary, car, *impact)


def recorded(name: str, *, with_car: bool = True, whole_ticks: bool = False, stem: str = "kamikaze") -> ExportedEpisode:
    scenario = load_scenario(name)
    how = course(name, whole_ticks=whole_ticks)
    actors = actors_of(scenario, how, with_car=True)
    x, y, heading, speed = actors[0].states[0].tolist()
    start = (x, y, heading, speed)
    chosen = actors if with_car else actors[1:]
    return ExportedEpisode(stem, f"a test of {name}", scenario, chosen, start, float(how.times[-1]), DATE, whole_ticks)


def safe(name: str, phi: np.ndarray) -> ExportedEpisode:
    """A φ of a scenario, ready to go out."""
    scenario = load_scenario(name)
    times = scenario.time_step * np.arange(len(phi))
    actors = actors_of(scenario, EpisodeMotion(times, phi, np.full((len(phi), 4), np.nan)), with_car=False)
    return ExportedEpisode("phi_000", "a φ", scenario, actors, start_of(scenario, phi), float(times[-1]), DATE)


def walk(scenario: Scenario, count: int = 12) -> np.ndarray:
    """Straight across at a pace that is no round number."""
    x = np.linspace(scenario.adversary.start_x, -scenario.adversary.start_x, count)
    return np.column_stack([x + 1e-3 * np.sin(np.arange(count)), 0.1 * np.cos(np.arange(count))])


def checked(path: Path) -> dict[str, tuple[str, list[str]]]:
    """Status and issues of each check of ASAM's checker for OpenSCENARIO."""
    from qc_baselib import Configuration, Result
    from qc_openscenario import constants
    from qc_openscenario.main import run_checks

    logging.disable(logging.CRITICAL)
    try:
        asked, result = Configuration(), Result()
        asked.set_config_param("InputFile", str(path.resolve()))
        asked.register_checker_bundle(constants.BUNDLE_NAME)
        result.register_checker_bundle(name=constants.BUNDLE_NAME, description="", version="1", summary="")
        result.set_result_version(version="1")
        run_checks(asked, result)
        (bundle,) = result._report_results.checker_bundles
        return {one.checker_id: (one.status.name, [its.description for its in one.issues]) for one in bundle.checkers}
    finally:
        logging.disable(logging.NOTSET)


def passes(path: Path) -> bool:
    """Whether a file passes all checks, of which there are seventeen."""
    found = checked(path)
    assert len(found) == 17
    return all(status == "COMPLETED" and not issues for status, issues in found.values())
