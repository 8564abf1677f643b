"""`skd export`: kamikazes and φ of a result in formats of others."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from skd_sim.errors import UsageError

from skd_evaluator.assessment.files.assessment_json import understood
from skd_evaluator.assessment.files.result_folder import write_json
from skd_evaluator.cli.arguments import result_folder
from skd_evaluator.cli.output import print_json
from skd_evaluator.extensions.exchange.exports import FORMATS, Export, Format, exports_of, selected_episodes
from skd_evaluator.extensions.exchange.scene import EXPORT, ROAD_FILE
from skd_evaluator.extensions.exchange.xml_formats import write_road
from skd_evaluator.report.html.subjects import Subject, read_subjects
from skd_evaluator.report.terminal import counted
from skd_evaluator.version import version


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    kind = FORMATS[arguments.format]
    kind.check()
    subjects = read_subjects([arguments.path])
    if len(subjects) > 1:
        raise UsageError(
            f"{arguments.path}: holds {len(subjects)} assessments; give the folder of one, as {subjects[0].folder}"
        )
    with understood(arguments.path):
        return _export(subjects[0], kind, arguments)


def _export(subject: Subject, kind: Format, arguments: argparse.Namespace) -> int:
    numbers = selected_episodes(subject, arguments.episode, arguments.worst, arguments.objective)
    out = result_folder(arguments)
    going = exports_of(subject, numbers, whole_ticks=kind.whole_ticks, with_car=arguments.car)
    content: dict[str, Any] = {
        "export": 1,
        "skd": version(),
        "result": str(arguments.path),
        "format": arguments.format,
        "road": ROAD_FILE if kind.with_road else None,
        "losses": list(kind.losses),
        "files": [{"file": kind.name(one.recorded), **one.entry} for one in going],
    }

    def write(folder: Path) -> None:
        if kind.with_road:
            write_road(folder / ROAD_FILE, [one.recorded for one in going])
        for one in going:
            kind.write(folder / kind.name(one.recorded), one.recorded)
        write_json(folder / EXPORT, content)

    problem = out.save(write)
    if arguments.json:
        print_json(content)
    elif not problem:
        print(_said(going, arguments.format, out.path))
    for line in subject.warnings:
        print(f"skd export: warning: {line}", file=sys.stderr)
    if problem:
        print(f"skd export: {problem}", file=sys.stderr)
    return 1 if problem else 0


def _said(going: list[Export], name: str, folder: Path) -> str:
    """Return what was written, in a line."""
    episodes = [one for one in going if "episode_id" in one.entry]
    safe = len(going) - len(episodes)
    return f"{safe} φ and {counted(len(episodes), 'episode')} as {name} in {folder}; {EXPORT} says which file is which"
