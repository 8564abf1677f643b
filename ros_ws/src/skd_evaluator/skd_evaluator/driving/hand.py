"""An adversary that is moved by keys, and what else keys ask for."""

from __future__ import annotations

import threading
from enum import Enum
from typing import Final

from skd_sim.scenario.scenario import Scenario
from skd_sim.world.state import CarState

_DIRECTIONS: Final = {
    # As seen on the screen, on which the car drives to the right: (East, North).
    "up": (-1.0, 0.0),
    "w": (-1.0, 0.0),
    "down": (1.0, 0.0),
    "s": (1.0, 0.0),
    "left": (0.0, -1.0),
    "a": (0.0, -1.0),
    "right": (0.0, 1.0),
    "d": (0.0, 1.0),
    " ": (0.0, 0.0),
}
_PACES: Final = (0.25, 0.5, 0.75, 1.0)
"""Shares of the road user's speed that can be chosen."""
_FASTER, _SLOWER = ("+", "="), ("-", "_")


class Wish(Enum):
    """What is to become of the episode."""

    NONE = "go on"
    AGAIN = "begin the next"
    QUIT = "end all of it"


_WISHES: Final = {"r": Wish.AGAIN, "n": Wish.AGAIN, "q": Wish.QUIT, "escape": Wish.QUIT}


class Hand:
    """Goes where the last key pointed, until another one is pressed; an `Adversary`.

    A terminal says when a key is pressed and not when it is let go, so one key begins a way and another ends it.
    """

    depletions: Final = 0

    def __init__(self, scenario: Scenario) -> None:
        """Stand, until a key is pressed.

        Args:
            scenario: gives the greatest speed.
        """
        self._speed = scenario.adversary.speed
        self._direction = (0.0, 0.0)
        self._pace = len(_PACES) - 1

    def press(self, key: str) -> bool:
        """Take a key by its name, and return whether it means anything to the hand."""
        if key in _DIRECTIONS:
            self._direction = _DIRECTIONS[key]
        elif key in _FASTER:
            self._pace = min(self._pace + 1, len(_PACES) - 1)
        elif key in _SLOWER:
            self._pace = max(self._pace - 1, 0)
        else:
            return False
        return True

    def act(self, car: CarState) -> tuple[float, float]:
        """Return the velocity for the coming tick; see `Adversary.act`."""
        east, north = self._direction
        speed = self._speed * _PACES[self._pace]
        return speed * east, speed * north


class Controls:
    """What somebody at the keys wants, from the thread that reads them to the one that drives.

    Attributes:
        hand: the adversary that keys move; None where it follows φ.
    """

    def __init__(self) -> None:
        """Want nothing yet."""
        self.hand: Hand | None = None
        self._wish = Wish.NONE
        self._lock = threading.Lock()

    def press(self, key: str) -> None:
        """Take a key by its name."""
        with self._lock:
            if self._wish is not Wish.QUIT and key in _WISHES:
                self._wish = _WISHES[key]
                return
        if self.hand is not None:
            self.hand.press(key)

    def look(self) -> Wish:
        """Return what is wanted."""
        return self._wish

    def take(self) -> Wish:
        """Return what is wanted, and forget it unless it is to end."""
        with self._lock:
            wish = self._wish
            if wish is Wish.AGAIN:
                self._wish = Wish.NONE
            return wish
