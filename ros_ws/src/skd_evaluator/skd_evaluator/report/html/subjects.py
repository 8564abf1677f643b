"""What a report is of: the assessments in the folders that it was asked for."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.errors import UsageError
from skd_sim.inputs.files import read_json, real_path
from skd_sim.options.adversary import RANKING_OBJECTIVES, first_of
from skd_sim.scenario.scenario import Scenario

from skd_evaluator.assessment.assessment import Assessment
from skd_evaluator.assessment.files.episodes_npz import StoredEpisodes, failing_episodes
from skd_evaluator.assessment.files.results import read_checked, result_folders
from skd_evaluator.files import tails
from skd_evaluator.metrics.aborted import not_credible
from skd_evaluator.report.formats import kept_failures


@dataclass(frozen=True, eq=False)
class Subject:
    """An assessment of one car.

    Attributes:
        folder: folder of the assessment.
        label: name in the report, which no other assessment in it has.
        kind: kind of φ if the assessment is part of a sweep, else empty.
        figures: content of assessment.json.
        episodes: content of episodes.npz.
        assessment: what follows from these.
        remarks: remarks on its figures, a line each.
    """

    folder: Path
    label: str
    kind: str
    figures: Mapping[str, Any]
    episodes: StoredEpisodes
    assessment: Assessment
    remarks: tuple[str, ...] = ()

    @property
    def ranking_objective(self) -> str:
        """The objective whose kamikazes rank the car."""
        return first_of(RANKING_OBJECTIVES, self.figures["objectives"])

    @property
    def ranking(self) -> Mapping[str, Any]:
        """The figures of those kamikazes."""
        found: Mapping[str, Any] = self.figures["objectives"][self.ranking_objective]
        return found

    @property
    def warnings(self) -> list[str]:
        """Remarks on its figures, and why they are not credible, a line each."""
        return [*self.remarks, *not_credible(self.figures["warnings"] or ())]

    @property
    def curve(self) -> Mapping[str, Any] | None:
        """The vulnerability curve; None where no kamikaze ran."""
        found: Mapping[str, Any] | None = self.figures["vulnerability_curve"]
        return found

    @property
    def scenario(self) -> Scenario:
        """Scenario of the test."""
        return self.assessment.plan.scenario

    @cached_property
    def margins(self) -> tuple[FloatArray, ...]:
        """Per φ what each trial of the margin counts as, m; none of each where it is not known."""
        margins = self.assessment.margins
        return (np.empty(0),) * len(self.episodes.safe) if margins is None else margins.per_phi

    @cached_property
    def failing(self) -> StoredEpisodes:
        """The most likely failures of the risk that are kept, as episodes, kind by kind (`kept_failures`)."""
        return failing_episodes(self.episodes, [one.row for one in kept_failures(self.figures)])

    @cached_property
    def safe_key(self) -> bytes:
        """Equal for subjects of the same φ, in the same order."""
        return b"|".join(one.tobytes() for one in self.episodes.safe)


def scenarios_of(subjects: Sequence[Subject]) -> list[str]:
    """Return the names of the scenarios, in the order in which they come."""
    return list(dict.fromkeys(one.scenario.name for one in subjects))


def read_subjects(folders: Sequence[Path]) -> list[Subject]:
    """Return the assessments in folders of assessments, sweeps and campaigns, in the order given.

    Raises:
        UsageError: a folder holds none, or one that is damaged or of another version.
    """
    if len(set(map(real_path, folders))) < len(folders):
        raise UsageError("a folder is given twice")
    found: list[Subject] = []
    for folder in folders:
        if (folder / "assessment.json").exists():
            found.append(_read(folder, ""))
        elif (folder / "sweep.json").exists():
            found += _read_sweep(folder)
        elif (folder / "campaign.json").exists():
            found += _read_campaign(folder)
        else:
            found += [_read(place, "") for place in result_folders([folder])]
    return _with_labels(found)


def _read_sweep(folder: Path) -> list[Subject]:
    parts = sorted(folder.glob("*/C_*/assessment.json"))
    if not parts:
        raise UsageError(f"{folder}: a sweep without its assessments (KIND/C_…/assessment.json)")
    found = [_read(part.parent, part.parent.parent.name) for part in parts]
    if strange := next((one.folder for one in found if one.figures["multiplier"] is None), None):
        raise UsageError(f"{strange}: is of a car without a multiplier C, and so of no sweep")
    return sorted(found, key=lambda one: (one.kind != "synthetic", one.kind, float(one.figures["multiplier"])))


def _read_campaign(folder: Path) -> list[Subject]:
    path = folder / "campaign.json"
    content = read_json(path)
    try:
        names = [str(row["name"]) for row in content["cells"] if row["state"] == "done"]
    except (KeyError, TypeError) as error:
        raise UsageError(f"{path}: is not of a campaign") from error
    if strange := next((name for name in names if Path(name).name != name), None):
        raise UsageError(f"{path}: {strange!r} is no name of a cell's folder")
    if not names:
        raise UsageError(f"{folder}: a campaign of which no cell is done")
    return [_read(folder / name, "") for name in names]


def _read(folder: Path, kind: str) -> Subject:
    figures, episodes, assessment, remarks = read_checked(folder)
    return Subject(folder, str(figures["car"]), kind, figures, episodes, assessment, remarks)


def _with_labels(subjects: Sequence[Subject]) -> list[Subject]:
    """Return subjects that have a label of their own: the car, where need be with its φ, else with its folder."""
    cars = Counter(one.label for one in subjects)
    with_kind = Counter((one.label, one.kind) for one in subjects)
    found = []
    for one, tail in zip(subjects, tails([one.folder for one in subjects]), strict=True):
        label = one.label
        if cars[label] > 1:
            alone = one.kind and with_kind[one.label, one.kind] == 1
            label = f"{label} ({one.kind} φ)" if alone else f"{label} ({tail})"
        found.append(replace(one, label=label))
    return found
