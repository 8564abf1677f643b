"""`skd export`: kamikazes and safe trajectories of a result as files that other tools open."""

from __future__ import annotations

import argparse
from pathlib import Path

from skd_sim.errors import UsageError

from skd_evaluator.cli.arguments import Parser, result_folder, whole_number
from skd_evaluator.cli.output import finish

EXPORT_FORMATS = ("openscenario", "osi", "commonroad", "csv")
"""Names of the formats: see `exports.FORMATS`."""


def add_export(parser: Parser) -> None:
    """Write kamikazes and safe trajectories as OpenSCENARIO, OSI, CommonRoad or csv.

    Write the safe trajectories φ of a result, and every kamikaze, as files that other tools open. It takes the trial of
    a comparison, a bisection or a log, too. docs/logs.md says what each format keeps.
    """
    parser.set_defaults(group="exchange")
    parser.add_value("path", "folder of an assessment or of a trial", type=Path, metavar="RESULT")
    text = "openscenario (1.2, OpenDRIVE road), osi (ground truth as MCAP; extra exchange), commonroad (2020a), csv"
    parser.add_value("--format", text, choices=EXPORT_FORMATS, required=True)
    which = parser.add_mutually_exclusive_group()
    text = "only the episode that has this id in episodes.npz and bags, and its φ"
    which.add_value("--episode", text, type=whole_number(0), metavar="ID")
    worst = "only so many episodes, the worst for the car first, runs along φ among them, and their φ"
    which.add_count("--worst", 1, 1_000_000, worst)
    parser.add_value("--objective", "only kamikazes of this objective, and their φ", metavar="NAME")
    parser.add_flag("--no-car", "leave out how the car drove, so that another may drive in its place")
    parser.add_output()


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    from skd_evaluator.assessment.files.assessment_json import understood
    from skd_evaluator.assessment.files.result_folder import write_json
    from skd_evaluator.extensions.exchange.exports import FORMATS, exports_of, selected_episodes, trial_of
    from skd_evaluator.extensions.exchange.osi import osi_writer, write_osi
    from skd_evaluator.extensions.exchange.scene import EXPORT, ROAD_FILE
    from skd_evaluator.extensions.exchange.xml_formats import write_road
    from skd_evaluator.report.formats import counted
    from skd_evaluator.report.html.subjects import read_one
    from skd_evaluator.version import version

    kind = FORMATS[arguments.format]
    if kind.write is write_osi:
        osi_writer()  # that its libraries are there
    if trial := trial_of(arguments.path):
        if given := [name for name in ("episode", "worst", "objective") if getattr(arguments, name) is not None]:
            raise UsageError(f"--{given[0]}: {arguments.path} is one trial")
        what, going, warnings = "the trial", [trial], list[str]()
    else:
        subject = read_one([arguments.path])
        with understood(arguments.path):
            numbers = selected_episodes(subject, arguments.episode, arguments.worst, arguments.objective)
            going = exports_of(subject, numbers, whole_ticks=kind.whole_ticks, with_car=arguments.car)
        what, warnings = f"{len(going) - len(numbers)} φ and {counted(len(numbers), 'episode')}", subject.warnings
    out = result_folder(arguments)
    files = {kind.name(recorded): (recorded, entry) for recorded, entry in going}
    content = {
        "export": 1,
        "skd": version(),
        "result": str(arguments.path),
        "format": arguments.format,
        "road": ROAD_FILE if kind.with_road else None,
        "files": [{"file": name, **entry} for name, (_, entry) in files.items()],
    }

    def write(folder: Path) -> None:
        if kind.with_road:
            write_road(folder / ROAD_FILE, [recorded for recorded, _ in going])
        for name, (recorded, _) in files.items():
            kind.write(folder / name, recorded)
        write_json(folder / EXPORT, content)

    def show() -> None:
        if not problem:
            print(f"{what} as {arguments.format} in {out.path}; {EXPORT} says which file is which")

    problem = out.save(write)
    return finish(arguments, content, show, warnings, [problem])
