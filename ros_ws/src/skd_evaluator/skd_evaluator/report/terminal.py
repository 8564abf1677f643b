"""What a command says on the terminal: tables of one assessment, and what was left out of damaged recordings."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from skd_sim.inputs.files import one_line
from skd_sim.options.adversary import RANKING_OBJECTIVES, SKD_OBJECTIVES, Objective, first_of
from skd_sim.options.car_under_test import CarUnderTest

from skd_evaluator.assessment.figure_table import AT_THE_TOP, Of, shown_in
from skd_evaluator.bags.checks import Damage
from skd_evaluator.metrics.aborted import not_credible
from skd_evaluator.metrics.margins import GAP_WARNING
from skd_evaluator.metrics.statistics import cantelli_bound
from skd_evaluator.report.formats import (
    NO_RATING,
    TERMINAL,
    bounded,
    failures_in,
    how_many,
    ninety,
    spoken_interval,
    surrogate_groups,
    surrogate_rows,
)


def counted(number: int, thing: str) -> str:
    """Return a number with its noun, which takes an s for all but one."""
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"


_EXACT = 5e-4  # m, of which nothing is seen in three digits
_PLAIN = box.Box("    \n" * 2 + " -- \n" + "    \n" * 5, ascii=True)


_number, _interval, _percent = TERMINAL.number, TERMINAL.interval, TERMINAL.share
_percent_interval = TERMINAL.share_interval
_BOLD = ("margin", "equivalent_multiplier", "nominal_collision_rate", "skd")


def car_name(result: Mapping[str, Any]) -> str:
    """Return how a result's car is called in headings."""
    car = CarUnderTest(str(result["controller"]))
    return replace(car, multiplier=float(result["multiplier"])).label if car.has_multiplier else car.label


def bounded_cell(result: Mapping[str, Any], text: str) -> str:
    """Return a cell with a margin, or what follows from it; in two lines and red where it is but a bound."""
    said = bounded(result, text)
    return said if said == text else f"[red]{said.replace('at most ', 'at most' + chr(10))}[/]"


def credibility(warnings: Iterable[object]) -> str:
    """Return that figures are not credible, by warnings about them; empty if they are."""
    return "not credible" if not_credible(warnings) else ""


def headline(result: Mapping[str, Any]) -> str:
    """Return what was found, in a sentence or two; first that it is not credible, if so."""
    said = credibility(result.get("warnings") or ())
    return f"{said.capitalize()} (the warnings say why): {_found(result)}" if said else _found(result)


def _trajectories(result: Mapping[str, Any]) -> str:
    """Return how many nominal trajectories there are, and how many of them are distinct if not all are."""
    count, distinct = len(result["per_safe_trajectory"]), result["distinct_safe_trajectories"]
    return f"{count} trajectories" if distinct == count else f"{count} trajectories, {distinct} of them distinct"


def _found(result: Mapping[str, Any]) -> str:
    car, eta_max = car_name(result), f"{result['eta_max']:g} m"
    if result["margin"] is None:
        return f"{car}: the margin is not known ({result['margin_note']})."
    trials, beyond = result["margin_trials"], result["margin_beyond"]
    how_many = f"{trials} trials, {_trajectories(result)}"
    if beyond == trials:
        found = f"{car}: no hit found within {eta_max} ({how_many})."
        if result.get("nominal_collision_rate"):
            found += (
                f" But {_percent(result['nominal_collision_rate'])} of the runs along nominal trajectories collide."
            )
        return found
    at_most = "" if result["margin_converged"] else "at most "
    interval = result["margin_ci95"]
    around = f"95 % CI {interval[0]:.2f}–{interval[1]:.2f}; " if interval else ""
    found = f"{car}: safety margin {at_most}{result['margin']:.2f} m ({around}{how_many})."
    if beyond:
        found += f" No hit found in {beyond} of {trials} trials: each counts as {eta_max}."
    if at_most:
        found += " The search has not converged: give a larger --margin-limit."
    return found


def headline_table(result: Mapping[str, Any]) -> Table:
    """Return the few rows that are printed first, from the content of assessment.json."""
    table = Table(title=f"Assessment: {escape(car_name(result))}", title_justify="left")
    table.add_column("")
    table.add_column("value", justify="right")
    table.add_column("95 % interval, by φ", justify="right")
    for figure in shown_in("summary"):
        value, by_phi = TERMINAL.value(figure, result), ninety(figure, result) or TERMINAL.by_phi(figure, result)
        if not figure.first or (value == TERMINAL.nothing and figure.key not in ("nominal_collision_rate", "skd")):
            continue
        label = figure.title + _beside(figure.key, result)
        if figure.key == "skd" and result["skd"] is None:
            value, by_phi = "none kept" if result["discarded_by_distance"] else "no kamikaze found", ""
        elif figure.key in _BOLD:
            label, value = label.replace(figure.label, f"[bold]{figure.label}[/]", 1), f"[bold]{value}[/]"
        elif figure.key == "optimality_gap":
            label = f"  {label}"
            value = f"[red]{value}[/]" if result["optimality_gap"] > GAP_WARNING else value
        table.add_row(label, value, escape(by_phi))
    aborted = sum(reasons["count"] for reasons in result["aborted_reasons"].values())
    if aborted:
        table.add_row("[red]aborted episodes[/]", str(aborted), "--details says why")
    return table


def _beside(key: str, result: Mapping[str, Any]) -> str:
    """Return what stands beside the name of a figure that is shown first."""
    if key == "margin":
        return f", {_how_sure(result) if result['margin_converged'] else '[red]not converged[/]'}"
    if key == "nominal_collision_rate":
        return f" ({counted(result['collision_runs'], 'run')})"
    if AT_THE_TOP[key].planned and result.get("knowledge"):
        return f", knowledge: {result['knowledge']}"
    if key == "skd" and result["skd"] is not None:
        return f", {_percent(result['kamikaze_success_rate'])} of trials collide"
    return ""


def _how_sure(result: Mapping[str, Any]) -> str:
    """Return how near a margin is to the least that there is, in a few words."""
    gap = result["margin_gap"]
    if gap is None:
        return "found by search"
    return "exact" if gap < _EXACT else f"at most {gap:.2g} m above the least"


def details_table(result: Mapping[str, Any]) -> Table:
    """Return everything else that is known of an assessment, from the content of assessment.json."""
    table = Table(title="Details", title_justify="left")
    table.add_column("")
    table.add_column("value", justify="right")
    table.add_column("95 % interval", justify="right")
    _add_margin(table, result)
    _add_further(table, result, Of.MARGIN)
    table.add_section()
    _add_deviation(table, result)
    _add_further(table, result, Of.RANKING)
    table.add_row(
        f"contact rate along φ, any touch ({counted(result['collision_runs'], 'run')})",
        _percent(result["contact_rate"]),
        _percent_interval(result["contact_rate_ci95"]),
    )
    table.add_row("  runs taken as independent (Wilson)", "", _percent_interval(result["contact_rate_ci95_runs"]))
    if result["collision_standing_contacts"]:
        table.add_row("  of these, walked into a standing car", str(result["collision_standing_contacts"]), "")
    _add_further(table, result, Of.CAR)
    for kind, reasons in result["aborted_reasons"].items():
        table.add_row(f"[red]aborted episodes: {kind}[/]", str(reasons["count"]), "")
    clipped = result["commands_clipped"]
    if clipped["commands"]:
        episodes = f"in {counted(clipped['episodes'], 'episode')}"
        table.add_row("[red]commands beyond what the car can do[/]", str(clipped["commands"]), episodes)
    age = result.get("command_age")
    if age and age["greatest_delay"]:  # of real time; in lockstep nobody waits for the clock
        worst = f"99 %: {1e3 * age['p99']:.1f}, worst: {1e3 * age['worst']:.1f}"
        table.add_row("age of the commands, ms: median", f"{1e3 * age['median']:.1f}", worst)
        table.add_row("  control periods without a new one", str(age["held"]), f"of {age['control_periods']}")
    if result["left_out"]:
        table.add_row("[red]left out as damaged[/]", str(len(result["left_out"])), "")
    _add_failures(table, result)
    table.add_section()
    _add_skd(table, result)
    _add_further(table, result, Of.SKD)
    return table


def _add_failures(table: Table, result: Mapping[str, Any]) -> None:
    """Add the kinds of failures of the risk with their shares."""
    found = failures_in(result)
    if found is not None:
        name = f"most likely failures at s = {found['scale']:g}"
        table.add_row(name, str(found["hits"]), f"of {counted(found['runs'], 'crossing')}")
        for one in found["kinds"]:
            nearest = f"the nearest: {how_many(one['nearest'][0]['people'])} deviate as much or more"
            table.add_row(f"  {escape(one['kind'])}", _percent(one["share"]), nearest)


def surrogate_table(result: Mapping[str, Any]) -> Table | None:
    """Return what the surrogate safety measures come to, from the content of assessment.json; None without any."""
    groups = surrogate_groups(result)
    if not groups:
        return None
    table = Table(title=f"Surrogate safety measures, median and worst. {NO_RATING}", title_justify="left")
    table.add_column("")
    for name, _ in groups:
        table.add_column(name, justify="right")
    for label, cells in surrogate_rows(result):
        pairs = zip(cells[::3], cells[1::3], strict=True)
        table.add_row(
            label, *(f"{median}, {worst}" if median != TERMINAL.nothing else median for median, worst in pairs)
        )
    return table


def _add_further(table: Table, result: Mapping[str, Any], of: Of) -> None:
    """Add figures that need no words of their own."""
    for figure in shown_in("details"):
        if figure.of is of and figure.key in result:
            around = ninety(figure, result) or (TERMINAL.by_phi(figure, result) if figure.by_phi else "")
            inset = "  " if of in (Of.RANKING, Of.SKD) else ""
            table.add_row(f"{inset}{figure.title}", TERMINAL.value(figure, result), escape(around))


def _add_margin(table: Table, result: Mapping[str, Any]) -> None:
    """Add how the margin was come by."""
    if result["margin"] is None:
        table.add_row("margin", "not known", escape(result["margin_note"]))
        return
    gap, budget = result["margin_gap"], result["margin_budget"]
    if budget is not None:
        stopped = "converged" if result["margin_converged"] else "[red]not converged[/]"
        table.add_row("margin: candidates driven in a trial", str(budget), stopped)
    elif gap:
        table.add_row("margin: the least is at most this much less (m)", f"{gap:.4f}", "")
    table.add_row(
        f"margin: trials in which nobody is hit within {result['eta_max']:g} m",
        f"{result['margin_beyond']} of {result['margin_trials']}",
        "",
    )
    if result["equivalent_multiplier_text"] is not None:
        interval = escape(spoken_interval(result, "equivalent_multiplier_ci95_these_phi_text") or "—")
        value = bounded(result, result["equivalent_multiplier_text"])
        table.add_row("equivalent multiplier C, on these φ alone", value, interval)


def _source(result: Mapping[str, Any], preferred: Sequence[Objective]) -> tuple[str, Mapping[str, Any]]:
    """Return the name and the figures of the first of some objectives that ran, else of the only other one."""
    objectives = result["objectives"]
    name = first_of(preferred, objectives)
    return name, objectives[name]


def _kamikazes(table: Table, objective: str, figures: Mapping[str, Any]) -> None:
    """Add what became of the kamikazes of an objective."""
    rate, interval = _percent(figures["success_rate"]), _percent_interval(figures["success_rate_ci95"])
    table.add_row(f"  success rate, {objective} ({_reached(figures)} of {figures['trials']})", rate, interval)
    if figures["standing_contacts"]:
        table.add_row("  trials that walked into a standing car", str(figures["standing_contacts"]), "")


def _reached(figures: Mapping[str, Any]) -> int:
    """Return how many trials of an objective reached what they planned for."""
    return int(figures["trials"]) - int(figures["failed"])


def _add_deviation(table: Table, result: Mapping[str, Any]) -> None:
    objective, figures = _source(result, RANKING_OBJECTIVES)
    if figures["deviation"] is None:
        table.add_row("planned deviation (m)", "no kamikaze ran", "")
        return
    table.add_row("planned deviation (m)", _number(figures["deviation"]), _interval(figures["deviation_ci95"]))
    table.add_row("  trials taken as independent", "", _interval(figures["deviation_ci95_trials"]))
    if figures["failed"]:
        # Without failures, and with none beyond η_max, it is the same.
        table.add_row("  of those that were hit alone (m)", _number(figures["deviation_of_successes"]), "")
        table.add_row(f"  not hit, counted as {result['eta_max']:g} m", str(figures["failed"]), "")
    for one in figures["measures"].values():
        _add_measure(table, one)
    _kamikazes(table, objective, figures)


def _add_measure(table: Table, one: Mapping[str, Any]) -> None:
    name = escape(f"{one['label']} ({one['unit']})" if one["unit"] else one["label"])
    if one["error"]:
        table.add_row(f"  [red]{name}[/]", "failed", escape(one["error"]))
    elif one["shown"]:
        pairs = f", {one['undefined']} without" if one["undefined"] else ""
        table.add_row(f"  {name}{pairs}", _number(one["mean"]), _interval(one["ci95"]))


def _add_skd(table: Table, result: Mapping[str, Any]) -> None:
    objective, figures = _source(result, SKD_OBJECTIVES)
    if result["skd"] is not None:
        table.add_row("SKD (m)", f"{result['skd']:.3f}", _interval(result["skd_ci95"]))
        table.add_row("  the paper's interval, over pairs", "", _interval(result["skd_ci95_pairs"]))
        table.add_row("  prefix distance (m)", _number(result["skd_prefix"]), _interval(result["skd_prefix_ci95"]))
        for eta, bound in result["probability_bound"].items():
            interval = _interval(result["probability_bound_ci95"][eta])
            table.add_row(f"  of these kamikazes, P(d ≤ {eta} m) at most, Theorem 1", f"{bound:.3f}", interval)
            sharper = cantelli_bound(float(eta), result["skd"], result["variance"])
            table.add_row(f"  of these kamikazes, P(d ≤ {eta} m) at most, Cantelli", f"{sharper:.3f}", "")
    if result["discarded_by_distance"]:
        table.add_row("  discarded by distance", str(result["discarded_by_distance"]), "")
    _kamikazes(table, objective, figures)


_FEW = 5
"""Below so many φ an interval says next to nothing."""


def interval_notes(result: Mapping[str, Any]) -> list[str]:
    """Return what is to be known of the intervals of one assessment, a line each."""
    figures: dict[str, list[str]] = {}
    for name, clustering in result["clustering"].items():
        for note in clustering["notes"] if clustering else ():
            figures.setdefault(note, []).append(name.replace("_", " "))
    return [f"{', '.join(names)}: {note}" for note, names in figures.items()]


def few_safe_trajectories(result: Mapping[str, Any]) -> str | None:
    """Return what to know of intervals over hardly any φ, in one line; None where there are enough, or no interval."""
    count = len(result["per_safe_trajectory"])
    if not 1 < count < _FEW:
        return None
    return (
        f"Intervals over {count} φ say little: they are wide, and rest on φ being of one kind. By default there are 20."
    )


def safe_trajectory_table(result: Mapping[str, Any]) -> Table:
    """Return the table of the safe trajectories of one assessment, from the content of assessment.json."""
    table = narrow_table("Each safe trajectory φ")
    table.add_column("φ", overflow="fold")
    for name in ("collision\nrate", "deviation\n(m)", "failed", "SKD\n(m)", "prefix\n(m)"):
        table.add_column(name, justify="right")
    _, of_deviation = _source(result, RANKING_OBJECTIVES)
    rows = zip(result["per_safe_trajectory"], of_deviation["per_safe_trajectory"], strict=True)
    for row, deviations in rows:
        rate = _percent(row["contact_rate"])
        table.add_row(
            escape(row["name"]),
            rate if row["safe"] else f"[red]{rate}, not safe[/]",
            _number(row["deviation"]),
            f"{deviations['failed']} of {deviations['trials'] - deviations['aborted']}",
            _number(row["skd"]),
            _number(row["skd_prefix"]),
        )
    return table


def narrow_table(title: str, heads: Sequence[str] = (), rows: Iterable[Sequence[str]] = ()) -> Table:
    """Return a table that spends no columns on edges and padding: for many figures a row; only figures stand right."""
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, show_edge=False, padding=0)
    for place, name in enumerate(heads):
        right = place and name not in ("folder", "source", "what happens")
        table.add_column(name, justify="right" if right else "left", overflow="ellipsis" if right else "fold")
    for row in rows:
        table.add_row(*row)
    return table


def one_line_cells(table: Table) -> Table:
    """Return a table after all that would steer a terminal was made visible in it.

    The console draws with escape sequences, which go around what keeps others' from the terminal.
    """
    table.title = table.title if table.title is None else one_line(str(table.title))
    for column in table.columns:
        column._cells = [one_line(cell) if isinstance(cell, str) else cell for cell in column._cells]
    return table


def print_table(table: Table) -> None:
    """Print to standard output, without trailing blanks; what is no terminal gets plain text, without a frame.

    Its width is that of the terminal, or COLUMNS; else 150. NO_COLOR is heeded.
    """
    terminal = sys.stdout.isatty()
    if not terminal:
        table.box, table.show_edge = _PLAIN, False
    width = None if terminal or os.environ.get("COLUMNS", "").isdigit() else 150
    console = Console(width=width, file=io.StringIO(), force_terminal=terminal, record=False)
    console.print(one_line_cells(table))
    assert isinstance(console.file, io.StringIO)
    for line in console.file.getvalue().splitlines():
        print(line.rstrip())


_SHOWN = 10


def say_damage(command: str, damage: Damage) -> None:
    """Say on the error stream what was left out, and what is to be known of the rest.

    Args:
        command: name of the command that read the recordings.
        damage: what was found in them.
    """
    say_left_out(command, damage)
    lines = list(damage.warnings)
    if damage.unchecked:
        first = f"{damage.unchecked[0]}" + (", …" if len(damage.unchecked) > 1 else "")
        lines.append(
            f"{counted(len(damage.unchecked), 'file')} without checksums ({first}): damage that leaves a possible "
            "episode cannot be noticed there"
        )
    _warn(command, lines)


def say_left_out(command: str, damage: Damage) -> None:
    """Say on the error stream what was left out, the first of it in full."""
    lines = [f"left out: {line}" for line in damage.left_out[:_SHOWN]]
    if len(damage.left_out) > _SHOWN:
        lines.append(f"left out: {len(damage.left_out) - _SHOWN} more")
    _warn(command, lines)


def _warn(command: str, lines: Sequence[str]) -> None:
    for line in lines:
        print(f"skd {command}: warning: {one_line(line)}", file=sys.stderr)
