"""`skd compare`: how many φ, and how many kamikazes for each, a wanted certainty takes."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.table import Table
from skd_sim.errors import UsageError

from skd_evaluator.cli.output import finish
from skd_evaluator.metrics.clustered import DISTANCES, VarianceComponents, variance_components
from skd_evaluator.metrics.sample_size import COUNTS, Size, sizes_for_power, sizes_for_width
from skd_evaluator.report.terminal import narrow_table, print_table

if TYPE_CHECKING:
    from skd_evaluator.assessment.files.results import StoredResult

_STATED = {
    "margin": (VarianceComponents(0.058**2, 0.340**2), VarianceComponents(0.007**2, 0.174**2)),
    "deviation": (VarianceComponents(0.069**2, 0.41**2), VarianceComponents(0.022**2, 0.28**2)),
}
"""By figure, variances (m²) of the basic car at C = 1 on synthetic φ, and of its difference to C = 1.05 on the same φ
and draws (`benchmarks/margin_variances.py`, of the difference what it is at most; `benchmarks/comparison.py`): assumed
where no result is given."""
_FEW = 10


@dataclass(frozen=True)
class _Variances:
    """Variances to plan with: of one car, or of a difference on the same φ; and where they are from."""

    components: VarianceComponents
    paired: bool
    text: str
    phi: int | None = None


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    if not arguments.paths:  # what reads results takes longer to import than all of this
        return _run(arguments, [])
    from skd_evaluator.assessment.files.assessment_json import understood
    from skd_evaluator.assessment.files.results import read_result

    with understood(Path("one of the results")):
        return _run(arguments, [read_result(path) for path in arguments.paths])


def _run(arguments: argparse.Namespace, results: Sequence[StoredResult]) -> int:
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
        print_table(_table(sizes, cheapest))
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
    if len(results) > 2:
        raise UsageError("give one result, or for --difference two of the same φ")
    if not results:
        if arguments.figure not in _STATED:
            raise UsageError(f"--figure {arguments.figure} needs a result of skd assess to plan with")
        of_one, of_a_difference = _STATED[arguments.figure]
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
    from skd_evaluator.assessment.compare.comparability import PLANNED
    from skd_evaluator.assessment.compare.comparison import compare

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


def _table(sizes: Sequence[Size], cheapest: Size) -> Table:
    rows = []
    for size in sizes:
        power = "—" if size.power is None else f"{100 * size.power:.0f} %"
        cells = (str(size.trials), str(size.safe), str(size.episodes), f"{size.width:.3f}", power)
        rows.append([f"[bold]{cell}[/]" if size is cheapest else cell for cell in cells])
    return narrow_table(
        "Each of these sizes is enough", ("trials\non each φ", "φ", "episodes", "width of\ninterval", "power"), rows
    )
