"""The margin of an attempt, found for any car that runs in process: never less than it, and nearer with more ticks.

Of a car that is not known beforehand only its own answers tell what it does. So ways of the adversary are tried against
the episode's own world and controller, with the episode's own draws, until a budget of simulated ticks of the car is
spent. First are φ itself and the ways that are given, as of planned kamikazes. Then plans are made in a picture of the
controller that was learned from all ticks so far (`planning`), and in turn with them searches that need no picture
(`local`).

A longer budget goes on where a shorter one stopped, so it never finds more deformation.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.episode.episode import Episode, Mode, until_contact
from skd_sim.episode.randomness import Role, generator
from skd_sim.geometry.trajectory import Trajectory
from skd_sim.simulation.branching import Branch, ControllerFactory

from skd_evaluator.errors import AssessmentError
from skd_evaluator.margin.search.local import LocalSearch
from skd_evaluator.margin.search.picture import Picture
from skd_evaluator.margin.search.planning import Planning
from skd_evaluator.margin.search.tree import ENOUGH, Node, OverError, Tree
from skd_evaluator.measure.distances.deformation import deformation
from skd_evaluator.measure.distances.least_way import LeastWay

DEFAULT_BUDGET: Final = 256
"""Simulated ticks of the car in an attempt."""
FORMS_DIFFER: Final = 1e-4
"""m by which a way may differ that is gone again by the other form of a policy, which may add up in another order."""
_PLANNED_A_TICK, _HEAD_START = 250, 100  # moments that may be planned for each simulated tick, and ticks on credit
_PLANS_FIRST = 4
_WORTH = 0.1, 1.0, 2.0  # of best first, of changes, of plans: by what they were seen to find
_MOMENTS = 250, 50  # that are planned count as a tick of a car that decides once in it, or more often
_IN_VAIN = 0, 1, 8  # ticks that a turn counts as, beyond its own, in which nothing new was simulated
_MOST_WORTH, _FADES = 8.0, 0.8  # of a search that finds less again and again; how soon that is forgotten


@dataclass(frozen=True, eq=False)
class SearchResult:
    """What a search has found.

    Attributes:
        way: the way of least deformation that hits, at most η_max; None: none was found. Its gap is infinite, or 0
            where φ itself is hit or nothing was left to find.
        trace: the least deformation, m, when 1, 2, 4, … ticks had been simulated, as far as the budget goes; infinity:
            no hit yet. What half of a budget that is a power of two had found is the last but one.
        simulated_ticks: how many ticks of the car were simulated.
        exhausted: whether everything with less deformation than the way was tried: a longer budget finds nothing else.
        samples: what was learned of the controller, n × 7; see `picture`.
    """

    way: LeastWay | None
    trace: FloatArray
    simulated_ticks: int
    exhausted: bool
    samples: FloatArray


def search_margin(
    episode: Episode,
    budget: int = DEFAULT_BUDGET,
    ways: Sequence[FloatArray] = (),
    controller: ControllerFactory | None = None,
    samples: FloatArray | None = None,
    *,
    walks: ControllerFactory | None = None,
) -> SearchResult:
    """Search for the way of least deformation that ends in a hit by the moving car.

    Args:
        episode: kamikaze mode; its objective does not matter.
        budget: ticks of the car that may be simulated.
        ways: ways to begin with: positions of the adversary at each tick, n × 2, m, the last of them at the contact, if
            there is one.
        controller: makes the car under test, anew at each call; from the specification by default.
        samples: samples of the same controller from other attempts, n × 7.
        walks: makes the car anew, for the way that was found to be gone again; by default as `controller` does.

    Raises:
        ValueError: the episode is not in kamikaze mode, or the budget is below 1.
        AssessmentError: the car answers differently to the same ways.
    """
    if episode.mode != Mode.KAMIKAZE or episode.safe_trajectory is None:
        raise ValueError(f"only a kamikaze episode has a margin, not mode {episode.mode.name}")
    if budget < 1:
        raise ValueError(f"the budget must be at least 1 tick, got {budget}")
    copies = Branch(episode, controller).can_be_copied()
    while True:
        root = Branch(episode, controller, copies=copies)
        picture = Picture(samples, not root.shares)
        tree = Tree(episode, budget, root, picture)
        exhausted = _run(tree, picture, ways)
        way = None
        if tree.found is not None:
            gap, enough = 0.0 if exhausted else math.inf, ENOUGH if walks is None else FORMS_DIFFER
            way = _walked(episode, tree, tree.found, walks or controller, gap, enough)
        if tree.found is None or way is not None:
            return SearchResult(way, _trace(tree, budget), tree.steps, exhausted, picture.gathered)
        if walks is not None:
            raise AssessmentError(
                f"controller {episode.controller}: on a way that the search found with commands, command answers "
                f"otherwise (episode {episode.episode_id}): both have to be the same car, without a memory of its own"
            )
        if not copies:
            raise AssessmentError(
                f"controller {episode.controller} answers differently to the same ways (episode {episode.episode_id}): "
                "what it draws at random has to come from the generator that reset gives it"
            )
        copies = False  # it keeps something outside of what was copied


def _run(tree: Tree, picture: Picture, ways: Sequence[FloatArray]) -> bool:
    """Search until the budget is spent; tell whether nothing is left to find."""
    episode = tree.episode
    search = LocalSearch(tree, generator(episode.seed, episode.episode_id, Role.FLOOR))
    try:
        last = search.roll_out(tree.root, search.as_phi)
        for way in ways:
            search.follow(np.asarray(way, dtype=np.float64))
        rng = generator(episode.seed, episode.episode_id, Role.FLOOR, 1)
        _take_turns(tree, search, Planning(tree, picture, rng) if tree.is_pedestrian else None, last)
    except OverError:
        return tree.least <= ENOUGH
    return True


def _take_turns(tree: Tree, search: LocalSearch, planning: Planning | None, last: Node) -> None:
    """Let the searches take turns; a search that lately found less deformation gets more ticks."""
    if planning is not None:
        for _ in range(_PLANS_FIRST):
            if _can_plan(planning, tree):
                planning.turn()
    # Of a car that decides once a tick one answer shows where all ways from a moment lead: best first finds more in it.
    if planning is None and tree.within_ticks:
        search.leave(last)
    search.walk_up(last)
    turns: list[Callable[[], object]] = [search.expand_best, search.vary]
    if planning is not None:
        turns.append(planning.turn)
    spent, worth = [0.0] * len(turns), list(_WORTH)
    while not search.exhausted:
        able = len(turns) if planning is None or _can_plan(planning, tree) else len(turns) - 1
        index = min(range(able), key=lambda one: spent[one])
        least, steps = tree.least, tree.steps
        planned = 0 if planning is None else planning.planned
        turns[index]()
        effort = 1 if planning is None else 1 + (planning.planned - planned) // _MOMENTS[tree.within_ticks]
        if tree.steps == steps:
            effort += _IN_VAIN[index]
        worth[index] = (
            min(_MOST_WORTH, 2.0 * worth[index]) if tree.least < least else max(_WORTH[index], _FADES * worth[index])
        )
        spent[index] += (tree.steps - steps + effort) / worth[index]


def _can_plan(planning: Planning, tree: Tree) -> bool:
    """Tell whether plans have not yet cost too much for the ticks so far: plans cost most where no hit is possible."""
    return planning.planned <= _PLANNED_A_TICK * (tree.steps + _HEAD_START)


def _trace(tree: Tree, budget: int) -> FloatArray:
    found = math.inf if tree.found is None else tree.least
    length = budget.bit_length()
    return np.array([*tree.trace, *[found] * length][:length])


def _walked(
    episode: Episode, tree: Tree, best: Node, controller: ControllerFactory | None, gap: float, enough: float
) -> LeastWay | None:
    """Run the best way from the start in a world of its own; none unless it ends in the same hit, `enough` m off."""
    assert episode.safe_trajectory is not None
    branch = Branch(episode, controller)
    user = branch.world.adversary
    places, contact = [user[:2]], None
    chain = best.chain
    for before, after in itertools.pairwise(chain):
        if contact is not None:
            return None
        user, contact = branch.go_on(user, tree.choices(before)[after.way])
        places.append(user[:2])
    if contact is None or not episode.scenario.collision.is_hit(contact.speed):
        return None
    duration = len(places) - 2 + contact.fraction
    walked = until_contact(np.array(places), duration)
    distance = deformation(episode.safe_trajectory.positions, walked, duration)
    if abs(distance - best.strayed) > enough:
        return None
    return LeastWay(distance, Trajectory(walked, episode.scenario.time_step), duration, contact.speed, gap)
