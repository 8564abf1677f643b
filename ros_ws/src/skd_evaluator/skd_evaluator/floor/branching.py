"""A car under test that can be led on from the same moment in several ways: its world and its controller, copied.

What the car does in a tick depends on where the pedestrian was until then and not on where he goes in it, so all his
actions share one step of the car. A controller that cannot be copied is run again from the start instead.
"""

from __future__ import annotations

import copy
from collections.abc import Callable

from skd_sim.controllers import Controller, SensingController, make_controller, require_sensor
from skd_sim.episode import Episode
from skd_sim.randomness import Role, generator
from skd_sim.sensors import make_laser
from skd_sim.state import PedestrianState
from skd_sim.trajectory import FloatArray
from skd_sim.world import World, make_world

ControllerFactory = Callable[[], Controller]


class Branch:
    """World and controller after some ticks. Where the pedestrian is then is given when it goes on.

    Attributes:
        world: after those ticks.
    """

    def __init__(self, episode: Episode, make: ControllerFactory | None = None, *, copies: bool = True) -> None:
        """Start an episode.

        Args:
            episode: what to run.
            make: the car under test; from the specification by default.
            copies: whether the controller may be copied; else every branch runs it again from the start.
        """
        self._episode = episode
        self._make = make or (lambda: make_controller(episode.controller, episode.multiplier))
        self._copies = copies
        self._walked: tuple[PedestrianState, ...] = ()  # where the pedestrian was at each tick that is gone
        self.world: World = make_world(episode)
        self._controller = self._make()
        require_sensor(self._controller, episode.controller, episode.scenario)
        self._controller.reset(episode.scenario, generator(episode.seed, episode.episode_id, Role.CONTROLLER))
        self._laser = make_laser(episode) if isinstance(self._controller, SensingController) else None

    def drive(self, pedestrian: PedestrianState) -> tuple[Branch, FloatArray]:
        """Let the car drive on for a tick that the pedestrian begins at a place, and leave this branch as it is.

        Returns:
            The branch after the tick, and the car's path in it.
        """
        after = self._copy()
        return after, after.go_on(pedestrian)

    def go_on(self, pedestrian: PedestrianState) -> FloatArray:
        """Change this branch itself by a tick, and return the car's path in it."""
        world, controller = self.world, self._controller
        world.pedestrian = pedestrian
        if self._laser is not None and isinstance(controller, SensingController):
            controller.sense(self._laser.scan(world.car, pedestrian, world.tick))
        path = world.drive(controller.command(world.car, pedestrian))
        world.tick += 1
        if not self._copies:
            self._walked = (*self._walked, pedestrian)
        return path

    def _copy(self) -> Branch:
        if not self._copies:
            again = Branch(self._episode, self._make, copies=False)
            for pedestrian in self._walked:
                again.go_on(pedestrian)
            return again
        shared = (self._episode, self._episode.scenario, self._make, self._laser)  # nobody changes these
        return copy.deepcopy(self, {id(one): one for one in shared if one is not None})

    def can_be_copied(self) -> bool:
        """Tell whether a copy of the controller can be made at all; a user's may hold what cannot be copied."""
        try:
            self._copy()
        except Exception:
            return False
        return True
