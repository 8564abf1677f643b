"""The rules of lockstep: what drives a tick, what ends an episode and why; without ROS and without waiting."""

import dataclasses
import math
from dataclasses import dataclass, field
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from skd_sim import AdversaryState, CarState, Frame, Outcome, load_scenario
from skd_sim.ros import lockstep as rules
from skd_sim.world.episode import AbortKind, kind_of, period_stamp, tick_stamp
from skd_sim.world.world import Contact

CROSSING = load_scenario("crossing")
START, TIME_STEP = 5_000_000_000, CROSSING.time_step
LIMITS = rules.WaitLimits(command=2.0, startup=10.0)
CAR, ADVERSARY = CarState(0.0, -15.0, math.pi / 2, 8.0), AdversaryState(-3.5, 0.0, 0.0, 0.0)


@dataclass
class Few(rules.Senders):
    """Senders as a middleware might see them."""

    alive: list[str] = field(default_factory=lambda: ["/one"])

    def count(self) -> int:
        return len(self.alive)

    def crowd(self) -> str | None:
        return f"{len(self.alive)} publish" if len(self.alive) > 1 else None

    def diagnosis(self) -> str:
        return "nobody publishes"


class Bench:
    """A lockstep that has begun, with its senders and a simulator that only counts."""

    def __init__(self, *, real_time: bool = False, quiet_time: float = 0.0) -> None:
        self.cars, self.adversaries = Few(), Few()
        self.car = rules.CommandSource("the car controller", "ego/acceleration_command", self.cars)
        self.adversary = rules.CommandSource("the adversary", "adversary/velocity_command", self.adversaries)
        self.lockstep = rules.Lockstep(self.car, self.adversary, LIMITS, real_time=real_time, quiet_time=quiet_time)
        self.now = 100.0
        assert self.begin() is None

    def begin(self, start: int = START) -> rules.End | None:
        return self.lockstep.begin(start, CROSSING, frame(0), self.now)

    def advance(self, tick: int, *how: Any) -> rules.End | None:
        return self.lockstep.advance(frame(tick, *how), self.now)

    def go_to(self, tick: int) -> None:
        for before in range(tick):
            assert self.lockstep.drive(stamp(before), 1.0) is None
            assert isinstance(self.lockstep.walk(stamp(before), (2.0, 0.0)), rules.ControlStep)
            assert self.advance(before + 1) is None


def frame(tick: int, outcome: Outcome = Outcome.RUNNING, contact: Contact | None = None) -> Frame:
    return Frame(tick, CAR, ADVERSARY, contact, outcome)


def stamp(tick: int) -> int:
    return tick_stamp(START, tick, TIME_STEP)


Message = tuple[str, int, tuple[float, ...]]


def send(lockstep: rules.Lockstep, message: Message) -> rules.Action | None:
    who, at, command = message
    return lockstep.drive(at, command[0]) if who == "car" else lockstep.walk(at, (command[0], command[1]))


@pytest.fixture
def bench() -> Bench:
    return Bench()


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
    under_way = answers(0, repeats) + strays(0)
    steps: list[rules.ControlStep] = []
    end: rules.End | None = None
    while end is None:
        place = order.draw(st.integers(0, len(under_way) - 1))
        action = send(bench.lockstep, under_way.pop(place))
        if isinstance(action, rules.ControlStep):
            steps.append(action)
            tick = len(steps)
            end = bench.advance(tick, Outcome.ARRIVED if tick == ticks else Outcome.RUNNING)
            under_way += answers(tick, repeats) + strays(tick)
        else:
            assert action is None
    assert steps == [rules.ControlStep(0.5 * tick - 2.0, (0.1 * tick, 1.0)) for tick in range(ticks)]
    assert (end.outcome, end.frame.tick, end.stamp, end.reason) == (Outcome.ARRIVED, ticks, stamp(ticks), "")
    assert all(send(bench.lockstep, late) is None for late in under_way)


@given(order=st.data(), tick=st.integers(0, 4), who=st.sampled_from(["car", "adversary"]), same=st.booleans())
def test_two_answers_to_a_tick_abort_in_any_order(order: st.DataObject, tick: int, who: str, same: bool) -> None:
    """Another answer, or from tick 1 on the same once more, ends the episode, whenever it comes."""
    if tick == 0 and same:
        return  # allowed: tick 0 is repeated
    bench = Bench()
    bench.go_to(tick)
    under_way = answers(tick, (1, 1))
    first = next(message for message in under_way if message[0] == who)
    under_way.append(first if same else (who, first[1], (*first[2][:-1], 7.0)))
    end: rules.Action | None = None
    while under_way and not isinstance(end, rules.End):
        end = send(bench.lockstep, under_way.pop(order.draw(st.integers(0, len(under_way) - 1))))
        if isinstance(end, rules.ControlStep):
            assert bench.advance(tick + 1) is None
    assert end.outcome == Outcome.ABORTED
    assert kind_of(end.reason) == AbortKind.ANSWERED_TWICE
    assert ("the car controller" if who == "car" else "the adversary") in end.reason
    given = "the same command" if same else "different commands"
    assert f"gave {given} at {0.3 * tick:.3f} s of the episode. Publish once per stamp: wait" in end.reason


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("tick", [0, 2])
def test_what_is_not_finite_ends_it(bench: Bench, bad: float, tick: int) -> None:
    bench.go_to(tick)
    end = bench.lockstep.drive(stamp(tick), bad)
    assert (end.outcome, end.frame.tick) == (Outcome.ABORTED, tick)
    assert end.reason == f"not a finite number: the car controller commanded {bad}"


def test_a_command_without_a_stamp_is_for_now(bench: Bench) -> None:
    """A type of message that has none; that it comes twice cannot be told from two ticks."""
    for tick in range(3):
        assert bench.lockstep.drive(None, 4.0) is None
        assert bench.lockstep.drive(None, 5.0) is None
        assert bench.lockstep.walk(stamp(tick), (1.0, 0.0)) == rules.ControlStep(5.0, (1.0, 0.0))
        assert bench.advance(tick + 1) is None


@pytest.mark.parametrize(("tick", "limit"), [(0, LIMITS.startup), (1, LIMITS.command), (3, LIMITS.command)])
def test_silence_ends_it_after_its_limit_and_is_named(bench: Bench, tick: int, limit: float) -> None:
    bench.go_to(tick)
    bench.lockstep.drive(stamp(tick), 1.0)
    assert not isinstance(bench.lockstep.watch(bench.now + limit), rules.End)
    end = bench.lockstep.watch(bench.now + limit + 0.01)
    silent = f"stayed silent for {limit:g} s at tick {tick}"
    assert end.reason.startswith(f"no answer: the adversary (adversary/velocity_command) {silent}")
    known = {0: ". nobody publishes", 1: "it hangs, or is too slow for -p command", 3: "before, and hangs"}[tick]
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
    assert end.reason.startswith("no answer: the car controller")


def test_tick_0_is_repeated_and_no_other(bench: Bench) -> None:
    assert bench.lockstep.watch(bench.now + 0.1) is None
    assert bench.lockstep.watch(bench.now + 0.21) == rules.Repeat()
    assert bench.lockstep.watch(bench.now + 0.3) is None
    assert bench.lockstep.watch(bench.now + 0.42) == rules.Repeat()
    bench.go_to(1)
    assert bench.lockstep.watch(bench.now + 1.0) is None


def test_two_nodes_of_one_kind_are_refused_whether_they_speak_or_not(bench: Bench) -> None:
    bench.cars.alive = ["/one", "/two"]
    end = bench.lockstep.watch(bench.now)
    assert end.reason == "second sender: 2 publish"


def test_an_episode_knows_nothing_of_the_last(bench: Bench) -> None:
    """Neither its commands, nor what was answered, nor what was ignored."""
    bench.lockstep.drive(stamp(0), 1.0)
    bench.lockstep.walk(stamp(7), (1.0, 0.0))
    bench.begin()
    assert bench.lockstep.walk(stamp(0), (1.0, 0.0)) is None
    end = bench.lockstep.watch(bench.now + 10.1)
    assert end.reason.startswith("no answer: the car controller")
    bench.begin()
    assert bench.lockstep.drive(stamp(0), 3.0) is None
    assert bench.lockstep.walk(stamp(0), (0.0, 1.0)) == rules.ControlStep(3.0, (0.0, 1.0))


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


THRICE = dataclasses.replace(CROSSING, control_period=0.1)


def moment(index: int) -> int:
    return period_stamp(START, index // 3, index % 3, 3, TIME_STEP)


@given(order=st.data(), repeats=st.integers(1, 3))
def test_between_ticks_only_the_car_is_waited_for(order: st.DataObject, repeats: int) -> None:
    """In any order of messages, also of an adversary that answers every state: what it says at a tick is held."""
    bench = Bench()
    bench.lockstep.begin(START, THRICE, frame(0), bench.now)
    steps: list[rules.ControlStep] = []
    under_way: list[Message] = []
    end: rules.End | None = None
    while end is None:
        index = len(steps)
        times = repeats if index == 0 else 1
        under_way += [("car", moment(index), (float(index),))] * times
        under_way += [("adversary", moment(index), (float(index), 1.0))] * times
        action: rules.Action | None = None
        while action is None:
            action = send(bench.lockstep, under_way.pop(order.draw(st.integers(0, len(under_way) - 1))))
        steps.append(action)
        tick, period = divmod(len(steps), 3)
        outcome = Outcome.ARRIVED if tick == 3 else Outcome.RUNNING
        end = bench.lockstep.advance(Frame(tick, CAR, ADVERSARY, None, outcome, period), bench.now)
    assert steps == [rules.ControlStep(float(index), (float(3 * (index // 3)), 1.0)) for index in range(9)]
    assert end.stamp == stamp(3)


def test_between_ticks_only_the_car_can_be_silent() -> None:
    bench = Bench()
    bench.lockstep.begin(START, THRICE, frame(0), bench.now)
    bench.lockstep.drive(moment(0), 1.0)
    assert bench.lockstep.walk(moment(0), (2.0, 0.0)) == rules.ControlStep(1.0, (2.0, 0.0))
    bench.lockstep.advance(Frame(0, CAR, ADVERSARY, period=1), bench.now)
    assert bench.lockstep.watch(bench.now + 1.0) is None  # no repetition: it has begun
    end = bench.lockstep.watch(bench.now + 2.1)
    silent = "stayed silent for 2 s at tick 0"
    assert end.reason.startswith(f"no answer: the car controller (ego/acceleration_command) {silent}")


def test_real_time_takes_the_adversary_at_ticks_and_the_car_always() -> None:
    bench = Bench(real_time=True)
    lockstep = bench.lockstep
    lockstep.begin(START, THRICE, frame(0), bench.now)
    lockstep.drive(moment(0), 0.0)
    assert lockstep.walk(moment(0), (0.0, 0.0)) == rules.Start()
    taken = []
    for index in range(6):
        lockstep.drive(moment(index), float(index))
        lockstep.walk(moment(index), (float(index), 0.0))
        taken.append(lockstep.go_on())
        tick, period = divmod(index + 1, 3)
        lockstep.advance(Frame(tick, CAR, ADVERSARY, period=period), bench.now)
    assert taken == [rules.ControlStep(float(index), (float(3 * (index // 3)), 0.0)) for index in range(6)]


QUIET = 0.02


@pytest.fixture
def quiet() -> Bench:
    return Bench(quiet_time=QUIET)


def test_with_a_quiet_time_a_period_is_over_when_the_car_has_spoken(quiet: Bench) -> None:
    now = quiet.now + 1.0
    assert quiet.lockstep.drive(stamp(0), 1.0, now=now) is None
    assert quiet.lockstep.drive(stamp(0), 2.0, now=now) is None  # the last word counts, and no second one is a fault
    assert quiet.lockstep.walk(stamp(0), (2.0, 0.0), now=now) == rules.ControlStep(2.0, (2.0, 0.0))
    assert quiet.advance(1) is None
    assert quiet.lockstep.walk(stamp(1), (2.0, 1.0), now=now) is None
    assert quiet.lockstep.drive(stamp(0), 3.0, now=now) is None  # too late for tick 0, and no answer to tick 1 …
    assert quiet.lockstep.quiet(now) == rules.ControlStep(3.0, (2.0, 1.0))  # … but the newest word when it is over
    assert quiet.advance(2) is None
    assert quiet.lockstep.drive(None, 4.0, now=now) is None
    assert quiet.lockstep.walk(stamp(2), (0.0, 1.0), now=now) == rules.ControlStep(4.0, (0.0, 1.0))
    assert quiet.lockstep.ages.held == 0


def test_when_the_quiet_time_is_over_the_last_command_is_held(quiet: Bench) -> None:
    now = quiet.now + 1.0
    assert quiet.lockstep.quiet(now) is None  # nothing to hold yet
    assert quiet.lockstep.drive(stamp(0), 1.0, now=now) is None
    assert isinstance(quiet.lockstep.walk(stamp(0), (2.0, 0.0), now=now), rules.ControlStep)
    assert quiet.advance(1) is None
    assert quiet.lockstep.quiet(now) is None  # the adversary is waited for, as ever
    assert quiet.lockstep.walk(stamp(1), (2.0, 1.0), now=now) == rules.ControlStep(1.0, (2.0, 1.0))
    assert quiet.advance(2) is None
    assert quiet.lockstep.walk(stamp(2), (2.0, 2.0), now=now) is None
    assert quiet.lockstep.quiet(now) == rules.ControlStep(1.0, (2.0, 2.0))
    assert quiet.lockstep.ages.held == 2


def test_commands_of_the_last_episode_do_not_drive_this_one(quiet: Bench) -> None:
    soon, later = quiet.now + 0.5 * QUIET, quiet.now + 2.0 * QUIET
    assert quiet.lockstep.walk(stamp(0), (2.0, 0.0), now=soon) is None
    assert quiet.lockstep.drive(START - rules.LEAD - 1, 9.0, now=later) is None
    assert quiet.lockstep.drive(None, 9.0, now=soon) is None  # it may have been under way
    assert quiet.lockstep.drive(0, 8.0, now=soon) is None  # as is one whose stamp says nothing
    assert quiet.lockstep.drive(START - rules.LEAD, 1.0, now=later) is None
    assert quiet.lockstep.quiet(later) == rules.ControlStep(1.0, (2.0, 0.0))


def test_a_second_answer_to_tick_0_without_a_stamp_does_not_answer_tick_1(quiet: Bench) -> None:
    quiet.now += 0.3
    assert quiet.lockstep.watch(quiet.now) == rules.Repeat()
    assert quiet.lockstep.walk(stamp(0), (2.0, 0.0)) is None
    assert quiet.lockstep.drive(None, 9.0, now=quiet.now) is None
    assert quiet.lockstep.watch(quiet.now + 0.3) is None  # another repetition would be answered late
    assert quiet.lockstep.drive(None, 1.0, now=quiet.now) is None
    assert quiet.lockstep.quiet(quiet.now) == rules.ControlStep(1.0, (2.0, 0.0))
    assert quiet.advance(1) is None
    assert quiet.lockstep.drive(None, 3.0, now=quiet.now) is None
    assert quiet.lockstep.walk(stamp(1), (2.0, 0.0)) == rules.ControlStep(3.0, (2.0, 0.0))


def test_the_clock_comes_nearer_while_a_car_that_is_there_has_nothing_to_say(quiet: Bench) -> None:
    """For it may decide by a timer, and its timer by the clock; one that is not there yet would miss it."""
    leads = [quiet.lockstep.lead]
    quiet.cars.alive = []
    quiet.now += 0.3
    assert quiet.lockstep.watch(quiet.now) == rules.Repeat()
    assert quiet.lockstep.lead == leads[0] == rules.LEAD
    quiet.cars.alive = ["/one"]
    for _ in range(12):
        quiet.now += 0.3
        assert quiet.lockstep.watch(quiet.now) == rules.Repeat()
        leads.append(quiet.lockstep.lead)
    assert leads == sorted(leads, reverse=True)
    assert len(set(leads)) == 10
    assert leads[-1] == 0
    quiet.lockstep.walk(stamp(0), (2.0, 0.0))
    assert isinstance(quiet.lockstep.drive(START - 5, 1.0, now=quiet.now), rules.ControlStep)
    assert quiet.advance(1) is None
    assert quiet.lockstep.lead == 0


def test_a_car_that_follows_the_clock_and_is_gone_ends_the_episode(quiet: Bench) -> None:
    quiet.lockstep.walk(stamp(0), (2.0, 0.0))
    quiet.lockstep.drive(stamp(0), 1.0, now=quiet.now)
    quiet.advance(1)
    quiet.now += 100.0
    quiet.lockstep.walk(stamp(1), (2.0, 0.0))
    quiet.cars.alive = []
    end = quiet.lockstep.watch(quiet.now)
    assert kind_of(end.reason) == AbortKind.ENDED


@pytest.fixture
def real_time() -> Bench:
    return Bench(real_time=True)


def test_real_time_starts_once_and_holds_what_came_last(real_time: Bench) -> None:
    lockstep = real_time.lockstep
    assert lockstep.go_on() is None
    assert lockstep.drive(stamp(0), 1.0) is None
    assert lockstep.drive(stamp(0), 2.0) is None  # no contradiction: the last one counts
    assert lockstep.walk(stamp(5) + 1, (1.0, 0.0)) == rules.Start()
    for tick in range(1, 4):
        assert lockstep.go_on() == rules.ControlStep(2.0, (1.0, 0.0))
        assert real_time.advance(tick) is None
    assert lockstep.walk(stamp(2), (0.0, 1.0)) is None
    assert lockstep.drive(START - 1, 9.0) is None
    assert lockstep.go_on() == rules.ControlStep(2.0, (0.0, 1.0))


def test_in_real_time_a_stamp_that_nobody_set_means_now(real_time: Bench) -> None:
    real_time.lockstep.walk(stamp(0), (1.0, 0.0))
    assert real_time.lockstep.drive(1, 1.0) is None  # one that somebody set, long ago
    assert real_time.lockstep.drive(0, 2.0) == rules.Start()
    assert real_time.lockstep.go_on() == rules.ControlStep(2.0, (1.0, 0.0))


def test_the_clock_begins_before_the_episode(real_time: Bench) -> None:
    """So a car that decides by a timer speaks before the first tick, and what it says then counts."""
    real_time.cars.alive = ["/one"]
    assert real_time.lockstep.lead == rules.LEAD
    real_time.now += 0.3
    assert real_time.lockstep.watch(real_time.now) == rules.Repeat()
    assert 0 < real_time.lockstep.lead < rules.LEAD
    real_time.lockstep.walk(stamp(0), (1.0, 0.0))
    assert real_time.lockstep.drive(START - rules.LEAD - 1, 9.0) is None  # of the episode before
    assert real_time.lockstep.drive(START - rules.LEAD, 2.0) == rules.Start()
    assert real_time.lockstep.go_on() == rules.ControlStep(2.0, (1.0, 0.0))
    assert real_time.advance(1) is None
    assert real_time.lockstep.lead == 0


def test_in_real_time_only_who_is_gone_is_missed(real_time: Bench) -> None:
    real_time.lockstep.drive(stamp(0), 1.0)
    real_time.lockstep.walk(stamp(0), (1.0, 0.0))
    assert real_time.lockstep.watch(real_time.now + 1e6) is None
    real_time.cars.alive = []
    end = real_time.lockstep.watch(real_time.now + 1e6)
    assert end.reason == "process ended: the car controller (publisher of ego/acceleration_command) is gone"
