"""Results that somebody changes, and whose manifest is kept, written anew as a forger would, or removed."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from skd_evaluator.assessment.files.result_folder import MANIFEST, write_manifests


def edit(folder: Path, change: Callable[[dict[str, Any]], object], manifest: str = "kept") -> None:
    """Change assessment.json; the manifest is kept, written anew, or removed."""
    path = folder / "assessment.json"
    figures = json.loads(path.read_text())
    change(figures)
    path.write_text(json.dumps(figures))
    follow(folder, manifest)


def follow(folder: Path, manifest: str) -> None:
    if manifest == "removed":
        (folder / MANIFEST).unlink()
    elif manifest == "rewritten":
        write_manifests(folder)


def change_array(folder: Path, name: str, change: Callable[[np.ndarray], np.ndarray]) -> None:
    with np.load(folder / "episodes.npz") as file:
        arrays = {key: file[key].copy() for key in file.files}
    arrays[name] = change(arrays[name])
    np.savez(folder / "episodes.npz", **arrays)
    write_manifests(folder)
