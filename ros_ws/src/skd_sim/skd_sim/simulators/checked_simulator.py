"""A guard around a simulator that is not SKD's own, which may raise anything and say anything of car and adversary.

Whether an episode as a whole can have happened is asked of its log (`skd_evaluator.assessment.plausibility`). Here it
is looked at what no log shows: that frames are frames, finite and one after the other, and that the adversary goes
where it is told, for which a log has no commands.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final, NoReturn, TypeVar

from skd_sim.controllers.user_controller import failed, shown
from skd_sim.errors import AssessmentError, UsageError
from skd_sim.interruption import Interrupted
from skd_sim.world.aborts import AbortKind
from skd_sim.world.episode import Outcome
from skd_sim.world.simulator import Frame, SimulatorError
from skd_sim.world.state import AdversaryState, CarState
from skd_sim.world.world import Contact

if TYPE_CHECKING:
    from skd_sim.world.episode import Episode
    from skd_sim.world.simulator import Simulator

_Result = TypeVar("_Result")
_Place = tuple[float, float]

DISOBEYED: Final = 0.05
"""m in a tick by which the adversary may be elsewhere than the velocities of this tick and the last one take it."""
STRAYED: Final = 1.0
"""m that it may be away from where it starts, and later from where all its commands would have taken it."""
_SHOWN = 80  # characters


class CheckedSimulator:
    """Another simulator, whose failures name it instead of ending in a traceback of ours; see `Simulator`.

    Attributes:
        strayed: greatest distance in this episode between the adversary and where its commands would have taken it, m.
    """

    def __init__(self, simulator: Simulator, name: str) -> None:
        """Guard `simulator`, called `name` in messages."""
        self._simulator, self._name = simulator, name
        self.strayed = 0.0

    def reset(self, episode: Episode) -> Frame:
        """Pass the call on and check the frame; see `Simulator.reset`.

        Raises:
            AssessmentError: it fails, or gives no frame of tick 0.
        """
        self._step = episode.scenario.time_step
        self._ticks, self._periods = episode.scenario.ticks, episode.scenario.control_periods
        self._before = self._told = (0.0, 0.0)
        self.strayed = 0.0
        frame = self._frame("reset", self._call("reset", lambda: self._simulator.reset(episode)), (0, 0))
        self._now, self._place, self._aim = (0, 0), frame.adversary[:2], episode.start
        self.strayed = math.dist(self._place, self._aim)
        if self.strayed > STRAYED:
            self._abort(
                AbortKind.REFUTED, f"the adversary starts {self.strayed:.3g} m from where the specification has it"
            )
        return frame

    def step(self, acceleration: float, velocity: tuple[float, float]) -> Frame:
        """Pass the call on and check the frame; see `Simulator.step`.

        Raises:
            AssessmentError: it fails, or gives no frame, or not the next one.
            SimulatorError: a state is not finite, or the adversary is not where it was told to go.
        """
        tick, period = self._now
        if period == 0:
            self._before, self._told = self._told, velocity
        answer = self._call("step", lambda: self._simulator.step(acceleration, velocity))
        # A contact ends a tick before all of its control periods are over.
        ended = isinstance(answer, Frame) and answer.contact is not None and answer.period == 0
        following = (tick + 1, 0) if ended or period + 1 == self._periods else (tick, period + 1)
        frame = self._frame("step", answer, following)
        self._now = following
        if following[1] == 0:
            self._look_where(frame.adversary[:2], tick)
        if frame.tick >= self._ticks and frame.outcome == Outcome.RUNNING:  # it would never end
            self._abort(AbortKind.REFUTED, f"it goes on after tick {frame.tick}, which is the last one")
        return frame

    @property
    def places_others(self) -> bool:
        """Whether the simulator says that it places the others of a scenario."""
        return bool(getattr(self._simulator, "places_others", False))

    @property
    def clipped(self) -> int:
        """How many commands of this episode asked more of the car than it can do."""
        count: object = self._call("clipped", lambda: self._simulator.clipped)
        try:
            number = operator.index(count)  # type: ignore[arg-type]
        except Exception:
            number = -1
        if number < 0:
            self._fail(f"clipped must be a whole number from 0 on, got {shown(count, repr, _SHOWN)}")
        return number

    @property
    def own_contact(self) -> float | None:
        """Time of the first contact by the simulator's own shapes (s), nan without one; None: it does not say."""
        time: Any = self._call("own_contact", lambda: getattr(self._simulator, "own_contact", None))
        if time is None:
            return None
        try:
            seconds = float(time)
        except Exception:
            seconds = math.inf
        if seconds < 0.0 or math.isinf(seconds):
            self._fail(f"own_contact must be a time in s, nan or None, got {shown(time, repr, _SHOWN)}")
        return seconds

    def _frame(self, method: str, answer: object, expected: tuple[int, int]) -> Frame:
        """Return what a method has answered as a frame of plain numbers; see `step` for what is raised."""
        try:
            assert isinstance(answer, Frame)
            frame = Frame(
                operator.index(answer.tick),
                CarState(*map(float, answer.car)),
                AdversaryState(*map(float, answer.adversary)),
                None if answer.contact is None else Contact(*map(float, answer.contact)),
                Outcome(answer.outcome),
                operator.index(answer.period),
            )
        except Exception:
            self._fail(f"{method} must return a Frame, got {shown(answer, repr, _SHOWN)}")
        if (frame.tick, frame.period) != expected:
            said, wanted = (_moment(*one, self._periods) for one in ((frame.tick, frame.period), expected))
            self._fail(f"{method} must return the frame of {wanted}, got that of {said}")
        numbers = (
            *zip(("x", "y", "heading", "speed"), frame.car, strict=True),
            *zip(("x", "y", "vx", "vy", "heading"), frame.adversary, strict=True),
        )
        for index, (what, number) in enumerate(numbers):
            if not math.isfinite(number):
                whose = "car" if index < len(frame.car) else "adversary"
                self._abort(AbortKind.NOT_FINITE, f"{what} of the {whose} is {number:g} in tick {frame.tick}")
        if frame.outcome == Outcome.ABORTED:
            self._abort(AbortKind.FAILED, f"it ended the episode as ABORTED in tick {frame.tick}")
        if frame.period and frame.outcome != Outcome.RUNNING:
            self._fail(f"{method} must not end an episode between two ticks, as {frame.outcome.name} does")
        return frame

    def _look_where(self, place: _Place, tick: int) -> None:
        """Look whether the adversary has gone where it was told in a tick, at once or by up to a tick later."""
        step, before, told = self._step, self._before, self._told
        moved = (place[0] - self._place[0], place[1] - self._place[1])
        late = (step * before[0], step * before[1])
        at_once = (step * told[0], step * told[1])
        start, self._aim = self._aim, (self._aim[0] + at_once[0], self._aim[1] + at_once[1])
        self._place = place
        off = _from_segment(moved, late, at_once)
        self.strayed = max(self.strayed, math.dist(place, self._aim))
        away = _from_segment(place, start, self._aim)
        if off > DISOBEYED:
            self._abort(
                AbortKind.REFUTED, f"in tick {tick} the adversary goes {off:.3g} m beside where it was told to go"
            )
        if away > STRAYED:
            self._abort(
                AbortKind.REFUTED, f"after tick {tick} the adversary is {away:.3g} m from where it was told to go"
            )

    def _call(self, method: str, call: Callable[[], _Result]) -> _Result:
        try:
            return call()
        except (UsageError, AssessmentError, SimulatorError, Interrupted):
            raise
        except BaseException as error:  # a user's code may raise anything
            raise failed(f"simulator {self._name}", method, error) from None

    def _fail(self, what: str) -> NoReturn:
        raise AssessmentError(f"simulator {self._name}: {what}") from None

    def _abort(self, kind: AbortKind, what: str) -> NoReturn:
        raise SimulatorError(kind, f"simulator {self._name}: {what}")


def _moment(tick: int, period: int, periods: int) -> str:
    return f"tick {tick}" if periods == 1 and period == 0 else f"tick {tick}, control period {period}"


def _from_segment(place: _Place, begin: _Place, end: _Place) -> float:
    """Return the distance of a place from the line between two others, m."""
    dx, dy = end[0] - begin[0], end[1] - begin[1]
    length = dx * dx + dy * dy
    share = 0.0 if length == 0.0 else ((place[0] - begin[0]) * dx + (place[1] - begin[1]) * dy) / length
    share = min(1.0, max(0.0, share))
    return math.dist(place, (begin[0] + share * dx, begin[1] + share * dy))
