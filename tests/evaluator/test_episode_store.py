"""Stored episodes: without loss to the last bit, there after any death."""

import dataclasses
import os
import signal
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from skd_evaluator import AssessmentError, Plan
from skd_evaluator.assessment.files import episode_store
from skd_sim import EpisodeLog, EpisodeSpec, Mode, Outcome, Trajectory, UsageError, load_scenario
from skd_sim.options.car_and_adversary import AdversaryModel, Objective
from skd_sim.world.episode import Timing

CROSSING = load_scenario("crossing")
ACROSS = Trajectory(np.array([(-2.0, 0.0), (2.0, 0.0)]), CROSSING.time_step, "across")
PLAN = Plan(CROSSING)
CELL, OTHER = b"c" * 16, b"d" * 16
FLOATS = st.floats(allow_nan=True, allow_infinity=True)


def episode(trial: int) -> EpisodeSpec:
    return PLAN.episode(Mode.KAMIKAZE, 0, trial, ACROSS)


def log_of(one: EpisodeSpec, rows: int = 3) -> EpisodeLog:
    """What happened, different for every episode."""
    draws = np.random.default_rng(one.episode_id)
    return EpisodeLog(
        one, Outcome.COLLISION, draws.normal(size=(rows, 2)), draws.normal(size=(rows, 4)), 0.4, 3.25, clipped=2
    )


def bits(log: EpisodeLog) -> list[bytes | str]:
    values = [getattr(log, one.name) for one in dataclasses.fields(log) if one.name != "episode"]
    return [one.tobytes() if isinstance(one, np.ndarray) else repr(one) for one in values]


@given(
    st.integers(1, 4).flatmap(lambda rows: st.lists(FLOATS, min_size=6 * rows, max_size=6 * rows)),
    st.sampled_from(Outcome),
    st.tuples(FLOATS, FLOATS, FLOATS),
    st.lists(FLOATS, max_size=3),
    st.tuples(*[st.integers(0, 2**40)] * 3),
    st.text(max_size=20),
    st.booleans(),
)
def test_a_record_loses_nothing(numbers, outcome, three, ages, whole, reason, believed):
    states = np.array(numbers).reshape(-1, 6)
    log = EpisodeLog(
        episode(0), outcome, states[:, :2], states[:, 2:], three[0], three[1], whole[0], reason, whole[1],
        Timing(tuple(ages), whole[2], three[2]), states[:, 2:] if believed else None,
    )  # fmt: skip
    read = episode_store.from_bytes(episode_store.to_bytes(log), log.episode)
    assert bits(read) == bits(log)
    assert read.episode is log.episode
    assert isinstance(read.outcome, Outcome)
    assert read.adversary.flags.writeable
    assert read.adversary.dtype == np.float64


def test_whatever_is_specified_is_in_the_digest():
    base = episode(0)
    others = [
        dataclasses.replace(base, **change)
        for change in (
            {"seed": 1}, {"episode_id": 1}, {"mode": Mode.REPLAY}, {"multiplier": 0.5},
            {"controller": "cal", "adversary_model": AdversaryModel.GENERIC},
            {"simulations": 7}, {"objective": Objective.FRECHET}, {"particles": 9}, {"maximum_distance": 2.0},
            {"name": "mine"}, {"car_model": "{}", "adversary_model": AdversaryModel.LEARNED},
            {"simulator": "elsewhere"}, {"steers": True},
            {"safe_trajectory": Trajectory(ACROSS.positions + 1e-15, ACROSS.time_step, "across")},
            {"safe_trajectory": dataclasses.replace(ACROSS, name="along")},
            {"scenario": dataclasses.replace(CROSSING, eta_max=4.0)},
            {"public": dataclasses.replace(CROSSING, eta_max=4.0)},
        )
    ]  # fmt: skip
    found = [episode_store.digest_of_specification(one) for one in (base, *others)]
    assert len(set(found)) == len(found)
    options = {one.name for one in dataclasses.fields(EpisodeSpec)}
    changed = {name for one in others for name in options if getattr(one, name) is not getattr(base, name)}
    assert changed == options
    same = dataclasses.replace(base, scenario=load_scenario("crossing"), safe_trajectory=dataclasses.replace(ACROSS))
    assert episode_store.digest_of_specification(same) == found[0]


def filled(folder: Path, count: int = 40) -> tuple[list[EpisodeSpec], list[bytes]]:
    """Episodes of a store that was closed."""
    store = episode_store.EpisodeStore(folder / episode_store.FILE_NAME)
    episodes = [episode(trial) for trial in range(count)]
    keys = [episode_store.digest_of_specification(one) for one in episodes]
    for key, one in zip(keys, episodes, strict=True):
        store.put(CELL, key, log_of(one))
    store.close()
    return episodes, keys


def read_all(folder: Path, episodes: Sequence[EpisodeSpec], keys: Sequence[bytes]) -> list[int]:
    """Which episodes are there; each is held against what was put."""
    store = episode_store.EpisodeStore(folder / episode_store.FILE_NAME)
    try:
        known = store.known(CELL, keys)
        for key, one in zip(keys, episodes, strict=True):
            if key in known:
                assert bits(store.get(CELL, key, one)) == bits(log_of(one))
        return [number for number, key in enumerate(keys) if key in known]
    finally:
        store.close()


def test_what_is_put_is_there(tmp_path):
    episodes, keys = filled(tmp_path)
    assert read_all(tmp_path, episodes, keys) == list(range(len(episodes)))
    store = episode_store.EpisodeStore(tmp_path / episode_store.FILE_NAME)
    assert store.count() == len(keys)
    assert store.known(OTHER, keys) == set()
    store.keep_only([CELL])
    assert store.count() == len(keys)
    store.drop(CELL)
    assert store.count() == 0
    store.remove()
    assert list(tmp_path.iterdir()) == []


def write_and_be_killed(folder, episodes, keys):
    """Write the episodes in a process that does not end by itself, and so closes nothing."""
    child = os.fork()
    if child == 0:
        store = episode_store.EpisodeStore(folder / episode_store.FILE_NAME)
        for key, one in zip(keys, episodes, strict=True):
            store.put(CELL, key, log_of(one))
        os.kill(os.getpid(), signal.SIGKILL)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL


@pytest.mark.parametrize("share", [1.0, 0.999, 0.5, 0.1])
def test_the_death_of_its_process_takes_nothing_and_a_torn_log_of_writes_the_latest_alone(tmp_path, share):
    """A power cut leaves less of the WAL than was written: then the first episodes are there, and no wrong one is."""
    episodes = [episode(trial) for trial in range(30)]
    keys = [episode_store.digest_of_specification(one) for one in episodes]
    write_and_be_killed(tmp_path, episodes, keys)
    wal = tmp_path / f"{episode_store.FILE_NAME}-wal"
    os.truncate(wal, int(share * wal.stat().st_size))
    found = read_all(tmp_path, episodes, keys)
    assert found == list(range(len(found)))
    assert (len(found) == 30) == (share == 1.0)


def test_two_do_not_share_a_store(tmp_path):
    store = episode_store.EpisodeStore(tmp_path / episode_store.FILE_NAME)
    with pytest.raises(UsageError, match="another process"):
        episode_store.EpisodeStore(tmp_path / episode_store.FILE_NAME)
    store.close()


class Counting:
    """A runner that remembers what it was asked; the third of its episodes is aborted once."""

    def __init__(self) -> None:
        self.asked: list[int] = []

    def run(self, episodes: Sequence[EpisodeSpec]) -> Iterator[EpisodeLog]:
        for one in episodes:
            trial = one.episode_id & 0xFFFF
            again = trial in self.asked
            self.asked.append(trial)
            log = log_of(one)
            if trial == 2 and not again:
                log = dataclasses.replace(log, outcome=Outcome.ABORTED, reason="process ended: it was killed")
            yield log


def test_nothing_is_run_twice_but_what_was_aborted(tmp_path):
    store = episode_store.EpisodeStore(tmp_path / episode_store.FILE_NAME)
    inner = Counting()
    runner = episode_store.StoringRunner(inner, store, CELL, threading.Event())
    episodes = [episode(trial) for trial in range(6)]
    begun = runner.run(episodes[:5])
    first = [next(begun) for _ in range(4)]
    begun.close()
    assert [log.outcome == Outcome.ABORTED for log in first] == [False, False, True, False]
    assert inner.asked == [0, 1, 2, 3]
    logs = list(runner.run(episodes))
    assert inner.asked == [0, 1, 2, 3, 2, 4, 5]
    assert [bits(log) for log in logs] == [bits(log_of(one)) for one in episodes]
    assert all(log.episode is one for log, one in zip(logs, episodes, strict=True))
    assert (runner.given, runner.read) == (10, 3)
    other = episode_store.StoringRunner(inner, store, OTHER, threading.Event())
    assert len(list(other.run(episodes[:1]))) == 1
    assert inner.asked[-1] == 0
    store.close()


def test_a_runner_that_is_to_stop_asks_for_nothing_more(tmp_path):
    store, stop, inner = episode_store.EpisodeStore(tmp_path / episode_store.FILE_NAME), threading.Event(), Counting()
    runner = episode_store.StoringRunner(inner, store, CELL, stop).run([episode(0), episode(1), episode(3)])
    next(runner)
    stop.set()
    with pytest.raises(episode_store.StoppedError):
        next(runner)
    assert inner.asked == [0]
    store.close()
    with pytest.raises(AssessmentError, match="closed"):
        store.count()
