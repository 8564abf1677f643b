"""What whole episodes have shown of an attempt: the tree of moments of a car that cannot be copied."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
from skd_sim.controllers import BasicController
from skd_sim.episode.episode import Episode, EpisodeLog, Mode, Outcome
from skd_sim.geometry.trajectory import Trajectory
from skd_sim.simulation.branching import Branch
from skd_sim.state import AdversaryState

from skd_evaluator.margin.search.picture import SITUATION, Picture
from skd_evaluator.margin.search.planning import Planning
from skd_evaluator.margin.search.tree import ENOUGH, Node, Tree, Velocity
from skd_evaluator.measure.distances.deformation import deformation
from skd_evaluator.measure.distances.least_way import LeastWay

_SAME = 1e-6  # m, between a tick's displacement and that of a way
_UNBOUNDED = 1 << 62


class EpisodeTree(Tree):
    """The moments of one attempt that episodes went through.

    Attributes:
        best_way: the hit of least deformation, as its episode went.
        episodes: how many were looked at.
        apart: greatest distance (m) between two places of the car after the same ways: how little it repeats itself.
    """

    def __init__(self, episode: Episode, picture: Picture) -> None:
        """Begin with the start of an attempt; the car is that of the world, whoever drives it."""
        super().__init__(episode, _UNBOUNDED, Branch(episode, lambda: BasicController(1.0)), picture)
        self.best_way: LeastWay | None = None
        self.episodes = 0
        self.apart = 0.0

    def learn(self, log: EpisodeLog) -> int:
        """Take note of what happened on a way, and return the number of ticks that are understood.

        From the tick where a kamikaze leaves the margin's ways on, the log is of no use, except for a hit, which
        counts.
        """
        self.episodes += 1
        if log.outcome == Outcome.ABORTED:
            return 0
        node, last = self.root, len(log.adversary) - 2
        for tick in range(last + 1):
            ends = tick == last
            share = (
                log.impact_time / self.scenario.time_step - tick if ends and log.outcome == Outcome.COLLISION else 1.0
            )
            way = self._way_of(node, log, tick)
            if way is None:
                return tick
            child = node.children.get(way)
            if child is None:
                child = self._note(node, way, log, tick, share)
            else:
                self.apart = max(self.apart, abs(child.along - float(log.car[tick + 1, 1])))
            if ends and log.hit:
                self._keep(child, log)
            if ends or child.outcome != Outcome.RUNNING:
                return tick + 1
            node = child
        return last + 1

    def _way_of(self, node: Node, log: EpisodeLog, tick: int) -> int | None:
        moved = (log.adversary[tick + 1] - log.adversary[tick]).tolist()
        step = self.scenario.time_step
        choices = self.choices(node)
        away = [math.hypot(moved[0] - step * vx, moved[1] - step * vy) for vx, vy in choices]
        way = int(np.argmin(away))
        return way if away[way] <= _SAME else None

    def _note(self, node: Node, way: int, log: EpisodeLog, tick: int, share: float) -> Node:
        """Return a moment that was not known, learned from a log; share: of the tick until the contact, if any."""
        vx, vy = self.choices(node)[way]
        x, y = log.adversary[tick + 1].tolist()
        heading = self.scenario.adversary.heading(node.user.heading, vx, vy)
        child = Node(node.branch, AdversaryState(x, y, vx, vy, heading), tick + 1, node, way)
        child.along, child.speed = float(log.car[tick + 1, 1]), float(log.car[tick + 1, 2])
        noise, step = self.noise[tick], self.scenario.time_step
        seen = (child.speed - node.speed * (1.0 + noise.speed)) / (step * (1.0 + noise.acceleration))
        child.acceleration = min(seen, node.acceleration) if child.speed <= 0.0 else seen
        here, there = self._phi[tick], self._phi[tick + 1]
        ex = node.user.x + share * (x - node.user.x) - (here[0] + share * (there[0] - here[0]))
        ey = node.user.y + share * (y - node.user.y) - (here[1] + share * (there[1] - here[1]))
        child.strayed = max(node.strayed, math.hypot(ex, ey))
        if log.outcome == Outcome.COLLISION and tick == len(log.adversary) - 2:
            child.outcome = Outcome.COLLISION if log.hit else Outcome.MISSED
        else:
            child.outcome = self.episode.outcome(child.tick, child.user, collided=False)
            before = node.user[2:4] if not self.within_ticks else (vx, vy)
            situation = np.empty(SITUATION)
            gap = node.user.y - node.along - self.scenario.car.front
            situation[:] = (gap, node.user.x, node.speed, node.acceleration, *before)
            self.picture.learn(situation, child.acceleration)
        node.children[way] = child
        node.tried |= 1 << way
        if child.outcome == Outcome.RUNNING and child.strayed < self.least:
            self.nodes.append(child)
        return child

    def _keep(self, child: Node, log: EpisodeLog) -> None:
        """Keep the end of an episode if it is the best hit so far."""
        duration = log.impact_time / self.scenario.time_step
        distance = deformation(self.phi, log.trajectory.positions, duration)
        if distance < self.least:
            self.best, self.least = child, max(distance, ENOUGH)
            gap = 0.0 if distance <= ENOUGH else math.inf
            self.best_way = LeastWay(distance, log.trajectory, duration, log.impact_speed, gap)


class Proposals(Planning):
    """Makes plans and hands them out, instead of following them itself."""

    proposal: tuple[Node, list[int]] | None = None

    def propose(self, turns: int) -> list[Velocity] | None:
        """Return the next way to try, velocities per tick (m/s), or None where the picture has no more of them.

        Args:
            turns: plans that may fail to find one.
        """
        self.proposal = None
        for _ in range(turns):
            if self.turn() and self.proposal is not None:
                break
        if self.proposal is None:
            return None
        node, ways = self.proposal
        tree = self._tree
        chain = node.chain
        so_far = [tree.choices(before)[after.way] for before, after in itertools.pairwise(chain)]
        return so_far + [tree.table(node.tick + index)[way] for index, way in enumerate(ways)]

    def note_failure(self) -> None:
        """Take note that the last proposal was walked to its end and did not hit, so that it is not planned again."""
        if self.proposal is None:
            return
        node, ways = self.proposal
        for way in ways[:-1]:
            child = node.children.get(way)
            if child is None:
                return
            node = child
        end = node.children.get(ways[-1])
        if end is not None and end.outcome != Outcome.COLLISION:
            self._failures.append((node.tick, node.user.x, node.user.y, node.along, ways[-1]))

    def _follow(self, node: Node, length: int) -> None:
        self.proposal = node, [int(way) for way in self._ways[:length]]


def walked(episode: Episode, velocities: list[Velocity]) -> Episode:
    """Return the episode in which somebody walks a way under the draws of an attempt.

    It is a replay, so any stack and any adversary node can run it. The car starts as in the attempt, whatever the way.
    """
    scenario = episode.scenario
    places = [episode.start]
    for vx, vy in velocities:
        x, y = places[-1]
        places.append((x + scenario.time_step * vx, y + scenario.time_step * vy))
    car = replace(scenario.car, meet_safe_trajectory=False, start_gap=episode.start_gap)
    way = Trajectory(np.array(places), scenario.time_step, name="way")
    started = replace(scenario, car=car)
    return replace(episode, mode=Mode.REPLAY, scenario=started, safe_trajectory=way, public=episode.public_scenario)
