"""Compile what tests of all folders need, into the cache: once, rather than in each of the processes that run them."""

from __future__ import annotations

import numpy as np
from skd_adversary.warm_up import any_car_models, warm_up_episodes
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages.margin import warm_up_margins
from skd_evaluator.metrics.frechet import discrete_frechet
from skd_sim.options.adversary import DEFAULT_OBJECTIVES


def compile_planners() -> None:
    """Compile the planners of cars that nobody has modelled, or load them."""
    kinds = (("basic", "basic"), ("external", "basic"), ("basic", "multi_body"))
    InProcessRunner(1).start(
        [episode for name, dynamics in kinds for episode in warm_up_episodes(name, dynamics=dynamics)]
    )
    discrete_frechet(np.zeros((2, 2)), np.ones((2, 2)))


def compile_the_rest() -> None:
    """Compile the planners of all other objectives and cars, and the search for margins."""
    for objective in DEFAULT_OBJECTIVES:
        for model in ("", *any_car_models()):
            InProcessRunner(1).start(warm_up_episodes(objective=objective, car_model=model))
    warm_up_margins()


if __name__ == "__main__":
    compile_planners()
    compile_the_rest()
