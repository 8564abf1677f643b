"""`skd export`: kamikazes and safe trajectories of a result as files that other tools open."""

from __future__ import annotations

from pathlib import Path

from skd_evaluator.cli.arguments import Parser, whole_number

EXPORT_FORMATS = ("openscenario", "osi", "commonroad", "csv")
"""Names of the formats: see `exports.FORMATS`."""


def add_export(parser: Parser) -> None:
    """Write kamikazes and safe trajectories as OpenSCENARIO, OSI, CommonRoad or csv.

    Write the safe trajectories φ of a result, and every kamikaze, as files that other tools open. It takes the trial of
    a comparison, a bisection or a log, too. docs/logs.md says what each format keeps.
    """
    parser.set_defaults(group="exchange", module="skd_evaluator.extensions.exchange.exports")
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
