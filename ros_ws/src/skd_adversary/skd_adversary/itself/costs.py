"""The cost of a way with or without a contact at its end: the objective, which depends on ψ and the hit alone."""

from __future__ import annotations

import math
from typing import Any, Final, Protocol

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.choices.objective import Objective
from skd_sim.episode.episode import Episode
from skd_sim.errors import UsageError
from skd_sim.kernels.compilation import kernel

from skd_adversary.model.coupling import first_row, next_row
from skd_adversary.model.objective import frechet, paper
from skd_adversary.model.safe_path import polyline_segments

PATIENCE: Final = 0.003
"""m a tick: what it costs to put the contact off, without which one waits for something better to the horizon."""


class Cost(Protocol):
    """Adds up what a way costs, tick by tick; so far is whatever it needs to know of the way so far.

    Attributes:
        worth: how much more than the best a way may cost on one future to be looked at on the others.
    """

    worth: float

    def start(self, x: float, y: float) -> Any:
        """Return so far at the start, at (x, y), m."""

    def step(self, so_far: Any, tick: int, x: float, y: float) -> Any:
        """Return so far after tick `tick`, at whose end the adversary is at (x, y), m."""

    def least(self, so_far: Any, tick: int) -> float:
        """Return the least cost of any way that has come this far after so many ticks."""

    def missed(self, so_far: Any) -> float:
        """Return the cost of a way that ends without a hit."""

    def hit(self, so_far: Any, tick: int, share: float, x: float, y: float, speed: float) -> float:
        """Return the cost of a way that ends in a contact.

        Args:
            so_far: what the cost knows of the way up to the beginning of the tick.
            tick: number of the tick in which they touch.
            share: share of the tick that has passed at the contact, from 0 to 1.
            x: x of the adversary at the contact, m.
            y: y of the adversary at the contact, m.
            speed: speed of the car at the contact, m/s.
        """


class DeformationCost:
    """The deformation of a hit by the moving car; η_max of anything else. So far: greatest squared distance, m²."""

    worth = 0.1

    def __init__(self, episode: Episode) -> None:
        """Take φ, η_max and the maximum distance of an episode."""
        assert episode.safe_trajectory is not None
        self._phi = [tuple(one) for one in episode.safe_trajectory.positions.tolist()]
        self._last = len(self._phi) - 1
        self._hit_speed = episode.scenario.collision.hit_speed
        self._miss = episode.scenario.eta_max
        self._limit = self._miss if episode.maximum_distance is None else min(self._miss, episode.maximum_distance)

    def start(self, x: float, y: float) -> float:
        """See `Cost`."""
        dx, dy = x - self._phi[0][0], y - self._phi[0][1]
        return float(dx * dx + dy * dy)

    def step(self, so_far: float, tick: int, x: float, y: float) -> float:
        """See `Cost`."""
        there = self._phi[tick + 1 if tick < self._last else self._last]
        dx, dy = x - there[0], y - there[1]
        squared = dx * dx + dy * dy
        return squared if squared > so_far else so_far

    def least(self, so_far: float, tick: int) -> float:
        """See `Cost`."""
        strayed = math.sqrt(so_far)
        return self._miss if strayed >= self._limit else strayed + PATIENCE * tick

    def missed(self, so_far: float) -> float:
        """See `Cost`."""
        return self._miss

    def hit(self, so_far: float, tick: int, share: float, x: float, y: float, speed: float) -> float:
        """See `Cost`."""
        if speed < self._hit_speed:
            return self._miss
        here, there = self._phi[min(tick, self._last)], self._phi[min(tick + 1, self._last)]
        dx = x - here[0] - share * (there[0] - here[0])
        dy = y - here[1] - share * (there[1] - here[1])
        strayed = math.sqrt(max(so_far, dx * dx + dy * dy))
        return self._miss if strayed >= self._limit else min(self._miss, strayed + PATIENCE * (tick + share))


class FrechetCost:
    """The discrete Fréchet distance of ψ, up to any contact, from the whole of φ. So far: the coupling's row, m²."""

    worth = 0.1
    _miss = frechet.REWARDS["collision_reward"]

    def __init__(self, episode: Episode) -> None:
        """Take φ and the maximum distance of an episode."""
        assert episode.safe_trajectory is not None
        self._phi = np.ascontiguousarray(episode.safe_trajectory.positions)
        self._limit = math.inf if episode.maximum_distance is None else episode.maximum_distance

    def start(self, x: float, y: float) -> FloatArray:
        """See `Cost`."""
        return np.asarray(_first(x, y, self._phi))

    def step(self, so_far: FloatArray, tick: int, x: float, y: float) -> FloatArray:
        """See `Cost`."""
        return np.asarray(_next(x, y, self._phi, so_far))

    def least(self, so_far: FloatArray, tick: int) -> float:
        """See `Cost`."""
        distance = math.sqrt(float(so_far.min()))
        return self._miss if distance > self._limit else distance + PATIENCE * tick

    def missed(self, so_far: FloatArray) -> float:
        """See `Cost`."""
        return self._miss

    def hit(self, so_far: FloatArray, tick: int, share: float, x: float, y: float, speed: float) -> float:
        """See `Cost`."""
        distance = math.sqrt(float(_next(x, y, self._phi, so_far)[-1]))
        return self._miss if distance > self._limit else min(self._miss, distance + PATIENCE * (tick + share))


class PaperCost:
    """The paper's reward with its sign changed: any contact, soon and near φ. So far: what has been paid."""

    worth = 2.0

    def __init__(self, episode: Episode) -> None:
        """Take φ of an episode."""
        assert episode.safe_trajectory is not None
        self._segments = polyline_segments(episode.safe_trajectory.positions).tolist()
        self._bonus, self._weight = paper.REWARDS["collision_reward"], paper.REWARDS["distance_weight"]

    def start(self, x: float, y: float) -> float:
        """See `Cost`."""
        return 0.0

    def _distance(self, x: float, y: float) -> float:
        best = math.inf
        for begin_x, begin_y, along_x, along_y, inverse in self._segments:
            px, py = x - begin_x, y - begin_y
            s = min(1.0, max(0.0, (px * along_x + py * along_y) * inverse))
            best = min(best, math.hypot(px - s * along_x, py - s * along_y))
        return best

    def step(self, so_far: float, tick: int, x: float, y: float) -> float:
        """See `Cost`."""
        return so_far + float(paper.DISCOUNT**tick) * self._weight * self._distance(x, y)

    def least(self, so_far: float, tick: int) -> float:
        """See `Cost`: what is still to be had is the reward of a collision in this tick."""
        return so_far + self._bonus * (1.0 - float(paper.DISCOUNT**tick))

    def missed(self, so_far: float) -> float:
        """See `Cost`."""
        return so_far + self._bonus

    def hit(self, so_far: float, tick: int, share: float, x: float, y: float, speed: float) -> float:
        """See `Cost`: what the collision's reward is short of its full height counts as paid."""
        return self.step(so_far, tick, x, y) + self._bonus * (1.0 - float(paper.DISCOUNT**tick))


@kernel
def _first(x: float, y: float, phi: FloatArray) -> FloatArray:
    row = np.empty(phi.shape[0])
    first_row(x, y, phi, row, 0)
    return row


@kernel
def _next(x: float, y: float, phi: FloatArray, before: FloatArray) -> FloatArray:
    row = np.empty(phi.shape[0])
    next_row(x, y, phi, before, row, 0)
    return row


_COSTS: Final[dict[str, type[DeformationCost] | type[FrechetCost] | type[PaperCost]]] = {
    Objective.DEFORMATION: DeformationCost,
    Objective.FRECHET: FrechetCost,
    Objective.PAPER: PaperCost,
}


def cost_of(episode: Episode) -> Cost:
    """Return what ways cost by the objective of an episode.

    Raises:
        UsageError: it is one of which that is not known.
    """
    made = _COSTS.get(episode.objective)
    if made is None:
        known = ", ".join(_COSTS)
        raise UsageError(f"knowledge itself cannot plan for objective {episode.objective}; it can for {known}")
    return made(episode)
