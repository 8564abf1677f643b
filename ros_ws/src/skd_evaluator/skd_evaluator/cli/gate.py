"""The gate's options: conditions for an assessment, and files that tell continuous integration what became of them."""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skd_sim.errors import AssessmentError, OutOfReachError, UsageError
from skd_sim.inputs.files import finite_number, real_path

from skd_evaluator.cli.arguments import rare
from skd_evaluator.files import check_file, write_file

if TYPE_CHECKING:  # this module is imported at every start, and has to be light
    from skd_evaluator.assessment.compare.gate import Check, Limit
    from skd_evaluator.assessment.files.results import StoredResult

_FILES = ("junit", "markdown")


def figure_limit(text: str) -> tuple[str, float]:
    """Parse `figure=number`."""
    name, _, number = text.partition("=")
    try:
        if name:
            return name, finite_number(number, name)
    except UsageError:
        pass
    raise argparse.ArgumentTypeError(f"must be FIGURE=NUMBER, as margin=0.8, got {text!r}")


def add_limits(parser: argparse.ArgumentParser) -> Any:
    """Add the limits of figures beyond which the exit code is 1; return their group."""
    group = parser.add_argument_group("gate")
    for side, example in (("below", "margin=0.8"), ("above", "nominal_collision_rate=0.05")):
        text = f"exit with 1 if this figure of assessment.json is {side} the number, as {example}. Can be repeated"
        limit: dict[str, Any] = {"type": figure_limit, "action": "append", "default": [], "metavar": "FIGURE=NUMBER"}
        group.add_argument(f"--fail-{side}", help=text, **limit)
    return group


def add_gate_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the conditions under which the exit code is 1, and the files that say which of them hold."""
    group = add_limits(parser)
    text = "exit with 1 if the car is less safe than in this earlier result, judged as skd compare does"
    group.add_argument("--fail-if-worse-than", type=Path, metavar="DIR", help=text)
    text = "write these conditions as JUnit XML. An error means that nothing can be said of the car"
    group.add_argument("--junit", type=Path, metavar="FILE", help=text)
    text = rare("write the figures and these conditions as a Markdown page")
    group.add_argument("--markdown", type=Path, metavar="FILE", help=text)


@dataclass(frozen=True)
class Gate:
    """What was asked for.

    Attributes:
        limits: the limits that figures have to keep.
        earlier: result that the car must not fall behind.
        files: the files to write, by kind: junit, markdown.
    """

    limits: tuple[Limit, ...]
    earlier: StoredResult | None
    files: Mapping[str, Path]

    def checks(self, result: Mapping[str, Any], folder: Path | None, errors: list[str]) -> list[Check]:
        """Return what became of each condition.

        Args:
            result: content of assessment.json.
            folder: folder of the result; None where it could not be written.
            errors: why nothing, or not enough, can be said of the car.
        """
        from skd_evaluator.assessment.compare.gate import Check, check_limits
        from skd_evaluator.margin.common_trajectories import check_not_worse
        from skd_evaluator.metrics.aborted import aborted_lines, not_credible

        kinds = ", ".join(f"{one['count']} aborted: {kind}" for kind, one in result["aborted_reasons"].items())
        aborted = "; ".join([*filter(None, [kinds]), *aborted_lines(result)])
        why = "; ".join(dict.fromkeys([*errors, *not_credible(result["warnings"])]))
        first = Check("assessment", why or aborted or "complete", error=bool(why))
        found = [first, *check_limits(result, self.limits)]
        if self.earlier is not None:
            try:
                if folder is None:
                    raise UsageError("there is no result on disk")
                found.append(check_not_worse(folder, self.earlier))
            except UsageError as error:
                found.append(Check(f"not worse than {self.earlier.folder}", f"not compared: {error}", error=True))
        if not why:
            return found
        # A condition that these figures meet may not be met by the car; one that they do not meet stays so.
        doubt = "not judged, for the assessment is an error"
        judged = (replace(one, text=f"{doubt}: {one.text}", error=True) if one.passed else one for one in found[1:])
        return [first, *judged]

    def write(self, result: Mapping[str, Any] | None, checks: list[Check], car: str = "") -> str | None:
        """Write the files, those of an assessment that ended without result but for Markdown; return why that failed.

        Args:
            result: content of assessment.json; None: there is none.
            checks: what became of each condition.
            car: its name, where there is no result.
        """
        from skd_evaluator.report.presentation import junit_xml, markdown

        try:
            for name, path in self.files.items():
                if name == "junit":
                    write_file(path, junit_xml(result, checks, car=car))
                elif result is not None:
                    write_file(path, markdown(result, checks))
        except OSError as error:
            return f"--{name} {path}: cannot be written ({error.strerror})"
        return None

    @contextmanager
    def watch(self, car: str) -> Iterator[None]:
        """If something ends the assessment, say why in the JUnit file, too."""
        try:
            yield
        except (AssessmentError, OutOfReachError) as error:
            from skd_evaluator.assessment.compare.gate import Check

            earlier = [f"not worse than {self.earlier.folder}"] if self.earlier else []
            lost = [Check(name, "not judged: no result", error=True) for name in (*map(str, self.limits), *earlier)]
            if problem := self.write(None, [Check("assessment", str(error), error=True), *lost], car):
                print(f"skd: {problem}", file=sys.stderr)
            raise


def gate_of(arguments: argparse.Namespace) -> Gate:
    """Return the gate that was requested; impossible conditions are refused before any work.

    Raises:
        UsageError: no such figure, no such result, or no place where a file can be written.
    """
    from skd_evaluator.assessment.from_options import inputs_of, refuse_to_replace

    limits = limits_of(arguments)
    earlier = None
    if arguments.fail_if_worse_than is not None:
        from skd_evaluator.assessment.files.results import read_result

        try:
            earlier = read_result(arguments.fail_if_worse_than)
        except UsageError as error:
            raise UsageError(f"--fail-if-worse-than {error}") from error
    files = {name: path for name in _FILES if (path := getattr(arguments, name)) is not None}
    inputs = inputs_of(vars(arguments)) if files else []
    for name, path in files.items():
        check_file(path, f"--{name}")
        refuse_to_replace(path, inputs, f"--{name}")
        if not os.access(real_path(path).parent, os.W_OK | os.X_OK):
            raise UsageError(f"--{name} {path}: must be a file in a folder that can be written")
    if len(set(map(real_path, files.values()))) < len(files):
        raise UsageError(f"--junit {arguments.junit}: --markdown is written there, too; give each a file of its own")
    for path in files.values():  # what an earlier run wrote says nothing of this one, however it ends
        real_path(path).unlink(missing_ok=True)
    return Gate(limits, earlier, files)


def limit_failures(limits: Sequence[Limit], results: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Return which figures of several cars are beyond their limits or not known, a line each.

    Args:
        limits: the limits.
        results: content of assessment.json of each car, by name.
    """
    from skd_evaluator.assessment.compare.gate import check_limits

    return [
        f"gate: {line}"
        for name, result in results.items()
        for one in check_limits(result, limits)
        if not one.passed
        for line in (f"{name}: {one.name}: {one.state}, {one.text}", *one.remarks)
    ]


def limits_of(arguments: argparse.Namespace) -> tuple[Limit, ...]:
    """Return the limits that figures have to keep.

    Raises:
        UsageError: no such figure, or one that is never beyond its limit, or always.
    """
    if not (arguments.fail_below or arguments.fail_above):
        return ()
    from skd_evaluator.assessment.compare.gate import Limit
    from skd_evaluator.assessment.files.assessment_json import better_of, check_figure, span_of
    from skd_evaluator.cli.output import warn

    limits = []
    for side in ("below", "above"):
        for name, value in getattr(arguments, f"fail_{side}"):
            condition = f"--fail-{side} {name}={value:g}"
            try:
                check_figure(name)
            except UsageError as error:
                raise UsageError(f"{condition}: {error}") from error
            if (better := better_of(name)) == ("less" if side == "below" else "more"):
                other = "above" if side == "below" else "below"
                warn(arguments.command, [f"{condition}: {better} is better: is --fail-{other} meant?"])
            low, high = span_of(name)
            if not low <= value <= high:
                span = f"at least {low:g}" if high == math.inf else f"from {low:g} to {high:g}"
                share = ", where 0.05 is 5 %" if high == 1.0 else ""
                raise UsageError(f"{condition}: this figure is {span}{share}; such a limit decides nothing")
            limits.append(Limit(name, value, is_least=side == "below"))
    return tuple(limits)
