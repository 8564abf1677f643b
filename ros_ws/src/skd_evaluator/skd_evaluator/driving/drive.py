"""Driving at the pace of the wall clock: how an episode stands, keys of a terminal, who they move, the simulator.

A drive is shown as a picture from above with figures on a terminal, as a line a second elsewhere. The car drives to the
right, and both are in the picture, which is drawn with letters. A letter is twice as high as it is wide, so that each
stands for a square of two halves, one above the other.
"""

from __future__ import annotations

import itertools
import math
import os
import re
import select
import sys
import termios
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import Enum
from typing import Final

import numpy as np
from rich.console import Console, Group
from rich.live import Live
from rich.text import Text
from skd_adversary.adversary import Adversary
from skd_sim.controllers.controller import make_controller
from skd_sim.options.car_and_adversary import CarUnderTest
from skd_sim.scenario.road_user import Body
from skd_sim.scenario.scenario import Scenario
from skd_sim.simulators.simulator import Frame, NamedSimulator
from skd_sim.world.dynamics.basic import Command, as_pair
from skd_sim.world.episode import EpisodeLog, EpisodeSpec
from skd_sim.world.state import CarState, FloatArray, RoadUserState

from skd_evaluator import palette
from skd_evaluator.assessment.run.episodes import run_episode
from skd_evaluator.metrics.contact_place import outline_of
from skd_evaluator.metrics.deviation import deviation
from skd_evaluator.metrics.surrogate_measures import clearance_at


@dataclass(frozen=True)
class Situation:
    """How an episode stands.

    Attributes:
        scenario: where it takes place.
        time: since its start, s.
        car: state of the car under test.
        adversary: state of the adversary.
        walked: places of the adversary at the ticks so far, n × 2, m.
        phi: the safe trajectory φ that is followed, n × 2, m; None where there is none.
        command: what the car commanded last; nan before its first command.
        steering: angle of the front wheels that it commanded, rad to the left; 0 of a car that does not steer.
        unit: unit of the command, m/s² or m/s.
        age: wall time from the state that the command answers to its use, s; nan where it is not known.
        clearance: distance between the outlines of car and adversary, m.
        strayed: greatest distance of the adversary so far from where φ is at the same time, m; nan without φ.
        note: what there is to say beside; empty for nothing.
    """

    scenario: Scenario
    time: float
    car: CarState
    adversary: RoadUserState
    walked: FloatArray
    phi: FloatArray | None = None
    command: float = math.nan
    steering: float = 0.0
    unit: str = "m/s²"
    age: float = math.nan
    clearance: float = math.nan
    strayed: float = math.nan
    note: str = ""

    def figures(self) -> list[tuple[str, str]]:
        """Return name and value of each figure, as people read them."""
        found = [
            ("time", f"{self.time:.1f} s"),
            ("speed", f"{self.car.speed:.1f} m/s"),
            ("command", "none yet" if math.isnan(self.command) else f"{self.command:+.1f} {self.unit}"),
            ("clearance", f"{self.clearance:.1f} m"),
        ]
        if self.steering:
            side = "left" if self.steering > 0.0 else "right"
            found.append(("steering", f"{abs(math.degrees(self.steering)):.1f}° to the {side}"))
        if not math.isnan(self.age):
            found.append(("age of the command", f"{self.age:.3f} s"))
        if not math.isnan(self.strayed):
            found.append(("deviation from φ", f"{self.strayed:.2f} m"))
        return found

    def line(self) -> str:
        """Return the figures in one line."""
        return ", ".join(f"{name} {value}" for name, value in self.figures())


class Onlooker:
    """Turns the states of one episode into situations."""

    def __init__(self, episode: EpisodeSpec, unit: str = "m/s²") -> None:
        """Begin.

        Args:
            episode: the episode that is under way.
            unit: unit of the car's commands.
        """
        self._scenario, self._unit = episode.scenario, unit
        safe = episode.safe_trajectory
        self._phi = None if safe is None else safe.positions
        self._walked: list[tuple[float, float]] = []

    def see(
        self, tick: int, period: int, car: CarState, adversary: RoadUserState, command: Command, age: float
    ) -> Situation:
        """Return the situation in a control period.

        Args:
            tick: number of the tick.
            period: number of the control period in the tick, 0 at the tick itself.
            car: state of the car.
            adversary: state of the adversary.
            command: what the car commanded last, with a steering angle or without; nan before its first command.
            age: age of that command when it was used, s; nan where it is not known.
        """
        if period == 0 and tick == len(self._walked):
            self._walked.append((adversary.x, adversary.y))
        walked = np.array(self._walked or [adversary[:2]])
        strayed = math.nan if self._phi is None else deviation(self._phi, walked, len(walked) - 1)
        time = (tick + period / self._scenario.control_periods) * self._scenario.time_step
        apart = clearance_at(self._scenario, car[:3], self._scenario.adversary, adversary[:2], adversary.heading)
        return Situation(
            self._scenario, time, car, adversary, walked, self._phi, *as_pair(command), self._unit, age, apart, strayed
        )


_DIRECTIONS: Final = {
    # As seen on the screen, on which the car drives to the right: (East, North).
    **dict.fromkeys(("up", "w"), (-1.0, 0.0)),
    **dict.fromkeys(("down", "s"), (1.0, 0.0)),
    **dict.fromkeys(("left", "a"), (0.0, -1.0)),
    **dict.fromkeys(("right", "d"), (0.0, 1.0)),
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
    """What the keyboard's user wants, from the thread that reads them to the one that drives.

    Attributes:
        hand: the adversary that keys move; None where it follows φ.
        pressed: whether a key was pressed at all.
    """

    def __init__(self) -> None:
        """Want nothing yet."""
        self.hand: Hand | None = None
        self.pressed = False
        self._wish = Wish.NONE
        self._lock = threading.Lock()

    def press(self, key: str) -> None:
        """Take a key by its name."""
        with self._lock:
            self.pressed = True
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


_ARROWS: Final = {"A": "up", "B": "down", "C": "right", "D": "left"}
_KEY: Final = re.compile("\x1b[\\[O][^A-Za-z~]*([A-Za-z~]?)|(.)", re.DOTALL)
_WAIT = 0.1  # s


def key_names(text: str) -> Iterator[str]:
    """Yield the names of the keys that a terminal sent: arrows by their names, letters in small.

    A terminal sends an arrow as ESC [ A or ESC O A, with digits and a semicolon in between where another key was held
    (ECMA-48; xterm's control sequences). Other sequences mean nothing here; ESC alone is the key itself.
    """
    for end, key in _KEY.findall(text):
        if key:
            yield "escape" if key == "\x1b" else key.lower()
        elif end in _ARROWS:
            yield _ARROWS[end]


@contextmanager
def reading_keys(press: Callable[[str], None]) -> Iterator[None]:
    """Call a function with the name of each key that is pressed, as long as this lasts; the terminal shows none.

    Standard input has to be a terminal. The function is called in a thread of its own, which ends where the terminal is
    closed.
    """
    descriptor = sys.stdin.fileno()
    before = termios.tcgetattr(descriptor)
    over = threading.Event()

    def read() -> None:
        while not over.is_set():
            if select.select([descriptor], [], [], _WAIT)[0]:
                try:
                    data = os.read(descriptor, 256)
                except OSError:  # it was closed
                    return
                if not data:
                    return
                for name in key_names(data.decode("utf-8", errors="ignore")):
                    press(name)

    reader = threading.Thread(target=read, name="skd-keys", daemon=True)
    try:
        tty.setcbreak(descriptor)
        attributes = termios.tcgetattr(descriptor)
        for key in (termios.VSUSP, termios.VQUIT):  # Ctrl-C is still a signal; these would leave the terminal drawn on
            attributes[6][key] = b"\0"
        termios.tcsetattr(descriptor, termios.TCSADRAIN, attributes)
        reader.start()
        yield
    finally:
        over.set()
        reader.join(2.0 * _WAIT)
        termios.tcsetattr(descriptor, termios.TCSADRAIN, before)


_NAP = 0.05  # s between two looks at what is wanted

Drive = Callable[[EpisodeSpec], EpisodeLog]
"""Runs an episode to its end, or raises a `LeftError`."""
Show = Callable[[Situation], None]
HandFor = Callable[[EpisodeSpec], Adversary | None]
"""Gives who moves the adversary of an episode that begins; None: what the episode says."""


class LeftError(Exception):
    """Somebody at the keys does not want to see the end of the episode."""


class PacedSimulator(NamedSimulator):
    """The simulator of an episode, which comes to the end of a control period when the wall clock does."""

    def __init__(self, rate: float, show: Show, look: Callable[[], Wish]) -> None:
        """Wait for an episode.

        Args:
            rate: simulated seconds in a second of the wall clock.
            show: called with each situation.
            look: says what is wanted.
        """
        super().__init__()
        self._rate, self._show, self._look = rate, show, look

    def reset(self, episode: EpisodeSpec) -> Frame:
        """Begin an episode; see `Simulator`."""
        self._onlooker = Onlooker(episode)
        frame = super().reset(episode)
        self._period = episode.scenario.control_duration / self._rate
        self._see(frame, math.nan, math.nan)
        self._due = self._shown + self._period
        return frame

    def step(self, command: Command, velocity: tuple[float, float]) -> Frame:
        """Wait for the end of the control period, and advance by it; see `Simulator`.

        Raises:
            LeftError: nobody wants to see more of it.
        """
        age = time.monotonic() - self._shown
        while (left := self._due - time.monotonic()) > 0.0 and self._look() is Wish.NONE:
            time.sleep(min(left, _NAP))
        if self._look() is not Wish.NONE:
            raise LeftError
        self._due = max(self._due + self._period, time.monotonic())  # what was missed is not made up for
        frame = super().step(command, velocity)
        self._see(frame, command, age)
        return frame

    def _see(self, frame: Frame, command: Command, age: float) -> None:
        self._show(self._onlooker.see(frame.tick, frame.period, frame.car, frame.adversary, command, age))
        self._shown = time.monotonic()


def driving_in_process(
    car: CarUnderTest, rate: float, hand_for: HandFor, show: Show, look: Callable[[], Wish]
) -> Drive:
    """Return what runs an episode at the pace of the wall clock.

    Args:
        car: the car under test.
        rate: simulated seconds in a second of the wall clock.
        hand_for: gives who moves the adversary.
        show: called with each situation.
        look: says what is wanted.
    """
    controller = make_controller(car.controller, car.multiplier)
    return lambda episode: run_episode(episode, controller, hand_for(episode), PacedSimulator(rate, show, look))


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

    def __init__(self, title: str, keys: str) -> None:
        """Show nothing yet.

        Args:
            title: who drives.
            keys: which keys there are.
        """
        self._title, self._keys, self.console = title, keys, Console()
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
