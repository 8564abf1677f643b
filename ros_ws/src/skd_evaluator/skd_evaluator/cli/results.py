"""What commands that rate a car print of an assessment, and the exit code that follows."""

from __future__ import annotations

import argparse
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from skd_sim.world.episode import counts_in_words

from skd_evaluator.assessment.assessment import Assessment
from skd_evaluator.assessment.files.result_folder import ResultFolder
from skd_evaluator.bags.checks import Damage
from skd_evaluator.cli.gate import Gate
from skd_evaluator.cli.output import print_json, say, warn
from skd_evaluator.metrics.margins import reference_text
from skd_evaluator.report import terminal
from skd_evaluator.report.formats import counted
from skd_evaluator.report.warnings import PLANNED, most_frequent, warnings_of, why_failed
from skd_evaluator.ros.processes import log_of

_SHOWN = 10


def print_result(
    assessment: Assessment,
    out: ResultFolder,
    arguments: argparse.Namespace,
    gate: Gate,
    problem: str | None = None,
    said: Collection[str] = (),
    result: Mapping[str, Any] | None = None,
) -> int:
    """Print an assessment and where it is, check the gate's conditions, and return the exit code.

    Args:
        assessment: what was found.
        out: folder to which the result was written.
        arguments: arguments of the command.
        gate: the conditions that it has to meet.
        problem: why the result is not where it was requested; None if it is.
        said: warnings of the assessment that were printed before.
        result: content of assessment.json, where the assessment is of its episodes alone, which are not all.
    """
    result = result or assessment.as_dict()
    if arguments.json:
        print_json(result)
    else:
        print_tables(result, details=arguments.details)
        seconds = f"{result['seconds']:.1f} s"
        more = "" if arguments.details else "; --details prints every figure, SKD among them"
        print(seconds if problem else f"{seconds}; results in {out.path}{more}")
    shown = arguments.details or arguments.json  # planned figures
    warn(arguments.command, [one for one in warnings_of(assessment, said=said) if shown or not one.startswith(PLANNED)])
    failures = [*([problem] if problem else []), *why_failed(assessment, arguments.max_aborted, result)]
    checks = gate.checks(result, None if problem else out.path, failures)
    if len(checks) > 1 and checks[0].error and not failures:
        failures.append(f"gate: nothing can be said of the car: {checks[0].text}")
    for one in checks[1:]:  # the first is of the failures above
        lines = [f"gate: {one.name}: {one.state}, {one.text}", *(f"  {line}" for line in one.remarks)]
        if not (arguments.json or arguments.quiet):
            print(*lines, sep="\n")
        elif not one.passed:
            failures += lines
    if unmet := [one.name for one in checks[1:] if not one.passed]:
        failures.append(f"gate: {len(unmet)} of {len(checks) - 1} conditions not passed: {', '.join(unmet)}")
    if unwritten := gate.write(result, checks):
        failures.append(unwritten)
    say(arguments.command, *failures)
    # How many of which is among the warnings, and the reason among the failures, if they are too many.
    logs = out.path / "logs"
    if assessment.reasons and (logs.is_dir() or not any(most_frequent(assessment.reasons) in why for why in failures)):
        say(arguments.command, f"why episodes were aborted: {_reasons(assessment.reasons, logs)}")
    return 1 if failures else 0


def say_aborted(command: str, reasons: Sequence[str], episodes: int, out: ResultFolder) -> None:
    """Say how many episodes were aborted and why, and which log of a graph says more; nothing if none was."""
    if reasons:
        aborted = f"{len(reasons)} of {counted(episodes, 'episode')} aborted"
        say(command, f"{aborted}: {_reasons(reasons, out.path / 'logs')}")


def _reasons(reasons: Sequence[str], logs: Path) -> str:
    """Return in words why episodes were aborted: which log of a graph says more, or else the most frequent reason."""
    first = most_frequent(reasons)
    more = f"log: {log_of(logs, first)}" if logs.is_dir() else f"the first one so: {first}"
    return f"{counts_in_words(reasons)}; {more}"


def print_tables(result: Mapping[str, Any], *, details: bool) -> None:
    """Print what was found, in a sentence and a few rows, or with all details, from the content of assessment.json."""
    print(terminal.headline(result))
    terminal.print_table(terminal.headline_table(result))
    beside = reference_text(result.get("reference") or ())
    reference = beside and f"Reference drivers: {beside}."
    for line in filter(None, (reference, terminal.command_ages(result), terminal.few_safe_trajectories(result))):
        print(line)
    if not details:
        return
    if result["equivalent_multiplier_note"]:
        print(f"Equivalent multiplier: {result['equivalent_multiplier_note']}")
    for table_of in (terminal.details_table, terminal.surrogate_table, terminal.safe_trajectory_table):
        if table := table_of(result):
            terminal.print_table(table)
    for note in terminal.interval_notes(result):
        print(f"Interval of {note}")
    if result["until_width"]:
        print(f"Stopped {result['until_width']['text']}")


def say_damage(command: str, damage: Damage) -> None:
    """Say what was left out of recordings, and what is to be known of the rest."""
    say_left_out(command, damage)
    warn(command, damage.warnings)
    if damage.unchecked:
        files = counted(len(damage.unchecked), "file")
        first = f"{damage.unchecked[0]}, …" if len(damage.unchecked) > 1 else f"{damage.unchecked[0]}"
        why = "damage that leaves a possible episode cannot be noticed there"
        warn(command, [f"{files} without checksums ({first}): {why}"])


def say_left_out(command: str, damage: Damage) -> None:
    """Say what was left out of recordings, the first of it in full."""
    lines = [f"left out: {line}" for line in damage.left_out[:_SHOWN]]
    if len(damage.left_out) > _SHOWN:
        lines.append(f"left out: {len(damage.left_out) - _SHOWN} more")
    warn(command, lines)
