"""Where the episodes of a campaign run: worker processes of this machine, or a Dask cluster."""

from __future__ import annotations

from skd_sim.controllers.isolated import CALL_LIMIT

from skd_evaluator.campaign.run.executor_runner import ExecutorRunner
from skd_evaluator.campaign.run.workers import InProcessRunner


def make_runner(
    scheduler: str | None, workers: int, *, isolated: bool = False, answer_limit: float = CALL_LIMIT
) -> ExecutorRunner:
    """Return what runs episodes, a context manager; the results are the same wherever they run.

    It may be used by several threads at once. Call its `start` before other threads start.

    Args:
        scheduler: address of a Dask scheduler, for example tcp://host:8786; None: processes of this machine.
        workers: number of processes on this machine; of no meaning with a scheduler.
        isolated: whether episodes with a user's own controller are to come.
        answer_limit: time that a call of a user's controller may take, s.

    Raises:
        UsageError: the address is none.
    """
    if scheduler is None:
        return InProcessRunner(workers, isolated=isolated, answer_limit=answer_limit)
    from skd_evaluator.campaign.run.dask_cluster import DaskRunner  # a command without one need not import it

    return DaskRunner(scheduler, answer_limit=answer_limit)
