"""The files that options name to be read: what is written must take the place of none of them."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from skd_adversary.safe_trajectories import REGULATORY
from skd_sim.errors import UsageError
from skd_sim.inputs.files import real_path
from skd_sim.options.car_under_test import CarUnderTest
from skd_sim.scenario.scenario_file import SCENARIOS, is_named, lineage

from skd_evaluator.assessment.plan.options import NO_BEHAVIOUR, OWN, SYNTHETIC
from skd_evaluator.metrics.behaviour import WALKERS
from skd_evaluator.provenance import code_paths

_WRITTEN = ("out", "junit", "markdown", "csv")
"""Options that name what is written."""
_WORDS = (None, "", SYNTHETIC, OWN, REGULATORY, WALKERS, NO_BEHAVIOUR)
"""Values that name no file where a path is expected."""


def inputs_of(values: Mapping[str, Any]) -> list[Path]:
    """Return the files and folders that options name to be read, whether they are there or not.

    A node's own command line is no such option: what it reads is not known.

    Args:
        values: values of options by name, of the command line, of a campaign's cell or of the evaluator's node.
    """
    found = [one for name, value in values.items() if name not in _WRITTEN for one in _paths(value)]
    if values.get("safe") not in _WORDS:
        found.append(Path(str(values["safe"])))
    models = [values.get(name) for name in ("car_model", "behaviour")]
    found += [_expanded(str(name)) for name in models if name not in _WORDS]
    found += map(_expanded, values.get("message_folder") or ())
    scenarios = [values.get("scenario"), *(values.get("names") or ())]
    if isinstance(listed := values.get("scenarios"), str):
        scenarios += [name.strip() for row in csv.reader([listed]) for name in row]
    found += [path for name in scenarios if name for path in _files_of_scenario(str(name))]
    if values.get("controller"):
        found += code_paths(CarUnderTest(str(values["controller"])))
    return list(dict.fromkeys(found))


def refuse_to_replace(out: Path, paths: Iterable[Path], option: str = "--out") -> None:
    """Refuse an output that is, or holds, what is read: it would be replaced.

    Args:
        out: where the file is to be, or the folder.
        paths: what is read.
        option: the option that names the output, for error lines.

    Raises:
        UsageError: it is so.
    """
    for path in (one for one in paths if lies_in(one, out)):
        if out.is_file():
            raise UsageError(f"{option} {out}: is read by this command; give another file")
        raise UsageError(f"{option} {out}: holds {path}, which this command reads; give another folder")


def lies_in(path: Path, folder: Path) -> bool:
    """Return whether a path leads into a folder, or through a link that is in it, whatever other links lead there."""
    links = (one for one in (path, *path.parents) if one.is_symlink())
    try:
        places = [real_path(path), *(real_path(link.parent) / link.name for link in links)]
        return any(one.is_relative_to(real_path(folder)) for one in places)
    except ValueError:  # a name with a zero in it leads nowhere
        return False


def _paths(value: Any) -> Iterator[Path]:
    """Yield the paths in a value of an option."""
    if isinstance(value, Path):
        yield value
    elif isinstance(value, (list, tuple)):
        yield from (one for one in value if isinstance(one, Path))


def _expanded(name: str) -> Path:
    try:
        return Path(name).expanduser()
    except RuntimeError:  # of a home that nobody has
        return Path(name)


def _files_of_scenario(name: str) -> list[Path]:
    """Return a scenario's file, if it has one, and those of the scenarios that it builds upon."""
    try:
        sources = lineage(name)
    except UsageError:  # it cannot be read, which is said elsewhere, or is a result
        sources = [name]
    files = (one for one in sources if one not in SCENARIOS.own)
    return [Path(one) for one in files if Path(one).is_file() or not is_named(one)]
