"""Rows of a campaign: what campaign.json says of each cell, always made from the cell's own folder.

Nothing is read back from campaign.json. A cell's folder is checked like any result: its files must be unchanged.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from skd_sim.errors import UsageError
from skd_sim.inputs.outside import sha256_of
from skd_sim.options.options import further_options

from skd_evaluator.assessment.judge.figure_table import columns
from skd_evaluator.assessment.judge.rating import Rating
from skd_evaluator.assessment.stages.findings import warnings_of, why_failed
from skd_evaluator.assessment.store.manifest import MANIFEST, check_unchanged
from skd_evaluator.assessment.store.recomputation import rating_of
from skd_evaluator.assessment.store.result_file import ASSESSMENT, read_figures, understood
from skd_evaluator.assessment.store.stored_episodes import EPISODES, read_episodes
from skd_evaluator.extensions.campaign.cell import Cell

FIGURES = columns("campaign")
OF_PLANS = ("knowledge", "ranking_objective")
"""Of a row: by whom its planned figures are."""
FIRST = ("name", "state", "controller", "multiplier", "scenario", "safe", "seed")
CHECKED = (ASSESSMENT, EPISODES)
OPEN, DONE, FAILED = "open", "done", "failed"

Row = dict[str, Any]


def open_row(cell: Cell) -> Row:
    """Return the row of a cell that is to be run."""
    plan = cell.plan
    return {
        "name": cell.name,
        "state": OPEN,
        "controller": plan.controller,
        "multiplier": plan.car.stated_multiplier,
        "scenario": plan.scenario.name,
        "safe": plan.safe,
        "seed": plan.seed,
        **{f"sweep.{key}": value for key, value in cell.swept.items() if key not in FIRST},
        "episodes": None,
        **dict.fromkeys((*OF_PLANS, *FIGURES)),
        "equivalent_multiplier_note": "",
        "problems": [],
        "warnings": [],
        "sha256": {},
    }


def done_row(
    cell: Cell,
    figures: Mapping[str, Any],
    rating: Rating,
    *,
    maximum_aborted: float,
    digests: Mapping[str, str],
) -> Row:
    """Return the row of a cell that is done.

    Args:
        cell: the cell that is done.
        figures: content of its assessment.json.
        rating: its figures.
        maximum_aborted: share of its episodes that may be aborted.
        digests: SHA-256 of the files that hold its result.
    """
    rating = replace(rating, warnings=tuple(figures["warnings"]))
    return {
        **open_row(cell),
        "state": DONE,
        **{name: figures[name] for name in FIGURES},
        "knowledge": str(figures["knowledge"]),
        "ranking_objective": str(rating.for_deviation.plan.objective),
        "equivalent_multiplier_note": figures["equivalent_multiplier_note"],
        "episodes": rating.episodes,
        "problems": why_failed(rating, maximum_aborted, figures),
        "warnings": warnings_of(rating),
        "sha256": dict(digests),
    }


def row_of(cell: Cell, folder: Path, maximum_aborted: float) -> Row | None:
    """Return the row of a cell whose folder is there and whole; None where it is to be run.

    Args:
        cell: the cell.
        folder: folder of its result.
        maximum_aborted: share of its episodes that may be aborted.

    Raises:
        UsageError: the folder is of another cell, is not what was written, or contradicts itself.
    """
    if not folder.is_dir():
        return None
    try:
        if not check_unchanged(folder, CHECKED):
            raise UsageError(f"{folder}: has no {MANIFEST}: nobody knows whether it is what was written")
        digests = {name: sha256_of(folder / name) for name in CHECKED}
        figures = read_figures(folder)
        stored = read_episodes(folder)
        with understood(folder / ASSESSMENT):
            _check_cell(cell, folder, figures, len(stored.safe))
            rating = rating_of(figures, stored)
            return done_row(cell, figures, rating, maximum_aborted=maximum_aborted, digests=digests)
    except UsageError as error:
        raise UsageError(f"{error}; remove {folder}, and --resume makes it again") from error


def _check_cell(cell: Cell, folder: Path, figures: Mapping[str, Any], safe_count: int) -> None:
    """Refuse a folder that holds the result of another cell."""
    plan = cell.plan
    asked = {
        "controller": plan.controller,
        "multiplier": plan.car.stated_multiplier,
        "safe": plan.safe,
        "seed": plan.seed,
        "simulations": plan.simulations,
        "knowledge": str(plan.knows),
        "maximum_distance": plan.maximum_distance,
        "scenario": json.loads(json.dumps(plan.scenario.as_dict())),
    }
    wrong = next((name for name, value in asked.items() if figures[name] != value), None)
    if wrong is None and _without_knowledge(figures["options"]) != _without_knowledge(further_options(plan)):
        wrong = "options"
    if wrong is None and set(figures["objectives"]) != set(map(str, cell.objectives)):
        wrong = "objectives"
    if wrong is None and safe_count != plan.safe_count:
        wrong = "number of φ"
    if wrong is not None:
        raise UsageError(f"{folder}: is the result of another cell: its {wrong} differs")


def _without_knowledge(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return options but what the adversary knows, as they are read from a file.

    A plan that is to learn has to say so; after that its model implies it, and the result leaves it out.
    """
    return {name: value for name, value in json.loads(json.dumps(options)).items() if name != "knowledge"}
