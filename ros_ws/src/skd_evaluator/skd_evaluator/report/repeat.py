"""The command that runs a stored episode anew, through the node graph: the same seed gives the same trajectory."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from skd_adversary.safe_trajectories.recordings import write_trajectory
from skd_sim.inputs.yaml_file import to_yaml
from skd_sim.options.car_and_adversary import AdversaryModel, CarUnderTest, default_adversary_model
from skd_sim.options.options import Option, options_of
from skd_sim.scenario.scenario import Scenario, load_scenario
from skd_sim.scenario.scenario_file import is_named
from skd_sim.world.episode import Mode
from skd_sim.world.state import Trajectory

from skd_evaluator.assessment.options import CampaignOptions
from skd_evaluator.assessment.plan import split_episode_id
from skd_evaluator.metrics.behaviour import WALKERS
from skd_evaluator.metrics.behaviour.model import load_behaviour

SCENARIO_FILE, CAR_MODEL_FILE, BEHAVIOUR_FILE = "scenario.yaml", "car_model.yaml", "behaviour.yaml"
"""What a scenario, a car model and a behaviour model are called that only the results have: who repeats saves them."""
TRAJECTORY_FILE = "trajectory.csv"
CONTROLLER_COMMAND = "COMMAND"
PROGRAM = "SKD_PROGRAM"
"""Variable in which `scripts/skd` says what was typed."""


def repeat_command(figures: Mapping[str, Any], mode: Mode, objective: str, number: int) -> list[str]:
    """Return the command that repeats an episode, as its words.

    Args:
        figures: content of assessment.json.
        mode: mode of the episode, kamikaze or replay.
        objective: objective of a kamikaze; of no meaning for a replay.
        number: id of the episode.
    """
    _, safe_index, trial = split_episode_id(number)
    return [*repeat_prefix(figures, mode, objective), "--safe-number", str(safe_index), "--trial", str(trial)]


def repeat_crossing(figures: Mapping[str, Any], number: int) -> list[str]:
    """Return the command that repeats a crossing of the risk, one of those that are kept as failures, as its words."""
    _, safe_index, trial = split_episode_id(number)
    return [*crossing_prefix(figures), "--safe-number", str(safe_index), "--trial", str(trial)]


def crossing_prefix(figures: Mapping[str, Any]) -> list[str]:
    """Return what the commands of all failures have in common."""
    words = _prefix(figures, [program(), "episode", "--mode", "risk"])
    words += ["--behaviour", behaviour_name(figures) or BEHAVIOUR_FILE]
    return [*words, "--scale", f"{figures['risk']['failures']['scale']:g}"]


def program() -> str:
    """Return what a command begins with, so that it works where this one did: `scripts/skd` if that was typed."""
    return os.environ.get(PROGRAM, "skd")


def behaviour_name(figures: Mapping[str, Any]) -> str:
    """Return the name under which the behaviour model of results can be had; empty where it takes its file."""
    stored = figures["risk"]["behaviour"]
    shipped = json.loads(json.dumps(load_behaviour(WALKERS).as_dict()))
    return WALKERS if stored == shipped else ""


def files_of(figures: Mapping[str, Any], words: Sequence[str]) -> dict[str, Any]:
    """Return the content of the files that only the result has and that a command names, by their names."""
    contents = {
        SCENARIO_FILE: figures["scenario"],
        CAR_MODEL_FILE: figures["car_model"],
        BEHAVIOUR_FILE: (figures.get("risk") or {}).get("behaviour"),
    }
    return {name: content for name, content in contents.items() if name in words}


def write_trial(folder: Path, scenario: Scenario, trajectory: Trajectory) -> None:
    """Write a scenario, and the road user's trajectory, as the files that `--scenario` and `--safe` take."""
    data = scenario.as_dict()
    data.pop("control_period", None)  # it comes with the controller
    (folder / SCENARIO_FILE).write_text(to_yaml(data), encoding="utf-8")
    times = trajectory.time_step * np.arange(len(trajectory.positions), dtype=np.float64)
    write_trajectory(folder / TRAJECTORY_FILE, times, trajectory.positions)


def repeat_prefix(figures: Mapping[str, Any], mode: Mode, objective: str) -> list[str]:
    """Return what the commands of all episodes of one mode and one objective have in common."""
    words = [program(), "episode", "--mode", mode.name.lower()]
    return _prefix(figures, [*words, "--objective", objective] if mode == Mode.KAMIKAZE else words)


def _prefix(figures: Mapping[str, Any], words: list[str]) -> list[str]:
    """Return the beginning of a command with the options of the car and the test."""
    values = {
        **figures["options"],
        **{name: figures[name] for name in ("controller", "simulations", "maximum_distance", "safe", "seed")},
        "multiplier": figures["multiplier"],
        "car_model": CAR_MODEL_FILE if figures["car_model"] else "",
    }
    known = AdversaryModel(figures["adversary_model"])
    if known != default_adversary_model(CarUnderTest(str(figures["controller"])), str(figures["car_model"] or "")):
        values["adversary_model"] = known
    for one in options_of(CampaignOptions):
        if "episode" in one.commands and one.name in values:
            words += _words(one, values[one.name])
    words += ["--scenario", scenario_name(figures) or SCENARIO_FILE]
    words += ["--safe-count", str(len(figures["per_safe_trajectory"]))]
    if CarUnderTest(str(figures["controller"])).is_external:
        words += ["--controller-command", CONTROLLER_COMMAND]
    return words


def _words(one: Option, value: Any) -> list[str]:
    """Return an option as it is given on the command line; nothing where the value is that of a single episode."""
    if value is None or value == one.default:
        return []
    text = repr(value) if one.kind is float else str(value)
    return [one.flag, *([] if one.kind is bool else [text])]


def scenario_name(figures: Mapping[str, Any]) -> str:
    """Return the name under which the scenario of results can be had; empty where there is none."""
    stored = dict(figures["scenario"])
    name = str(stored["name"])
    if not is_named(name):  # a name only, no path: nothing that a result names is opened
        return ""
    known = json.loads(json.dumps(load_scenario(name).as_dict()))
    external = CarUnderTest(str(figures["controller"])).is_external
    if not external:  # what the controller declares comes with the controller
        stored.pop("control_period", None)
        known.pop("control_period", None)
    return name if stored == known else ""
