"""Who runs the episodes of a command in process, as its options say."""

from __future__ import annotations

import argparse

from skd_sim.controllers.isolated import CALL_LIMIT

from skd_evaluator.assessment.run.dask_cluster import make_runner
from skd_evaluator.assessment.run.workers import ExecutorRunner, available_workers


def runner_of(
    arguments: argparse.Namespace, *, isolated: bool = False, answer_limit: float = CALL_LIMIT
) -> ExecutorRunner:
    """Return what the options of `add_runner_arguments` ask for; see `make_runner`."""
    workers = arguments.workers or available_workers()
    return make_runner(arguments.scheduler, workers, isolated=isolated, answer_limit=answer_limit)
