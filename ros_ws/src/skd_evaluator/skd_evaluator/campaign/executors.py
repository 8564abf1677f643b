"""Where the episodes of a campaign run: worker processes of this machine, or a Dask cluster."""

from __future__ import annotations

from skd_sim.errors import UsageError

from skd_evaluator.campaign.worker_pool import ANSWER_LIMIT
from skd_evaluator.campaign.workers import InProcessRunner


def make_runner(
    scheduler: str | None, workers: int, *, isolated: bool = False, answer_limit: float = ANSWER_LIMIT
) -> InProcessRunner:
    """Return what runs episodes, a context manager; the results are the same wherever they run.

    It may be used by several threads at once. Call its `start` before other threads start.

    Args:
        scheduler: address of a Dask scheduler, as tcp://host:8786; None: processes of this machine.
        workers: processes of this machine; of no meaning with a scheduler.
        isolated: whether a controller of a user's own is to come.
        answer_limit: s that a call of a user's controller may take.

    Raises:
        UsageError: the address is none.
    """
    if scheduler is None:
        return InProcessRunner(workers, isolated=isolated, answer_limit=answer_limit)
    raise UsageError(f"no scheduler at {scheduler}")
