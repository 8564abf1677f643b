"""A lockstep without ROS and without waiting: time is handed in, and the simulator only counts."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from skd_sim.ros.lockstep import Action, CommandSource, ControlStep, End, Lockstep, Senders, WaitLimits
from skd_sim.scenario.scenario import load_scenario
from skd_sim.simulators.simulator import Frame
from skd_sim.world.episode import Outcome
from skd_sim.world.state import AdversaryState, CarState
from skd_sim.world.timing import tick_stamp
from skd_sim.world.world import Contact

CROSSING = load_scenario("crossing")
START, TIME_STEP = 5_000_000_000, CROSSING.time_step
LIMITS = WaitLimits(command=2.0, startup=10.0)
CAR, ADVERSARY = CarState(0.0, -15.0, math.pi / 2, 8.0), AdversaryState(-3.5, 0.0, 0.0, 0.0)


@dataclass
class Few(Senders):
    """Senders as a middleware might see them."""

    alive: list[str] = field(default_factory=lambda: ["/one"])

    def count(self) -> int:
        return len(self.alive)

    def crowd(self) -> str | None:
        return f"{len(self.alive)} publish" if len(self.alive) > 1 else None

    def absence(self) -> str:
        return "nobody publishes"


class Bench:
    """A lockstep with its senders and a simulator that only counts."""

    def __init__(self, *, real_time: bool = False, quiet_time: float = 0.0) -> None:
        self.cars, self.adversaries = Few(), Few()
        self.car = CommandSource("the car controller", "ego/acceleration_command", self.cars)
        self.adversary = CommandSource("the adversary", "adversary/velocity_command", self.adversaries)
        self.lockstep = Lockstep(self.car, self.adversary, LIMITS, real_time=real_time, quiet_time=quiet_time)
        self.now = 100.0

    def begin(self, start: int = START) -> End | None:
        return self.lockstep.begin(start, CROSSING, frame(0), self.now)

    def advance(self, tick: int, outcome: Outcome = Outcome.RUNNING, contact: Contact | None = None) -> End | None:
        return self.lockstep.advance(frame(tick, outcome, contact), self.now)

    def go_to(self, tick: int) -> None:
        """Answer until a tick is there."""
        for before in range(tick):
            assert self.lockstep.drive(stamp(before), 1.0) is None
            assert isinstance(self.lockstep.walk(stamp(before), (2.0, 0.0)), ControlStep)
            assert self.advance(before + 1) is None


def frame(tick: int, outcome: Outcome = Outcome.RUNNING, contact: Contact | None = None) -> Frame:
    return Frame(tick, CAR, ADVERSARY, contact, outcome)


def stamp(tick: int) -> int:
    return tick_stamp(START, tick, TIME_STEP)


Message = tuple[str, int, tuple[float, ...]]


def send(lockstep: Lockstep, message: Message) -> Action | None:
    who, at, command = message
    return lockstep.drive(at, command[0]) if who == "car" else lockstep.walk(at, (command[0], command[1]))
