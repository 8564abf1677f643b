"""`skd list`: the assessments under a folder."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from typing import Any

from skd_sim.errors import UsageError
from skd_sim.inputs.printable import one_line

from skd_evaluator.cli.output import print_json
from skd_evaluator.report.history.namesakes import namesakes
from skd_evaluator.report.history.runs import Run, find_runs
from skd_evaluator.report.history.table import runs_table
from skd_evaluator.report.terminal import counted, print_table

_LAST = float("inf")
_KEYS: dict[str, Callable[[Run], Any]] = {
    "date": lambda run: run.date,
    "folder": lambda run: str(run.folder),
    "car": lambda run: (run.car, run.date),
    "margin": lambda run: _LAST if run.figures["margin"] is None else run.figures["margin"],
    "hit_rate": lambda run: _LAST if run.figures["hit_rate"] is None else run.figures["hit_rate"],
}


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    runs = find_runs(arguments.paths)
    unread = [one for one in runs if not one.figures]
    found = [one for one in runs if one.figures and _is_asked_for(one, arguments)]
    found.sort(key=_KEYS[arguments.sort])
    if arguments.last is not None:
        found = found[-arguments.last :]
    if arguments.json:
        print_json({"results": [one.as_dict() for one in found], "unread": [str(one.folder) for one in unread]})
    else:
        for one in unread:
            print(f"skd list: warning: {one.folder}: {one.remark}", file=sys.stderr)
        if not found:
            where = ", ".join(map(str, arguments.paths))
            raise UsageError(f"{where}: holds no assessment that is asked for ({counted(len(runs), 'result')} in all)")
        print_table(runs_table(found))
        for one in found:
            for line in (*([one.remark] if one.remark else []), *one.not_credible):
                print(f"* {one.folder}: {line}")
        for line in namesakes(found):
            print(f"skd list: warning: {one_line(line)}", file=sys.stderr)
        print(f"{counted(len(found), 'result')}; skd verify says whether figures follow from their episodes")
    return 0


def _is_asked_for(one: Run, arguments: argparse.Namespace) -> bool:
    wanted = {one.car: arguments.car, one.encounter: arguments.encounter}
    return all(part is None or part.casefold() in name.casefold() for name, part in wanted.items())
