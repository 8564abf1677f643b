"""`skd verify`: whether the files of a result are what was written, and whether its figures follow from its episodes.

The assessment is computed again from episodes.npz by the functions that computed it first. Nothing that the file names
is imported. What a car is called, how much was searched and what was requested stay what assessment.json says of them.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from skd_sim.errors import UsageError
from skd_sim.inputs.files import folders_in, read_json, sha256_of

from skd_evaluator.assessment.assessment import Assessment
from skd_evaluator.assessment.failures import Walkers, failures_of
from skd_evaluator.assessment.figure_table import AT_THE_TOP
from skd_evaluator.assessment.files.assessment_json import ASSESSMENT, read_figures, understood
from skd_evaluator.assessment.files.episodes_npz import StoredEpisodes, failing_episodes, read_episodes
from skd_evaluator.assessment.files.result_folder import CHANGED, GONE, MANIFEST, compared, read_manifest
from skd_evaluator.assessment.files.results import assessment_from_file, differences
from skd_evaluator.files import check_folder
from skd_evaluator.metrics.aborted import not_credible
from skd_evaluator.metrics.behaviour.model import NAMES

_CAMPAIGN = "campaign.json"
_KEPT = (("vulnerability_curve", "budgets"), ("risk", "behaviour"))
"""Parts of figures that do not follow from the episodes: kamikazes that are not kept, and a model that was given."""


@dataclass(frozen=True)
class Verified:
    """What was found out about a folder.

    Attributes:
        folder: folder that was looked at.
        files: files that are not as its manifest has them, what is wrong by name; None if it has no manifest.
        agree: names of figures that follow from its episodes.
        contradict: figures that do not, a line each.
        unknown: names of figures that cannot be recomputed from the folder.
        problems: whatever else is wrong, a line each.
        remarks: remarks for the reader, a line each.
    """

    folder: Path
    files: Mapping[str, str] | None
    agree: tuple[str, ...] = ()
    contradict: tuple[str, ...] = ()
    unknown: tuple[str, ...] = ()
    problems: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()

    @property
    def fine(self) -> bool:
        """Whether nothing was found that speaks against the folder."""
        return not (self.contradict or self.problems or {CHANGED, GONE} & {*(self.files or {}).values()})

    def as_dict(self) -> dict[str, Any]:
        """Return it as JSON has it."""
        return {**dataclasses.asdict(self), "folder": str(self.folder), "fine": self.fine}


def folders_below(folder: Path) -> list[Path]:
    """Return the folders of results at and below one, itself first; links are not followed.

    Raises:
        UsageError: there is none, or a folder cannot be looked into.
    """
    check_folder(folder)

    def refuse(path: Path, why: str) -> None:
        raise UsageError(f"{path}: {why}")

    names = {ASSESSMENT, MANIFEST, _CAMPAIGN}
    found = sorted(path for path, _, files in folders_in(folder, refuse) if names & set(files))
    if not found:
        raise UsageError(f"{folder}: holds no {ASSESSMENT} and no {MANIFEST}; give the folder of a result")
    return found


def verify(folder: Path) -> Verified:
    """Return what is to be said of a folder of a result, whatever is wrong with it."""
    found = Verified(folder, None)
    try:
        manifest = read_manifest(folder)
        if manifest is not None:
            found = replace(found, files=compared(folder, manifest))
        elif not (folder / _CAMPAIGN).exists():
            found = replace(found, remarks=(f"no {MANIFEST}: that a file was changed would not be seen",))
        if (folder / _CAMPAIGN).exists():
            found = replace(found, problems=_rows_that_differ(folder))
        if (folder / ASSESSMENT).exists() or ASSESSMENT in (manifest or {}):
            figures, stored = read_figures(folder), read_episodes(folder)
            found = replace(found, remarks=(*found.remarks, *not_credible(figures.get("warnings") or ())))
            with understood(folder / ASSESSMENT):
                again = json.loads(json.dumps(_with_failures(assessment_from_file(figures, stored), stored).as_dict()))
                agree, contradict = _compared(figures, again)
            unknown = tuple(name for name in figures if name in AT_THE_TOP and not AT_THE_TOP[name].recomputed)
            found = replace(found, agree=agree, contradict=contradict, unknown=unknown)
    except UsageError as error:
        found = replace(found, problems=(*found.problems, str(error)))
    return found


def _with_failures(assessment: Assessment, stored: StoredEpisodes) -> Assessment:
    """Return the assessment with the most likely failures, computed anew but for what the car did.

    Raises:
        ValueError, LookupError: those that are kept are others.
    """
    risks, scenario = assessment.risks, assessment.plan.scenario
    if risks is None:
        return assessment
    parameters = risks.behaviour["parameters"]
    values = np.array([float(parameters[name]["value"]) for name in NAMES])
    walkers = Walkers(scenario, stored.safe, int(stored.further["seed"]), values)
    found, failing = failures_of(risks.scales, walkers), failing_episodes(stored)
    rows = [] if found is None else sorted(one.row for one in found.nearest)
    if found is None:
        if len(failing):
            raise ValueError("failures are kept, and no crossing is one")
        return assessment
    if rows != stored.further["risk_failure"].tolist():
        raise ValueError("the failures that are kept are not those nearest to how people walk")
    failures = found.with_speeds(dict(zip(rows, failing.impact_speed.tolist(), strict=True)))
    return replace(assessment, risks=replace(risks, failures=failures))


def _compared(figures: Mapping[str, Any], found: dict[str, Any]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return which figures are those that were found again, and in a line each what the others are."""
    for name, part in _KEPT:
        if figures.get(name) and found.get(name):
            found[name][part] = figures[name].get(part)
    agree, contradict = [], []
    for name in dict.fromkeys((*figures, *found)):
        figure = AT_THE_TOP.get(name.partition("_ci95")[0])
        if figure is not None and figure.recomputed:
            said = [*differences(name, figures.get(name), found.get(name))]
            contradict += said
            agree += [] if said else [name]
    return tuple(agree), tuple(contradict)


def _rows_that_differ(folder: Path) -> tuple[str, ...]:
    """Return which rows of a campaign are not of the results in the folders of its cells, a line each."""
    path = folder / _CAMPAIGN
    with understood(path):
        return tuple(
            f"{path}: cell {row['name']}: {name} is not the file that the row is of"
            for row in read_json(path)["cells"]
            for name, digest in row["sha256"].items()
            if sha256_of(folder / row["name"] / name) != digest
        )
