"""The simulator that an episode names, made when it is asked for."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, cast

from skd_sim.errors import UsageError
from skd_sim.options.registry import reason_of
from skd_sim.options.simulators import SIMULATORS, is_own_world
from skd_sim.simulators.checked_simulator import CheckedSimulator
from skd_sim.world.simulator import require_others

if TYPE_CHECKING:
    from skd_sim.world.episode import Episode
    from skd_sim.world.simulator import Frame, Simulator
    from skd_sim.world.world import World


def make_simulator(name: str) -> Simulator:
    """Make the simulator of a name.

    Raises:
        UsageError: there is none, it cannot be made, or is none.
    """
    factory = SIMULATORS.find(name)
    try:
        found = factory()
    except UsageError:
        raise
    except Exception as error:
        raise UsageError(f"simulator {name!r} cannot be made: {reason_of(error)}") from None
    missing = [method for method in ("reset", "step") if not callable(getattr(found, method, None))]
    if missing:
        raise UsageError(f"simulator {name!r} needs the methods reset(episode) and step(acceleration, velocity)")
    return cast("Simulator", found)


def repeats_itself(name: str) -> bool:
    """Return whether in a simulator the same commands lead to the same states: in SKD's world, and where one says so.

    Raises:
        UsageError: there is no such simulator, or it cannot be made.
    """
    return is_own_world(name) or bool(getattr(make_simulator(name), "repeats_itself", False))


class NamedSimulator:
    """The simulator that an episode names, kept from one episode to the next; see `Simulator`.

    Any but SKD's own world is looked at as it goes; see `CheckedSimulator`.
    """

    places_others: Final = True
    """It asks the one that is named."""

    def __init__(self) -> None:
        """Wait for an episode."""
        self._name = ""
        self._simulator: Simulator

    def reset(self, episode: Episode) -> Frame:
        """Make the simulator if the episode names another one than the last did, and begin the episode."""
        if episode.simulator != self._name:
            made = make_simulator(episode.simulator)
            self._name = episode.simulator
            self._simulator = made if is_own_world(self._name) else CheckedSimulator(made, self._name)
        require_others(self._simulator, self._name, episode)
        return self._simulator.reset(episode)

    def step(self, acceleration: float, velocity: tuple[float, float]) -> Frame:
        """Advance the simulator by one control period."""
        return self._simulator.step(acceleration, velocity)

    @property
    def world(self) -> World | None:
        """SKD's own world, if that is the simulator; see `WorldSimulator.world`."""
        return getattr(self._simulator, "world", None) if is_own_world(self._name) else None

    @property
    def own_contact(self) -> float | None:
        """Time of the first contact by the simulator's own shapes (s), nan without one; None: it does not say."""
        return getattr(self._simulator, "own_contact", None)

    @property
    def strayed(self) -> float:
        """Greatest distance between the adversary and where it was told to go (m), of another simulator than SKD's."""
        return getattr(self._simulator, "strayed", 0.0)

    @property
    def clipped(self) -> int:
        """How many commands of this episode asked more of the car than it can do."""
        return self._simulator.clipped
