"""What a recording waits for when an episode is over: messages that other topics still have on the way."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from skd_evaluator.assessment.plan import EpisodeGroup, episode_id
from skd_evaluator.assessment.run.assembly import EpisodeEnd, EpisodeKey, Samples, aborted
from skd_evaluator.ros.recording import BagRecorder
from skd_msgs.msg import Episode as EpisodeMsg
from skd_sim.ros.commands import message_class
from skd_sim.ros.support import ADVERSARY_ODOMETRY, CLOCK, EGO_ODOMETRY
from skd_sim.scenario.scenario import load_scenario
from skd_sim.world.episode import EpisodeSpec, Mode, Outcome
from skd_sim.world.state import Trajectory
from skd_sim.world.timing import period_stamp, tick_stamp

START, TICKS, PERIODS = 1_000_000_000, 3, 3
DRIVE, WALK = "/cmd_vel", "/adversary/velocity_command"
COMMAND = message_class("geometry_msgs/msg/TwistStamped")


class Names:
    """A node as far as a recorder asks it: for names, and for subscriptions on which nothing comes."""

    def get_name(self) -> str:
        return "names"

    def get_namespace(self) -> str:
        return "/"

    def create_subscription(self, *_: Any, **__: Any) -> None:
        return None


def made(folder: Path, patience: float) -> BagRecorder:
    node = cast(Node, Names())
    return BagRecorder(node, folder, DRIVE, WALK, own_world=False, patience=patience, say=lambda _line: None)


@pytest.mark.parametrize("until", [PERIODS, 2])
def test_the_command_that_ended_the_episode_is_waited_for(tmp_path: Path, until: int) -> None:
    """The simulator had it, or the episode would not be over: after a tick with all its periods, or with a contact."""
    crossing = load_scenario("crossing")
    scenario = dataclasses.replace(crossing, control_period=crossing.time_step / PERIODS)
    step = scenario.time_step
    recorder = made(tmp_path, patience=60.0)
    recorder.begin(EpisodeKey("test", 0, START), tick_stamp(START, scenario.ticks, step))
    moments = [(tick, period) for tick in range(TICKS) for period in range(PERIODS)]
    moments = moments[: len(moments) - PERIODS + until]
    stamps = [period_stamp(START, *moment, PERIODS, step) for moment in moments]
    end = tick_stamp(START, TICKS, step)
    for stamp in (*stamps, end):
        for topic, kind in ((CLOCK, Clock), (EGO_ODOMETRY, Odometry), (ADVERSARY_ODOMETRY, Odometry)):
            recorder.keep(f"/{topic.lstrip('/')}", kind, stamp, b"")
    for tick in range(TICKS):
        recorder.keep(WALK, COMMAND, tick_stamp(START, tick, step), b"")
    for stamp in stamps[:-1]:
        recorder.keep(DRIVE, COMMAND, stamp, b"")
    awaited = [stamps[-1]]

    def listen(_seconds: float) -> None:
        recorder.keep(DRIVE, COMMAND, awaited.pop(), b"")

    recorder.settle(
        EpisodeSpec(scenario, Mode.SAFE, 0, 0), EpisodeEnd(Outcome.ARRIVED, TICKS, math.nan, math.nan, ""), listen
    )
    assert not awaited
    assert [kept.stamp for kept in recorder._messages if kept.topic == DRIVE] == stamps


def test_an_episode_that_is_run_again_has_one_bag(tmp_path: Path) -> None:
    """It had two of one name where the stack was started by hand, and nothing was written."""
    recorder = made(tmp_path, patience=0.0)
    scenario = load_scenario("crossing")
    phi = Trajectory(np.zeros((4, 2)), scenario.time_step)
    episode = EpisodeSpec(scenario, Mode.REPLAY, 0, episode_id(EpisodeGroup.NOMINAL, 0, 1), phi)
    way = dataclasses.replace(episode, episode_id=episode_id(EpisodeGroup.RISK, 0, 1))
    assert recorder.takes(episode)
    assert not recorder.takes(way)
    log = aborted(episode, "no reason")
    recorder.begin(EpisodeKey("test", episode.episode_id, START), START)
    ending = EpisodeEnd(Outcome.ABORTED, 0, math.nan, math.nan, "")
    recorder.write(EpisodeMsg(), log, Samples(), ending, START, unsaid=False)
    assert len(list(tmp_path.iterdir())) == 1
    assert not recorder.takes(episode)
