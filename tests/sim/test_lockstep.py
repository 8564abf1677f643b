"""The rules of lockstep: what drives a tick, what ends an episode and why."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from lockstep_bench import LIMITS, START, Bench, Message, send, stamp
from skd_sim.ros.lockstep import Action, ControlStep, End, Repeat
from skd_sim.world.episode import AbortKind, Outcome, kind_of
from skd_sim.world.world import Contact


@pytest.fixture
def bench() -> Bench:
    made = Bench()
    assert made.begin() is None
    return made


# --- any order


def answers(tick: int, repeats: tuple[int, int]) -> list[Message]:
    """Both answers to a tick; those to tick 0 as often as it was repeated for each."""
    car: Message = ("car", stamp(tick), (0.5 * tick - 2.0,))
    adversary: Message = ("adversary", stamp(tick), (0.1 * tick, 1.0))
    return [car] * (repeats[0] if tick == 0 else 1) + [adversary] * (repeats[1] if tick == 0 else 1)


def strays(tick: int) -> list[Message]:
    """What is for no tick of the episode that has begun: of the one before, and of times to come."""
    ahead = stamp(tick + 3) + 1
    return [
        ("car", START - 1, (9.0,)),
        ("adversary", 0, (9.0, 9.0)),
        ("car", ahead, (9.0,)),
        ("adversary", ahead, (9.0, 9.0)),
    ]


@given(order=st.data(), ticks=st.integers(1, 6), repeats=st.tuples(st.integers(1, 3), st.integers(1, 3)))
def test_messages_in_any_order_give_the_same_episode(order, ticks, repeats):
    """However answers, their repetitions and strays overtake each other: one step a tick, with its own two commands."""
    bench = Bench()
    bench.begin()
    under_way = answers(0, repeats) + strays(0)
    steps: list[ControlStep] = []
    end: End | None = None
    while end is None:
        place = order.draw(st.integers(0, len(under_way) - 1))
        action = send(bench.lockstep, under_way.pop(place))
        if isinstance(action, ControlStep):
            steps.append(action)
            tick = len(steps)
            end = bench.advance(tick, Outcome.ARRIVED if tick == ticks else Outcome.RUNNING)
            under_way += answers(tick, repeats) + strays(tick)
        else:
            assert action is None
    assert steps == [ControlStep(0.5 * tick - 2.0, (0.1 * tick, 1.0)) for tick in range(ticks)]
    assert (end.outcome, end.frame.tick, end.stamp, end.reason) == (Outcome.ARRIVED, ticks, stamp(ticks), "")
    assert all(send(bench.lockstep, late) is None for late in under_way)


@given(
    order=st.data(),
    tick=st.integers(0, 4),
    who=st.sampled_from(["car", "adversary"]),
    same=st.booleans(),
)
def test_two_answers_to_a_tick_abort_in_any_order(order: st.DataObject, tick: int, who: str, same: bool) -> None:
    """Another answer, or from tick 1 on the same once more, ends the episode, whenever it comes."""
    if tick == 0 and same:
        return  # allowed: tick 0 is repeated
    bench = Bench()
    bench.begin()
    bench.go_to(tick)
    under_way = answers(tick, (1, 1))
    first = next(message for message in under_way if message[0] == who)
    under_way.append(first if same else (who, first[1], (*first[2][:-1], 7.0)))
    end: Action | None = None
    while under_way and not isinstance(end, End):
        end = send(bench.lockstep, under_way.pop(order.draw(st.integers(0, len(under_way) - 1))))
        if isinstance(end, ControlStep):
            assert bench.advance(tick + 1) is None
    assert isinstance(end, End)
    assert end.outcome == Outcome.ABORTED
    assert kind_of(end.reason) == AbortKind.SECOND_SENDER
    assert ("the car controller" if who == "car" else "the adversary") in end.reason
    assert f"answered the tick at {0.3 * tick:.3f} s of the episode twice" in end.reason
    assert ("with the same command" if same else "with different commands") in end.reason


# --- what no command may be


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("tick", [0, 2])
def test_what_is_not_finite_ends_it(bench: Bench, bad: float, tick: int) -> None:
    bench.go_to(tick)
    end = bench.lockstep.drive(stamp(tick), bad)
    assert isinstance(end, End)
    assert (end.outcome, end.frame.tick) == (Outcome.ABORTED, tick)
    assert end.reason == f"not a finite number: the car controller commanded {bad}"


def test_a_command_without_a_stamp_is_for_now(bench: Bench) -> None:
    """A type of message that has none; that it comes twice cannot be told from two ticks."""
    for tick in range(3):
        assert bench.lockstep.drive(None, 4.0) is None
        assert bench.lockstep.drive(None, 5.0) is None
        assert bench.lockstep.walk(stamp(tick), (1.0, 0.0)) == ControlStep(5.0, (1.0, 0.0))
        assert bench.advance(tick + 1) is None


# --- silence


@pytest.mark.parametrize(("tick", "limit"), [(0, LIMITS.startup), (1, LIMITS.command), (3, LIMITS.command)])
def test_silence_ends_it_after_its_limit_and_is_named(bench: Bench, tick: int, limit: float) -> None:
    bench.go_to(tick)
    bench.lockstep.drive(stamp(tick), 1.0)
    assert not isinstance(bench.lockstep.watch(bench.now + limit), End)
    end = bench.lockstep.watch(bench.now + limit + 0.01)
    assert isinstance(end, End)
    silent = f"stayed silent for {limit:g} s at tick {tick}"
    assert end.reason.startswith(f"no answer: the adversary (adversary/velocity_command) {silent}")
    known = {0: f"at tick {tick}", 1: "it hangs, or is too slow for -p command_timeout:=", 3: "before, and hangs"}[tick]
    assert known in end.reason  # by what it has answered before
    assert end.stamp == stamp(tick)
    assert bench.lockstep.watch(bench.now + 1e6) is None


def test_a_late_answer_to_the_episode_before_is_no_wrong_stamp(bench: Bench) -> None:
    """Of a node that hangs in its answer, which comes when the next episode has begun."""
    bench.go_to(1)
    bench.lockstep.stop()
    later = START + 30 * 10**9
    bench.begin(later)
    bench.lockstep.drive(stamp(1), 1.0)
    bench.lockstep.walk(later, (1.0, 0.0))
    end = bench.lockstep.watch(bench.now + LIMITS.startup + 0.01)
    assert isinstance(end, End)
    assert end.reason.startswith("no answer: the car controller")


def test_tick_0_is_repeated_and_no_other(bench: Bench) -> None:
    assert bench.lockstep.watch(bench.now + 0.1) is None
    assert bench.lockstep.watch(bench.now + 0.21) == Repeat()
    assert bench.lockstep.watch(bench.now + 0.3) is None
    assert bench.lockstep.watch(bench.now + 0.42) == Repeat()
    bench.go_to(1)
    assert bench.lockstep.watch(bench.now + 1.0) is None


# --- crowds


def test_two_nodes_of_one_kind_are_refused_whether_they_speak_or_not(bench: Bench) -> None:
    bench.cars.alive = ["/one", "/two"]
    end = bench.lockstep.watch(bench.now)
    assert isinstance(end, End)
    assert end.reason == "second sender: 2 publish"


@pytest.mark.parametrize("when", ["begin", "end"])
def test_a_crowd_is_seen_at_begin_and_end(when: str) -> None:
    bench = Bench()
    if when == "end":
        bench.begin()
    bench.adversaries.alive = ["/a", "/b"]
    end = bench.begin() if when == "begin" else bench.advance(1, Outcome.COLLISION, Contact(0.5, 8.0))
    assert isinstance(end, End)
    assert end.outcome == Outcome.ABORTED
    assert kind_of(end.reason) == AbortKind.SECOND_SENDER


# --- ends


def test_an_episode_knows_nothing_of_the_last(bench: Bench) -> None:
    """Neither its commands, nor what was answered, nor what was ignored."""
    bench.lockstep.drive(stamp(0), 1.0)
    bench.lockstep.walk(stamp(7), (1.0, 0.0))
    bench.begin()
    assert bench.lockstep.walk(stamp(0), (1.0, 0.0)) is None
    end = bench.lockstep.watch(bench.now + 10.1)
    assert isinstance(end, End)
    assert end.reason.startswith("no answer: the car controller")
    bench.begin()
    assert bench.lockstep.drive(stamp(0), 3.0) is None
    assert bench.lockstep.walk(stamp(0), (0.0, 1.0)) == ControlStep(3.0, (0.0, 1.0))


# --- how old commands are


def test_ages_are_those_of_the_commands_that_were_used(bench: Bench) -> None:
    """In lockstep: how long the car took to answer, whatever else was waited for."""
    now = bench.now
    bench.lockstep.drive(stamp(0), 1.0, now=now + 0.25)
    bench.lockstep.walk(stamp(0), (2.0, 0.0), now=now + 3.0)
    bench.now += 3.0
    bench.advance(1)
    bench.lockstep.drive(stamp(0) + 7, 1.0, now=now + 3.5)  # for no tick
    bench.lockstep.walk(stamp(1), (2.0, 0.0), now=now + 3.1)
    bench.lockstep.drive(stamp(1), 1.0, now=now + 4.0)
    assert bench.lockstep.ages.ages == pytest.approx([0.25, 1.0])
