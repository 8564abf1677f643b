"""What a command says on the terminal: tables of one assessment or several, and what was left out of recordings."""

from __future__ import annotations

import io
import itertools
import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from skd_sim.inputs.files import one_line
from skd_sim.options.car_and_adversary import EXTERNAL, RANKING_OBJECTIVES, first_of

from skd_evaluator.assessment.compare.comparison import EACH
from skd_evaluator.assessment.figure_table import AT_THE_TOP
from skd_evaluator.metrics.aborted import not_credible
from skd_evaluator.metrics.price_of_caution import does_not_get_past
from skd_evaluator.report import formats
from skd_evaluator.report.formats import BARE, TERMINAL, figure_rows, never_passes

_EXACT = 5e-4  # m, of which nothing is seen in three digits
_PLAIN = box.Box("    \n" * 2 + " -- \n" + "    \n" * 5, ascii=True)


_number, _percent = TERMINAL.number, TERMINAL.share


def bounded_cell(result: Mapping[str, Any], text: str) -> str:
    """Return a cell with a margin, or what follows from it; red where it is but a bound."""
    said = formats.bounded(result, text)
    return said if said == text else f"[red]{said.replace('at most', '≤')}[/]"


def credibility(warnings: Iterable[object]) -> str:
    """Return that figures are not credible, by warnings about them; empty if they are."""
    return "not credible" if not_credible(warnings) else ""


def headline(result: Mapping[str, Any], *, named: bool = True) -> str:
    """Return what was found, in one line; first that it is not credible, if so; with the name of the car if `named`."""
    said = credibility(result.get("warnings") or ())
    found = _found(result, f"{result['car']}; " if named else "")
    if lanes := result.get("margin_lanes"):
        state, other = lanes
        found += f" The margin is with the oncoming lane {state}; with it {other} it is {_number(lanes[other])} m."
    return f"{said.capitalize()} (the warnings say why): {found}" if said else found


def _found(result: Mapping[str, Any], car: str) -> str:
    most = f"{result['eta_max']:g} m"
    if result["margin"] is None:
        return f"Safety margin not known: {car}{result['margin_note']}."
    trials, beyond = result["margin_trials"], result["margin_beyond"]
    if beyond == trials:
        found = f"No hit found within {most} in {trials} of {trials} trials: {car}{_trajectories(result)}."
        if rate := result.get("nominal_collision_rate"):
            found += f" But {_percent(rate)} of the runs along nominal trajectories collide."
        return found
    around = f" {_number(interval)}" if (interval := result["margin_ci95"]) else ""
    margin = formats.TERMINAL.value(AT_THE_TOP["margin"], result)  # with the digits of the tables
    found = f"Safety margin {margin} m{around}: {car}{formats.counted(trials, 'trial')} "
    found += f"on {_trajectories(result)}."
    if beyond:
        found += f" No hit found in {beyond} of {trials}: each counts as {most}."
    return found


def _trajectories(result: Mapping[str, Any]) -> str:
    """Return how many nominal trajectories there are, and how many of them are distinct if not all are."""
    count, distinct = len(result["per_safe_trajectory"]), result["distinct_safe_trajectories"]
    alike = "all alike" if distinct == 1 else f"{distinct} distinct"
    return formats.counted(count, "trajectory") + ("" if distinct == count else f", {alike}")


_HEADLINE = ("margin", "nominal_collision_rate", "impact_speed", "risk_1", "time_lost")


def headline_table(result: Mapping[str, Any]) -> Table:
    """Return the few rows that are printed first, from the content of assessment.json: those that are known."""
    table = narrow_table("", ("", "", "95 % interval"))
    for key in _HEADLINE:
        figure = AT_THE_TOP.get(key)
        if figure is None or result.get(key) is None:
            continue
        value = TERMINAL.value(figure, result)
        unit = "" if figure.kind.unit in ("", "%") or value == TERMINAL.nothing else f" {figure.kind.unit}"
        intervals = (TERMINAL.by_phi(figure, result), TERMINAL.independent(figure, result))
        interval = next((one for one in intervals if one != TERMINAL.nothing), "")
        table.add_row(f"{figure.label}{_beside(key, result)}  ", f"[bold]{value}{unit}[/]  ", escape(interval))
    return table


def missing_figures(result: Mapping[str, Any]) -> list[str]:
    """Return why risk and price of caution are not among the rows, a line each; nothing where they are."""
    notes = {"risk": "risk_note", "price of caution": "price_note"}
    return [f"No {name}: {why}." for name, key in notes.items() if (why := result.get(key))]


def command_ages(result: Mapping[str, Any]) -> str | None:
    """Return in one line how old the commands of a stack were; None of other cars."""
    age = result.get("command_age")
    if not age or result["controller"] != EXTERNAL:
        return None
    line = f"Age of the commands: median {1e3 * age['median']:.1f} ms, 99 % below {1e3 * age['p99']:.1f} ms"
    held = f"; {age['held']} of {age['control_periods']} control periods had no new one" if age["held"] else ""
    return f"{line}{held}."


def _beside(key: str, result: Mapping[str, Any]) -> str:
    """Return what stands beside the name of a figure that is shown first."""
    if key == "margin":
        return f", {_how_sure(result) if result['margin_converged'] else '[red]not converged[/]'}"
    if key == "nominal_collision_rate":
        return f", {formats.counted(result['collision_runs'], 'run')}"
    if said := formats.beside(AT_THE_TOP[key], result):
        return f", {said} m/s" if key == "impact_speed" else f", [red]{said}[/]"
    return ", ordinary walkers" if key == "risk_1" else ""


def _how_sure(result: Mapping[str, Any]) -> str:
    """Return how near a margin is to the least that there is, in a few words."""
    gap = result["margin_gap"]
    if gap is None:
        return "found by search"
    return "exact" if gap < _EXACT else f"at most {gap:.2g} m above the least"


def details_table(result: Mapping[str, Any]) -> Table:
    """Return every figure that is known of an assessment, from the content of assessment.json."""
    heads = ("", "value", "95 %,\nby φ", "95 %, as\nindependent", " basis")
    rows = [
        [escape(text.replace(formats.NOTHING, TERMINAL.nothing)) for text in one.texts()]
        for one in figure_rows(result, TERMINAL)
    ]
    for kind, reasons in result["aborted_reasons"].items():
        rows.append([f"[red]aborted episodes: {kind}[/]", str(reasons["count"])])
    if result["left_out"]:
        rows.append(["[red]left out as damaged[/]", str(len(result["left_out"]))])
    for one in result["measures"].values():
        if one["error"]:
            rows.append([f"[red]{escape(one['label'])}[/]", "failed", "", "", f" {escape(one['error'])}"])
    if (found := formats.failures_in(result)) is not None:
        of = f" of {formats.counted(found['runs'], 'crossing')}"
        rows.append([f"most likely failures at s = {found['scale']:g}", str(found["hits"]), "", "", of])
        for one in found["kinds"]:
            nearest = f" the least unusual: {formats.how_unusual(one['nearest'][0]['people'])}"
            rows.append([f"  {escape(one['kind'])}", _percent(one["share"]), "", "", nearest])
    if result["discarded_by_distance"]:
        rows.append(["discarded by distance", str(result["discarded_by_distance"])])
    return narrow_table("Details", heads, rows)


def surrogate_table(result: Mapping[str, Any]) -> Table | None:
    """Return what the surrogate safety measures come to, from the content of assessment.json; None without any."""
    groups = formats.surrogate_groups(result)
    if not groups:
        return None
    rows = []
    for label, cells in formats.surrogate_rows(result):
        pairs = zip(cells[::3], cells[1::3], strict=True)
        rows.append(
            [label, *(median if median == formats.NOTHING else f"{median}, {worst}" for median, worst in pairs)]
        )
    title = f"Surrogate safety measures, median and worst. {formats.NO_RATING}"
    return narrow_table(title, ("", *(name for name, _ in groups)), rows)


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
    if not 1 < count < _FEW or result["nominal_collision_rate"] is None:
        return None
    return f"Intervals over {count} φ say little. By default there are 20 φ."


def safe_trajectory_table(result: Mapping[str, Any]) -> Table:
    """Return the table of the safe trajectories of one assessment, from the content of assessment.json."""
    objectives = result["objectives"]
    of_deviation = objectives[first_of(RANKING_OBJECTIVES, objectives)]
    rows = []
    for row, deviations in zip(result["per_safe_trajectory"], of_deviation["per_safe_trajectory"], strict=True):
        rate = _percent(row["contact_rate"])
        cells = [escape(row["name"]), rate if row["safe"] else f"[red]{rate}, not safe[/]", _number(row["deviation"])]
        cells.append(f"{deviations['failed']} of {deviations['trials'] - deviations['aborted']}")
        rows.append([*cells, _number(row["skd"]), _number(row["skd_prefix"])])
    heads = ("φ", "collision\nrate", "deviation\n(m)", "failed", "SKD\n(m)", "prefix\n(m)")
    return narrow_table("Each safe trajectory φ", heads, rows)


_LEFT = (
    "folder", "source", "what happens", " basis", "adversary", "impact places (%)", "car", "scenario",
    "code of\nthe car", "date\n(UTC)",
)  # fmt: skip
"""Heads of columns of words beside the first."""


def narrow_table(
    title: str, heads: Sequence[str] = (), rows: Iterable[Sequence[str]] = (), *, whole: bool = False
) -> Table:
    """Return a table that spends no columns on edges and padding: for many figures a row; only figures stand right.

    With `whole` figures and dates are never broken, however narrow the terminal is.
    """
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, show_edge=False, padding=0)
    for place, name in enumerate(heads):
        if place and name not in _LEFT:
            table.add_column(name, justify="right", no_wrap=whole, overflow="fold" if whole else "ellipsis")
        else:
            table.add_column(name, overflow="fold", no_wrap=whole and name.startswith("date"))
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


def credibility_mark(row: Mapping[str, Any]) -> str:
    """Return what stands behind the name of a car that is not credible, or does not get past people."""
    said = credibility([*(row.get("warnings") or ()), *(row.get("problems") or ())])
    marks = [*([said] if said else []), *(["often stuck"] if does_not_get_past(row) else [])]
    return f", [red]{'; '.join(marks)}[/]" if marks else ""


def comparison_table(rows: Sequence[Mapping[str, Any]], ranked_by: str | None) -> Table:
    """Return the table of several assessments side by side.

    Args:
        rows: rows of the table, as comparison.json has them.
        ranked_by: figure by which cars are in order, the most vulnerable one first; None: in the order given.
    """
    order = "In the order given"
    if ranked_by:  # who does not get past people is never the best
        stuck = "; cars that are often stuck stand above" if any(map(does_not_get_past, rows)) else ""
        order = f"By {_RANKED[ranked_by]}, the safest car last{stuck}"
        rows = sorted(rows, key=lambda one: (not does_not_get_past(one), float(one[ranked_by])))
    heads = ["car", "margin\n(m)", "95 %\nby φ", "nominal\ncollisions", "risk\nR(1)", "time\nlost (s)"]
    heads.append("equivalent\nmultiplier")
    cells = [
        [
            f"{escape(row['car'])}{credibility_mark(row)}",
            bounded_cell(row, _number(row["margin"])),
            _number(row["margin_ci95"], 2),
            TERMINAL.share(row["nominal_collision_rate"]),
            TERMINAL.probability(row["risk_1"]),
            "—" if never_passes(row) else _number(row.get("time_lost"), 1),
            bounded_cell(row, row["equivalent_multiplier_text"] or "—"),
        ]
        for row in rows
    ]
    return narrow_table(order, heads, cells)


_RANKED = {key: AT_THE_TOP[key].label for key in ("margin", "deviation")}


def verdict_table(entries: Sequence[Mapping[str, Any]], first: str, confidence: float) -> Table:
    """Return the table of what the other cars are beside the first, from the entries of comparison.json."""
    heads = ["car", "verdict", "by", "difference", f"{100 * confidence:.3g} %\nby φ", "effect\nsize", "p", "how"]
    cells = []
    for entry in entries:
        shown = entry["judged_by"] or next((one for one in _RANKED if one in entry["differences"]), "")
        found = entry["differences"].get(shown)
        figures = ["—"] * 5
        if found is not None:
            # The scales of the risk share what is left to err.
            holds = "" if found["confidence"] == confidence else f"{100 * found['confidence']:.3g} %: "
            figures = [AT_THE_TOP[shown].label, f"{found['difference']:+.3f}", holds + _number(found["interval"])]
            figures.append("—" if found["effect_size"] is None else f"{found['effect_size']:+.2f}")
            figures.append("—" if found["p_value"] is None else f"{found['p_value']:.2g}")
        verdict = f"[bold]{_short(entry)}[/]" + (f" ({entry['reason']})" if entry["reason"] else "")
        cells.append([escape(entry["car"]), verdict, *figures, entry["design"]])
    return narrow_table(f"Compared with {escape(first)}; all intervals together hold with 95 %", heads, cells)


def _short(entry: Mapping[str, Any]) -> str:
    """Return a verdict with its price in few words."""
    verdict = str(entry["verdict"])
    if not verdict.endswith(EACH):
        return verdict
    said = verdict.partition(" at the price")[0].partition(",")[0]
    later = entry["price"]["difference"]
    return f"{said}, {abs(later):.1f} s {'slower' if later > 0.0 else 'quicker'}"


def _plus_minus(value: float | None, interval: Sequence[float] | None) -> str:
    """Return a mean with half its normal interval, as the paper writes it."""
    if value is None or interval is None:
        return _number(value, 2)
    return f"{value:.2f} ± {0.5 * (interval[1] - interval[0]):.2f}"


def sweep_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Return the table of a sweep: one section per kind of safe trajectories, one row per multiplier; 80 columns wide.

    What follows ± takes pairs as independent, as the paper does.
    """
    heads = ["φ, C", "margin\n(m)", "95 %,\nby φ", "planned\n(m)", "95 %,\nby φ", "coll.\nrate (%)", "SKD (m)\n± 95 %"]
    heads.append("collide\n(%)")
    table = narrow_table("Margin, planned deviation, contact rate and SKD against the multiplier C", heads)
    for kind, some in itertools.groupby(rows, key=lambda row: str(row["kind"])):
        table.add_section()
        table.add_row(f"[bold]{kind}[/]")
        for row in some:
            margin = f"[bold]{_number(row['margin'], 3)}[/]", _number(row["margin_ci95"], 2)
            deviation = _number(row["deviation"], 3), _number(row["deviation_ci95"], 2)
            contact, collide = (BARE.share(row[key]) for key in ("contact_rate", "kamikaze_success_rate"))
            skd = _plus_minus(row["skd"], row["skd_ci95_pairs"])
            table.add_row(f"  {row['multiplier']:.3f}", *margin, *deviation, contact, skd, collide)
    return table
