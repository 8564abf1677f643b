"""The adversary that knows the car itself; see `skd_adversary.adversary.Adversary`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from skd_sim.controllers import Controller, SensingController
from skd_sim.controllers.copying import Copier
from skd_sim.dynamics.interface import make_dynamics
from skd_sim.episode.episode import Episode
from skd_sim.episode.randomness import Role, generator
from skd_sim.simulation.world import World
from skd_sim.state import AdversaryState, CarState

from skd_adversary.itself.belief import Particles
from skd_adversary.itself.costs import cost_of
from skd_adversary.itself.fidelity import Watched, check_copies
from skd_adversary.itself.future import Course, Draws, Node
from skd_adversary.itself.moves import Moves
from skd_adversary.itself.planner import Size, Way, decide
from skd_adversary.model.car.basic import CarModel

CALLS: Final = 200_000
"""Calls of the controller that an episode's plans may make; a car that takes scans has an eighth of them."""
SENSING_SHARE: Final = 8
PARTICLES: Final = 200
_FEWEST_PARTICLES: Final = 50
_CALLS_A_PARTICLE: Final = 500
_A_DECISION: Final = 8  # the share of what is left of the calls that a decision may use


class ItselfAdversary:
    """Plans in futures of copies of the car that it meets.

    Attributes:
        depletions: how often no particle explained what happened.
        calls: how many calls of copies of the controller have been made so far.
    """

    def __init__(
        self,
        episode: Episode,
        controller: Controller,
        known: CarModel,
        *,
        told: World | None,
        calls: int = 0,
    ) -> None:
        """Prepare for an episode.

        Args:
            episode: the episode, of mode kamikaze.
            controller: the car under test, which has been reset; it is copied and never called. One that is watched
                gets a copy beside it.
            known: the adversary's model, whose sensor this adversary has.
            told: the world of the episode, where the car's state is told in every tick, its controller's included; it
                is copied and never changed. None: the car is sensed.
            calls: how many calls of copies may be made; 0: the usual number.

        Raises:
            UsageError: the car cannot be copied, or copies of it have something in common that they change.
        """
        self._watched = controller if isinstance(controller, Watched) else None
        self._controller = controller.controller if isinstance(controller, Watched) else controller
        self._episode, self._known, self._world = episode, known, told
        self._senses = isinstance(controller, SensingController)
        self._left = calls or CALLS // (SENSING_SHARE if self._senses else 1)
        scenario = episode.scenario
        self._copier = Copier(scenario, scenario.road, scenario.road.line)
        self._moves = Moves(episode, known)
        self._cost = cost_of(episode)
        self._course = Course(episode, self._moves, self._cost, self._copier, self._controller)
        self._rng = generator(episode.seed, episode.episode_id, Role.ITSELF)
        self._sensor_rng = generator(episode.seed, episode.episode_id, Role.SENSOR)
        self._size = _size(self._left, told=told is not None)
        x, y = episode.start
        self._place, self._own = scenario.adversary.first_state(x, y), self._moves.start
        self._so_far = self._cost.start(x, y)
        self._tick = 0
        self._waits = 0
        self._ways: Sequence[Way] = ()
        self._velocity: tuple[float, float] | None = None
        self._particles: Particles | None = None
        self._check()
        if told is None:
            count = episode.particles or min(PARTICLES, max(_FEWEST_PARTICLES, self._left // _CALLS_A_PARTICLE))
            self._particles = Particles(
                episode,
                controller,
                self._course,
                self._moves,
                self._cost,
                self._copier,
                known.sensor,
                count,
                self._rng,
                senses=self._senses,
            )

    def _check(self) -> None:
        """Refuse a car that cannot be copied, before anything is planned with copies."""
        episode = self._episode
        start = World(
            episode.scenario,
            adversary_start=episode.start,
            gap=episode.start_gap,
            start_rng=self._rng,
            car_rng=self._rng,
        )
        dynamics = make_dynamics(episode.scenario)
        dynamics.reset(start.car)
        velocities = self._moves.velocities(self._own, 0)
        root = Node(0, start.car, dynamics, self._controller, self._place, self._own, velocities, self._so_far)
        draws = Draws(episode, dynamics, self._rng, senses=self._senses)
        check_copies(root, self._course, self._copier, episode.controller, draws)

    @property
    def depletions(self) -> int:
        """How often no particle explained what happened."""
        return 0 if self._particles is None else self._particles.depletions

    @property
    def calls(self) -> int:
        """Calls of copies of the controller so far."""
        return self._course.calls

    def act(self, car: CarState) -> tuple[float, float]:
        """Sense or be told, plan; see `Adversary.act`."""
        if self._watched is not None:
            self._watched.follow(self._copier)
        if self._particles is not None:
            if self._velocity is not None:
                self._particles.predict(self._velocity)
            scenario = self._episode.scenario
            seen = self._known.sensor.sense(scenario, self._place[:2], (car.x, car.y), self._sensor_rng)
            self._particles.correct(self._place[:2], seen)
        velocities = self._moves.velocities(self._own, self._tick)
        action = self._moves.as_phi
        if self._waits > 0:
            self._waits -= 1
            self._ways = tuple(way[1:] for way in self._ways if len(way) > 1 and way[0] == action)
        else:
            action = self._plan(car)
        velocity = velocities[action]
        step, place = self._episode.scenario.time_step, self._place
        heading = self._episode.scenario.adversary.heading(place.heading, *velocity)
        x, y = place.x + step * velocity[0], place.y + step * velocity[1]
        self._so_far = self._cost.step(self._so_far, self._tick, x, y)
        self._own = self._moves.settle(self._own, velocity)
        self._place = AdversaryState(x, y, *velocity, heading)
        self._tick += 1
        self._velocity = velocity
        return velocity

    def _plan(self, car: CarState) -> int:
        decision = decide(
            self._course,
            self._cost,
            self._moments(car),
            self._ways,
            self._size,
            (self._left - self._course.calls) // _A_DECISION,
            self._moves.as_phi,
            self._rng,
        )
        self._ways = tuple(way[1:] for way in decision.ways if len(way) > 1 and way[0] == decision.action)
        if decision.action == self._moves.as_phi:
            self._waits = max(0, decision.waits // 2 - 1)
        return decision.action

    def _moments(self, car: CarState) -> list[tuple[Node, Draws]]:
        """Return the present as it may be, with fresh draws: copies, so that nothing is changed."""
        found = []
        velocities = self._moves.velocities(self._own, self._tick)
        chosen = [] if self._particles is None else self._particles.drawn(self._size.futures)
        for index in range(self._size.futures):
            if self._world is not None:
                dynamics, controller, state = self._world.dynamics, self._controller, car
            else:
                assert self._particles is not None
                node = self._particles.nodes[chosen[index][0]]
                dynamics, controller, state = node.dynamics, node.controller, node.car
            dynamics = self._copier.copy(dynamics)
            controller = self._copier.afresh(controller, self._rng)
            root = Node(self._tick, state, dynamics, controller, self._place, self._own, velocities, self._so_far)
            found.append((root, Draws(self._episode, dynamics, self._rng, senses=self._senses)))
        return found


def _size(calls: int, *, told: bool) -> Size:
    """Return how much a decision tries, by the calls that an episode may make."""
    if calls < 50_000:
        return Size(4 if told else 8, 600, 0.5)
    if calls < 1_000_000:
        return Size(8, 3000, 0.5)
    return Size(16 if told else 32, 5000, 0.3)
