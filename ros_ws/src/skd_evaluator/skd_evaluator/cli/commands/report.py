"""`skd report`: one HTML file of one or more assessments, or pictures of their worst episodes."""

from __future__ import annotations

import argparse
from pathlib import Path

from skd_sim.errors import AssessmentError, UsageError

from skd_evaluator.cli.arguments import Parser, output_path, whole_number
from skd_evaluator.cli.output import finish
from skd_evaluator.files import check_file, write_file


def add(parser: Parser) -> None:
    """Write one HTML file with a player of all episodes, or pictures and films of the worst.

    Write results into one HTML file: figures, charts, maps, and every episode with a player. The file needs no other
    file and no network. With --format png, gif or mp4 draw the worst episodes of one result, and print the command that
    repeats each.
    """
    parser.set_defaults(group="look")
    parser.add_paths("DIR", "folder of an assessment, a sweep or a campaign, or one above some")
    text = "html for the page, png for pictures, gif or mp4 (with ffmpeg) for films at half speed"
    parser.add_value("--format", text, choices=("html", "png", "gif", "mp4"), default="html")
    which = parser.add_argument_group("pictures and films").add_mutually_exclusive_group()
    which.add_count("--worst", 1, 1000, "how many episodes to draw, the worst for the car first", default=1)
    which.add_value("--episode", "draw the episode with this id", type=whole_number(0), metavar="ID")
    which.add_count("--failures", 1, 1000, "draw so many of the risk's most likely failures, of each kind in turn")
    text = "draw only kamikazes of this objective (default: all episodes)"
    parser.add_value("--objective", text, metavar="NAME")
    text = "the HTML file, or the folder for pictures (default: skd_results/report-<time>)"
    parser.add_output("PATH", text)


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    if arguments.format != "html":
        from skd_evaluator.cli import show

        return show.run(arguments)
    from skd_evaluator.assessment.files.assessment_json import understood
    from skd_evaluator.report.formats import counted
    from skd_evaluator.report.html.page import render
    from skd_evaluator.report.html.subjects import read_subjects

    for option in ("episode", "failures", "objective"):
        if getattr(arguments, option) is not None:
            raise UsageError(f"--{option} goes with --format png, gif or mp4: the page has a player of all episodes")
    out = _target(output_path(arguments), overwrite=arguments.overwrite)
    subjects = read_subjects(arguments.paths)
    with understood(arguments.paths[0] if len(subjects) == 1 else Path("a result")):
        page = render(subjects)
    try:
        write_file(out, page, overwrite=arguments.overwrite)
    except OSError as error:
        raise AssessmentError(f"--out {out}: nothing was written: {error.strerror}") from error
    size = len(page.encode())
    content = {"file": str(out), "bytes": size, "assessments": [one.label for one in subjects]}
    where = f"report of {counted(len(subjects), 'assessment')} in {out} ({size / 1e6:.1f} MB)"
    return finish(arguments, content, lambda: print(where), [line for one in subjects for line in one.remarks])


def _target(out: Path, *, overwrite: bool) -> Path:
    """Return the file that is to be written.

    Raises:
        UsageError: it is there already, or is no file that can be replaced, or no HTML file.
    """
    if out.suffix == "":
        out = out.with_suffix(".html")
    if out.suffix.lower() not in (".html", ".htm"):
        raise UsageError(f"--out {out}: give the name of an .html file")
    check_file(out, "--out", overwrite=overwrite)
    return out
