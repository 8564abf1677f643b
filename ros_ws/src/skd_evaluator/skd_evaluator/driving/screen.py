"""How a drive is shown: a picture from above with figures on a terminal, a line a second elsewhere.

The car drives to the right, and both are in the picture, which is drawn with letters. A letter is twice as high as it
is wide, so that each stands for a square of two halves, one above the other.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from typing import Final

import numpy as np
from rich.console import Console, Group
from rich.live import Live
from rich.text import Text
from skd_sim.scenario.road_user import Body
from skd_sim.world.state import FloatArray

from skd_evaluator import palette
from skd_evaluator.driving.drive import Situation
from skd_evaluator.metrics.contact_place import outline_of

KEYS = "arrows or w a s d: walk · space: stand · + −: pace · r: again · q: quit"
KEYS_OF_ONLOOKER = "r: again · q: quit"
_REFRESH = 10  # pictures a second
_LEAST_HEIGHT, _BESIDE = 6, 4  # lines: of the picture; of title, figures and keys
_LINE_EVERY = 1.0  # s of simulated time, of whole ones


class Screen:
    """The picture of the last situation, drawn anew some times a second.

    Attributes:
        console: the terminal.
        waiting: what is said as long as the car has not commanded anything.
        over: how the episode ended; empty while it runs.
    """

    def __init__(self, title: str, keys: str, console: Console | None = None) -> None:
        """Show nothing yet.

        Args:
            title: who drives.
            keys: which keys there are.
            console: the terminal; by default that behind standard output.
        """
        self._title, self._keys, self.console = title, keys, console or Console()
        self._situation: Situation | None = None
        self.waiting = "starting"
        self.over = ""

    def show(self, situation: Situation) -> None:
        """Take the situation that is to be seen next."""
        self._situation = situation

    def __rich__(self) -> Group:
        """Return what is to be seen now."""
        situation, (width, height) = self._situation, self.console.size
        title = Text(self._title, "bold", overflow="ellipsis", no_wrap=True)
        keys = Text(self._keys, "dim", overflow="ellipsis", no_wrap=True)
        if situation is None:
            return Group(title, Text(self.waiting), keys)
        figures = Text.assemble(*_figures(situation, width))
        silent = self.waiting if math.isnan(situation.command) else ""
        state = Text(self.over or silent, "bold reverse" if self.over else "")
        lines = len(state.wrap(self.console, width)) or 1
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


def drawing(screen: Screen) -> Live:
    """Return what draws a screen on its terminal while it is entered; afterwards it is as it was before."""
    return Live(
        screen, console=screen.console, screen=True, refresh_per_second=_REFRESH, redirect_stdout=False,
        redirect_stderr=False,
    )  # fmt: skip


def can_draw() -> bool:
    """Return whether standard output is a terminal that pictures can be drawn on, which TERM=dumb is not."""
    console = Console()
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


_SCALES: Final = (0.5, 1.0, 2.0, 4.0)  # m: width of a letter, and half of its height
_ROOM: Final = 6.0  # m that car and adversary are to have to the picture's edge
_SQUARES: Final = {(True, True): "█", (True, False): "▀", (False, True): "▄"}
_EDGE, _DASH, _WAY, _SAFE, _PERSON = "─", "╌", "∙", "·", "●"
_LANE_REACH = 60.0  # m along each lane, at the least
_DASH_EVERY, _DASH_LENGTH = 6.0, 3.0  # m


class _TopView:
    """A grid of letters over a part of the ground; each stands for two squares, one above the other."""

    def __init__(self, width: int, height: int, middle: tuple[float, float], side: float) -> None:
        """Begin with nothing.

        Args:
            width: in letters.
            height: in letters.
            middle: place (x, y) of the world in the middle of it, m.
            side: of a square: width of a letter, and half of its height, m.
        """
        self._side, self._middle = side, np.array(middle)
        self._cells = np.full((height, width), "", dtype=object)  # a letter and its colour
        column, row = np.meshgrid(np.arange(width) + 0.5, np.arange(2 * height) + 0.5)
        self._squares = np.stack([column, row], axis=-1)

    def _placed(self, places: FloatArray) -> FloatArray:
        """Return where places (n × 2, m) are in the grid: column and row of squares, n × 2, as real numbers."""
        height, width = self._cells.shape
        away = np.asarray(places, dtype=float).reshape(-1, 2) - self._middle
        return np.column_stack([0.5 * width + away[:, 1] / self._side, height + away[:, 0] / self._side])

    def points(self, places: FloatArray, letter: str, colour: str, *, over: bool = False) -> None:
        """Put a letter at each of some places (n × 2, m); with `over` also where there is another one."""
        for column, row in np.floor(self._placed(places) / (1.0, 2.0)).astype(int).tolist():
            inside = 0 <= row < self._cells.shape[0] and 0 <= column < self._cells.shape[1]
            if inside and (over or not self._cells[row, column]):
                self._cells[row, column] = letter, colour

    def polygon(self, corners: FloatArray, colour: str) -> None:
        """Fill a convex polygon (k × 2, m); a small one has one square at the least."""
        placed = self._placed(corners)
        sides = np.roll(placed, -1, axis=0) - placed
        away = self._squares[:, :, None] - placed
        turns = sides[:, 0] * away[..., 1] - sides[:, 1] * away[..., 0]
        filled = np.logical_or(np.all(turns >= 0.0, axis=-1), np.all(turns <= 0.0, axis=-1))
        if not filled.any():
            filled = np.all(np.abs(self._squares - placed.mean(axis=0)) <= 0.5, axis=-1)
        upper, lower = np.asarray(filled)[::2], np.asarray(filled)[1::2]
        for row, column in np.argwhere(upper | lower).tolist():
            self._cells[row, column] = _SQUARES[upper[row, column], lower[row, column]], colour

    def text(self) -> Text:
        """Return it as text with colours."""
        rows = ([cell or " " for cell in row] for row in self._cells.tolist())
        return Text("\n", no_wrap=True).join(Text.assemble(*row) for row in rows)


def top_view(situation: Situation, width: int, height: int) -> Text:
    """Return a situation as seen from above, with car and adversary in it.

    Args:
        situation: what is to be seen.
        width: in letters.
        height: in lines.
    """
    car, adversary, scenario = situation.car, situation.adversary, situation.scenario
    # The least of the scales at which both are in the picture, else the greatest one.
    along, aside = abs(car.y - adversary.y) + 2.0 * _ROOM, max(abs(car.x), abs(adversary.x)) + 0.5 * _ROOM
    half = next((one for one in _SCALES if along <= one * width and aside <= one * height), _SCALES[-1])
    # In its middle is the place between both, or, where that is too far, one near the adversary.
    beside = 0.5 * half * width - _ROOM
    middle = min(max(0.5 * (car.y + adversary.y), adversary.y - beside), adversary.y + beside)
    view, fine = _TopView(width, height, (0.0, middle), half), 0.5 * half
    reach = max(_LANE_REACH, half * width)
    low, high = car.y - reach, car.y + reach
    for left, right in scenario.road.surfaces(low, high):
        for edge in (left, right):
            view.points(_between(edge, fine), _EDGE, palette.ROAD_EDGE)
    view.points(_dashes(scenario.road.edge(0.0, low, high), low, fine), _DASH, palette.ROAD_EDGE)
    if situation.phi is not None:
        view.points(_between(situation.phi, fine), _SAFE, palette.SKY)
    view.points(_between(situation.walked, fine), _WAY, palette.ORANGE)
    view.polygon(outline_of(scenario, (car.x, car.y, car.heading)), palette.CAR)
    for other, state in zip(scenario.others, scenario.others_after(situation.time), strict=True):
        _draw(view, other, state[:2], state.heading, palette.OBSTACLE)
    _draw(view, scenario.adversary, adversary[:2], adversary.heading, palette.VERMILLION)
    return view.text()


def _draw(view: _TopView, body: Body, place: tuple[float, float], heading: float, colour: str) -> None:
    if body.is_box:
        view.polygon(body.outline_at(np.array(place), heading), colour)
    else:
        view.points(np.array([place]), _PERSON, colour, over=True)


def _between(way: FloatArray, step: float) -> FloatArray:
    """Return places along a way (n × 2, m), at most so far apart (m)."""
    found = [way[:1]]
    for start, end in itertools.pairwise(way):
        count = max(1, math.ceil(float(np.hypot(*(end - start))) / step))
        found.append(start + (end - start) * (np.arange(1, count + 1) / count)[:, None])
    return np.concatenate(found)


def _dashes(line: FloatArray, begin: float, step: float) -> FloatArray:
    """Return the places of a broken line along a way: it lies still on the ground while the picture goes along."""
    places = _between(line, step)
    passed = begin + np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(places, axis=0).T))])
    return np.asarray(places[passed % _DASH_EVERY < _DASH_LENGTH])
