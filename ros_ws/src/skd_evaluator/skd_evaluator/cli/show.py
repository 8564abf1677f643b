"""`skd report --format png`: episodes of a result as pictures or films."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from skd_sim.errors import UsageError
from skd_sim.inputs.files import from_here
from skd_sim.inputs.yaml_file import to_yaml
from skd_sim.world.episode import Mode, Outcome

from skd_evaluator.assessment.files.assessment_json import understood
from skd_evaluator.assessment.files.result_folder import write_json
from skd_evaluator.cli.arguments import result_folder
from skd_evaluator.cli.output import finish
from skd_evaluator.metrics.surrogate_measures import episode_measures
from skd_evaluator.metrics.surrogate_scenes import course_of
from skd_evaluator.report.formats import KeptFailure, bounded, kept_failures
from skd_evaluator.report.html.subjects import Subject, believed_car, chosen_episodes, episode_entry, read_one
from skd_evaluator.report.pictures import ShownEpisode, check_format, save_episode
from skd_evaluator.report.repeat import files_of, repeat_command, repeat_crossing


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    check_format(arguments.format)
    subject = read_one(arguments.paths)
    arguments.path = arguments.paths[0]
    with understood(arguments.path):
        return _show(subject, arguments)


def _show(subject: Subject, arguments: argparse.Namespace) -> int:
    kept = kept_failures(subject.figures)
    if arguments.failures is None:
        kept, numbers = [], chosen_episodes(subject, arguments.episode, arguments.objective)
        numbers = numbers if arguments.episode is not None else numbers[: arguments.worst]
    else:
        numbers = _likeliest(kept, arguments)
        subject = replace(subject, episodes=subject.failing)
    out = result_folder(arguments)
    names = [f"{place}.{arguments.format}" for place in range(1, len(numbers) + 1)]
    commands = [_command(subject, number, kept) for number in numbers]
    needed = {name: content for words in commands for name, content in files_of(subject.figures, words).items()}
    entries = [
        {
            **_entry(subject, number, name, kept),
            "command": shlex.join([str(out.path / word) if word in needed else from_here(word) for word in words]),
            "measures": _measures(subject, number),
        }
        for number, name, words in zip(numbers, names, commands, strict=True)
    ]
    content = {"result": str(arguments.path), "episodes": entries}

    def write(folder: Path) -> None:
        for number, name in zip(numbers, names, strict=True):
            save_episode(folder / name, shown_episode(subject, number, kept))
        for name, inside in needed.items():
            (folder / name).write_text(to_yaml(inside), encoding="utf-8")
        write_json(folder / "show.json", content)

    def show() -> None:
        for one in entries:
            print(f"{out.path / str(one['file'])}: {one['title']}")
            print(f"  {one['command']}")

    out.write(write)
    return finish(arguments, content, show, subject.warnings)


def _likeliest(kept: Sequence[KeptFailure], arguments: argparse.Namespace) -> list[int]:
    """Return the places of the failures that are asked for: the nearest of each kind first, then the next of each.

    Raises:
        UsageError: there is none.
    """
    if not kept:
        raise UsageError(f"--failures: {arguments.path} has none: the crossings of its risk have no hit")
    return sorted(range(len(kept)), key=lambda place: (kept[place].rank, place))[: arguments.failures]


def shown_episode(subject: Subject, number: int, kept: Sequence[KeptFailure] = ()) -> ShownEpisode:
    """Return an episode of a result as it is drawn; with `kept`, one of the failures that are kept."""
    episodes = subject.episodes
    adversary = episodes.until_contact(number)
    car = episodes.car_until_contact(number, subject.scenario)
    times = [tick * episodes.time_step for tick in range(len(adversary))]
    if episodes.collided[number]:
        times[-1] = float(episodes.impact_time[number])
    return ShownEpisode(
        _title(subject, number, kept),
        subject.scenario,
        episodes.safe[int(episodes.safe_index[number])],
        adversary,
        car,
        np.array(times),
        bool(episodes.collided[number]),
        believed_car(subject.scenario, episodes.car[number], episodes.belief[number]) if episodes.belief else None,
    )


def _measures(subject: Subject, number: int) -> dict[str, Any]:
    """Return the surrogate safety measures of an episode; none of one that never began."""
    episodes, collided = subject.episodes, bool(subject.episodes.collided[number])
    adversary, car = episodes.adversary[number], episodes.car[number]
    if len(car) < 2 or not np.isfinite(car).all():
        return {}
    course = course_of(subject.scenario, adversary, car, *episodes.impact(number))
    return episode_measures(subject.scenario, course, collided=collided)


def _title(subject: Subject, number: int, kept: Sequence[KeptFailure]) -> str:
    episodes, figures = subject.episodes, subject.figures
    name = figures["per_safe_trajectory"][int(episodes.safe_index[number])]["name"]
    objective = str(episodes.objective[number])
    who = f"kamikaze of objective {objective}" if objective else kept[number].text if kept else "along φ"
    least = figures["margin"]
    margin = "" if least is None else f" (margin {bounded(figures, f'{least:.3f}')} m)"
    ended = Outcome(int(episodes.outcome[number])).name.lower()
    if episodes.collided[number]:
        ended = f"hit at {episodes.impact_speed[number]:.1f} m/s, deviation {episodes.deviation[number]:.2f} m"
    ended = f"\n{kept[number].likely}, {ended}" if kept else f" {ended}"
    return f"{subject.label}{margin}\n{name}, {who}:{ended}"


def _entry(subject: Subject, number: int, name: str, kept: Sequence[KeptFailure]) -> dict[str, Any]:
    title = _title(subject, number, kept).replace(":\n", ", ").replace("\n", ": ")
    failure = {"failure": asdict(kept[number])} if kept else {}
    return {"file": name, "title": title, **episode_entry(subject, number), **failure}


def _command(subject: Subject, number: int, kept: Sequence[KeptFailure]) -> list[str]:
    """Return the words of the command that repeats an episode."""
    episodes, found = subject.episodes, int(subject.episodes.episode_id[number])
    if kept:
        return repeat_crossing(subject.figures, found)
    mode, objective = Mode(int(episodes.mode[number])), str(episodes.objective[number])
    return repeat_command(subject.figures, mode, objective, found)
