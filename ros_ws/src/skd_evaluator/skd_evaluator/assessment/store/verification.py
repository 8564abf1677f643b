"""`skd verify`: whether a result is what was written, and whether its figures follow from its episodes."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from skd_sim.errors import UsageError
from skd_sim.inputs.outside import folders_in, read_json, sha256_of

from skd_evaluator.assessment.judge.figure_table import AT_THE_TOP, Told
from skd_evaluator.assessment.store.manifest import MANIFEST, Held, hold, read_manifest
from skd_evaluator.assessment.store.recomputation import rating_of
from skd_evaluator.assessment.store.result_file import ASSESSMENT, read_figures, understood
from skd_evaluator.assessment.store.stored_episodes import read_episodes
from skd_evaluator.metrics.credibility import not_credible

_CAMPAIGN = "campaign.json"
_AGREE = 1e-7
"""Relative to a figure, or to 1: what another machine's rounding may come to in an interval, which is searched for."""
_KEPT = (("vulnerability_curve", "budgets"), ("risk", "behaviour"))
"""Parts of figures that do not follow from the episodes: kamikazes that are not kept, and a model that was given."""


@dataclass(frozen=True)
class Verified:
    """What was found out about a folder.

    Attributes:
        folder: folder that was looked at.
        files: comparison of its files with its manifest; None if it has no manifest.
        agree: names of figures that follow from its episodes.
        contradict: figures that do not, a line each.
        unknown: names of figures that cannot be recomputed from the folder, by the reason.
        problems: whatever else is wrong, a line each.
        remarks: remarks for the reader, a line each.
    """

    folder: Path
    files: Held | None
    agree: tuple[str, ...] = ()
    contradict: tuple[str, ...] = ()
    unknown: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    problems: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()

    @property
    def fine(self) -> bool:
        """Whether nothing was found that speaks against the folder."""
        files = self.files
        return not (self.contradict or self.problems or (files is not None and (files.changed or files.missing)))

    def as_dict(self) -> dict[str, Any]:
        """Return it as JSON has it."""
        files = self.files
        parts = ("same", "changed", "missing", "others")
        return {
            "folder": str(self.folder),
            "fine": self.fine,
            "files": None if files is None else {name: list(getattr(files, name)) for name in parts},
            "agree": list(self.agree),
            "contradict": list(self.contradict),
            "unknown": {reason: list(names) for reason, names in self.unknown.items()},
            "problems": list(self.problems),
            "remarks": list(self.remarks),
        }


def folders_below(folder: Path) -> list[Path]:
    """Return the folders of results at and below one, itself first; links are not followed.

    Raises:
        UsageError: there is none, or a folder cannot be looked into.
    """
    if not folder.is_dir():
        raise UsageError(f"{folder}: no such folder; give that of a result")

    def refuse(path: Path, why: str) -> None:
        raise UsageError(f"{path}: {why}")

    names = {ASSESSMENT, MANIFEST, _CAMPAIGN}
    found = sorted(path for path, _, files in folders_in(folder, refuse) if names & set(files))
    if not found:
        raise UsageError(f"{folder}: holds no {ASSESSMENT} and no {MANIFEST}; give the folder of a result")
    return found


def verify(folder: Path) -> Verified:
    """Return what is to be said of a folder of a result, whatever is wrong with it."""
    files, problems, remarks = None, [], []
    agree: tuple[str, ...] = ()
    contradict: tuple[str, ...] = ()
    unknown: dict[str, tuple[str, ...]] = {}
    try:
        manifest = read_manifest(folder)
        if manifest is not None:
            files = hold(folder, manifest)
        elif not (folder / _CAMPAIGN).exists():
            remarks.append(f"no {MANIFEST}: that a file was changed cannot be told")
        if (folder / _CAMPAIGN).exists():
            problems += _rows_that_differ(folder)
        if ASSESSMENT in {path.name for path in folder.iterdir()} | {*(manifest or {})}:
            figures, stored = read_figures(folder), read_episodes(folder)
            remarks += not_credible(figures.get("warnings") or ())
            with understood(folder / ASSESSMENT):
                found = json.loads(json.dumps(rating_of(figures, stored).as_dict()))
                agree, contradict = _compared(figures, found)
            for reason, rows in _not_from_episodes(figures).items():
                unknown[reason] = rows
    except UsageError as error:
        problems.append(str(error))
    return Verified(folder, files, agree, contradict, unknown, tuple(problems), tuple(remarks))


def _follows(name: str) -> bool:
    """Return whether an entry at the top of assessment.json follows from the episodes beside it."""
    return name in AT_THE_TOP and AT_THE_TOP[name].told is Told.EPISODES


def _not_from_episodes(figures: Mapping[str, Any]) -> dict[str, tuple[str, ...]]:
    """Return the names of the entries that do not follow from the episodes, by the reason."""
    reasons: dict[str, list[str]] = {}
    for name in figures:
        if name in AT_THE_TOP and not _follows(name):
            reasons.setdefault(str(AT_THE_TOP[name].told), []).append(name)
    return {reason: tuple(names) for reason, names in reasons.items()}


def _compared(figures: Mapping[str, Any], found: dict[str, Any]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return which figures are those that were found again, and in a line each what the others are."""
    for name, part in _KEPT:
        if figures.get(name) and found.get(name):
            found[name][part] = figures[name].get(part)
    agree, contradict = [], []
    for name in dict.fromkeys((*figures, *found)):
        if _follows(name.partition("_ci95")[0]):
            differences = [*_differences(name, figures.get(name), found.get(name))]
            contradict += differences
            agree += [] if differences else [name]
    return tuple(agree), tuple(contradict)


def _differences(name: str, said: Any, found: Any) -> Iterator[str]:
    """Yield, a line each, where two values of JSON differ by more than rounding."""
    if isinstance(said, Mapping) and isinstance(found, Mapping):
        for key in dict.fromkeys((*said, *found)):
            yield from _differences(f"{name}.{key}", said.get(key), found.get(key))
    elif isinstance(said, list) and isinstance(found, list) and len(said) == len(found):
        for place, (one, other) in enumerate(zip(said, found, strict=True)):
            yield from _differences(f"{name}.{place}", one, other)
    elif not _alike(said, found):
        yield f"{name} is {_shown(said)}, its episodes give {_shown(found)}"


def _alike(said: Any, found: Any) -> bool:
    if isinstance(said, float) or isinstance(found, float):
        numbers = all(isinstance(one, (int, float)) and not isinstance(one, bool) for one in (said, found))
        return numbers and abs(said - found) <= _AGREE * max(1.0, abs(said), abs(found))
    return bool(said == found)


def _shown(value: Any) -> str:
    if value is None:
        return "nothing"
    return f"{value:.6g}" if isinstance(value, float) else f"{value!r:.60}"


def _rows_that_differ(folder: Path) -> list[str]:
    """Return which rows of a campaign are not of the results in the folders of its cells, a line each."""
    path, found = folder / _CAMPAIGN, []
    with understood(path):
        for row in read_json(path)["cells"]:
            for name, digest in row["sha256"].items():
                if sha256_of(folder / row["name"] / name) != digest:
                    found.append(f"{path}: cell {row['name']}: {name} is not the file that the row is of")
    return found
