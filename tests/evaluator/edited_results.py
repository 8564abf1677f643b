"""Results that somebody changes, and whose manifest is kept, written anew as a forger would, or removed."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

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
