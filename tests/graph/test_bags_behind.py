"""Bags that a process of their own writes: the same files, whatever becomes of it."""

from __future__ import annotations

import dataclasses
import os
import signal
from pathlib import Path

import pytest
from bag_tools import read_items
from common import wait_until
from rclpy.serialization import deserialize_message, serialize_message
from skd_evaluator.bags.writer import RecordedMessage
from skd_evaluator.ros.recording import bags_behind
from skd_evaluator.ros.recording.bags_behind import BagsBehind
from skd_evaluator.ros.recording.recording import Recording, write_recording
from skd_msgs.msg import Episode as EpisodeMsg
from skd_sim.episode.episode import EpisodeLog
from skd_sim.messages.command_messages import message_class
from skd_sim.messages.to_messages import episode_to_message
from skd_sim.nodes import support

START = 1_000_000_000


def recording(folder: Path, log: EpisodeLog, number: int) -> Recording:
    """A recording of an episode under a number of its own, with nothing but what the evaluator itself says."""
    episode = dataclasses.replace(log.episode, episode_id=log.episode.episode_id + number)
    data = bytes(serialize_message(episode_to_message(episode, "test", START)))
    latched = [RecordedMessage("/skd/episode", EpisodeMsg, START, data, latched=True)]
    names = {topic: f"/{topic}" for topic in (support.MARKERS, support.CLEARANCE, support.DEFORMATION)}
    shown = (names, log.adversary, log.car, log.outcome, log.impact_time)
    return Recording(folder / f"{number}", data, START, *shown, latched, [])


def contents(bag: Path) -> tuple[str, list[str]]:
    """All that a bag holds, its messages as objects: their bytes have gaps, in which anything may be."""
    messages = [
        f"{item.topic} {item.log_time} {deserialize_message(item.data, message_class(item.type_name))}"
        for item in read_items(bag.glob("*.mcap"))
    ]
    assert {path.name for path in bag.iterdir()} == {"metadata.yaml", f"{bag.name}.mcap"}
    return (bag / "metadata.yaml").read_text(), messages


@pytest.mark.parametrize("ends_by", [None, signal.SIGKILL, signal.SIGSTOP])
def test_every_bag_is_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, expected: EpisodeLog, ends_by: signal.Signals | None
) -> None:
    """Whether the process lives, is killed or stopped: each bag is as if it had been written at once."""
    monkeypatch.setattr(bags_behind, "_FROM", 2)
    monkeypatch.setattr(bags_behind, "_PATIENCE", 1.0 if ends_by == signal.SIGSTOP else 300.0)
    bags, count = BagsBehind(), 0

    def write() -> bool:
        nonlocal count
        bags.write(recording(tmp_path / "behind", expected, count))
        count += 1
        return bags._ready

    write()
    wait_until(write, "the process")
    process = bags._popen
    assert process is not None
    for number in range(30):
        if number == 10 and ends_by is not None:
            os.kill(process.pid, ends_by)
        write()
    bags.finish()
    assert (bags._popen, process.returncode) == (None, -signal.SIGKILL)
    for number in range(count):
        write_recording(recording(tmp_path / "here", expected, number))
        assert contents(tmp_path / "behind" / f"{number}") == contents(tmp_path / "here" / f"{number}")
    assert {path.name for path in (tmp_path / "behind").iterdir()} == {str(number) for number in range(count)}


def test_a_bag_that_cannot_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, expected: EpisodeLog) -> None:
    """It is an error of whoever wanted it, with the file's name, if later."""
    monkeypatch.setattr(bags_behind, "_FROM", 1)
    bags, number = BagsBehind(), 0
    while not bags._ready:
        bags.write(recording(tmp_path / "bags", expected, number))
        number += 1
    (tmp_path / "bags" / f"{number}" / "full").mkdir(parents=True)

    def write_it() -> None:
        bags.write(recording(tmp_path / "bags", expected, number))
        bags.finish()

    with pytest.raises(OSError, match="Directory not empty") as error:
        write_it()
    assert error.value.filename2 == str(tmp_path / "bags" / f"{number}")
    bags.close()
