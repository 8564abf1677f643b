"""Candidates of the search for a margin: sequences of the road user's actions, and where they lead.

Where a candidate leads and how far it deviates from φ is known without the car.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from skd_adversary.crossing.model import choices, walked
from skd_adversary.crossing.road_users import AS_PHI, PEDESTRIAN, road_user_named
from skd_sim.kernels.compilation import kernel
from skd_sim.scenario.ending import Ending
from skd_sim.scenario.road import right_and_along
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.state import FloatArray, IntArray, Pair

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
        return _followed(sequences, self.table, tuple(self.path[0].tolist()), self.scenario.time_step)

    def table_along(self, positions: FloatArray, longest: int) -> FloatArray:
        """Return the velocities of actions that are held from each tick of a trajectory (n × 2, m) on.

        They are ticks × actions × so many ticks × 2, m/s, or × 1 × 2 where they are those of the tick itself.
        """
        if self.table is not None:
            return self.table[:, :, None]
        return choices(road_user_named(self.scenario.adversary.kind), self.scenario, self.path, positions, longest)

    def candidates(self, sequences: IntArray) -> list[Candidate]:
        """Return where sequences of actions lead, n × ticks."""
        positions, road = self.positions(sequences), self.scenario.road
        places = positions
        if not road.straight:
            places = right_and_along(road.line, positions.reshape(-1, 2)).reshape(positions.shape)
        anywhere = bool(self.scenario.others)
        known = _deviations_and_reach(positions, self.phi, places, self.end.path_edge, self.end.loss, anywhere)
        return list(map(Candidate, sequences, positions, *known))

    def candidate(self, actions: IntArray) -> Candidate:
        """Return where a sequence of actions leads."""
        return self.candidates(actions[None])[0]

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


@kernel
def changed(
    draws: FloatArray, actions: IntArray, end: int, as_phi: int, action_count: int, others: IntArray
) -> IntArray:
    """Return sequences with one or two small changes before a tick, or with the end of another one, n × ticks.

    Args:
        draws: uniform in [0, 1), n × 11.
        actions: the sequence that is changed.
        end: tick from which on nothing is changed.
        as_phi: number of the action "as φ".
        action_count: how many actions there are in a tick.
        others: sequences of other trials, m × ticks with m ≥ 1.
    """
    found = np.empty((draws.shape[0], actions.shape[0]), np.int64)
    for row in range(draws.shape[0]):
        one = found[row]
        one[:] = actions
        for change in range(2 if draws[row, 10] < 0.4 else 1):
            where, much, kind, which, stays = draws[row, 5 * change : 5 * change + 5]
            at, length, action = int(where * end), 1 + int(4.0 * much), int(which * action_count)
            if kind < 1 / 3:
                one[at : at + length] = action
            elif kind < 1 / 2:
                one[at : at + length] = as_phi
            elif kind < 2 / 3:
                one[at + 1 :] = one[at:-1].copy()
                if stays < 0.5:
                    one[at] = action
            elif kind < 5 / 6:
                one[at:-1] = one[at + 1 :].copy()
            else:
                one[at:] = others[int(which * others.shape[0]), at:]
    return found


@kernel
def _followed(sequences: IntArray, table: FloatArray, start: Pair, step: float) -> FloatArray:
    """Return where sequences of actions (n × ticks) lead from a start, n × (ticks + 1) × 2, m."""
    count, ticks = sequences.shape
    found = np.empty((count, ticks + 1, 2))
    for row in range(count):
        x = y = 0.0
        for tick in range(ticks):
            found[row, tick, 0], found[row, tick, 1] = x + start[0], y + start[1]
            vx, vy = table[tick, sequences[row, tick]]
            x, y = x + step * vx, y + step * vy
        found[row, ticks, 0], found[row, ticks, 1] = x + start[0], y + start[1]
    return found


@kernel
def _deviations_and_reach(
    positions: FloatArray,
    phi: FloatArray,
    places: FloatArray,
    edge: float,
    loss: tuple[float, float, float, float],
    anywhere: bool,
) -> tuple[FloatArray, IntArray]:
    """Return `deviations` and `reached` of candidates; see `Candidate`.

    Args:
        positions: n × (ticks + 1) × 2, m.
        phi: (ticks + 1) × 2, m.
        places: the positions in road coordinates, to the right and along, m.
        edge: distance to the centre line (m) within which the road user can reach where the car may drive.
        loss: bounds of the region from which it cannot meet the car any more, m.
        anywhere: whether the car may drive anywhere.
    """
    count, ends, _ = positions.shape
    deviations, reached = np.empty((count, ends)), np.empty((count, ends - 1), np.int64)
    for row in range(count):
        most, last, is_over = 0.0, -1, False
        for tick in range(ends):
            away = positions[row, tick, 0] - phi[tick, 0], positions[row, tick, 1] - phi[tick, 1]
            most = max(most, math.hypot(away[0], away[1]))
            deviations[row, tick] = most
            if tick == ends - 1:
                break
            across, across_to, along = places[row, tick, 0], places[row, tick + 1, 0], places[row, tick, 1]
            is_over = is_over or (loss[0] < across < loss[1] and loss[2] < along < loss[3])
            touches = abs(across) <= edge or abs(across_to) <= edge or across * across_to < 0.0
            if anywhere or (touches and not is_over):
                last = tick
            reached[row, tick] = last
    return deviations, reached
