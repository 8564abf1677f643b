"""Which logs of recordings count, which are left out as damaged, and what has to be said of the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from skd_sim.errors import UsageError
from skd_sim.world.episode import EpisodeLog

from skd_evaluator.assessment.validation.episode_check import examine

OPTION = "--skip-damaged"


class Damage:
    """Keeps the account of what was left out of recordings, and of what a reader of the result should know.

    Attributes:
        left_out: what was left out and why, a line each.
        warnings: what counts, but with a warning, a line each.
        unchecked: files that have no checksums.
    """

    def __init__(self, *, skip: bool = False) -> None:
        """Begin with nothing.

        Args:
            skip: leave damaged parts out instead of refusing them.
        """
        self.skip = skip
        self.left_out: list[str] = []
        self.warnings: list[str] = []
        self.unchecked: list[Path] = []

    def leave_out(self, what: str) -> None:
        """Leave something out.

        Raises:
            UsageError: nothing is to be left out.
        """
        if not self.skip:
            raise UsageError(f"{what}; {OPTION} leaves it out")
        if what not in self.left_out:
            self.left_out.append(what)

    def warn(self, what: str) -> None:
        """Take note of a warning about something that counts."""
        if what not in self.warnings:
            self.warnings.append(what)


@dataclass(frozen=True)
class Found:
    """A log and where it was found.

    Attributes:
        log: what happened in one episode.
        where: file or other origin, for messages.
        campaign: name of the campaign to which the episode belongs.
    """

    log: EpisodeLog
    where: str
    campaign: str

    @property
    def name(self) -> str:
        """File and episode, for messages."""
        return f"{self.where}: episode {self.log.episode.episode_id}"


def accept(found: Sequence[Found], damage: Damage) -> list[int]:
    """Return which logs count, as indices.

    Left out is what cannot have happened, and what SKD's own world would not have given in a campaign of which it gave
    other episodes. Where it gave none, the recording is of another simulator: it counts, checked within that
    simulator's freedom only, and a warning says so.

    Args:
        found: logs of any number of campaigns, each episode once.
        damage: told what is left out, and what is to be said.

    Raises:
        UsageError: something would have to be left out, and `damage` does not allow it.
    """
    verdicts = [examine(one.log) for one in found]
    ours = {one.campaign for one, verdict in zip(found, verdicts, strict=True) if verdict.ours and len(one.log.car) > 1}
    kept: list[int] = []
    foreign: dict[str, list[int]] = {}
    for index, (one, verdict) in enumerate(zip(found, verdicts, strict=True)):
        if verdict.fault:
            damage.leave_out(f"{one.name}: {verdict.fault}")
        elif not verdict.ours and one.campaign in ours:
            damage.leave_out(
                f"{one.name}: {verdict.where} does not follow from its other states (by {verdict.deviation:.3g}), "
                "though this campaign ran in SKD's own world"
            )
        else:
            kept.append(index)
            if not verdict.ours:
                foreign.setdefault(one.campaign, []).append(index)
    for places in foreign.values():
        worst = max(places, key=lambda place: verdicts[place].deviation)
        what = "1 episode" if len(places) == 1 else f"{len(places)} episodes"
        damage.warn(
            f"{what} did not run in SKD's own world ({verdicts[worst].where} is off by "
            f"{verdicts[worst].deviation:.3g}, {found[worst].name}): another simulator's impacts are checked roughly"
        )
    return kept
