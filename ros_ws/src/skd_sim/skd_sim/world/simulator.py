"""What SKD asks of a simulator, in process as in the graph, and SKD's own world behind it.

A class with the two methods of `Simulator` and the count is enough: `run_episode(episode, simulator=…)` runs it in
process, `nodes.simulator_node.SimulatorNode` in the graph.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple, Protocol

from skd_sim.errors import UsageError
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.aborts import AbortKind, abort_reason
from skd_sim.world.episode import Episode, Outcome
from skd_sim.world.state import AdversaryState, CarState, Scene
from skd_sim.world.world import Contact, World, make_world


class Frame(NamedTuple):
    """How an episode stands at the end of a control period: the car is to decide, and at a tick the adversary, too.

    Attributes:
        tick: number of the tick; 0 is the start.
        car: state of the car under test.
        adversary: state of the adversary.
        contact: collision in the tick that has just ended, if there was one; its fraction is of the tick.
        outcome: outcome of the episode: `RUNNING` while there is something to decide, anything else only at a tick.
        period: number of control periods since the tick; 0 at the tick itself.
    """

    tick: int
    car: CarState
    adversary: AdversaryState
    contact: Contact | None = None
    outcome: Outcome = Outcome.RUNNING
    period: int = 0

    def scene(self, scenario: Scenario) -> Scene:
        """Return everybody; where the others of the scenario are depends on the time alone."""
        return Scene(self.car, self.adversary, scenario.others_at(self.tick, self.period))

    def impact(self, time_step: float) -> tuple[float, float]:
        """Return time since the start (s) and the car's speed (m/s) at the contact; nan where there is none."""
        if self.contact is None:
            return math.nan, math.nan
        return (self.tick - 1 + self.contact.fraction) * time_step, float(self.contact.speed)


class SimulatorError(Exception):
    """A simulator cannot go on with this episode, which is aborted; the next one may be better."""

    def __init__(self, kind: AbortKind, what: str) -> None:
        """Say what went wrong, and which kind of fault it is."""
        super().__init__(abort_reason(kind, what))


class Simulator(Protocol):
    """Runs one episode after another, a control period at a time when told to; it may take as long as it needs."""

    @property
    def clipped(self) -> int:
        """How many commands of this episode asked more of the car than it can do."""

    def reset(self, episode: Episode) -> Frame:
        """Put car and adversary at the start, as `make_world` draws it, and return tick 0.

        Raises:
            UsageError: this simulator cannot run such an episode.
            SimulatorError: it fails.
        """

    def step(self, acceleration: float, velocity: tuple[float, float]) -> Frame:
        """Hold both commands for one control period (`Scenario.control_periods` of a tick), and return its end.

        A contact is looked for along all of it, and ends the tick, where the adversary's velocity takes it.
        `Episode.outcome` says how an episode stands at a tick.

        Args:
            acceleration: acceleration of the car, m/s², finite; what the car cannot do is clipped and counted.
            velocity: velocity of the adversary, (East, North), m/s, finite; the same throughout a tick.

        Raises:
            SimulatorError: it fails.
        """


def require_others(simulator: object, name: str, episode: Episode) -> None:
    """Refuse an episode whose scenario has others for a simulator, called `name`, that does not say it places them.

    Raises:
        UsageError: it is so.
    """
    if episode.scenario.others and not getattr(simulator, "places_others", False):
        raise UsageError(
            f"scenario {episode.scenario.name} has others, which simulator {name!r} does not place; take SKD's own "
            "world, or a simulator whose attribute places_others is true"
        )


class WorldSimulator:
    """SKD's own world; see `Simulator`."""

    places_others: Final = True
    """Whether the others of a scenario are there: of a simulator that does not say so, they are not."""

    def reset(self, episode: Episode) -> Frame:
        """Make the world of an episode, with all that is drawn for it."""
        self._episode = episode
        self._world = make_world(episode)
        return Frame(0, self._world.car, self._world.adversary)

    def step(self, acceleration: float, velocity: tuple[float, float]) -> Frame:
        """Advance the world by one control period."""
        world = self._world
        contact = world.step(acceleration, velocity)
        if world.period:
            return Frame(world.tick, world.car, world.adversary, period=world.period)
        outcome = self._episode.outcome(world.tick, world.adversary, collided=contact is not None)
        return Frame(world.tick, world.car, world.adversary, contact, outcome)

    @property
    def world(self) -> World:
        """World of the running episode, to be looked at and not to be changed."""
        return self._world

    @property
    def clipped(self) -> int:
        """How many commands of this episode asked more of the car than it can do."""
        return self._world.clipped
