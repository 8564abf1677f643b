"""How the adversary can move from where it is: its road user's own actions, and as φ as far as it can."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from skd_sim.episode.episode import Episode

from skd_adversary.model.car.basic import CarModel
from skd_adversary.model.composer import compose, road_user_interfaces
from skd_adversary.model.objectives import objective_named
from skd_adversary.model.road_users import road_user_named
from skd_adversary.model.safe_path import velocities_of, velocity_at

Velocity = tuple[float, float]


class Own(NamedTuple):
    """What a road user has of its own beyond its place, as its model keeps it: nothing, or heading and speed."""

    values: tuple[float, ...]


class Moves:
    """The velocities that a road user can choose.

    Attributes:
        as_phi: number of the action that moves as φ; those below it are the road user's own.
        rest: action with which it stays where it is, or comes nearest to that.
        start: what it has of its own when the episode begins.
        fastest: speed that it has at most, m/s; φ may be faster.
    """

    def __init__(self, episode: Episode, car: CarModel) -> None:
        """Take the road user of an episode, as it is in models with a kind of car."""
        assert episode.safe_trajectory is not None
        scenario = episode.scenario
        user = road_user_named(scenario.adversary.kind)
        self._user = user.kernels
        model = compose(
            scenario,
            objective_named(episode.objective),
            car,
            start=episode.start,
            gap=episode.start_gap,
            path=episode.safe_trajectory.positions,
            road_user=user,
        )
        self._parameters = model.parameters
        self._interfaces = road_user_interfaces(self._user, car.kernels)
        self._row = self._interfaces["USER_ROW"]
        self._state, self._after = np.zeros(model.state_dim), np.zeros(model.state_dim)
        self._phi = velocities_of(episode.safe_trajectory.positions, scenario.time_step)
        self.as_phi = self._user.action_count
        self.rest = self._user.rest
        self.fastest = scenario.adversary.speed
        self._interfaces["start_road_user"](self._parameters, self._state)
        self.start = self._own(self._state)
        self._known: dict[Own, tuple[Velocity, ...]] = {}
        self._settled: dict[tuple[Own, Velocity], Own] = {}

    def _own(self, state: Any) -> Own:
        return Own(tuple(state[self._row : self._row + self._user.own_dim].tolist()))

    def velocities(self, own: Own, tick: int) -> tuple[Velocity, ...]:
        """Return the velocities (East, North), m/s, of all actions over a tick, that of as φ last."""
        mine = self._known.get(own)
        if mine is None:
            self._state[self._row : self._row + self._user.own_dim] = own.values
            velocity = self._interfaces["velocity"]
            found = [velocity(self._parameters, self._state, action) for action in range(self.as_phi)]
            mine = self._known[own] = tuple((float(vx), float(vy)) for vx, vy in found)
        return (*mine, self._along_phi(own, tick))

    def _along_phi(self, own: Own, tick: int) -> Velocity:
        """Return φ's velocity over a tick, none after its end; as far as the road user can do it."""
        wanted = velocity_at(self._phi, tick)
        if not own.values:  # from no state anything is refused, and this is asked very often
            return wanted
        self._state[self._row : self._row + self._user.own_dim] = own.values
        vx, vy = self._interfaces["possible"](self._parameters, self._state, *wanted)
        return float(vx), float(vy)

    def settle(self, own: Own, velocity: Velocity) -> Own:
        """Return what the road user has of its own after a tick at a velocity."""
        if not own.values:
            return own
        after = self._settled.get((own, velocity))
        if after is None:
            self._state[self._row : self._row + self._user.own_dim] = own.values
            self._interfaces["settle"](self._parameters, self._state, *velocity, self._after)
            after = self._settled[own, velocity] = self._own(self._after)
        return after
