"""Stacks that do not answer message by message: what real time says of them, and lockstep by the clock alone."""

import dataclasses
import os
import shlex
import signal
import sys
import threading
import time
from pathlib import Path

import numpy as np
from common import PATIENCE
from graph_support import HERE, pids_with, whole_graph
from skd_evaluator.assessment.episode_figures import command_age
from skd_evaluator.assessment.from_options import with_requested_period
from skd_evaluator.assessment.options import GraphOptions
from skd_evaluator.assessment.run.episodes import run_episode
from skd_evaluator.bags.read import read_bags
from skd_evaluator.ros.evaluator import Evaluator
from skd_sim import AdversaryState, CarState, EpisodeSpec, Outcome, Scenario
from skd_sim.world.episode import AbortKind, kind_of

STALL = 0.5  # s


class Near:
    """The law of the foreign node `clock` in fake_nodes.py, as a class.

    It decides some control periods late, and perhaps first by where it was at the end of the episode before.
    """

    def __init__(self, late: int, first: float | None) -> None:
        self._late, self._first = late, first

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        self._seen: list[float] = []

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        self._seen.append(car.y)
        where = self._seen[max(0, len(self._seen) - 1 - self._late)]
        if len(self._seen) == 1 and self._first is not None:
            where = self._first
        return -3.0 if where > -9.0 else 0.0


def test_a_car_that_only_follows_the_clock(tmp_path: Path, replay: EpisodeSpec) -> None:
    """It knows nothing of ticks, and yet it drives as its law has it, at most a period late.

    The clock and the states are topics of their own: which of them it hears first is up to its executor.
    """
    node = shlex.join([sys.executable, str(HERE / "fake_nodes.py"), "clock"])
    options = GraphOptions(controller_command=node, quiet_time=10.0, startup_timeout=PATIENCE)
    external = dataclasses.replace(
        replay, controller="external", adversary_model="generic", scenario=with_requested_period(replay.scenario, 0.1)
    )
    wanted = [dataclasses.replace(external, episode_id=external.episode_id + number) for number in range(3)]
    with whole_graph(tmp_path, options) as (evaluator, _):
        logs = list(evaluator.run(wanted))
    last = None
    for episode, log in zip(wanted, logs, strict=True):
        assert log.outcome != Outcome.ABORTED, log.reason
        cars = [Near(late, first) for late in (0, 1) for first in (None, last)]
        laws = [run_episode(dataclasses.replace(episode, controller="basic"), car) for car in cars]
        last = float(log.car[-1, 1])
        assert min(law.car[:, 3].min() for law in laws) < 7.0  # it did brake
        ticks = min(len(one.car) for one in (log, *laws))
        speeds = [one.car[:ticks, 3] for one in (log, *laws)]
        assert np.all(speeds[0] >= np.min(speeds[1:], axis=0) - 0.1)
        assert np.all(speeds[0] <= np.max(speeds[1:], axis=0) + 0.1)
        periods = 3 * (len(log.car) - 1)
        assert periods - 2 <= len(log.timing.ages) <= periods  # fewer where the contact was within a tick


def stall(evaluator: Evaluator, token: str) -> None:
    """Stop the simulator for a moment, once the next episode is under way."""
    last = evaluator._key
    (pid,) = (pid for pid, command in pids_with(token).items() if "vehicle_simulator" in command)
    while evaluator._key == last or len(evaluator._samples.car) < 3:
        time.sleep(0.005)
    os.kill(pid, signal.SIGSTOP)
    time.sleep(STALL)
    os.kill(pid, signal.SIGCONT)


def test_an_episode_in_which_the_simulator_was_late_is_not_the_cars(tmp_path: Path, replay: EpisodeSpec) -> None:
    options = GraphOptions(pacing="real_time", rate_factor=3.0, slip_limit=0.5 * STALL)
    wanted = [dataclasses.replace(replay, episode_id=replay.episode_id + number) for number in range(12)]
    with whole_graph(tmp_path, options, record_to=tmp_path / "bags") as (evaluator, token):
        logs = [evaluator.run_episode(wanted[0])]  # the nodes start, and all may be late
        stalled = threading.Thread(target=stall, args=(evaluator, token), daemon=True)
        stalled.start()
        logs.append(evaluator.run_episode(wanted[1]))
        stalled.join()
        for episode in wanted[2:]:
            logs.append(evaluator.run_episode(episode))
            if logs[-1].outcome != Outcome.ABORTED:
                break  # on a busy machine others may have been late
    slipped, last = logs[1], logs[-1]
    assert slipped.outcome == Outcome.ABORTED
    assert kind_of(slipped.reason) == AbortKind.SLIPPED, slipped.reason
    assert f"(slip_limit {0.5 * STALL:g} s)" in slipped.reason
    assert last.outcome != Outcome.ABORTED, last.reason
    figures = command_age([slipped, last])
    assert figures["control_periods"] == len(last.car) - 1 == len(last.timing.ages)
    period = replay.scenario.time_step / 3.0
    assert min(last.timing.ages) >= 0.5 * period  # commands are used when the period is over
    assert 0.0 < figures["median"] <= figures["p99"] <= figures["worst"]
    assert 0.0 <= figures["greatest_delay"] <= 0.5 * STALL
    assert figures["held"] <= len(last.timing.ages)
    assert read_bags([tmp_path / "bags"]).episodes[-1].log.timing == last.timing
