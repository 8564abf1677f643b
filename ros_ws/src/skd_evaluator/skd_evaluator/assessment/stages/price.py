"""The price of caution: harmless runs, each beside the same drive on the empty road.

Road users wait behind the kerb, walk or ride along it, go away from it, or cross along φ, at least `CLEAR` before or
after the undisturbed car is there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from skd_adversary.crossing.road_users import road_user_named
from skd_sim.errors import AssessmentError
from skd_sim.scenario.road import beside_road, right_and_along
from skd_sim.scenario.scenario import Scenario
from skd_sim.simulators.simulator import repeats_itself
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Mode, Outcome, Role, generator
from skd_sim.world.state import FloatArray, Trajectory

from skd_evaluator.assessment.assessment import Assessment
from skd_evaluator.assessment.context import Context, Runner, stage
from skd_evaluator.assessment.episode_figures import lane_left
from skd_evaluator.assessment.plan import EpisodeGroup, Plan, episode_id
from skd_evaluator.metrics.price_of_caution import BRAKING_LASTS, HARD_BRAKING, HORIZON, HarmlessRun, PriceOfCaution

LABEL: Final = "price of caution"
KINDS: Final = ("waits", "goes along", "goes away", "crosses before", "crosses after")
RUNS: Final = 60
"""Harmless runs, and as many undisturbed ones."""
GRAPH_RUNS: Final = 30
"""And through the node graph."""
CLEAR: Final = 2.5
"""s, at least, between who crosses and the undisturbed car."""
_GAP, _APPROACH = 40.0, 4.8  # m and s from the car's start to the crossing line, whichever is more
_PASSED = 1.0  # m that the rear is beyond the crossing line when the car has passed
_BEHIND_KERB = (0.5, 1.0)  # m
_SPREAD = 2.0  # s after `CLEAR` over which crossings are spread
_SOON = 3.0  # times as long as a car at its start speed takes to the crossing line, within which most have passed
_BEHIND, _AHEAD = (-1000.0, -1000.0), (-1000.0, 1000.0)  # m to the right, and along: far from the car
_PACE = (0.4, 0.8)  # share of the adversary's speed
_HEAVIEST = 150.0  # kg: who is heavier drives a vehicle, and does not wait at a kerb


def why_no_price(plan: Plan, *, repeats: bool) -> str:
    """Return why there is no price of caution, in one line; empty where there is one."""
    user = road_user_named(plan.scenario.adversary.kind)
    if user.mass > _HEAVIEST:
        return f"the price of caution is of people on foot, bicycle or scooter; the adversary is a {user.name}"
    if not plan.scenario.car.start_speed > 0.0:
        return "the price of caution needs a car that starts at some speed"
    if not repeats or not repeats_itself(plan.simulator):
        return "the price of caution needs drives that repeat themselves: SKD's own world, in lockstep by stamps"
    return ""


@stage(85)
def run(context: Context, assessment: Assessment) -> Assessment:
    """Return the assessment with the price of caution, or why there is none."""
    plan = assessment.for_deviation.plan
    why = why_no_price(plan, repeats=context.repeats and not context.holds_commands)
    if why:
        return replace(assessment, price_note=why)
    external = plan.car.is_external
    runner = context.runner if external else context.workers
    context.progress(LABEL, 0, 1)
    try:
        price = price_of_caution(plan, assessment.safe, runner, GRAPH_RUNS if external else RUNS)
    except AssessmentError as error:
        return assessment.failed(error, price_note=f"its harmless runs ended: {error}")
    context.progress(LABEL, 1, 1)
    if price is None:
        why = "all harmless runs were aborted"
        line = f"the price of caution is not known: {why}"
        return replace(assessment, price_note=why, warnings=(*assessment.warnings, line))
    lines = () if plan.car.is_own else warnings(plan.car.label, price)
    return replace(assessment, price=price, warnings=(*assessment.warnings, *lines))


def warnings(car: str, price: PriceOfCaution) -> tuple[str, ...]:
    """Return what a reader should know of the price of a user's car, a line each."""
    every = len(price.runs) + price.aborted
    lost = (f"{price.aborted} of {every} harmless runs were aborted: the price of caution is of the others",)
    deadlocks = round(price.mean("deadlock") * len(price.runs))
    runs = f"{deadlocks} of {len(price.runs)} runs of {HORIZON:g} s"
    stuck = (f"{car} is often stuck: in {runs} it does not get past people who are not in its path",)
    return (*(lost if price.aborted else ()), *(stuck if price.does_not_get_past else ()))


def price_of_caution(plan: Plan, safe: Sequence[Trajectory], runner: Runner, count: int) -> PriceOfCaution | None:
    """Return the price of caution; None where every run was aborted.

    Args:
        plan: the plan of the assessment.
        safe: its φ, along which some road users cross.
        runner: runs episodes of the car.
        count: how many harmless runs there are; kinds take turns.

    Raises:
        AssessmentError: the car fails.
    """
    scenario = _scenario(plan.scenario)
    undisturbed = _undisturbed(plan, scenario, runner, count, _BEHIND)
    if any(log.outcome == Outcome.ARRIVED and passes(log) >= HORIZON for log in undisturbed):
        ahead = _undisturbed(plan, scenario, runner, count, _AHEAD)  # it stops for who is behind it
        undisturbed = min(undisturbed, ahead, key=lambda logs: sum(map(passes, logs)))
    crossing = [one for one in safe if _crosses(scenario, one)]
    kinds = KINDS if crossing else KINDS[:3]
    ways = [
        harmless_trajectory(scenario, kinds[number % len(kinds)], log, crossing)
        for number, log in enumerate(undisturbed)
    ]
    harmless = _drive(runner, [_episode(plan, scenario, number, way) for number, way in enumerate(ways)])
    runs = tuple(
        _run(log, other)
        for log, other in zip(harmless, undisturbed, strict=True)
        if Outcome.ABORTED not in (log.outcome, other.outcome)
    )
    return PriceOfCaution(runs, count - len(runs)) if runs else None


def _undisturbed(
    plan: Plan, scenario: Scenario, runner: Runner, count: int, place: tuple[float, float]
) -> list[EpisodeLog]:
    """Return the logs of drives with nobody but a road user at a place far from the car."""
    away = np.tile(place, (scenario.ticks + 1, 1))
    empty = Trajectory(beside_road(scenario.road.line, away), scenario.time_step, "empty road")
    return _drive(runner, [_episode(plan, scenario, number, empty) for number in range(count)])


def _drive(runner: Runner, episodes: Sequence[EpisodeSpec]) -> list[EpisodeLog]:
    """Return the logs of drives until the car has passed; most do so soon, and the others are driven to the end."""
    scenario = episodes[0].scenario
    soon = math.ceil(_SOON * (scenario.car.start_gap / scenario.car.start_speed) / scenario.time_step)
    ways = [one.safe_trajectory for one in episodes]
    cut = [replace(one, safe_trajectory=way and way.prefix(soon + 1)) for one, way in zip(episodes, ways, strict=True)]
    logs = list(runner.run(cut))
    slow = [number for number, log in enumerate(logs) if log.outcome == Outcome.ARRIVED and passes(log) >= HORIZON]
    for number, log in zip(slow, runner.run([episodes[number] for number in slow]), strict=True):
        logs[number] = log
    return logs


def _scenario(scenario: Scenario) -> Scenario:
    """Return a scenario with the car further away, and time enough to get past."""
    gap = max(_GAP, _APPROACH * scenario.car.start_speed)
    car = replace(scenario.car, meet_safe_trajectory=False, start_gap=gap)
    return replace(scenario, car=car, horizon=HORIZON, others=())


def _episode(plan: Plan, scenario: Scenario, number: int, trajectory: Trajectory) -> EpisodeSpec:
    return EpisodeSpec(
        scenario,
        Mode.REPLAY,
        plan.seed,
        episode_id(EpisodeGroup.PRICE, 0, number),
        trajectory,
        public=replace(plan.scenario, others=(), horizon=HORIZON),
        controller=plan.controller,
        multiplier=plan.multiplier,
        simulator=plan.simulator,
    )


# --- harmless road users


def harmless_trajectory(scenario: Scenario, kind: str, alone: EpisodeLog, safe: Sequence[Trajectory]) -> Trajectory:
    """Return the trajectory of a road user who is not in the car's path.

    Args:
        scenario: the scenario of the run.
        kind: one of `KINDS`.
        alone: the undisturbed drive of the same draws.
        safe: φ that cross the car's path, of which one is drawn.
    """
    number = alone.episode.episode_id
    rng = generator(alone.episode.seed, number, Role.WALKER)
    if kind.startswith("crosses"):
        phi = safe[int(rng.integers(len(safe)))]
        offsets = _crossing(scenario, right_and_along(scenario.road.line, phi.positions), alone, rng, kind)
    else:
        offsets = _beside(scenario, kind, rng)
    return Trajectory(beside_road(scenario.road.line, offsets), scenario.time_step, f"harmless/{kind}")


def _beside(scenario: Scenario, kind: str, rng: np.random.Generator) -> FloatArray:
    """Return a way on the adversary's side of the road, in road coordinates, n × 2, m."""
    side = -scenario.end.crossing
    road, adversary = scenario.road, scenario.adversary
    lanes = [one for one, lane in road.every_lane.items() if lane.beside]
    kerb = max(side * road.offset(one) + 0.5 * road.width(one) for one in lanes)
    across = max(kerb, scenario.car.half_width) + adversary.reach + rng.uniform(*_BEHIND_KERB)
    pace = adversary.speed * rng.uniform(*_PACE)
    along = rng.uniform(-10.0, 10.0)
    velocity = {"waits": (0.0, 0.0), "goes along": (0.0, pace * rng.choice((-1.0, 1.0))), "goes away": (pace, 0.0)}
    time = scenario.time_step * np.arange(scenario.ticks + 1)[:, None]
    offsets: FloatArray = np.array([across, along]) + time * np.array(velocity[kind])
    offsets[:, 0] *= side
    return offsets


def _crosses(scenario: Scenario, phi: Trajectory) -> bool:
    """Return whether φ comes from one side of the car's path and ends on the other."""
    across = right_and_along(scenario.road.line, phi.positions)[[0, -1], 0]
    return bool(across[0] * across[1] < 0.0 and (np.abs(across) > scenario.path_edge).all())


def _crossing(
    scenario: Scenario, phi: FloatArray, alone: EpisodeLog, rng: np.random.Generator, kind: str
) -> FloatArray:
    """Return φ earlier or later, so that it is clear of the undisturbed car; who has crossed goes on.

    Args:
        scenario: the scenario of the run.
        phi: φ in road coordinates, n × 2, m.
        alone: the undisturbed drive.
        rng: draws how clear.
        kind: whether it crosses before or after the car; before where it can, else after.
    """
    step, reach = scenario.time_step, scenario.adversary.reach
    inside = np.flatnonzero(np.abs(phi[:, 0]) <= scenario.path_edge)
    first, last = (int(inside[0]), int(inside[-1])) if inside.size else (1, 1)
    low, high = phi[first : last + 1, 1].min(), phi[first : last + 1, 1].max()
    comes = reaches(alone, low - reach - scenario.car.front)
    gone = reaches(alone, high + reach + scenario.car.rear)
    clear = CLEAR + rng.uniform(0.0, _SPREAD)
    shift = math.floor((comes - clear) / step) - last - 1
    if kind == "crosses after" or first + shift < 1:
        shift = math.ceil((gone + clear) / step) - first + 1
    waits = np.repeat(phi[:1], max(0, shift), axis=0)
    way = np.vstack([waits, phi[max(0, -shift) :]])
    ticks = scenario.ticks + 1
    goes_on = np.arange(1, max(0, ticks - len(way)) + 1)[:, None] * (way[-1] - way[-2])
    return np.vstack([way, way[-1] + goes_on])[:ticks]


# --- what became of it


def reaches(log: EpisodeLog, along: float) -> float:
    """Return when (s) the car's reference point is this far along the road (m), `HORIZON` where it is not by then."""
    step = log.episode.scenario.time_step
    place = right_and_along(log.episode.scenario.road.line, np.ascontiguousarray(log.car[:, :2]))[:, 1]
    beyond = np.flatnonzero(place >= along)
    if not beyond.size:
        return HORIZON
    tick = int(beyond[0])
    if tick == 0:
        return 0.0
    before, after = place[tick - 1], place[tick]
    return min(HORIZON, float(tick - 1 + (along - before) / (after - before)) * step)


def passes(log: EpisodeLog) -> float:
    """Return when (s) the car's rear is clear of the crossing line, `HORIZON` where it is not by then."""
    return reaches(log, _PASSED + log.episode.scenario.car.rear)


def _run(log: EpisodeLog, alone: EpisodeLog) -> HarmlessRun:
    scenario = log.episode.scenario
    start = right_and_along(scenario.road.line, np.ascontiguousarray(log.car[:1, :2]))[0, 1]
    assert log.episode.safe_trajectory is not None
    kind = log.episode.safe_trajectory.name.partition("/")[2]
    unslowed = float(_PASSED + scenario.car.rear - start) / scenario.car.start_speed
    passed = passes(log)
    on_its_way = replace(log, car=log.car[: math.ceil(passed / scenario.time_step) + 1])
    return HarmlessRun(kind, passed, passes(alone), unslowed, brakes(log, alone), lane_left(on_its_way))


def brakes(log: EpisodeLog, alone: EpisodeLog) -> bool:
    """Return whether the car brakes hard in a tick in which the undisturbed one, of the same noise, does not."""
    count, step = min(len(log.car), len(alone.car)), log.episode.scenario.time_step
    own, other = (-np.diff(one.car[:count, 3]) / step for one in (log, alone))
    hard = own - np.maximum(other, 0.0) >= HARD_BRAKING
    lasts = max(1, math.ceil(BRAKING_LASTS / step - 1e-9))
    return bool((np.convolve(hard, np.ones(lasts)) >= lasts).any())
