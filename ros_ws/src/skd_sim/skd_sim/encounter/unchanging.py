"""Objects that nobody changes: a copy of something that holds such an object holds the same object."""

from __future__ import annotations

from typing import Any, Self


class Unchanging:
    """A class of frozen objects, which `copy.deepcopy` shares.

    Controllers keep their scenario, and the search for the margin copies controllers by the thousand.
    """

    __slots__ = ()

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return self
