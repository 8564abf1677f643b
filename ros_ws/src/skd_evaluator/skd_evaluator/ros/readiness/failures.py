"""Episodes that are aborted, as they come: said once of each kind, and too many in a row end the campaign."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from skd_sim.controllers.isolated import FAILED_STARTS
from skd_sim.world.aborts import AbortKind, kind_of
from skd_sim.world.episode import EpisodeLog, Outcome

from skd_evaluator.errors import AssessmentError
from skd_evaluator.ros.processes import log_of


class Failures:
    """Takes note of every episode of a campaign, in their order.

    Attributes:
        reasons: why episodes were aborted, one reason for each.
    """

    def __init__(self, say: Callable[[str], None], log_folder: Path | None = None) -> None:
        """Know of none yet.

        Args:
            say: called with a line for the user.
            log_folder: folder with the output of the graph's processes, if they print there.
        """
        self.reasons: list[str] = []
        self._say = say
        self._log_folder = log_folder
        self._said: set[AbortKind] = set()
        self._failed_starts = 0

    def note(self, log: EpisodeLog) -> None:
        """Take note of an episode.

        Raises:
            AssessmentError: it is the last of several in a row that were aborted before their first tick.
        """
        if log.outcome != Outcome.ABORTED:
            self._failed_starts = 0
            return
        self.reasons.append(log.reason)
        self._failed_starts = 0 if len(log.adversary) > 1 else self._failed_starts + 1
        kind = kind_of(log.reason)
        if kind not in self._said:
            self._said.add(kind)
            where = f"; log: {log_of(self._log_folder, log.reason)}" if self._log_folder else ""
            self._say(f"an episode was aborted, the first one so: {log.reason}{where}")
        if self._failed_starts >= FAILED_STARTS:
            raise AssessmentError(f"{FAILED_STARTS} starts in a row failed, the last one so: {log.reason}")
