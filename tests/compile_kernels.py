"""Compile what tests of all folders need, into the cache, once: rather than in each process that runs them."""

import multiprocessing
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from skd_adversary.adversary import any_car_models, warm_up_episodes
from skd_evaluator import assess, discrete_frechet
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages.margin import warm_up_margins
from skd_sim.options.car_and_adversary import DEFAULT_OBJECTIVES, Objective

CARS = (("basic", "basic"), ("external", "basic"), ("basic", "multi_body"))
"""Controllers and dynamics that nobody has modelled."""
EVADES = str(Path(__file__).resolve().parents[1] / "examples" / "evasive" / "evasive.py") + ":BrakesToOtherLane"
"""A car that steers, in another process."""
SMALL = {"safe_count": 1, "kamikaze_count": 1, "collision_runs": 1, "simulations": 10, "margin_limit": 1, "workers": 1}


def compile_planners(controller: str, dynamics: str) -> None:
    """Compile the planners of a car that nobody has modelled."""
    InProcessRunner(1).start(warm_up_episodes(controller, dynamics=dynamics))


def compile_objective(objective: Objective, model: str, car: str) -> None:
    """Compile the planners of an objective, against a car of which a model may be known."""
    InProcessRunner(1).start(warm_up_episodes(car, objective=objective, car_model=model))


def compile_assessment(**options: Any) -> None:
    """Compile what measures, checks and searches besides the planners."""
    assess(**SMALL | options)


def compile_distances() -> None:
    """Compile Fréchet distances, and the search for margins."""
    warm_up_margins()
    discrete_frechet(np.zeros((2, 2)), np.ones((2, 2)))


def works() -> list[Callable[[], None]]:
    """Return what is to be compiled, in parts that have much in common with few others."""
    law, forest = any_car_models()
    cars = (("", "basic"), (law, "basic"), (law, "external"), (forest, "external"))
    planners = [(objective, *car) for car in cars for objective in DEFAULT_OBJECTIVES] + [(Objective.FRECHET, *cars[0])]
    return [
        compile_distances,
        *(partial(compile_planners, *car) for car in CARS),
        partial(compile_assessment),
        partial(compile_assessment, controller="cal", adversary_model="generic"),
        partial(compile_assessment, scenario="cyclist"),
        partial(compile_assessment, scenario="child", objective="deviation"),
        partial(compile_assessment, scenario="oncoming_lane", controller=EVADES, kamikaze_count=6, behaviour="none"),
        *(partial(compile_objective, *one) for one in planners),
    ]


if __name__ == "__main__":
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("fork")) as pool:
        for done in [pool.submit(work) for work in works()]:
            done.result()
