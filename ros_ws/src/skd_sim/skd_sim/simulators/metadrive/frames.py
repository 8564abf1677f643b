"""The frames of MetaDrive behind `FramedSimulator`: who is where after each step of its physics. Imports MetaDrive."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from skd_sim.scenario.road import HEADING_NORTH
from skd_sim.scenario.scenario import Scenario
from skd_sim.simulators.framed_simulator import States
from skd_sim.simulators.metadrive.bodies import Placed
from skd_sim.simulators.metadrive.stage import START, Stage, pedals_of, stage_for, step_of
from skd_sim.world.aborts import AbortKind
from skd_sim.world.dynamics.limits import CommandLimits
from skd_sim.world.heading import on_grid
from skd_sim.world.simulator import SimulatorError
from skd_sim.world.state import AdversaryState, CarState, RoadUserState

_APART: Final = 0.01  # m


class MetaDriveFrames:
    """A `FrameSource` and `StagedFrameSource`; MetaDrive's frame has the road along x and its left along y.

    Attributes:
        frame_step: time between frames, s.
        limits: least and greatest acceleration of the car, as measured.
        apart: greatest distance in this episode between where MetaDrive has the adversary and where it was commanded
            to be, m.
    """

    def __init__(self, scenario: Scenario) -> None:
        """Build road and car of a scenario, and measure the car's pedals.

        Raises:
            UsageError: MetaDrive cannot run in this process.
        """
        self._stage: Stage = stage_for(scenario, step_of(scenario))
        self._pedals = pedals_of(self._stage, scenario)
        self.frame_step: float = self._stage.step
        self.limits: CommandLimits = self._pedals.limits
        self.apart = 0.0

    def prepare(self, scenario: Scenario) -> None:
        """Bring everybody else of a scenario on."""
        self._scenario, self._cast = scenario, self._stage.cast_for(scenario)
        self._middle = 0.5 * (scenario.car.front - scenario.car.rear)  # of the car's body, ahead of its reference point

    def show(self, others: Sequence[RoadUserState]) -> None:
        """Put the others where they are at the next frame's end, or at the start."""
        self._others = tuple(others)

    def place(self, car: CarState, adversary: AdversaryState) -> States:
        """Put car and adversary at the start; the car stands on its springs there."""
        self._ahead = START - self._middle - car.y  # how far along MetaDrive's road the crossing point is
        self._stage.place(car.speed)
        self._stage.decided = None
        self._at = adversary
        for body, one in zip(self._cast.standing, self._scenario.obstacles, strict=True):
            self._put(body, one.x, one.y, one.heading)
        self._put_moving()
        self._stage.show_anew(self._cast)
        self.apart = 0.0
        return self._states()

    def control(self, acceleration: float, velocity: tuple[float, float]) -> None:
        """Press the pedal that stands for an acceleration, or do what a driver within MetaDrive has decided."""
        decided, self._stage.decided = self._stage.decided, None
        self._velocity, self._acceleration = velocity, acceleration
        if decided is not None and decided.acceleration == acceleration:
            self._holds = False
            self._stage.drive(decided.steering, decided.pedal)
        else:
            self._holds = acceleration < 0.0
            self._stage.drive(0.0, self._pedals.pedal(acceleration))

    def advance(self) -> States:
        """Take a step of the physics, at whose end everybody is where they are to be."""
        if self._holds:
            self._hold()
        vx, vy = self._velocity
        heading = float(on_grid(self._scenario.adversary.heading(self._at.heading, vx, vy)))
        x, y = self._at.x + self.frame_step * vx, self._at.y + self.frame_step * vy
        self._at = AdversaryState(x, y, vx, vy, heading)
        self._put_moving()
        self._stage.advance()
        return self._states()

    def touching(self) -> bool:
        """Return whether by MetaDrive's own shapes the car touches the adversary or one of the others."""
        return any(self._stage.touches(body) for body in (self._cast.adversary, *self._cast.others))

    def _hold(self) -> None:
        """Brake as much as it takes to stand, where the car comes to: under more, MetaDrive's trembles and creeps."""
        needed = abs(self._stage.speed) / self.frame_step
        if needed < -self._acceleration or self._stage.speed < 0.0:
            brakes = min(needed, -self._acceleration)
            self._stage.press(self._pedals.pedal(-brakes) if brakes > -self._pedals.coasting else 0.0)

    def _put_moving(self) -> None:
        self._put(self._cast.adversary, self._at.x, self._at.y, self._at.heading)
        for body, other in zip(self._cast.others, self._others, strict=True):
            self._put(body, other.x, other.y, other.heading)

    def _put(self, body: Placed, x: float, y: float, heading: float) -> None:
        body.put(self._ahead + y, self._stage.across - x, heading - HEADING_NORTH)

    def _states(self) -> States:
        """Return where MetaDrive has car and adversary, in the world's frame."""
        x, y, heading = self._stage.pose
        reference = (
            self._stage.across - y + self._middle * math.sin(heading),
            x - self._ahead - self._middle * math.cos(heading),
        )
        heading = float(on_grid(heading + HEADING_NORTH))
        self._check_adversary()
        return CarState(*reference, heading, max(0.0, self._stage.speed)), self._at

    def _check_adversary(self) -> None:
        """Hold MetaDrive's place of the adversary against where it is to be: its numbers have 24 bits, ours 53.

        Raises:
            SimulatorError: MetaDrive has it elsewhere.
        """
        x, y = self._cast.adversary.position
        apart = math.hypot(self._stage.across - float(y) - self._at.x, float(x) - self._ahead - self._at.y)
        self.apart = max(self.apart, apart)
        if not apart <= _APART:
            raise SimulatorError(
                AbortKind.FAILED, f"MetaDrive has the adversary {apart:.3g} m from where it was commanded to be"
            )
