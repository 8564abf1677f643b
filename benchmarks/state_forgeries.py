"""Forgeries of what happened in the episodes of a recording: states, stamps and contacts; see `forgeries.py`."""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
import operator
from typing import Any

import numpy as np
from bag_forge import ADVERSARY, CAR, EPISODE, RESULT, Sent, changed, messages_of
from forging import each, episode_of
from mutators import pick
from skd_evaluator.campaign.run.runner import run_episode
from skd_sim.messages.from_messages import message_to_episode


def later_contact(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    _, end = episode_of(sent, rng)
    factor = float(pick(rng, [0.5, 0.999, 1.001, 1.1]))
    content = changed(sent[end].content, "impact_time", sent[end].content.impact_time * factor)
    content = changed(content, "impact_speed", content.impact_speed * factor)
    return [*sent[:end], dataclasses.replace(sent[end], content=content), *sent[end + 1 :]], f"contact times {factor}"


def moved_world(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    shift, axis = float(pick(rng, [1e-6, 0.1, -1.0])), pick(rng, ["x", "y"])
    field = f"pose.pose.position.{axis}"

    def edit(one: Any) -> Any:
        return changed(one, field, getattr(one.pose.pose.position, axis) + shift)

    return each(sent, [CAR, ADVERSARY], edit), f"all states moved by {shift} m along {axis}"


def another_walk(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    """Give an episode the states of another one, stamps kept."""
    one, end = episode_of(sent, rng)
    other, _ = episode_of(sent, rng)
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

    return each(sent, [topic], edit), f"{topic} rounded to {digits} digits"


def single_precision(sent: list[Sent], _rng: np.random.Generator) -> tuple[list[Sent], str]:
    def edit(one: Any) -> Any:
        for field in ("pose.pose.position.x", "pose.pose.position.y", "twist.twist.linear.x"):
            one = changed(one, field, float(np.float32(operator.attrgetter(field)(one))))
        return one

    return each(sent, [CAR, ADVERSARY], edit), "all states in single precision"


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


def mirrored(sent: list[Sent], _rng: np.random.Generator) -> tuple[list[Sent], str]:
    """Exchange left and right, of states and of φ."""

    def edit(one: Any) -> Any:
        return changed(one, "pose.pose.position.x", -one.pose.pose.position.x)

    def phi(one: Any) -> Any:
        return changed(one, "safe_trajectory", [changed(point, "x", -point.x) for point in one.safe_trajectory])

    return each(each(sent, [CAR, ADVERSARY], edit), [EPISODE], phi), "left and right exchanged"


def other_clock(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    """Shift the times at which messages were recorded, which say nothing."""
    shift = int(rng.integers(10**12))
    return [dataclasses.replace(one, time=one.time + shift) for one in sent], f"recorded {shift} ns later"


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

    return each(sent, topics, edit), f"stamps {shift} ns later on {', '.join(topics)}"


def _again(sent: list[Sent], first: int, end: int, **otherwise: Any) -> list[Sent]:
    """Return an episode that SKD ran with something else, as if it had run as the recording says."""
    content = sent[first].content
    spec = dataclasses.replace(message_to_episode(content), **otherwise)
    start = content.header.stamp.sec * 10**9 + content.header.stamp.nanosec
    made = messages_of(run_episode(spec), content.campaign, start)
    return [*sent[:first], sent[first], *made[1:], *sent[end + 1 :]]


def slower_car(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    """Put in what another car did in an episode, in full, under the name of the first."""
    first, end = episode_of(sent, rng)
    new = float(pick(rng, [1.2, 2.0, 5.0]))
    return _again(sent, first, end, multiplier=new), f"the episode at {first} was driven with {new}"


def weaker_kamikaze(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    """Put in what a kamikaze did that planned with fewer simulations, in one episode."""
    first, end = episode_of(sent, rng)
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
