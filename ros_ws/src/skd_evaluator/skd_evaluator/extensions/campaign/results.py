"""What `skd campaign` runs and prints: cells in process and through the graph, how to go on, and what they came to."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.markup import escape
from rich.table import Table
from skd_sim.errors import OutOfReachError, UsageError
from skd_sim.world.episode import EpisodeSpec

from skd_evaluator.assessment.compare.gate import Limit
from skd_evaluator.assessment.files.assessment_json import read_figures
from skd_evaluator.assessment.from_options import inputs_of, refuse_to_replace
from skd_evaluator.assessment.run.workers import available_workers
from skd_evaluator.assessment.stages.margin import margins_compiled_in_background
from skd_evaluator.assessment.stages.pipeline import compile_for_graph, planners_of
from skd_evaluator.assessment.stages.risk import warm_up_risk
from skd_evaluator.cli.arguments import output_path, runner_of
from skd_evaluator.cli.gate import limit_failures, limits_of
from skd_evaluator.cli.output import EXIT_INTERRUPTED, finish, print_json, say, warn
from skd_evaluator.extensions.campaign import cells as of_cells
from skd_evaluator.extensions.campaign.campaign import Campaign, CampaignFolder
from skd_evaluator.extensions.campaign.cells import DONE, FAILED, Cell, Combination
from skd_evaluator.report.formats import counted, number, percent
from skd_evaluator.report.progress import progress_bar
from skd_evaluator.report.repeat import program
from skd_evaluator.report.terminal import bounded_cell, credibility_mark, narrow_table, print_table
from skd_evaluator.ros.session import prepare_ros

_CELLS_ON_A_CLUSTER = 8


def run_campaign(arguments: argparse.Namespace) -> int:
    """Run what a file says, or only say what there would be; return the exit code."""
    limits = limits_of(arguments)
    combinations = of_cells.read_campaign(arguments.path)
    if arguments.dry_run:
        return _say_plan(of_cells.make_cells(combinations), arguments)
    done = run_combinations(combinations, arguments)
    return EXIT_INTERRUPTED if done is None else _say_result(*done, arguments, limits)


def run_combinations(
    combinations: Sequence[Combination], arguments: argparse.Namespace
) -> tuple[Mapping[str, Any], Path] | None:
    """Run the cells of a campaign; return the content of campaign.json and the folder; None: interrupted.

    Raises:
        UsageError: a cell cannot run, or the folder cannot be taken.
        OutOfReachError: no episode can be run any more.
    """
    if arguments.resume and arguments.overwrite:
        raise UsageError("--resume goes on with what --overwrite replaces: give one of them")
    if arguments.resume and arguments.out is None:
        raise UsageError("--resume needs --out: the folder of the campaign to go on with")
    cells = of_cells.make_cells(combinations)
    _prepare_graphs(cells)
    out = output_path(arguments)
    if arguments.overwrite:
        reads = [path for one in combinations for path in inputs_of({**one.values, "scenario": one.scenario})]
        refuse_to_replace(out, reads)
    folder = CampaignFolder(out, cells, resume=arguments.resume, overwrite=arguments.overwrite)
    try:
        campaign = Campaign(cells, folder, arguments.command_line, maximum_aborted=arguments.max_aborted)
        try:
            if folder.resumed:
                say("campaign", *([] if arguments.quiet else [_state(campaign)]))
                unknown = dict.fromkeys(cell.plan.car.label for cell in cells if cell.identity["file"] is None)
                why = "are not known: nothing says whether it is the same car"
                warn("campaign", [f"the files of {one} {why}" for one in unknown])
            _run_cells(campaign, arguments)
        except KeyboardInterrupt:
            if arguments.json:
                print_json({"interrupted": True, **campaign.content})
            say(arguments.command, f"interrupted; {_state(campaign)}; go on with: {_go_on(arguments, out)}")
            return None
        except OutOfReachError as error:
            raise OutOfReachError(f"{error}; {_state(campaign)}; go on with: {_go_on(arguments, out)}") from error
        finally:
            campaign.close()
        return campaign.content, out
    finally:
        folder.close()


def _prepare_graphs(cells: Sequence[Cell]) -> None:
    """See that the node graph can be run where a cell needs it."""
    options = [(cell.graph, cell) for cell in cells if cell.graph is not None]
    for one, cell in options:
        try:
            one.check(cell.plan.car)
        except UsageError as error:
            raise UsageError(f"{cell.where}: {error}") from error
    for one in dict.fromkeys(one for one, _ in options):
        prepare_ros(one)


def _run_cells(campaign: Campaign, arguments: argparse.Namespace) -> None:
    if in_process := campaign.in_process:
        isolated = any(cell.plan.runs_others_code for cell in in_process)
        margins = any(cell.requested["margin_limit"] for cell in in_process)
        limit = max(cell.answer_limit for cell in in_process)
        with runner_of(arguments, isolated=isolated, answer_limit=limit) as runner:
            with margins_compiled_in_background(needed=margins) as load_margins:
                for cell in in_process:
                    if cell.requested["risk"].behaviour is not None:
                        warm_up_risk(cell.plan)
                runner.start(_planners(in_process), inherited=load_margins)
            import skd_evaluator.report.pictures  # noqa: F401 - it may start a program: see `Campaign`

            # While one cell has few episodes left, another has many.
            threads = _CELLS_ON_A_CLUSTER if arguments.scheduler else min(2, arguments.workers or available_workers())
            with progress_bar(quiet=arguments.quiet) as progress:
                campaign.run(runner, progress, threads)
    if through_graph := campaign.through_graph:
        for cell in through_graph:
            compile_for_graph(cell.plan, cell.requested["objectives"])
        with progress_bar(quiet=arguments.quiet) as progress:
            campaign.run_graphs(progress)


def _planners(cells: Sequence[Cell]) -> list[EpisodeSpec]:
    """Return short episodes that make the planners of all cells compile, one for those that share theirs."""
    found: dict[tuple[object, ...], EpisodeSpec] = {}
    for cell in cells:
        for episode in planners_of(cell.plan, cell.requested["objectives"]):
            kind = (episode.mode, episode.objective, episode.car_model, episode.car, episode.scenario.car.dynamics)
            found.setdefault(kind, episode)
    return list(found.values())


def _state(campaign: Campaign) -> str:
    """Return how far a campaign is, in words."""
    done = f"{campaign.content['done']} of {counted(len(campaign.rows), 'cell')} done"
    return f"{done}, and {counted(campaign.kept_episodes, 'episode')} of the others kept"


def _go_on(arguments: argparse.Namespace, out: Path) -> str:
    """Return the command that goes on with a campaign."""
    words = [word for word in arguments.command_line if word not in ("--overwrite", "--resume")]
    if arguments.out is None:
        words += ["--out", str(out)]
    return shlex.join([program(), *words[1:], "--resume"])


def _say_plan(cells: Sequence[Cell], arguments: argparse.Namespace) -> int:
    rows, keys = of_cells.planned_rows(cells), ("name", "scenario", "safe", "episodes", "most")
    total, most = (sum(row[key] for row in rows) for key in ("episodes", "most"))

    def show() -> None:
        shown = [[escape(str(row[key])) for key in keys] for row in rows]
        print_table(narrow_table("Cells", ("cell", "scenario", "safe", "episodes", "at most"), shown))
        print(f"{counted(len(rows), 'cell')}, {total} episodes; at most {most} where kamikazes fail")

    return finish(arguments, {"cells": rows, "episodes": total, "most": most}, show)


def _say_result(content: Mapping[str, Any], out: Path, arguments: argparse.Namespace, limits: Sequence[Limit]) -> int:
    rows = content["cells"]

    def show() -> None:
        print_table(campaign_table(rows))
        print(f"{content['seconds']:.1f} s; results in {out}")

    refusal = [content["planned_refusal"]] if content["planned_refusal"] else []
    warnings = [f"{row['name']}: {line}" for row in rows for line in row["warnings"]]
    failures = [
        f"{row['name']}: {'failed: ' if row['state'] == FAILED else ''}{problem}"
        for row in rows
        for problem in row["problems"]
    ]
    if limits:
        done = [str(row["name"]) for row in rows if row["state"] == DONE]
        failures += limit_failures(limits, {name: read_figures(out / name) for name in done})
    return finish(arguments, content, show, [*refusal, *warnings], failures)


def campaign_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Return the table of what cells came to, from the content of campaign.json; red: a margin had not converged."""
    heads = ["cell", "margin\n(m)", "95 %,\nby φ", "equiv.\nC", "nominal\ncollisions", "time\nlost (s)", "planned\n(m)"]
    heads += ["adversary\nmodel", "SKD\n(m)"]
    cells = [
        [
            f"{escape(str(row['name']))}{credibility_mark(row)}",
            bounded_cell(row, number(row["margin"])),
            number(row["margin_ci95"]),
            bounded_cell(row, number(row["equivalent_multiplier"])),
            percent(row["nominal_collision_rate"]),
            number(row["time_lost"], 1),
            number(row["deviation"]),
            str(row["adversary_model"]),
            number(row["skd"]),
        ]
        if row["sha256"]
        else [escape(str(row["name"])), f"[red]{row['state']}[/]"]
        for row in rows
    ]
    return narrow_table("What the cells came to", heads, cells)
