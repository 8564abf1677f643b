"""An episode runner that stores the logs of another one, and asks it only for episodes that have not run before."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence

from skd_sim.world.episode import Episode, EpisodeLog, Outcome

from skd_evaluator.assessment.plan.plan import EpisodeRunner
from skd_evaluator.extensions.campaign.store import CellStore


class StoppedError(RuntimeError):
    """The campaign is to end; no episode is worth waiting for any more."""


class StoringRunner:
    """Runs episodes, or reads what became of them; an `EpisodeRunner`.

    A plan draws its episodes deterministically, so the same plan over the same store goes on where it was. An aborted
    episode is passed on and not stored: it says something about the machine only, so it is run again when the campaign
    is resumed.

    Attributes:
        given: how many episodes there have been so far.
        read: how many of them had been stored before.
    """

    def __init__(self, runner: EpisodeRunner, store: CellStore, stop: threading.Event) -> None:
        """Let `runner` do what is missing in `store`, until `stop` is set."""
        self._runner, self._store, self._stop = runner, store, stop
        self.given = self.read = 0

    def run(self, episodes: Sequence[Episode]) -> Iterator[EpisodeLog]:
        """Run all of `episodes`; see `EpisodeRunner`.

        Raises:
            StoppedError: the campaign is to end.
            StoreError: the store is damaged, or cannot be written.
        """
        keys = self._store.specifications(episodes)
        known = self._store.known(keys)
        pairs = list(zip(keys, episodes, strict=True))
        missing = [episode for key, episode in pairs if key not in known]
        fresh = self._runner.run(missing) if missing else iter(())
        for key, episode in pairs:
            if self._stop.is_set():
                raise StoppedError
            if key in known:
                log = self._store.get(key, episode)
                self.read += 1
            else:
                log = next(fresh)
                if log.outcome != Outcome.ABORTED:
                    self._store.put(key, log)
            self.given += 1
            yield log
