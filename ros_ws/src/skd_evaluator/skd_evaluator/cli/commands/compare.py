"""`skd compare`: several assessments side by side, each compared with the first."""

from __future__ import annotations

import argparse
import json
import shutil
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skd_sim.errors import UsageError
from skd_sim.options.car_and_adversary import ControllerName

from skd_evaluator.cli.arguments import Parser, positive_number, rare, real_number, result_folder
from skd_evaluator.cli.gate import add_limits, limit_failures, limits_of
from skd_evaluator.cli.output import finish, is_read

if TYPE_CHECKING:
    from skd_evaluator.assessment.files.results import StoredResult
    from skd_evaluator.cli.explain import Explanation


def add(parser: Parser) -> None:
    """Put results side by side: which car is safer, and how many trajectories it takes to tell.

    Put results side by side, and say whether each car is safer or less safe than the first. That goes by margin and
    risk: one of them has to differ, and none the other way. With --width or --difference it says how many safe
    trajectories φ a precision takes, by how much earlier results vary.
    """
    parser.set_defaults(group="compare and gate", words=[])
    text = "folder of an assessment, a campaign, or one above some; the others are compared with the first"
    parser.add_paths("paths", "DIR", text, nargs="*")
    text = "find the smallest trial in which only one of two cars hits, and write it as scenario, test and pictures"
    parser.add_flag("--explain", text)
    text = "rate the car of two git revisions and compare these; after -- follow options of skd assess"
    parser.add_value("--rev", text, nargs=2, metavar=("A", "B"), default=())
    parser.add_flag("--no-pictures", rare("draw no pictures, which saves about half a second"))
    size = parser.add_argument_group("how many trajectories")
    goal = size.add_mutually_exclusive_group()
    text = "until the 95 %% interval is this wide, in the figure's unit: m, or a share of runs"
    goal.add_value("--width", text, type=positive_number, metavar="W")
    text = "until this difference between two cars is found, m"
    goal.add_value("--difference", text, type=positive_number, metavar="D")
    text = "probability with which the difference is found"
    size.add_value("--power", text, type=real_number(0.06, 0.9999), default=0.8, metavar="P")
    size.add_flag("--unpaired", "the two cars are rated on different safe trajectories")
    size.add_value("--figure", "which figure", choices=("margin", "deviation", "skd", "contact_rate"), default="margin")
    size.add_count("--kamikaze-count", 2, 1_000_000, "only with this many kamikazes for each φ")
    add_limits(parser)
    parser.add_output()


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    if arguments.width is not None or arguments.difference is not None:
        from skd_evaluator.cli import plan

        return plan.run(arguments)
    from skd_evaluator.assessment.files.assessment_json import understood
    from skd_evaluator.assessment.files.results import read_result, result_folders

    def compared(folders: Sequence[Path], controller: str = "") -> int:
        if len(folders) < 2:
            raise UsageError("give folders with at least two assessments; the same one counts once")
        with understood(Path("one of the results")):
            return _compare(arguments, list(map(read_result, folders)), str(ControllerName(controller)))

    if not arguments.rev:
        return compared(result_folders(arguments.paths))
    from skd_evaluator.cli.revisions import Repository, assess_request
    from skd_evaluator.report.progress import progress_bar

    if arguments.paths:
        raise UsageError("--rev rates two revisions: leave out the folders")
    request = assess_request(arguments.words)
    repository = Repository(request.controller)
    with (
        progress_bar(quiet=arguments.quiet) as progress,
        repository.assessed(arguments.rev, request, progress) as folders,
    ):
        return compared(folders, request.controller)


def _compare(arguments: argparse.Namespace, results: Sequence[StoredResult], controller: str) -> int:
    """Compare results.

    Args:
        arguments: of the command.
        results: at least two.
        controller: what both cars are called where they are driven again; empty: what they are called in the results.
    """
    from skd_evaluator.assessment.compare.comparison import compare, ranking_figure
    from skd_evaluator.assessment.figure_table import columns
    from skd_evaluator.assessment.files.result_folder import write_json
    from skd_evaluator.margin.common_trajectories import distinguishing_trials, on_common_trajectories
    from skd_evaluator.metrics.aborted import not_credible
    from skd_evaluator.report.progress import progress_bar
    from skd_evaluator.report.tables import comparison_table, equal_remarks, verdict_table
    from skd_evaluator.report.terminal import print_table

    names, limits = labels(results), limits_of(arguments)
    out = result_folder(arguments)
    rows = [
        {
            "car": name,
            "folder": str(result.folder),
            **{key: result.figures.get(key) for key in columns("compare")},
            "warnings": not_credible(result.figures.get("warnings") or ()),
        }
        for name, result in zip(names, results, strict=True)
    ]
    # All verdicts together are to be right with 95 %: Bonferroni's share for each.
    confidence = 1.0 - 0.05 / (len(results) - 1)
    entries: list[dict[str, Any]] = []
    found: list[Explanation] = []
    warnings = [line for one in results for line in one.remarks]
    with progress_bar() as progress:
        for name, other in zip(names[1:], results[1:], strict=True):
            first, second, tried = on_common_trajectories(results[0], other, progress)
            compared = compare(first, second, confidence)
            entries.append({"car": name, "compared_with": names[0], **compared.as_dict()})
            warnings += [*tried, *compared.lines()]
            if arguments.explain:
                from skd_evaluator.cli.explain import Explanation  # which draws: slow to import

                first_only, second_only = distinguishing_trials(results[0], other, progress)
                found.append(Explanation(names[0], name, first_only, controller))
                found.append(Explanation(name, names[0], second_only, controller))
    ranked_by = ranking_figure(results)
    content: dict[str, Any] = {
        "rows": rows,
        "ranked_by": ranked_by,
        "confidence": confidence,
        "comparisons": entries,
        **({"only_one_hits": [one.as_dict() for one in found]} if arguments.explain else {}),
        "warnings": list(dict.fromkeys([*warnings, *equal_remarks(rows, "car")])),
    }
    if arguments.rev:  # each was rated elsewhere, and will be there
        there, here = (json.dumps(str(one))[1:-1] for one in (results[0].folder.parent, out.path))
        content = json.loads(json.dumps(content).replace(there, here))

    def show() -> None:
        print_table(comparison_table(rows, ranked_by))
        print_table(verdict_table(content["comparisons"], names[0], confidence))
        for one in found:
            print(one.text)

    def write(folder: Path) -> None:
        write_json(folder / "comparison.json", content)
        for result in results if arguments.rev else ():
            shutil.copytree(result.folder, folder / result.folder.name)
        for one in found:
            one.write(folder)
        if not arguments.pictures:
            return
        from skd_evaluator.report.charts import save_comparison  # slow to import, and needed only now

        save_comparison(folder, dict(zip(names, results, strict=True)), ranked_by)

    read = arguments.json or is_read(show)  # before the pictures, which take longer than the figures
    problem = out.save(write)

    def place() -> None:
        if not problem:
            print(f"results in {out.path}")
            for one in found:
                print(one.command(out.path))

    failed = limit_failures(limits, {name: one.figures for name, one in zip(names, results, strict=True)})
    return max(finish(arguments, content, place, content["warnings"], [problem, *failed]), not read)


def labels(results: Sequence[StoredResult]) -> list[str]:
    """Return a name for each result: that of its car, with its folder where several have the same."""
    from skd_evaluator.files import tails

    cars = [str(result.figures["car"]) for result in results]
    often = Counter(cars)
    return [
        car if often[car] == 1 else f"{car} ({tail})"
        for car, tail in zip(cars, tails([result.folder for result in results]), strict=True)
    ]
