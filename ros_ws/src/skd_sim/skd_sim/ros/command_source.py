"""Where one kind of command comes from: who sends it, what has been answered, and what to say if nothing comes."""

from __future__ import annotations

from typing import Protocol

from skd_sim.world.aborts import AbortKind, abort_reason
from skd_sim.world.stamps import NANOSECONDS, stamp_fault


class Senders(Protocol):
    """What the middleware knows of those who may send one kind of command."""

    def count(self) -> int:
        """Return how many there are, the dead of the last seconds among them; it is asked often, and cheap."""

    def living(self) -> int:
        """Return how many of them live."""

    def names(self) -> list[str]:
        """Return the names of those that live, one that publishes twice twice; it may take a moment."""

    def absence(self) -> str:
        """Return why nothing can come, where `count` is 0."""


class Source:
    """One kind of command: who sends it, what was answered to which tick, and what was of no use.

    Attributes:
        who: name of the sender, for messages.
        topic: topic on which its commands are published.
        senders: what the middleware knows of those who publish there.
        command: command for the coming step; None until it has come.
    """

    def __init__(self, who: str, topic: str, senders: Senders) -> None:
        """Begin without any command and without any sender."""
        self.who = who
        self.topic = topic
        self.senders = senders
        self._alone = f"{who} ({topic})"
        self.begin()

    def begin(self) -> None:
        """Forget the last episode."""
        self.command: tuple[float, ...] | None = None
        self._answers: dict[int, tuple[float, ...]] = {}
        self.go_on()

    def go_on(self) -> None:
        """Forget what was of no use: a control period is over."""
        self._ignored = self._newest = 0

    def answered(self, stamp: int) -> bool:
        """Return whether there was an answer with this stamp (ns) already."""
        return stamp in self._answers

    def note(self, stamp: int, answer: tuple[float, ...]) -> None:
        """Take note of the first answer with a stamp (ns)."""
        self._answers[stamp] = answer

    def ignore(self, stamp: int) -> None:
        """Take note of a command that is for no tick that is wanted."""
        self._ignored += 1
        self._newest = max(self._newest, stamp)

    def contradiction(self, stamp: int, answer: tuple[float, ...], start: int) -> str | None:
        """Return what is wrong with a second answer to a tick, if anything.

        Of two different answers to one tick, it would be chance which one counts. The state of tick 0 is repeated, and
        so its answer may be repeated, too.

        Args:
            stamp: stamp of the tick, ns.
            answer: command that answers the tick.
            start: stamp of tick 0, ns.
        """
        same = self._answers[stamp] == answer
        if same and stamp == start:
            return None
        names = self.senders.names()
        by = f" (it has {len(names)} publishers: {', '.join(names)})" if len(names) > 1 else ""
        how = "with the same command" if same else "with different commands"
        return abort_reason(
            AbortKind.SECOND_SENDER,
            f"{self._alone} answered the tick at {_seconds(stamp - start)} of the episode twice, {how}{by}",
        )

    def crowd(self) -> str | None:
        """Return who the senders are where they are several; none where there is one, or nobody."""
        if self.senders.count() < 2 or self.senders.living() < 2:
            return None
        names = self.senders.names()
        names += ["one that is gone"] * (2 - len(names))
        return abort_reason(
            AbortKind.SECOND_SENDER, f"{len(names)} nodes publish {self.topic}, one may: {', '.join(names)}"
        )

    def silence(self, wanted: int, limit: float, tick: int) -> str:
        """Return why there is no answer to a tick, as a reason.

        Args:
            wanted: stamp of the tick for which a command is missing, ns.
            limit: how long the command was waited for, s of wall time.
            tick: number of that tick.
        """
        silent = f"{self._alone} stayed silent for {limit:g} s at tick {tick}"
        if self._ignored:
            return abort_reason(
                AbortKind.WRONG_STAMP,
                f"{silent}: its commands carry other stamps ({self._ignored} came; newest {_seconds(self._newest)}, "
                f"wanted {_seconds(wanted)}); {stamp_fault(self._newest, wanted)}",
            )
        if self.senders.count():
            return abort_reason(AbortKind.NO_ANSWER, silent)
        return abort_reason(AbortKind.NOT_STARTED, f"{silent}: {self.senders.absence()}")


def _seconds(stamp: int) -> str:
    return f"{stamp / NANOSECONDS:.3f} s"
