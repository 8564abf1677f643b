"""At a first run the searches for the margin compile in a process of their own, beside the planners.

They take as long as the planners of an assessment, nearly half a minute, and most machines have a second core. What is
compiled there comes by the cache on disk, as in any later run, so nothing of a result depends on it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

import numpy as np
from skd_sim.kernels.compilation import is_kept

from skd_evaluator.assessment.run.workers import available_workers, in_background
from skd_evaluator.margin.assessment_margin import warm_up_margins
from skd_evaluator.margin.exact.exact_search import search_least_way
from skd_evaluator.metrics.distances.frechet import discrete_frechet


@contextmanager
def margins_compiled_beside(*, wanted: bool = True) -> Iterator[Callable[[], None]]:
    """Begin to compile the searches for the margin in another process, where that is to be done anew.

    Yields what loads them into this process, for `ExecutorRunner.start`: it waits for the other process first. Enter it
    before other threads start: a process with threads is not safe to fork.

    Args:
        wanted: whether any margin is to be computed; if not, nothing is done.
    """
    with ExitStack() as stack:
        wait: Callable[[], bool] | None = None
        if wanted and available_workers() > 1 and not is_kept(search_least_way):
            wait = stack.enter_context(in_background(_compile))

        def load() -> None:
            if wait is not None:
                wait()  # however it ended: what it has not compiled is compiled here
            if wanted:
                warm_up_margins()

        yield load


def _compile() -> None:
    warm_up_margins()
    discrete_frechet(np.zeros((2, 2)), np.ones((2, 2)))
