"""How often cars hit an adversary under a much larger perturbation than kamikazes are planned with, nobody planning.

One run: a safe trajectory φ, walked at another pace, a little further up or down the road, earlier or later beside the
car. The car starts further away than in an assessment, so that earlier and later mean the same to every car. There are
three manners of walking so; `TRUTHS` are the rates that cars are ranked by, fixed before any figure was seen. The same
runs for every car (common random numbers).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import chain

import numpy as np
from cars.catalogue import Car
from contacts import Run, counted, run_of
from skd_evaluator.assessment.plan import EpisodeGroup, episode_id
from skd_evaluator.assessment.run.episodes import run_episode
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_sim.world.episode import EpisodeSpec, Mode
from skd_sim.world.state import Trajectory

EARLIER_OR_LATER = 1.0  # s, to either side: 8.3 m of the car's way, against the 2.5 m of an assessment's draw
PACES = (0.5, 1.5)  # times that of φ: at 2.5 m/s from a walk, 1.25 m/s, to a run, 3.75 m/s
ALONG_THE_ROAD = 3.0  # m, to either side
LONGEST_PAUSE = 1.0  # s, of who hesitates
_STREAM = 712  # of the draws, apart from those of any episode
_PART = 50  # runs that a worker does at a time


class Manner(StrEnum):
    """How everybody walks φ, beside pace, place and time of his own."""

    WIDE = "wide"
    """At one pace."""
    CHANGING = "changing pace"
    """Changes his pace once, anywhere on the way, to another of the same range."""
    HESITATING = "hesitating"
    """Stops once, anywhere on the way, and goes on after up to LONGEST_PAUSE."""


HITS = (Run.FRONT, Run.FLANK, Run.REAR)


@dataclass(frozen=True)
class Truth:
    """A rate that says how safe cars are.

    Attributes:
        manners: of walking, whose runs it counts.
        kinds: of runs that are hits.
    """

    manners: tuple[Manner, ...]
    kinds: tuple[Run, ...]

    def hits(self, runs: Mapping[Manner, str]) -> np.ndarray:
        """Return which of a car's runs are hits, n booleans, in the same order for every car."""
        return np.concatenate([counted(runs[manner], *self.kinds) for manner in self.manners])


TRUTHS = {
    "wide": Truth((Manner.WIDE,), HITS),
    "changing pace": Truth((Manner.CHANGING,), HITS),
    "hesitating": Truth((Manner.HESITATING,), HITS),
    "front only": Truth(tuple(Manner), (Run.FRONT,)),
}
"""Touches of a car slower than the scenario's hit_speed are hits in none of them."""


def walked(
    phi: Trajectory,
    *,
    delay: float,
    pace: float,
    along: float,
    ticks: int,
    change: tuple[float, float] | None = None,
    pause: tuple[float, float] | None = None,
) -> Trajectory:
    """Return φ as somebody else walks it.

    Between its points φ is linear; before it the adversary stands at its first point.

    Args:
        phi: φ.
        delay: before the first step, s.
        pace: by which the clock of φ is faster.
        along: by how much it is moved, m, North.
        ticks: of time at most.
        change: after which share of φ the pace becomes another one, and which; none by default.
        pause: after which share of φ the adversary stops, and for how long (s); none by default.
    """
    moment = pace * (np.arange(ticks + 1) * phi.time_step - delay)
    if change is not None:
        turn = change[0] * phi.duration
        moment = np.where(moment > turn, turn + (moment - turn) * change[1] / pace, moment)
    if pause is not None:
        stop = pause[0] * phi.duration
        moment = np.where(moment > stop, np.maximum(stop, moment - pace * pause[1]), moment)
    last = int(np.searchsorted(moment, phi.duration)) + 1
    knots = np.arange(len(phi)) * phi.time_step
    moment = moment[: last + 1]
    x = np.interp(moment, knots, phi.positions[:, 0])
    y = np.interp(moment, knots, phi.positions[:, 1]) + along
    return Trajectory(np.column_stack([x, y]), phi.time_step, phi.name)


def scenarios(
    car: Car, safe: Sequence[Trajectory], runs: range, seed: int, manner: Manner = Manner.WIDE
) -> list[EpisodeSpec]:
    """Return some runs of a car; φ take turns.

    Args:
        car: under test.
        safe: φ.
        runs: their numbers.
        seed: of every draw.
        manner: of walking; all share the draws of pace, place and time.
    """
    away = EARLIER_OR_LATER * car.scenario.car.start_speed
    further = replace(car.scenario.car, start_gap=car.scenario.car.start_gap + away)
    scenario = replace(car.scenario, car=further)
    found = []
    for run in runs:
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_STREAM, run)))
        delay = rng.uniform(0.0, 2.0 * EARLIER_OR_LATER)  # the car needs half of it longer
        pace = rng.uniform(*PACES)
        along = rng.uniform(-ALONG_THE_ROAD, ALONG_THE_ROAD)
        change = (rng.uniform(), rng.uniform(*PACES)) if manner == Manner.CHANGING else None
        pause = (rng.uniform(), rng.uniform(0.0, LONGEST_PAUSE)) if manner == Manner.HESITATING else None
        path = walked(
            safe[run % len(safe)],
            delay=delay,
            pace=pace,
            along=along,
            ticks=scenario.ticks,
            change=change,
            pause=pause,
        )
        number = episode_id(EpisodeGroup.NOMINAL, run % len(safe), run // len(safe))
        found.append(
            EpisodeSpec(scenario, Mode.REPLAY, seed, number, path, controller=car.controller, multiplier=car.multiplier)
        )
    return found


def _letters(job: tuple[Car, Sequence[Trajectory], range, int, Manner]) -> str:
    return "".join(run_of(run_episode(episode)) for episode in scenarios(*job))


def outcomes(
    car: Car, safe: Sequence[Trajectory], runs: int, seed: int, manner: Manner, runner: InProcessRunner
) -> str:
    """Run a car and return a letter of `Run` for each run.

    Args:
        car: under test.
        safe: φ.
        runs: how many.
        seed: of every draw.
        manner: of walking.
        runner: has the workers.

    Raises:
        RuntimeError: a run was aborted.
    """
    parts = [range(first, min(runs, first + _PART)) for first in range(0, runs, _PART)]
    jobs = [(car, tuple(safe), part, seed, manner) for part in parts]
    return "".join(chain(runner.map(_letters, jobs)))
