"""`skd report`: one HTML file of one or more assessments."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from skd_sim.errors import UsageError

from skd_evaluator.assessment.files.assessment_json import understood
from skd_evaluator.cli.arguments import output_path
from skd_evaluator.cli.output import print_json
from skd_evaluator.errors import AssessmentError
from skd_evaluator.files import check_file, write_file
from skd_evaluator.report.html.page import render
from skd_evaluator.report.html.subjects import read_subjects
from skd_evaluator.report.terminal import counted


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    if arguments.format != "html":
        from skd_evaluator.cli import show

        return show.run(arguments)
    out = _target(output_path(arguments), overwrite=arguments.overwrite)
    subjects = read_subjects(arguments.paths)
    with understood(arguments.paths[0] if len(subjects) == 1 else Path("a result")):
        page = render(subjects)
    _write(out, page, overwrite=arguments.overwrite)
    size = len(page.encode())
    for line in (line for one in subjects for line in one.remarks):
        print(f"skd report: warning: {line}", file=sys.stderr)
    if arguments.json:
        found = {"file": str(out), "bytes": size, "assessments": [one.label for one in subjects]}
        print_json(found)
    else:
        print(f"report of {counted(len(subjects), 'assessment')} in {out} ({size / 1e6:.1f} MB)")
    return 0


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


def _write(out: Path, page: str, *, overwrite: bool) -> None:
    """Write the file.

    Raises:
        AssessmentError: it cannot be written.
    """
    try:
        write_file(out, page, overwrite=overwrite)
    except OSError as error:
        raise AssessmentError(f"--out {out}: nothing was written: {error.strerror}") from error
