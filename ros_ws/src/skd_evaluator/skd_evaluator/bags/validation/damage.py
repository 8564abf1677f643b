"""What is done with damaged recordings: refused at once, or left out and counted."""

from __future__ import annotations

from pathlib import Path

from skd_sim.errors import UsageError

OPTION = "--skip-damaged"


class Damage:
    """Keeps the account of what was left out of recordings, and of what a reader of the result should know.

    Attributes:
        left_out: what was left out and why, a line each.
        warnings: what counts, but with a warning, a line each.
        unchecked: files that have no checksums.
        unread: files that are no recordings, and were not read.
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
        self.unread: list[Path] = []

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
