"""Which episodes an assessment is made of, and in which order their results count.

What counts never depends on who runs the episodes: trials are numbered, and sets are filled in that order.

Probes show how an unknown car reacts: adversaries vary what they do, without a plan or a model of the car. A parameter
shows where the car is near its boundary. So adversaries stand, cross, stop halfway, step out late and walk along the
lane, at many distances, times and speeds: the car meets the distance (or time, or place) at which it begins to brake
again and again, each time at another phase of its ticks.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from skd_adversary.crossing.objectives import objective_named
from skd_adversary.crossing.road_users import check_kind
from skd_sim.controllers.controller import with_control_period
from skd_sim.errors import UsageError
from skd_sim.options.car_and_adversary import DEFAULT, CarUnderTest, check_adversary_model, is_own_world
from skd_sim.options.options import shared_options
from skd_sim.scenario.road import beside_road
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Mode, Outcome, Role, generator
from skd_sim.world.state import FloatArray, Trajectory

from skd_evaluator.assessment.options import WALKERS, CampaignOptions
from skd_evaluator.metrics.behaviour.model import load_behaviour

TRIALS_PER_REQUESTED = 2
"""Cap on kamikaze episodes per wanted kamikaze trajectory."""


class EpisodeGroup(IntEnum):
    """Part of a campaign. Values enter the episode id and so every draw: never renumber."""

    SAFE = 0
    KAMIKAZE = 1
    NOMINAL = 2
    PROBE = 3
    LEARNING = 4
    RISK = 5
    PRICE = 6


GROUPS = {Mode.SAFE: EpisodeGroup.SAFE, Mode.KAMIKAZE: EpisodeGroup.KAMIKAZE, Mode.REPLAY: EpisodeGroup.NOMINAL}


def episode_id(group: EpisodeGroup, safe_index: int, trial: int) -> int:
    """Return the id, unique within a campaign and the same for every car, of an episode."""
    if not (0 <= safe_index < 1 << 16 and 0 <= trial < 1 << 32):
        raise ValueError(f"out of range: safe_index {safe_index}, trial {trial}")
    return int(group) << 48 | safe_index << 32 | trial


def split_episode_id(number: int) -> tuple[EpisodeGroup, int, int]:
    """Return (group, safe_index, trial) of an id made by `episode_id`.

    Raises:
        UsageError: it was not made by it.
    """
    group = number >> 48
    if group not in tuple(EpisodeGroup):
        raise UsageError(f"episode id {number} is not of an SKD campaign")
    return EpisodeGroup(group), number >> 32 & 0xFFFF, number & 0xFFFF_FFFF


def model_digest(number: int, car_model: str) -> str:
    """Return what tells apart kamikazes of one id by which a car is learned: which model they tried; empty of others.

    Args:
        number: id of a kamikaze, of whatever campaign.
        car_model: the model of the car that its episode carries.
    """
    return hashlib.sha256(car_model.encode()).hexdigest()[:8] if number >> 48 == EpisodeGroup.LEARNING else ""


def follows_other_trajectory(episode: EpisodeSpec) -> bool:
    """Return whether the road user follows no φ, but a trajectory of the margin, the risk or the price of caution."""
    stage = split_episode_id(episode.episode_id)[0]
    return episode.mode == Mode.REPLAY and stage in (EpisodeGroup.KAMIKAZE, EpisodeGroup.RISK, EpisodeGroup.PRICE)


@dataclass(frozen=True)
class Plan(CampaignOptions):
    """What to assess and how much of it: its options are described in `CampaignOptions` and `EpisodeOptions`.

    Attributes:
        scenario: fixed description of the test; with the control period that the controller declares, if it does.
    """

    scenario: Scenario

    def __post_init__(self) -> None:
        # The car's own clock belongs to the description: who reads a file or a bag knows it, and so does the simulator.
        check_adversary_model(self.resolved_adversary_model, self.car, model=bool(self.car_model))
        check_kind(self.scenario)
        if self.safe == WALKERS and self.scenario.adversary.kind != load_behaviour(WALKERS).kind:
            kind = self.scenario.adversary.kind
            raise UsageError(
                f"--safe {WALKERS} needs a pedestrian; {self.scenario.name} has a {kind}: give another source"
            )
        clocked = with_control_period(self.scenario, self.car.kind.control_period, self.controller)
        object.__setattr__(self, "scenario", clocked)

    @property
    def runs_others_code(self) -> bool:
        """Whether its episodes run a controller or a simulator that is not SKD's own, which may end its process."""
        return not (self.car.is_own and is_own_world(self.simulator))

    @property
    def limits_deviation(self) -> bool:
        """Whether the maximum distance applies to deviations: it applies to what the objective plans for."""
        return objective_named(self.objective).plans_deviation

    def succeeds(self, log: EpisodeLog) -> bool:
        """Tell whether a kamikaze reached what it planned for: a hit by the moving car, or any collision.

        A kamikaze that plans for the deviation has to be hit; for the paper's kamikazes a collision is enough, as
        published.
        """
        return log.hit if self.limits_deviation else log.outcome == Outcome.COLLISION

    def episode(self, mode: Mode, safe_index: int, trial: int, safe: Trajectory | None) -> EpisodeSpec:
        """Return the specification of one episode against the car under test.

        Args:
            mode: what the adversary does.
            safe_index: number of φ, from 0.
            trial: number within the stage and φ.
            safe: φ; none in safe mode.
        """
        return EpisodeSpec(
            self.scenario,
            mode,
            self.seed,
            episode_id(GROUPS[mode], safe_index, trial),
            safe_trajectory=safe,
            **shared_options(self),
        )

    def trials(self, safe: Sequence[Trajectory], each: int) -> list[EpisodeSpec]:
        """Return the first so many trials on each φ, φ by φ, in kamikaze mode."""
        return [
            self.episode(Mode.KAMIKAZE, index, trial, phi) for index, phi in enumerate(safe) for trial in range(each)
        ]


def runs_along(plan: Plan, safe: Sequence[Trajectory]) -> list[EpisodeSpec]:
    """Return the runs along φ, dealt out evenly over Φ."""
    return [
        plan.episode(Mode.REPLAY, run % len(safe), run // len(safe), safe[run % len(safe)])
        for run in range(plan.collision_runs)
    ]


MANOEUVRES = ("stand", "along", "cross", "along", "stop", "along", "late", "along")
_APPROACH = 1.5  # times κ: the least distance from which the car comes, beyond the trigger of a cautious car
_LONGEST = 40  # ticks: the car has passed, or stands


def probe_scenario(scenario: Scenario) -> Scenario:
    """Return the scenario with a car that starts far enough away to be seen driving freely first."""
    gap = max(scenario.car.start_gap, _APPROACH * scenario.car.safe_distance)
    spread = max(scenario.car.start_gap_range, scenario.car.start_speed * scenario.time_step)
    car = dataclasses.replace(
        scenario.car, meet_safe_trajectory=False, start_gap=min(gap, 500.0), start_gap_range=min(spread, 50.0)
    )
    return dataclasses.replace(scenario, car=car)


def probe_trajectory(scenario: Scenario, manoeuvre: str, rng: np.random.Generator) -> Trajectory:
    """Return what the adversary of one probe does.

    Args:
        scenario: fixed description of the test.
        manoeuvre: what the adversary does, one of `MANOEUVRES`.
        rng: draws start, times and speeds.
    """
    adversary, step = scenario.adversary, scenario.time_step
    ticks = min(scenario.ticks, _LONGEST)
    edge = scenario.path_edge
    near = max(abs(adversary.start_x), edge + 1.0)
    velocity = np.zeros((ticks, 2))
    x, y = -near, adversary.start_y + rng.uniform(0.0, scenario.car.safe_distance)
    pace = adversary.speed * rng.uniform(0.3, 1.0)
    begin = int(rng.integers(0, 1 + int(3.0 / step)))
    if manoeuvre == "stand":
        x = rng.uniform(-near, near) if rng.random() < 0.5 else rng.uniform(-edge, edge)
    elif manoeuvre == "cross":
        velocity[:, 0] = pace
    elif manoeuvre == "stop":
        velocity[: max(1, round((near + rng.uniform(-edge, edge)) / (pace * step))), 0] = pace
    elif manoeuvre == "late":
        x = -rng.uniform(edge, near)
        velocity[begin:, 0] = pace
    elif manoeuvre == "along":
        x = rng.uniform(-near, near) if rng.random() < 0.5 else rng.uniform(-edge, edge)
        velocity[:, 1] = adversary.speed * rng.uniform(0.7, 1.0) if rng.random() < 0.8 else -0.5 * pace
        tick = 10 + begin
        while tick < ticks:  # stops and goes on: what follows slowly shows the noise of its brake best
            rest = int(rng.integers(2, 10))
            velocity[tick : tick + rest] = 0.0
            tick += rest + int(rng.integers(2, 10))
    else:
        raise ValueError(f"no such manoeuvre: {manoeuvre}")
    offsets: FloatArray = np.array([x, y]) + np.vstack([np.zeros(2), np.cumsum(step * velocity, axis=0)])
    offsets[:, 0] *= scenario.end.crossing
    return Trajectory(beside_road(scenario.road.line, offsets), step, f"probe/{manoeuvre}")


def probed(scenario: Scenario, seed: int, number: int) -> Trajectory:
    """Return what the adversary does in the probe with an id.

    Args:
        scenario: the scenario of the probe, as `probe_scenario` returns it.
        seed: seed of every random draw.
        number: number of the probe's episode, which is its id.
    """
    manoeuvre = MANOEUVRES[split_episode_id(number)[2] % len(MANOEUVRES)]
    return probe_trajectory(scenario, manoeuvre, generator(seed, number, Role.PROBE))


def probe_episodes(
    scenario: Scenario, count: int, *, seed: int, controller: str = DEFAULT, multiplier: float = 1.0
) -> list[EpisodeSpec]:
    """Return the episodes of a probe; the same seed gives the same ones for every car.

    Args:
        scenario: the scenario of the assessment for which the model is made.
        count: number of episodes; the manoeuvres take turns.
        seed: seed of every random draw.
        controller: name of the car under test, as in `Plan`.
        multiplier: C of the basic controller.
    """
    clocked = with_control_period(scenario, CarUnderTest(controller).kind.control_period, controller)
    seen = probe_scenario(clocked)
    car: dict[str, Any] = {"controller": controller, "multiplier": multiplier}
    episodes = []
    for index in range(count):
        number = episode_id(EpisodeGroup.PROBE, 0, index)
        trajectory = probed(seen, seed, number)
        episodes.append(EpisodeSpec(seen, Mode.REPLAY, seed, number, trajectory, public=clocked, **car))
    return episodes
