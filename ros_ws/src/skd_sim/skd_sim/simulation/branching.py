"""A car under test that can be led on from the same moment in several ways: its world and its controller, copied.

What a car that decides once a tick does in it depends on where the adversary was until then and not on where it goes
in it, so all its actions share one step of the car. One that decides more often takes a step for each. A controller
that cannot be copied is run again from the start instead.
"""

from __future__ import annotations

import copy
from collections.abc import Callable

from skd_sim.arrays import FloatArray
from skd_sim.controllers import (
    Controller,
    SensingController,
    make_controller,
    require_control_period,
    require_sensor,
    sight_of,
)
from skd_sim.episode.episode import Episode
from skd_sim.episode.randomness import controller_generator, controller_seed
from skd_sim.sensors import make_laser
from skd_sim.simulation.world import Contact, World, make_world
from skd_sim.state import AdversaryState

ControllerFactory = Callable[[], Controller]
Velocity = tuple[float, float]


class Branch:
    """World and controller after some ticks; the adversary's place is given when the car is led on.

    Attributes:
        world: world after those ticks.
    """

    def __init__(self, episode: Episode, make: ControllerFactory | None = None, *, copies: bool = True) -> None:
        """Start an episode.

        Args:
            episode: specification of the episode.
            make: makes the controller of the car under test; by default from the specification.
            copies: whether the controller may be copied; if not, every branch runs it again from the start.
        """
        self._episode = episode
        self._make = make or (lambda: make_controller(episode.controller, episode.multiplier))
        self._copies = copies
        self._walked: tuple[tuple[AdversaryState, Velocity | None], ...] = ()  # the adversary in each tick that is gone
        self.world: World = make_world(episode)
        self._controller = self._make()
        require_sensor(self._controller, episode.controller, episode.scenario)
        require_control_period(self._controller, episode.controller, episode.scenario)
        self._controller.reset(
            episode.public_scenario, controller_generator(controller_seed(episode.seed, episode.episode_id))
        )
        self._sight = sight_of(self._controller, episode.scenario)
        self._laser = make_laser(episode) if isinstance(self._controller, SensingController) else None

    def drive(self, adversary: AdversaryState) -> Way:
        """Let the car drive on for a tick that the adversary begins at a place, and leave this branch as it is."""
        return Way(self, adversary)

    def go_on(self, adversary: AdversaryState, velocity: Velocity) -> tuple[AdversaryState, Contact | None]:
        """Change this branch itself by a tick; return the adversary after it, and the contact in it, if any."""
        if self.shares:
            return self.world.meet(self.share(adversary), velocity)
        self.world.adversary = adversary
        tick, contact = self.world.tick, None
        while self.world.tick == tick:
            contact = self.world.step(self._command(), velocity)
        self._note(adversary, velocity)
        return self.world.adversary, contact

    @property
    def shares(self) -> bool:
        """Whether what the car does in a tick is the same wherever the adversary goes in it."""
        return self._episode.scenario.control_periods == 1

    def share(self, adversary: AdversaryState) -> FloatArray:
        """Change the car by the tick that all actions share, and return its path in it."""
        self.world.adversary = adversary
        path = self.world.drive(self._command())
        self.world.tick += 1
        self._note(adversary, None)
        return path

    def copy(self) -> Branch:
        """Return another branch at the same moment."""
        if not self._copies:
            again = Branch(self._episode, self._make, copies=False)
            for adversary, velocity in self._walked:
                if velocity is None:
                    again.share(adversary)
                else:
                    again.go_on(adversary, velocity)
            return again
        again = Branch.__new__(Branch)
        again.__dict__.update(self.__dict__)
        again.world = self.world.copy()
        again._controller = copy.deepcopy(self._controller)
        return again

    def can_be_copied(self) -> bool:
        """Tell whether a copy of the controller can be made; a user's controller may hold what cannot be copied."""
        try:
            self.copy()
        except Exception:
            return False
        return True

    def _command(self) -> float:
        world, controller = self.world, self._controller
        if self._laser is not None and isinstance(controller, SensingController):
            controller.sense(self._laser.scan(world.car, world.adversary, world.tick, world.period))
        return controller.command(world.car, self._sight(world.car, world.adversary, world.tick, world.period))

    def _note(self, adversary: AdversaryState, velocity: Velocity | None) -> None:
        if not self._copies:
            self._walked = (*self._walked, (adversary, velocity))


class Way:
    """The ways on from a branch in one tick, by what the adversary does in it.

    Attributes:
        ticks: number of ticks of the car that were simulated.
        shared: whether all actions of the adversary share one tick of the car.
        after: state of the car after the tick, where they share it.
    """

    def __init__(self, branch: Branch, adversary: AdversaryState) -> None:
        """Let the car drive as far as its motion does not depend on the adversary's action."""
        self._before, self._adversary = branch, adversary
        self.ticks, self.shared = 0, branch.shares
        self.after: Branch | None = None
        if branch.shares:
            self.after = branch.copy()
            self._path = self.after.share(adversary)
            self.ticks = 1

    def go(self, velocity: Velocity) -> tuple[Branch, AdversaryState, Contact | None]:
        """Return the branch after the tick, the adversary's state there, and the contact in it, if any."""
        if self.after is not None:
            self.after.world.adversary = self._adversary
            return self.after, *self.after.world.meet(self._path, velocity)
        after = self._before.copy()
        self.ticks += 1
        return after, *after.go_on(self._adversary, velocity)
