"""Lockstep with a car that decides more often than once a tick."""

from __future__ import annotations

import dataclasses

from hypothesis import given
from hypothesis import strategies as st
from lockstep_bench import ADVERSARY, CAR, CROSSING, START, TIME_STEP, Bench, Message, frame, send, stamp
from skd_sim.ros.lockstep import Action, ControlStep, End, Start
from skd_sim.simulators.simulator import Frame
from skd_sim.world.episode import Outcome
from skd_sim.world.timing import period_stamp

THRICE = dataclasses.replace(CROSSING, control_period=0.1)


def moment(index: int) -> int:
    return period_stamp(START, index // 3, index % 3, 3, TIME_STEP)


@given(order=st.data(), repeats=st.integers(1, 3))
def test_between_ticks_only_the_car_is_waited_for(order: st.DataObject, repeats: int) -> None:
    """In any order of messages, also of an adversary that answers every state: what it says at a tick is held."""
    bench = Bench()
    bench.lockstep.begin(START, THRICE, frame(0), bench.now)
    steps: list[ControlStep] = []
    under_way: list[Message] = []
    end: End | None = None
    while end is None:
        index = len(steps)
        times = repeats if index == 0 else 1
        under_way += [("car", moment(index), (float(index),))] * times
        under_way += [("adversary", moment(index), (float(index), 1.0))] * times
        action: Action | None = None
        while action is None:
            action = send(bench.lockstep, under_way.pop(order.draw(st.integers(0, len(under_way) - 1))))
        assert isinstance(action, ControlStep)
        steps.append(action)
        tick, period = divmod(len(steps), 3)
        outcome = Outcome.ARRIVED if tick == 3 else Outcome.RUNNING
        end = bench.lockstep.advance(Frame(tick, CAR, ADVERSARY, None, outcome, period), bench.now)
    assert steps == [ControlStep(float(index), (float(3 * (index // 3)), 1.0)) for index in range(9)]
    assert end.stamp == stamp(3)


def test_between_ticks_only_the_car_can_be_silent() -> None:
    bench = Bench()
    bench.lockstep.begin(START, THRICE, frame(0), bench.now)
    bench.lockstep.drive(moment(0), 1.0)
    assert bench.lockstep.walk(moment(0), (2.0, 0.0)) == ControlStep(1.0, (2.0, 0.0))
    bench.lockstep.advance(Frame(0, CAR, ADVERSARY, period=1), bench.now)
    assert bench.lockstep.watch(bench.now + 1.0) is None  # no repetition: it has begun
    end = bench.lockstep.watch(bench.now + 2.1)
    assert isinstance(end, End)
    assert end.reason.startswith(
        "no answer: the car controller (ego/acceleration_command) stayed silent for 2 s at tick 0"
    )


def test_real_time_takes_the_adversary_at_ticks_and_the_car_always() -> None:
    bench = Bench(real_time=True)
    lockstep = bench.lockstep
    lockstep.begin(START, THRICE, frame(0), bench.now)
    lockstep.drive(moment(0), 0.0)
    assert lockstep.walk(moment(0), (0.0, 0.0)) == Start()
    taken = []
    for index in range(6):
        lockstep.drive(moment(index), float(index))
        lockstep.walk(moment(index), (float(index), 0.0))
        taken.append(lockstep.go_on())
        tick, period = divmod(index + 1, 3)
        lockstep.advance(Frame(tick, CAR, ADVERSARY, period=period), bench.now)
    assert taken == [ControlStep(float(index), (float(3 * (index // 3)), 0.0)) for index in range(6)]
