"""Forgeries of recordings with episodes that did run so, but not in this campaign; see `forgeries.py`.

Each of their messages is true. Only beside the others can it be seen that they do not belong together.
"""

from __future__ import annotations

import dataclasses
import json
import math
from typing import Any

import numpy as np
from bag_forge import EPISODE, RESULT, Sent, changed, messages_of
from forging import each, episode_of
from mutators import pick
from skd_evaluator.campaign.plan.plan import Stage, episode_id, split_episode_id
from skd_evaluator.campaign.run.runner import run_episode
from skd_sim.choices.objective import Objective
from skd_sim.episode.episode import Mode
from skd_sim.messages.from_messages import message_to_episode


def _run_again(sent: list[Sent], first: int, end: int, **otherwise: Any) -> list[Sent]:
    """Return the recording with an episode that was run with something else, and says so."""
    content = sent[first].content
    start = content.header.stamp.sec * 10**9 + content.header.stamp.nanosec
    log = run_episode(dataclasses.replace(message_to_episode(content), **otherwise))
    return [*sent[:first], *messages_of(log, content.campaign, start), *sent[end + 1 :]]


def one_of_another_campaign(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    """Put in an episode of another campaign: of another seed, car, budget, objective, knowledge or world."""
    first, end = episode_of(sent, rng)
    scenario = message_to_episode(sent[first].content).scenario
    others: list[dict[str, Any]] = [
        {"seed": 12345},
        {"multiplier": 1.4},
        {"simulations": 50},
        {"objective": Objective.FRECHET},
        {"maximum_distance": 2.0},
        {"scenario": dataclasses.replace(scenario, eta_max=scenario.eta_max + 1.0)},
        {"scenario": dataclasses.replace(scenario, name="another")},
        {"scenario": dataclasses.replace(scenario, car=dataclasses.replace(scenario.car, start_gap_range=0.0))},
    ]
    otherwise = pick(rng, others)
    return _run_again(sent, first, end, **otherwise), f"the episode at {first} is of a campaign with {[*otherwise]}"


def all_of_several_seeds(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    """Take every episode of the best of three seeds, under the first."""
    first, end = episode_of(sent, rng)
    content = sent[first].content
    start = content.header.stamp.sec * 10**9 + content.header.stamp.nanosec
    logs = [run_episode(dataclasses.replace(message_to_episode(content), seed=seed)) for seed in (3, 4, 5)]
    best = min(logs, key=lambda log: -1.0 if math.isnan(log.impact_speed) else log.impact_speed)
    made = messages_of(best, content.campaign, start)
    return [*sent[:first], sent[first], *made[1:], *sent[end + 1 :]], f"the best of three seeds at {first}"


def of_the_other_kind(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    """Put in another episode of its φ: a run along φ in the place of a kamikaze, or the reverse, or a probe."""
    first, end = episode_of(sent, rng)
    _, index, attempt = split_episode_id(int(sent[first].content.episode_id))
    replay = sent[first].content.mode == int(Mode.REPLAY)
    stage = pick(rng, [Stage.KAMIKAZE if replay else Stage.COLLISION_RATE, Stage.PROBE, Stage.LEARNING])
    mode = Mode.KAMIKAZE if stage == Stage.KAMIKAZE or rng.random() < 0.3 else Mode.REPLAY
    new = _run_again(sent, first, end, mode=mode, episode_id=episode_id(stage, index, attempt + 5))
    return new, f"the episode at {first} is {mode.name} of stage {stage.name}"


def attempts_exchanged(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    """Exchange the numbers of two attempts."""
    numbers = [int(one.content.episode_id) for one in sent if one.topic == EPISODE]
    one, other = pick(rng, numbers), pick(rng, numbers)
    names = {one: other, other: one}

    def edit(content: Any) -> Any:
        return changed(content, "episode_id", names.get(int(content.episode_id), int(content.episode_id)))

    return each(sent, [EPISODE, RESULT], edit), f"episodes {one} and {other} exchanged"


def phi_left_out(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    """Leave out all episodes of a φ, the others with their numbers or with new ones without a gap."""
    indices = sorted({split_episode_id(int(one.content.episode_id))[1] for one in sent if one.topic == EPISODE})
    gone, anew = pick(rng, indices), bool(rng.random() < 0.5)
    new, keep = list[Sent](), True
    for one in sent:
        if one.topic == EPISODE:
            keep = split_episode_id(int(one.content.episode_id))[1] != gone
        if keep and anew and one.topic in (EPISODE, RESULT):
            stage, index, attempt = split_episode_id(int(one.content.episode_id))
            number = episode_id(stage, index - (index > gone), attempt)
            new.append(dataclasses.replace(one, content=changed(one.content, "episode_id", number)))
        elif keep:
            new.append(one)
    return new, f"φ {gone} of {len(indices)} left out, {'numbered anew' if anew else 'numbers kept'}"


def another_top_value(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    """Change a number of the scenario that stands in no section, or in a list of one, in all episodes."""
    scenario = json.loads(next(one.content.scenario for one in sent if one.topic == EPISODE))
    key = pick(rng, sorted(name for name, value in scenario.items() if isinstance(value, (int, float))))
    factor = float(pick(rng, [0.5, 0.9, 1.1, 2.0]))

    def edit(one: Any) -> Any:
        data = json.loads(one.scenario)
        return changed(one, "scenario", json.dumps(data | {key: data[key] * factor}))

    return each(sent, [EPISODE], edit), f"scenario.{key} of all times {factor}"


def another_option(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    """Change an option of all episodes, or what their car or its model is called."""
    known = json.loads(next(one.content.options for one in sent if one.topic == EPISODE) or "{}")
    key = pick(rng, [*sorted(known), "controller", "car_model", "maximum_distance"])
    new: Any = pick(rng, ["carla", "cal", "itself", "nothing", "{}", "known", 0.5, 7, True])

    def edit(one: Any) -> Any:
        if key in known:
            return changed(one, "options", json.dumps(json.loads(one.options or "{}") | {key: new}))
        return changed(one, key, 2.5 if key == "maximum_distance" else str(new))

    return each(sent, [EPISODE], edit), f"{key} of all: {new!r}"


def contact_rounded(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    """Move times and speeds of all contacts by their last digits."""
    by = float(pick(rng, [1e-15, 1e-12, 1e-9, 1e-6]))

    def edit(one: Any) -> Any:
        one = changed(one, "impact_time", one.impact_time * (1.0 - by))
        return changed(one, "impact_speed", one.impact_speed * (1.0 - by))

    return each(sent, [RESULT], edit), f"contacts of all times 1 - {by}"


def all_hits_aborted(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    """Call every hit of a mode aborted, with its last state or without it."""
    modes = {int(one.content.episode_id): int(one.content.mode) for one in sent if one.topic == EPISODE}
    mode = pick(rng, sorted(set(modes.values())))
    short, reason = bool(rng.random() < 0.5), str(pick(rng, ["no answer", "", "the stack fell over"]))

    def edit(one: Any) -> Any:
        if one.outcome != 1 or modes[int(one.episode_id)] != mode:
            return one
        for field, value in (("outcome", 5), ("reason", reason), ("impact_time", math.nan), ("impact_speed", math.nan)):
            one = changed(one, field, value)
        return changed(one, "ticks", max(0, one.ticks - 1)) if short else one

    return each(sent, [RESULT], edit), f"all hits of mode {mode} called aborted{', a tick before' if short else ''}"
