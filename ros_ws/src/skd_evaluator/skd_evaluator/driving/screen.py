"""How a drive is shown: a picture with figures on a terminal, a line a second elsewhere."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console, Group
from rich.live import Live
from rich.text import Text

from skd_evaluator.driving.situation import Situation
from skd_evaluator.driving.top_view import top_view

KEYS = "arrows or w a s d: walk · space: stand · + −: pace · r: again · q: quit"
KEYS_OF_ONLOOKER = "r: again · q: quit"
_REFRESH = 10  # pictures a second
_LEAST_HEIGHT, _BESIDE = 6, 4  # lines: of the picture; of title, figures and keys
_LINE_EVERY = 1.0  # s of simulated time, of whole ones


class Screen:
    """The picture of the last situation, drawn anew some times a second.

    Attributes:
        waiting: what is said as long as the car has not commanded anything.
        over: how the episode ended; empty while it runs.
    """

    def __init__(self, title: str, keys: str, console: Console) -> None:
        """Show nothing yet.

        Args:
            title: who drives.
            keys: which keys there are.
            console: the terminal.
        """
        self._title, self._keys, self._console = title, keys, console
        self._situation: Situation | None = None
        self.waiting = "starting"
        self.over = ""

    def show(self, situation: Situation) -> None:
        """Take the situation that is to be seen next."""
        self._situation = situation

    def __rich__(self) -> Group:
        """Return what is to be seen now."""
        situation, (width, height) = self._situation, self._console.size
        title = Text(self._title, "bold", overflow="ellipsis", no_wrap=True)
        keys = Text(self._keys, "dim", overflow="ellipsis", no_wrap=True)
        if situation is None:
            return Group(title, Text(self.waiting), keys)
        figures = Text.assemble(*_figures(situation, width))
        silent = self.waiting if math.isnan(situation.command) else ""
        state = Text(self.over or silent, "bold reverse" if self.over else "")
        lines = len(state.wrap(self._console, width)) or 1
        picture = top_view(situation, width, max(_LEAST_HEIGHT, height - _BESIDE - lines))
        return Group(title, picture, figures, state, keys)


def _figures(situation: Situation, width: int) -> Iterator[str | tuple[str, str]]:
    """Yield the figures, each with its name before it, in two lines that keep their places."""
    half = max(20, width // 4)
    for number, (name, value) in enumerate(situation.figures()):
        if number and number % 4 == 0:
            yield "\n"
        yield f"{name} ", "dim"
        yield value.ljust(max(1, half - len(name) - 1))


@contextmanager
def drawing(screen: Screen, console: Console) -> Iterator[None]:
    """Draw a screen on a terminal as long as this lasts; afterwards it is as it was before."""
    live = Live(screen, console=console, screen=True, refresh_per_second=_REFRESH, redirect_stdout=False,
                redirect_stderr=False)  # fmt: skip
    with live:
        yield


def terminal() -> Console:
    """Return the terminal behind standard output."""
    return Console()


def can_draw() -> bool:
    """Return whether standard output is a terminal that pictures can be drawn on, which TERM=dumb is not."""
    console = terminal()
    return console.is_terminal and not console.is_dumb_terminal


class Lines:
    """Says a line for each simulated second."""

    def __init__(self, write: Callable[[str], None]) -> None:
        """Begin; `write` is called with each line."""
        self._write = write
        self._next = self._last = 0.0

    def show(self, situation: Situation) -> None:
        """Take a situation, and say it if it is time."""
        if situation.time < self._last:
            self._next = 0.0
        self._last = situation.time
        if situation.time >= self._next - 1e-9:
            self._next = math.floor(situation.time + 1e-9) + _LINE_EVERY
            self._write(situation.line())
