"""Candidates of the search for a margin: sequences of the road user's actions, and where they lead.

Where a candidate leads and how far it deviates from φ is known without the car.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from skd_adversary.crossing.model import choices, walked
from skd_adversary.crossing.road_users import AS_PHI, PEDESTRIAN, road_user_named
from skd_sim.scenario.ending import Ending
from skd_sim.scenario.road import right_and_along
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.state import BoolArray, FloatArray, IntArray

from skd_evaluator.margin.actions import velocities

ENOUGH = 1e-9
"""m: a trajectory that deviates less is φ itself."""
_ALTERNATES = 0.3
_LENGTHS = 1, 2, 3, 4, 6, 8  # ticks


class Candidate(NamedTuple):
    """A sequence of actions, and where it leads.

    Attributes:
        actions: number of the action in each tick.
        positions: of the road user at each tick, (ticks + 1) × 2, m.
        deviations: greatest distance from φ up to each tick, m.
        reached: the last tick, up to each one, in which the road user is where the car may drive; −1: there is none.
    """

    actions: IntArray
    positions: FloatArray
    deviations: FloatArray
    reached: IntArray

    def last_tick(self, bound: float) -> int:
        """Return the last tick in which it can be hit with a deviation below a bound (m); −1: in none."""
        ticks = int(self.deviations[:-1].searchsorted(bound))
        return int(self.reached[ticks - 1]) if ticks else -1


class ActionSpace:
    """What the trials of one φ have in common: where sequences of actions lead.

    Attributes:
        scenario: the scenario.
        end: when an episode is over.
        ticks: number of ticks of a sequence.
        path: φ, n × 2, m.
        phi: positions of φ at ticks 0 … ticks, held at its end, m.
        as_phi: number of the action "as φ".
        action_count: how many actions there are in a tick.
        opposite: of each action the one that leads back most.
        table: velocities of the actions in each tick, ticks × actions × 2, m/s; None: they depend on the road user's
            state.
    """

    def __init__(self, scenario: Scenario, end: Ending, path: FloatArray) -> None:
        """Prepare a φ, n × 2, m, of which is known when an episode is over."""
        self.scenario, self.end, self.path = scenario, end, np.ascontiguousarray(path, dtype=np.float64)
        self.ticks = ticks = scenario.ticks
        self.phi = self.path[np.minimum(np.arange(ticks + 1), len(path) - 1)]
        user = road_user_named(scenario.adversary.kind)
        self._every = np.arange(ticks)
        self.table: FloatArray | None = None
        if user is PEDESTRIAN:
            self.table = np.array([velocities(scenario, self.path, tick) for tick in range(ticks)])
        first = velocities(scenario, self.path, 0, self.path[:1])
        self.action_count = len(first)
        self.as_phi = AS_PHI if user is PEDESTRIAN else self.action_count - 1
        sums = np.hypot(*(first[:, None] + first).transpose(2, 0, 1))
        self.opposite = sums.argmin(axis=1)

    def positions(self, sequences: IntArray) -> FloatArray:
        """Return where sequences of actions (n × ticks) lead, n × (ticks + 1) × 2, m."""
        if self.table is None:
            return walked(road_user_named(self.scenario.adversary.kind), self.scenario, self.path, sequences)
        found = np.empty((len(sequences), self.ticks + 1, 2))
        found[:, 0] = 0.0
        np.cumsum(self.scenario.time_step * self.table[self._every, sequences], axis=1, out=found[:, 1:])
        found += self.path[0]
        return found

    def table_along(self, positions: FloatArray, longest: int) -> FloatArray:
        """Return the velocities of actions that are held from each tick of a trajectory (n × 2, m) on.

        They are ticks × actions × so many ticks × 2, m/s, or × 1 × 2 where they are those of the tick itself.
        """
        if self.table is not None:
            return self.table[:, :, None]
        return choices(road_user_named(self.scenario.adversary.kind), self.scenario, self.path, positions, longest)

    def candidates(self, sequences: IntArray) -> list[Candidate]:
        """Return where sequences of actions lead, n × ticks."""
        positions = self.positions(sequences)
        away = positions - self.phi
        deviations = np.maximum.accumulate(np.hypot(away[..., 0], away[..., 1]), axis=1)
        reached = np.maximum.accumulate(np.where(self._reaches(positions), self._every, -1), axis=1)
        return list(map(Candidate, sequences, positions, deviations, reached))

    def candidate(self, actions: IntArray) -> Candidate:
        """Return where a sequence of actions leads."""
        return self.candidates(actions[None])[0]

    def _reaches(self, positions: FloatArray) -> BoolArray:
        """Return whether the car may drive where the road user is, in each tick of positions, n × (ticks + 1) × 2."""
        if self.scenario.others:
            return np.ones((len(positions), self.ticks), dtype=bool)
        road, (low, high, first, last) = self.scenario.road, self.end.loss
        place = positions if road.straight else right_and_along(road.line, positions.reshape(-1, 2))
        across, along = place.reshape(positions.shape)[..., 0], place.reshape(positions.shape)[..., 1]
        inside = np.abs(across) <= self.end.path_edge
        lost = (low < across) & (across < high) & (first < along) & (along < last)
        over = np.logical_or.accumulate(lost, axis=1)  # it cannot meet the car any more
        touched = inside[:, :-1] | inside[:, 1:] | (across[:, :-1] * across[:, 1:] < 0.0)
        reached: BoolArray = touched & ~over[:, :-1]
        return reached

    def actions_along(self, positions: FloatArray) -> IntArray:
        """Return the actions that come nearest to a trajectory, positions at ticks, n × 2, m; as φ after its end."""
        found, gone = np.full(self.ticks, self.as_phi, np.int64), self.path[:1]
        for tick, target in enumerate(positions[1 : self.ticks + 1]):
            moves = velocities(self.scenario, self.path, tick, gone) if self.table is None else self.table[tick]
            reached = gone[-1] + self.scenario.time_step * moves
            found[tick] = int(np.argmin(np.hypot(*(reached - target).T)))
            gone = np.concatenate([gone, reached[found[tick], None]])
        return found


def excursion(rng: np.random.Generator, space: ActionSpace) -> tuple[IntArray, int]:
    """Return a sequence that follows φ up to a tick, takes an action for some ticks, and another or φ from then on.

    Either action may alternate with the one that leads back most. The second value is the tick in which the first ends.
    """
    found = np.full(space.ticks, space.as_phi, np.int64)
    start, length, rest, *legs = rng.random(7).tolist()
    leaves = int(start * min(space.ticks, len(space.path)))
    back = leaves + _LENGTHS[int(length * len(_LENGTHS))]
    again = back + (0, 0, 1, 2, 4, space.ticks)[int(rest * 6)]
    for begin, end, which, how in ((leaves, back, *legs[:2]), (back, again, *legs[2:])):
        action = int(which * space.action_count)
        found[begin:end] = action
        if how < _ALTERNATES:
            found[begin + 1 : end : 2] = space.opposite[action]
    return found, back


def changed(
    rng: np.random.Generator, space: ActionSpace, actions: IntArray, tick: int, others: Sequence[IntArray]
) -> IntArray:
    """Return a sequence with one or two small changes before a tick, or with the end of another one.

    Args:
        rng: draws the changes.
        space: has the actions.
        actions: the sequence.
        tick: after which changes hardly matter: that of its contact.
        others: sequences of other trials, at least one.
    """
    found, end = actions.copy(), min(len(actions), tick + 2)
    draws = rng.random(11).tolist()
    for where, much, kind, which, stays in (draws[:5], draws[5:10])[: 2 if draws[10] < 0.4 else 1]:
        at, length, action = int(where * end), 1 + int(4.0 * much), int(which * space.action_count)
        if kind < 1 / 3:
            found[at : at + length] = action
        elif kind < 1 / 2:
            found[at : at + length] = space.as_phi
        elif kind < 2 / 3:
            found[at + 1 :] = found[at:-1].copy()
            if stays < 0.5:
                found[at] = action
        elif kind < 5 / 6:
            found[at:-1] = found[at + 1 :].copy()
        else:
            found[at:] = others[int(which * len(others))][at:]
    return found
