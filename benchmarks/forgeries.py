"""Ways to forge a whole recording so that its messages still agree with each other; see `mutations.py`.

Beside these stand recorders that are odd and honest (`recorders.py`): they are to change no number. Each has the
signature of a `mutators.Mutator`.
"""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
import operator
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from bag_forge import ADVERSARY, CAR, EPISODE, RESULT, Sent, changed, messages_of, write_mcap
from mutators import Mutator, pick
from recorders import odd_chunks, odd_records
from skd_evaluator.campaign.run.runner import run_episode
from skd_sim.messages.from_messages import message_to_episode

Forgery = Callable[[list[Sent], np.random.Generator], tuple[list[Sent], str]]


def _each(sent: Sequence[Sent], topics: Sequence[str], edit: Callable[[Any], Any]) -> list[Sent]:
    return [dataclasses.replace(one, content=edit(one.content)) if one.topic in topics else one for one in sent]


def _episode_of(sent: Sequence[Sent], rng: np.random.Generator) -> tuple[int, int]:
    """Return where an episode begins and where its result is; they stand one after the other."""
    first = pick(rng, [place for place, one in enumerate(sent) if one.topic == EPISODE])
    return first, next(place for place in range(first, len(sent)) if sent[place].topic == RESULT)


def another_seed(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    new = int(rng.integers(2**31))
    return _each(sent, [EPISODE], lambda one: changed(one, "seed", new)), f"seed of all: {new}"


def another_car(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    new = float(pick(rng, [1.0, 1.1000001, 1.11, 1.2, 5.0, 0.1]))
    return _each(sent, [EPISODE], lambda one: changed(one, "multiplier", new)), f"multiplier of all: {new}"


def another_scenario(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    places = [
        (section, key)
        for section, inside in json.loads(next(one.content.scenario for one in sent if one.topic == EPISODE)).items()
        if isinstance(inside, dict)
        for key, value in inside.items()
        if isinstance(value, float)
    ]
    section, key = pick(rng, places)
    factor = float(pick(rng, [0.5, 0.99, 1.000001, 1.01, 2.0]))

    def edit(one: Any) -> Any:
        scenario = json.loads(one.scenario)
        scenario[section][key] *= factor
        return changed(one, "scenario", json.dumps(scenario))

    return _each(sent, [EPISODE], edit), f"scenario.{section}.{key} of all times {factor}"


def another_phi(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    name = pick(rng, sorted({one.content.safe_trajectory_name for one in sent if one.topic == EPISODE}))
    shift, tick = float(pick(rng, [1e-9, 0.01, -0.3, 2.0])), int(rng.integers(30))

    def edit(one: Any) -> Any:
        if one.safe_trajectory_name != name:
            return one
        points = list(one.safe_trajectory)
        place = tick % len(points)
        points[place] = changed(points[place], "y", points[place].y + shift)
        return changed(one, "safe_trajectory", points)

    return _each(sent, [EPISODE], edit), f"φ {name} moved by {shift} m at a tick, in all"


def another_objective(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    new = pick(rng, ["paper", "frechet", "deformation", "position"])
    return _each(sent, [EPISODE], lambda one: changed(one, "objective", new)), f"objective of all: {new}"


def fewer_simulations(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    new = int(rng.integers(1, 5000))
    return _each(sent, [EPISODE], lambda one: changed(one, "simulations", new)), f"simulations of all: {new}"


def aborted(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    _, end = _episode_of(sent, rng)
    content = sent[end].content
    for field, value in (("outcome", 5), ("reason", "no command"), ("impact_time", 0.0), ("impact_speed", 0.0)):
        content = changed(content, field, value)
    return [*sent[:end], dataclasses.replace(sent[end], content=content), *sent[end + 1 :]], "an episode called aborted"


def ended_before(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    first, end = _episode_of(sent, rng)
    states = [one for one in sent[first + 1 : end] if one.topic in (CAR, ADVERSARY)]
    ticks = max(1, len(states) // 2 - 1 - int(rng.integers(1, 3)))
    content = sent[end].content
    outcome = int(pick(rng, [1, 2, 3, 4]))
    for field, value in (("outcome", outcome), ("ticks", ticks), ("impact_time", 0.0), ("impact_speed", 0.0)):
        content = changed(content, field, value)
    result = dataclasses.replace(sent[end], content=content)
    return [*sent[: first + 1], *states[: 2 * (ticks + 1)], result, *sent[end + 1 :]], f"over after {ticks}: {outcome}"


def later_contact(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    _, end = _episode_of(sent, rng)
    factor = float(pick(rng, [0.5, 0.999, 1.001, 1.1]))
    content = changed(sent[end].content, "impact_time", sent[end].content.impact_time * factor)
    content = changed(content, "impact_speed", content.impact_speed * factor)
    return [*sent[:end], dataclasses.replace(sent[end], content=content), *sent[end + 1 :]], f"contact times {factor}"


def moved_world(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    shift, axis = float(pick(rng, [1e-6, 0.1, -1.0])), pick(rng, ["x", "y"])
    field = f"pose.pose.position.{axis}"

    def edit(one: Any) -> Any:
        return changed(one, field, getattr(one.pose.pose.position, axis) + shift)

    return _each(sent, [CAR, ADVERSARY], edit), f"all states moved by {shift} m along {axis}"


def another_walk(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    """Give an episode the states of another one, stamps kept."""
    one, end = _episode_of(sent, rng)
    other, _ = _episode_of(sent, rng)
    new = list(sent)
    for place in range(one + 1, end):
        source = other + place - one
        if source >= len(sent) or sent[source].topic != sent[place].topic:
            break
        content = changed(sent[place].content, "pose", sent[source].content.pose)
        new[place] = dataclasses.replace(sent[place], content=changed(content, "twist", sent[source].content.twist))
    return new, f"states of the episode at {one} are those at {other}"


def rounded(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    digits, topic = int(pick(rng, [2, 4, 6, 9, 12])), pick(rng, [CAR, ADVERSARY])

    def edit(one: Any) -> Any:
        where = one.pose.pose.position
        one = changed(one, "pose.pose.position.x", round(where.x, digits))
        return changed(one, "pose.pose.position.y", round(where.y, digits))

    return _each(sent, [topic], edit), f"{topic} rounded to {digits} digits"


def _kind_of(one: Sent) -> tuple[Any, ...]:
    return one.content.mode, one.content.safe_trajectory_name


def without(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    """Drop an episode whole that another attempt of its kind follows: specification, states and result."""
    places = [place for place, one in enumerate(sent) if one.topic == EPISODE]
    followed = [
        place
        for place in places
        if any(_kind_of(sent[other]) == _kind_of(sent[place]) for other in places if other > place)
    ]
    return _dropped(sent, pick(rng, followed or places[:1]))


def without_last(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    """Drop the last episode of all."""
    return _dropped(sent, max(place for place, one in enumerate(sent) if one.topic == EPISODE))


def _dropped(sent: list[Sent], first: int) -> tuple[list[Sent], str]:
    end = next(place for place in range(first, len(sent)) if sent[place].topic == RESULT)
    return [*sent[:first], *sent[end + 1 :]], f"the episode at {first} left out"


def run_twice(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    """Add an episode again under the name of another campaign."""
    first, end = _episode_of(sent, rng)
    again = _each(sent[first : end + 1], [EPISODE, RESULT], lambda one: changed(one, "campaign", "another"))
    return [*sent, *again], f"the episode at {first} in two campaigns"


def renumbered(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    first, end = _episode_of(sent, rng)
    new = int(sent[first].content.episode_id) + int(pick(rng, [1, 2**32, 2**48, 7]))
    inside = _each(sent[first : end + 1], [EPISODE, RESULT], lambda one: changed(one, "episode_id", new))
    return [*sent[:first], *inside, *sent[end + 1 :]], f"the episode at {first} is number {new}"


def other_clock(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    """Shift the times at which messages were recorded, which say nothing."""
    shift = int(rng.integers(10**12))
    return [dataclasses.replace(one, time=one.time + shift) for one in sent], f"recorded {shift} ns later"


def namespaced(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    name = pick(rng, ["/a", "/a/b", "/skd"])
    return [dataclasses.replace(one, topic=name + one.topic) for one in sent], f"all below {name}"


def shifted_topic(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    """Give every state of one topic what the one a tick before or after it says, within its episode; stamps stay."""
    topic, by = pick(rng, [CAR, ADVERSARY]), int(pick(rng, [-1, 1]))
    new, run = list(sent), list[int]()
    for place, one in enumerate(sent):
        run = [] if one.topic == EPISODE else [*run, place] if one.topic == topic else run
        if one.topic == RESULT:
            for index, here in enumerate(run):
                source = sent[run[min(max(index + by, 0), len(run) - 1)]].content
                content = changed(changed(sent[here].content, "pose", source.pose), "twist", source.twist)
                new[here] = dataclasses.replace(sent[here], content=content)
    return new, f"{topic} a tick {'late' if by < 0 else 'early'}"


def other_stamps(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    """Shift the stamps of one topic, or of all; the times at which messages were recorded stay."""
    topics = pick(rng, [[CAR], [ADVERSARY], [CAR, ADVERSARY], [EPISODE], [CAR, ADVERSARY, EPISODE, RESULT]])
    shift = int(pick(rng, [1, 1000, 10**6, 3 * 10**8, 10**9]))

    def later(stamp: Any) -> Any:
        total = stamp.sec * 10**9 + stamp.nanosec + shift
        return changed(changed(stamp, "sec", total // 10**9), "nanosec", total % 10**9)

    def edit(one: Any) -> Any:
        one = changed(one, "header", changed(one.header, "stamp", later(one.header.stamp)))
        return changed(one, "start", later(one.start)) if hasattr(one, "start") else one

    return _each(sent, topics, edit), f"stamps {shift} ns later on {', '.join(topics)}"


def single_precision(sent: list[Sent], _rng: np.random.Generator) -> tuple[list[Sent], str]:
    def edit(one: Any) -> Any:
        for field in ("pose.pose.position.x", "pose.pose.position.y", "twist.twist.linear.x"):
            one = changed(one, field, float(np.float32(operator.attrgetter(field)(one))))
        return one

    return _each(sent, [CAR, ADVERSARY], edit), "all states in single precision"


def mirrored(sent: list[Sent], _rng: np.random.Generator) -> tuple[list[Sent], str]:
    """Exchange left and right, of states and of φ."""

    def edit(one: Any) -> Any:
        return changed(one, "pose.pose.position.x", -one.pose.pose.position.x)

    def phi(one: Any) -> Any:
        return changed(one, "safe_trajectory", [changed(point, "x", -point.x) for point in one.safe_trajectory])

    return _each(_each(sent, [CAR, ADVERSARY], edit), [EPISODE], phi), "left and right exchanged"


def exchanged_phi(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    """Say of two episodes, or of all, that each was of the other φ, by its number and by its positions."""
    firsts = [place for place, one in enumerate(sent) if one.topic == EPISODE]
    first = sent[pick(rng, firsts)].content
    others = [sent[place].content for place in firsts]
    other = next((one for one in others if one.safe_trajectory_name != first.safe_trajectory_name), first)
    both = rng.random() < 0.5  # of all, or of these two alone
    phis = {one.safe_trajectory_name: one for one in (first, other)}

    def edit(one: Any) -> Any:
        if not hasattr(one, "safe_trajectory_name") or one.safe_trajectory_name not in phis or len(phis) == 1:
            return one
        if not both and one.episode_id not in (first.episode_id, other.episode_id):
            return one
        new = next(phi for name, phi in phis.items() if name != one.safe_trajectory_name)
        one = changed(one, "safe_trajectory", new.safe_trajectory)
        return changed(one, "safe_trajectory_name", new.safe_trajectory_name)

    return _each(sent, [EPISODE], edit), f"φ exchanged, {'of all' if both else 'of two'}"


def doubled_under_new_numbers(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    """Add an episode again as the next attempt of its kind, later."""
    first, end = _episode_of(sent, rng)
    ids = {one.content.episode_id for one in sent if one.topic == EPISODE}
    new = next(number for number in range(int(sent[first].content.episode_id), 2**63) if number not in ids)
    shift = 10**9 * (2 + sent[-1].content.header.stamp.sec)

    def later(stamp: Any) -> Any:
        return changed(stamp, "sec", stamp.sec + shift // 10**9)

    def edit(one: Any) -> Any:
        one = changed(one, "header", changed(one.header, "stamp", later(one.header.stamp)))
        one = changed(one, "start", later(one.start)) if hasattr(one, "start") else one
        return changed(one, "episode_id", new) if hasattr(one, "episode_id") else one

    again = _each(sent[first : end + 1], [EPISODE, CAR, ADVERSARY, RESULT], edit)
    return [*sent, *again], f"the episode at {first} again as number {new}"


def two_sessions(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    """Glue a second session behind the first: the same, another seed's or campaign's; its clock begins anew."""
    how = pick(rng, ["the same", "another seed", "another campaign", "another campaign without its last episode"])
    second = list(sent)
    if how == "another seed":
        second = _each(second, [EPISODE], lambda one: changed(one, "seed", int(one.seed) + 1))
    elif how != "the same":
        second = _each(second, [EPISODE, RESULT], lambda one: changed(one, "campaign", "second"))
        if how.endswith("episode"):
            second, _ = without_last(second, rng)
    return [*sent, *second], f"glued: {how}"


def _again(sent: list[Sent], first: int, end: int, **otherwise: Any) -> list[Sent]:
    """Return an episode that SKD ran with something else, as if it had run as the recording says."""
    content = sent[first].content
    spec = dataclasses.replace(message_to_episode(content), **otherwise)
    start = content.header.stamp.sec * 10**9 + content.header.stamp.nanosec
    made = messages_of(run_episode(spec), content.campaign, start)
    return [*sent[:first], sent[first], *made[1:], *sent[end + 1 :]]


def slower_car(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    """Put in what another car did in an episode, in full, under the name of the first."""
    first, end = _episode_of(sent, rng)
    new = float(pick(rng, [1.2, 2.0, 5.0]))
    return _again(sent, first, end, multiplier=new), f"the episode at {first} was driven with {new}"


def weaker_kamikaze(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    """Put in what a kamikaze did that planned with fewer simulations, in one episode."""
    first, end = _episode_of(sent, rng)
    return _again(sent, first, end, simulations=1), f"the episode at {first} was planned with one simulation"


def missed_instead(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    """Cut the last tick before a contact, lead the adversary out of reach, and say that it missed."""
    ends = [place for place, one in enumerate(sent) if one.topic == RESULT and one.content.outcome == 1]
    end = pick(rng, ends) if ends else next(place for place, one in enumerate(sent) if one.topic == RESULT)
    places = [place for place in range(end) if sent[place].topic == ADVERSARY][-1:]
    new, away = list(sent), float(pick(rng, [-1.0, 1.0, 3.0]))
    for place in places:
        moved = changed(sent[place].content, "pose.pose.position.x", sent[place].content.pose.pose.position.x + away)
        new[place] = dataclasses.replace(sent[place], content=moved)
    content = sent[end].content
    outcome = int(pick(rng, [2, 3, 4]))
    for field, value in (("outcome", outcome), ("impact_time", math.nan), ("impact_speed", math.nan)):
        content = changed(content, field, value)
    new[end] = dataclasses.replace(sent[end], content=content)
    return new, f"a contact called {content.outcome}, the adversary {away} m away"


def half_steps(sent: list[Sent], _rng: np.random.Generator) -> tuple[list[Sent], str]:
    """Halve the time step, and put a state between each two."""
    new: list[Sent] = []
    last: dict[str, Sent] = {}
    for one in sent:
        content = one.content
        if one.topic == EPISODE:
            last = {}
            scenario = json.loads(content.scenario)
            scenario["time_step"] /= 2.0
            points = list(content.safe_trajectory)
            between = [_middle(a, b) for a, b in itertools.pairwise(points)]
            points = [point for pair in itertools.zip_longest(points, between) for point in pair if point is not None]
            content = changed(changed(content, "scenario", json.dumps(scenario)), "safe_trajectory", points)
            content = changed(content, "safe_trajectory_time_step", content.safe_trajectory_time_step / 2.0)
        elif one.topic == RESULT:
            ticks = 2 * content.ticks
            if content.outcome == 1:
                ticks = math.ceil(content.impact_time / scenario["time_step"])
            content = changed(content, "ticks", ticks)
        elif one.topic in last:
            before = last[one.topic]
            here, then = content.header.stamp, before.content.header.stamp
            stamp = (here.sec * 10**9 + here.nanosec + then.sec * 10**9 + then.nanosec) // 2
            middle = changed(content, "header.stamp.sec", stamp // 10**9)
            middle = changed(middle, "header.stamp.nanosec", stamp % 10**9)
            place = _middle(content.pose.pose.position, before.content.pose.pose.position)
            middle = changed(middle, "pose.pose.position", place)
            speed = (content.twist.twist.linear.x + before.content.twist.twist.linear.x) / 2.0
            new.append(dataclasses.replace(one, content=changed(middle, "twist.twist.linear.x", speed), time=stamp))
        if one.topic in (CAR, ADVERSARY):
            last[one.topic] = one
        new.append(dataclasses.replace(one, content=content))
    return new, "half the time step, states between"


def _middle(one: Any, other: Any) -> Any:
    return dataclasses.replace(one, x=(one.x + other.x) / 2.0, y=(one.y + other.y) / 2.0)


def cut_and_closed(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    """Cut anywhere, and close the file as if it had ended there, as a tool that repairs files does."""
    keep = int(rng.integers(1, len(sent)))
    return sent[:keep], f"cut after {keep} of {len(sent)} messages, and closed"


FORGERIES: dict[str, Forgery] = {
    "another seed": another_seed,
    "another multiplier": another_car,
    "another scenario": another_scenario,
    "another φ": another_phi,
    "another objective": another_objective,
    "simulations of all": fewer_simulations,
    "called aborted": aborted,
    "over before": ended_before,
    "another contact": later_contact,
    "another place": moved_world,
    "states of another": another_walk,
    "rounded states": rounded,
    "left out": without,
    "the last left out": without_last,
    "in two campaigns": run_twice,
    "another number": renumbered,
    "another clock": other_clock,
    "another namespace": namespaced,
    "one topic a tick off": shifted_topic,
    "other stamps": other_stamps,
    "single precision": single_precision,
    "left and right exchanged": mirrored,
    "φ exchanged": exchanged_phi,
    "doubled under new numbers": doubled_under_new_numbers,
    "two sessions glued": two_sessions,
    "another car's states": slower_car,
    "a weaker kamikaze's states": weaker_kamikaze,
    "a miss instead": missed_instead,
    "half the time step": half_steps,
    "cut and closed": cut_and_closed,
}

FOUND_OTHERWISE: dict[str, str] = {
    "another objective": "`--verify`",
    "another scenario": "`--verify`, where only plans follow from the value",
    "simulations of all": "`--verify`",
    "another multiplier": "nothing, where that car would have done the same in every episode",
    "the last left out": "the manifest, or assessment.json beside the bags",
    "one topic a tick off": "`--verify`, where a kamikaze that waits for a tick meets the car all the same",
    "a weaker kamikaze's states": "`--verify`",
    "another car's states": "`--verify`, where that car would have done the same, and only the plans differ",
}
"""Consistent forgeries that replay alone does not find, and what finds them."""
OF_SEVERAL = ("left out", "the last left out", "φ exchanged")
"""What is done to recordings of several episodes alone."""


def _mutator(forgery: Forgery) -> Mutator:
    def mutate(
        _original: Path, file: Path, sent: Sequence[Sent], options: dict[str, Any], rng: np.random.Generator
    ) -> str:
        new, what = forgery(list(sent), rng)
        write_mcap(file, new, **options)
        return what

    return mutate


FORGING: dict[str, Mutator] = {
    **{name: _mutator(forgery) for name, forgery in FORGERIES.items()},
    "odd chunks": odd_chunks,
    "odd records": odd_records,
}
"""Of recordings."""
