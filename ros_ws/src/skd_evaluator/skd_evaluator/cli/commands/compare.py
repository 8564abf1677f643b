"""`skd compare`: several assessments side by side, each compared with the first; or how many φ a certainty takes."""

from __future__ import annotations

import argparse
import json
import shutil
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skd_sim.errors import UsageError
from skd_sim.options.car_and_adversary import ControllerName

from skd_evaluator.cli.arguments import Parser, positive_number, rare, real_number, result_folder
from skd_evaluator.cli.gate import add_limits, limit_failures, limits_of
from skd_evaluator.cli.output import finish, is_read

if TYPE_CHECKING:
    from rich.table import Table

    from skd_evaluator.assessment.files.results import StoredResult
    from skd_evaluator.cli.explain import Explanation
    from skd_evaluator.metrics.clustered import VarianceComponents
    from skd_evaluator.metrics.sample_size import Size


def add(parser: Parser) -> None:
    """Put results side by side: which car is safer, and how many trajectories it takes to tell.

    Put results side by side, and say whether each car is safer or less safe than the first. That goes by margin and
    risk: one of them has to differ, and none the other way. With --width or --difference it says how many safe
    trajectories φ a precision takes, by how much earlier results vary.
    """
    parser.set_defaults(group="compare and gate", words=[])
    text = "folder of an assessment, a campaign, or one above some; the others are compared with the first"
    parser.add_paths("DIR", text, nargs="*")
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
    from skd_evaluator.assessment.files.assessment_json import understood
    from skd_evaluator.assessment.files.results import read_result, result_folders

    if arguments.width is not None or arguments.difference is not None:
        with understood(Path("one of the results")):
            return _plan(arguments, list(map(read_result, arguments.paths)))

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
    from skd_evaluator.report.terminal import comparison_table, print_table, verdict_table

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
        "warnings": list(dict.fromkeys(warnings)),
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
            for command in filter(None, (one.command(out.path) for one in found)):
                print(f"to repeat: {command}")

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


_STATED = {
    "margin": ((0.058**2, 0.340**2), (0.007**2, 0.174**2)),
    "deviation": ((0.069**2, 0.41**2), (0.022**2, 0.28**2)),
}
"""By figure, variances (m²) between and within φ: of the basic car at C = 1 on synthetic φ, and of its difference to
C = 1.05 on the same φ and draws (`benchmarks/margin_variances.py`, of the difference what it is at most;
`benchmarks/comparison.py`): assumed where no result is given."""
_FEW = 10


@dataclass(frozen=True)
class _Variances:
    """Variances to plan with: of one car, or of a difference on the same φ; and where they are from."""

    components: VarianceComponents
    paired: bool
    text: str
    phi: int | None = None


def _plan(arguments: argparse.Namespace, results: Sequence[StoredResult]) -> int:
    """Say how many φ, and how many kamikazes for each, a wanted certainty takes; return the exit code."""
    from skd_evaluator.metrics.clustered import DISTANCES
    from skd_evaluator.metrics.sample_size import COUNTS, sizes_for_power, sizes_for_width
    from skd_evaluator.report.terminal import print_table

    source = _source(arguments, results)
    between, within = source.components.between, source.components.within
    if between is None or within is None:
        raise UsageError(f"{source.text}, which takes at least 2 φ with 2 trials each")
    counts = [arguments.kamikaze_count] if arguments.kamikaze_count else COUNTS
    if arguments.width is not None:
        prior = None if arguments.figure == "contact_rate" else DISTANCES
        sizes = sizes_for_width(arguments.width, between, within, prior=prior, counts=counts)
    else:
        goal = arguments.difference, arguments.power
        sizes = sizes_for_power(*goal, between, within, paired=source.paired, counts=counts)
    if not sizes:
        raise UsageError("even 10,000 φ are not enough: ask for a wider interval or a larger difference")
    cheapest = min(sizes, key=lambda size: (size.episodes, size.safe))
    content = {
        "figure": arguments.figure,
        "variance_between": between,
        "variance_within": within,
        "source": source.text,
        "paired": source.paired,
        "sizes": [{**asdict(size), "episodes": size.episodes} for size in sizes],
        "cheapest": asdict(cheapest),
    }

    def show() -> None:
        unit = "" if arguments.figure == "contact_rate" else " m"
        what, goal = "", f"an interval of {arguments.width}"
        if arguments.width is None:
            what, goal = "the difference in ", f"a difference of {arguments.difference}"
        of_what = f"{what}{arguments.figure.replace('_', ' ')}"
        print(f"{source.text}, for {goal}{unit}.")
        print(f"Standard deviation of {of_what}: {between**0.5:.3f}{unit} between φ, {within**0.5:.3f}{unit} on one φ.")
        print_table(_sizes_table(sizes, cheapest))
        print(f"fewest episodes: --safe-count {cheapest.safe} --kamikaze-count {cheapest.trials}")

    warnings = [line for one in results for line in one.remarks]
    if source.phi is not None and source.phi < _FEW:
        advice = "take more, or --until-width, which does not rely on it"
        warnings.append(f"planned from {source.phi} φ, which is uncertain: {advice}")
    return finish(arguments, content, show, warnings)


def _source(arguments: argparse.Namespace, results: Sequence[StoredResult]) -> _Variances:
    """Return the variances to plan with.

    Raises:
        UsageError: results that do not suffice for what is asked.
    """
    from skd_evaluator.metrics.clustered import VarianceComponents, variance_components

    if len(results) > 2:
        raise UsageError("give one result, or for --difference two of the same φ")
    if not results:
        if arguments.figure not in _STATED:
            raise UsageError(f"--figure {arguments.figure} needs a result of skd assess to plan with")
        of_one, of_a_difference = (VarianceComponents(*one) for one in _STATED[arguments.figure])
        if arguments.width is not None or arguments.unpaired:
            return _Variances(of_one, False, "Planned as for the basic car with C = 1 (an earlier result plans better)")
        text = "Planned as for the basic cars with C = 1 and 1.05 (two earlier results plan better)"
        return _Variances(of_a_difference, True, text)
    for one in results:
        if arguments.figure not in one.groups:
            none = f"no {arguments.figure} ({one.figures['margin_note']})"
            raise UsageError(f"{one.folder} has {none}: choose another --figure")
    first = results[0]
    groups = first.groups[arguments.figure]
    if len(results) == 1:
        if arguments.difference is not None and not arguments.unpaired:
            advice = "give two, or add --unpaired for different φ"
            raise UsageError(f"--difference on the same φ is planned from two results: {advice}")
        return _Variances(variance_components(groups), False, f"Planned from {first.folder}", len(groups))
    if arguments.width is not None or arguments.unpaired:
        raise UsageError("two results are for --difference of cars on the same φ; give one")
    return _paired_source(first, results[1], arguments.figure)


def _paired_source(first: StoredResult, second: StoredResult, figure: str) -> _Variances:
    import numpy as np

    from skd_evaluator.assessment.compare.comparability import PLANNED
    from skd_evaluator.assessment.compare.comparison import compare
    from skd_evaluator.metrics.clustered import variance_components

    held = compare(first, second)
    if held.refusals:
        raise UsageError(held.refusals[0])
    if figure in PLANNED and figure not in held.differences:
        raise UsageError(held.planned_refusal or f"{first.folder} and {second.folder} have no {figure} in common")
    if not first.same_safe(second.safe):
        raise UsageError(f"{first.folder} and {second.folder} are of different φ: give one of them, with --unpaired")
    pairs = zip(first.groups[figure], second.groups[figure], strict=True)
    differences = [np.subtract(other[: len(one)], one[: len(other)]) for one, other in pairs]
    text = f"Planned from {first.folder} and {second.folder}"
    return _Variances(variance_components(differences), True, text, len(differences))


def _sizes_table(sizes: Sequence[Size], cheapest: Size) -> Table:
    from skd_evaluator.report.terminal import narrow_table

    rows = []
    for size in sizes:
        power = "—" if size.power is None else f"{100 * size.power:.0f} %"
        cells = (str(size.trials), str(size.safe), str(size.episodes), f"{size.width:.3f}", power)
        rows.append([f"[bold]{cell}[/]" if size is cheapest else cell for cell in cells])
    return narrow_table(
        "Each of these sizes is enough", ("trials\non each φ", "φ", "episodes", "width of\ninterval", "power"), rows
    )
