"""How often cars hit a pedestrian under a much larger perturbation than kamikazes are planned with, nobody planning.

One run: a safe trajectory φ, walked at another pace, a little further up or down the road, earlier or later beside the
car. The car starts further away than in an assessment, so that earlier and later mean the same to every car. The same
runs for every car (common random numbers).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from skd_evaluator.campaign.plan import EpisodeRunner, Stage, episode_id
from skd_sim.car_under_test import CarUnderTest
from skd_sim.controllers import with_control_period
from skd_sim.encounter.scenario import Scenario
from skd_sim.episode import Episode, Mode, Outcome
from skd_sim.trajectory import Trajectory

EARLIER_OR_LATER = 1.0  # s, to either side: 8.3 m of the car's way, against the 2.5 m of an assessment's draw
PACES = (0.5, 1.5)  # times that of φ: at 2.5 m/s from a walk, 1.25 m/s, to a run, 3.75 m/s
ALONG_THE_ROAD = 3.0  # m, to either side
LONGEST_PAUSE = 1.0  # s, of who hesitates
STANDING = 0.1  # m/s: who touches a slower car has walked into it
_STREAM = 712  # of the draws, apart from those of any episode


@dataclass(frozen=True)
class Car:
    """A car under test.

    Attributes:
        label: in tables.
        controller: as in `Episode`.
        multiplier: C of the basic controller.
        scenario: with the car's dynamics.
    """

    label: str
    controller: str
    multiplier: float
    scenario: Scenario


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

    Between its points φ is linear; before it the pedestrian stands at its first point.

    Args:
        phi: φ.
        delay: before the first step, s.
        pace: by which the clock of φ is faster.
        along: by how much it is moved, m, North.
        ticks: of time at most.
        change: after which share of φ the pace becomes another one, and which; none by default.
        pause: after which share of φ the pedestrian stops, and for how long (s); none by default.
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


def encounters(
    car: Car,
    safe: Sequence[Trajectory],
    runs: int,
    seed: int,
    *,
    changing: bool = False,
    hesitating: bool = False,
) -> list[Episode]:
    """Return the runs of a car; φ take turns.

    Args:
        car: under test.
        safe: φ.
        runs: how many.
        seed: of every draw.
        changing: whether everybody changes his pace once, anywhere on the way, to another of the same range.
        hesitating: whether everybody stops once, anywhere on the way, and goes on after up to LONGEST_PAUSE.
    """
    away = EARLIER_OR_LATER * car.scenario.car.start_speed
    further = replace(car.scenario.car, start_gap=car.scenario.car.start_gap + away)
    clocked = with_control_period(car.scenario, CarUnderTest(car.controller).control_period, car.controller)
    scenario = replace(clocked, car=further)
    found = []
    for run in range(runs):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_STREAM, run)))
        delay = rng.uniform(0.0, 2.0 * EARLIER_OR_LATER)  # the car needs half of it longer
        pace = rng.uniform(*PACES)
        along = rng.uniform(-ALONG_THE_ROAD, ALONG_THE_ROAD)
        change = (rng.uniform(), rng.uniform(*PACES)) if changing else None
        pause = (rng.uniform(), rng.uniform(0.0, LONGEST_PAUSE)) if hesitating else None
        path = walked(
            safe[run % len(safe)],
            delay=delay,
            pace=pace,
            along=along,
            ticks=scenario.ticks,
            change=change,
            pause=pause,
        )
        number = episode_id(Stage.COLLISION_RATE, run % len(safe), run // len(safe))
        found.append(
            Episode(scenario, Mode.REPLAY, seed, number, path, controller=car.controller, multiplier=car.multiplier)
        )
    return found


def hit_rate(
    car: Car, safe: Sequence[Trajectory], runs: int, seed: int, runner: EpisodeRunner, **manner: bool
) -> dict[str, int]:
    """Run a car and return how many runs there were, how many were hits, and how many touched a standing car.

    Args:
        car: under test.
        safe: φ.
        runs: how many.
        seed: of every draw.
        runner: runs them.
        manner: of walking, as `encounters` has it: `changing`, `hesitating`.

    Raises:
        RuntimeError: a run was aborted.
    """
    hits = standing = 0
    for log in runner.run(encounters(car, safe, runs, seed, **manner)):
        if log.outcome == Outcome.ABORTED:
            raise RuntimeError(f"{car.label}: {log.reason}")
        if log.outcome == Outcome.COLLISION:
            standing += log.impact_speed < STANDING
            hits += log.impact_speed >= STANDING
    return {"runs": runs, "hits": hits, "standing": standing}
