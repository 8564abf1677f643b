"""Recordings that are right although SKD's own world in lockstep did not make them."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest
from bag_forge import ADVERSARY, CAR, EPISODE, RESULT, Sent, campaign_messages, forged
from mcap.writer import CompressionType
from recordings_support import crossing
from skd_adversary.adversary import make_adversary
from skd_evaluator import Plan, run_episode
from skd_sim.controllers.controller import make_controller
from skd_sim.scenario.road import HEADING_NORTH
from skd_sim.scenario.scenario import Scenario, load_scenario
from skd_sim.simulators.simulator import FramedSimulator
from skd_sim.world.dynamics.basic import CommandLimits
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Mode, Outcome, Timing
from skd_sim.world.state import AdversaryState, CarState, RoadUserState

Write = Callable[..., Path]
Replay = Callable[..., Any]

FRAME = 0.05


class Rolling:
    """Frames of a car that starts somewhat off; its brake takes half a second to build up, and rolling costs speed."""

    frame_step = FRAME
    limits = CommandLimits(-20.0, 20.0)

    def __init__(self, off: float) -> None:
        self._off = off

    def prepare(self, scenario: Scenario) -> None:
        """It needs to know nothing of the scenario."""

    def show(self, others: Sequence[RoadUserState]) -> None:
        assert not others

    def place(self, car: CarState, adversary: AdversaryState) -> tuple[CarState, AdversaryState]:
        self._braking = 0.0
        self._car = car._replace(x=0.3 * self._off, y=car.y + self._off)
        self._adversary = adversary._replace(x=adversary.x + 0.2 * self._off)
        return self._car, self._adversary

    def control(self, acceleration: float, steering: float, velocity: tuple[float, float]) -> None:
        self._commands = acceleration, velocity

    def advance(self) -> tuple[CarState, AdversaryState]:
        command, velocity = self._commands
        car, adversary = self._car, self._adversary
        self._braking += max(-0.5, min(0.5, command - self._braking))
        speed = max(0.0, car.speed + FRAME * (self._braking - 0.1))
        self._car = CarState(car.x, car.y + 0.5 * FRAME * (car.speed + speed), HEADING_NORTH, speed)
        x, y = adversary.x + FRAME * velocity[0], adversary.y + FRAME * velocity[1]
        self._adversary = AdversaryState(x, y, *velocity)
        return self._car, self._adversary


def framed(episode: EpisodeSpec, off: float) -> EpisodeLog:
    """An episode in a simulator with frames of 50 ms, as `carla_bridge` counts them."""
    return run_episode(episode, simulator=FramedSimulator(Rolling(off)))


@pytest.fixture(scope="module")
def foreign() -> list[EpisodeLog]:
    plan = Plan(load_scenario("crossing"), multiplier=0.75, simulations=60, seed=3)
    safe = crossing(0.75, 10, "brisk")
    specs = [plan.episode(Mode.KAMIKAZE, 0, trial, safe) for trial in range(12)]
    specs += [plan.episode(Mode.REPLAY, 0, trial, safe) for trial in range(12)]
    logs = [framed(spec, 0.05 + 0.02 * number) for number, spec in enumerate(specs)]
    assert {log.outcome for log in logs} >= {Outcome.COLLISION, Outcome.ARRIVED}
    return logs


def test_another_simulator_counts_and_is_named(foreign: list[EpisodeLog], recorded: Write, replay: Replay) -> None:
    done = replay(recorded(campaign_messages(foreign)))
    assert done.code == 0, done.err
    assert done.result["left_out"] == []
    (line,) = done.result["warnings"]
    assert "24 episodes did not run in SKD's own world" in line
    kamikazes = [log for log in foreign if log.episode.mode == Mode.KAMIKAZE]
    assert done.result["pairs"] == sum(log.outcome == Outcome.COLLISION for log in kamikazes)


@pytest.mark.parametrize(
    ("topic", "field", "value"),
    [
        (RESULT, "impact_time", 0.1),
        (RESULT, "impact_speed", 30.0),
        (RESULT, "outcome", 2),
        (CAR, "pose.pose.position.y", 40.0),
        (CAR, "twist.twist.linear.x", -20.0),
        (ADVERSARY, "pose.pose.position.x", -60.0),
    ],
)
def test_what_no_simulator_gives_is_refused(foreign, recorded, refused, topic, field, value):
    hit = next(number for number, log in enumerate(foreign) if log.outcome == Outcome.COLLISION)
    episodes = campaign_messages(foreign)
    place = [number for number, one in enumerate(episodes[hit]) if one.topic == topic][-1]
    episodes[hit] = forged(episodes[hit], place, field, value)
    assert f"episode {foreign[hit].episode.episode_id}" in refused(recorded(episodes))


class _Late:
    """A controller whose commands arrive a tick late, as they may in real time."""

    def __init__(self, multiplier: float) -> None:
        self._inner = make_controller("basic", multiplier)
        self._last = 0.0

    def reset(self, scenario: Any, rng: np.random.Generator) -> None:
        self._inner.reset(scenario, rng)

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        now, self._last = self._last, self._inner.command(car, adversary)
        return now


class _Held:
    """An adversary whose commands arrive a tick late."""

    depletions = 0

    def __init__(self, episode: EpisodeSpec) -> None:
        self._inner = make_adversary(episode)
        self._last: tuple[float, float] | None = None

    def act(self, car: CarState) -> tuple[float, float]:
        now, self._last = self._last, self._inner.act(car)
        return now or self._last


def test_commands_that_come_late_count(logs: list[EpisodeLog], recorded: Write, replay: Replay) -> None:
    late = [
        replace(run_episode(log.episode, _Late(log.episode.multiplier), _Held(log.episode)), timing=Timing(delay=0.1))
        for log in logs
    ]
    done = replay(recorded(campaign_messages(late)))
    assert done.code == 0, done.err
    assert done.result["left_out"] == []
    assert not [line for line in done.result["warnings"] if "own world" in line]


def test_states_of_another_topic_are_not_mixed_in(sent: list[list[Sent]], recorded: Write, replay: Replay) -> None:
    """carla_ros_bridge publishes /carla/ego/odometry for a car with the role name `ego`."""
    right = replay(recorded(sent))
    cars = [message for one in sent for message in one if message.topic == CAR]
    moved = [forged([message], 0, "pose.pose.position.y", 7.0)[0] for message in cars]
    extra = [replace(message, topic=f"/carla{message.topic}") for message in moved]
    done = replay(recorded([*sent, extra]))
    assert done.err == ""
    assert done.episodes == right.episodes


def test_neither_order_nor_compression_nor_what_is_said_again_matters(sent, recorded, replay):
    mixed = [one for episode in sent for one in episode]
    mixed += [one for one in mixed if one.topic == EPISODE]
    Random(0).shuffle(mixed)
    done = replay(recorded([mixed], "mixed", compression=CompressionType.ZSTD, chunk_size=4096))
    plain = replay(recorded(sent))
    assert (done.code, done.episodes) == (0, plain.episodes)
    assert done.result["warnings"] == plain.result["warnings"] == []
