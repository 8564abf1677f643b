"""Results that many tests read: a small sweep, and copies of its parts with other figures."""

import functools
import json
import operator
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cli_support import SMALL
from common import run_skd
from skd_evaluator.assessment.files.result_folder import MANIFEST, write_manifests


def make_sweep(folder: Path) -> Path:
    counts = ["--safe-count", "2", "--kamikaze-count", "14", "--collision-runs", "12", "--behaviour", "walkers"]
    assert run_skd("sweep", *SMALL, *counts, "--multipliers", "0.5", "1.0", "--out", str(folder)) == 0
    return folder


def edit(folder: Path, changes: Mapping[str, Any]) -> None:
    """Change entries of assessment.json, by their dotted names, and write the manifest anew, as a forger would."""
    path = folder / "assessment.json"
    figures = json.loads(path.read_text())
    for name, value in changes.items():
        *outer, last = (int(word) if word.isdecimal() else word for word in name.split("."))
        functools.reduce(operator.getitem, outer, figures)[last] = value
    path.write_text(json.dumps(figures))
    write_manifests(folder)


def edited(source: Path, target: Path, **changes: Any) -> Path:
    """Copy an assessment, as older versions left it, and change entries of its assessment.json."""
    shutil.copytree(source, target)
    edit(target, changes)
    (target / MANIFEST).unlink()
    return target
