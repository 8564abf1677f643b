"""Forgeries of what a recording says that its episodes were, with their states as they are; see `forgeries.py`."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

import numpy as np
from bag_forge import EPISODE, RESULT, Sent, changed
from forging import each, episode_of
from mutators import pick


def another_seed(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    new = int(rng.integers(2**31))
    return each(sent, [EPISODE], lambda one: changed(one, "seed", new)), f"seed of all: {new}"


def another_car(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    new = float(pick(rng, [1.0, 1.1000001, 1.11, 1.2, 5.0, 0.1]))
    return each(sent, [EPISODE], lambda one: changed(one, "multiplier", new)), f"multiplier of all: {new}"


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

    return each(sent, [EPISODE], edit), f"scenario.{section}.{key} of all times {factor}"


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

    return each(sent, [EPISODE], edit), f"φ {name} moved by {shift} m at a tick, in all"


def another_objective(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    new = pick(rng, ["paper", "frechet", "deformation", "position"])
    return each(sent, [EPISODE], lambda one: changed(one, "objective", new)), f"objective of all: {new}"


def fewer_simulations(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    new = int(rng.integers(1, 5000))
    return each(sent, [EPISODE], lambda one: changed(one, "simulations", new)), f"simulations of all: {new}"


def renumbered(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    first, end = episode_of(sent, rng)
    new = int(sent[first].content.episode_id) + int(pick(rng, [1, 2**32, 2**48, 7]))
    inside = each(sent[first : end + 1], [EPISODE, RESULT], lambda one: changed(one, "episode_id", new))
    return [*sent[:first], *inside, *sent[end + 1 :]], f"the episode at {first} is number {new}"


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

    return each(sent, [EPISODE], edit), f"φ exchanged, {'of all' if both else 'of two'}"


def namespaced(sent: list[Sent], rng: np.random.Generator) -> tuple[list[Sent], str]:
    name = pick(rng, ["/a", "/a/b", "/skd"])
    return [dataclasses.replace(one, topic=name + one.topic) for one in sent], f"all below {name}"
