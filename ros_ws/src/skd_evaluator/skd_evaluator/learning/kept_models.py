"""Models of cars that were learned before, kept for those who rate the same car again.

A model is kept under a digest of all that it follows from, as far as that is known: the files of the controller, the
command that starts it, the scenario, how the graph is run, and SKD itself. SKD cannot see what a controller reads
elsewhere, from the environment or from a server: if that changes, delete the folder.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import os
import shutil
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from skd_adversary.car_model_file import car_model_for_scenario, write_car_model
from skd_adversary.fitted_car import FittedCar
from skd_sim.choices.simulators import SIMULATORS
from skd_sim.encounter.scenario import Scenario
from skd_sim.errors import UsageError
from skd_sim.inputs.outside import sha256_of

from skd_evaluator.campaign.plan.plan import Plan
from skd_evaluator.likeness import likeness
from skd_evaluator.provenance import controller_files, module_file
from skd_evaluator.temporary_folders import make_temporary

_LARGEST = 16 * 2**20  # bytes of a file that is read for the digest; of a larger one, its size and time of change
_MOST = 10_000  # files of a package


def kept_models() -> Path:
    """Return the folder of the models: `skd/car_models` in the user's cache (XDG_CACHE_HOME)."""
    cache = os.environ.get("XDG_CACHE_HOME") or ""
    base = Path(cache) if Path(cache).is_absolute() else Path.home() / ".cache"
    return base / "skd" / "car_models"


def folder_of(plan: Plan, command: str | None, graph: Mapping[str, Any] | None) -> Path | None:
    """Return where the model of a plan's car is kept, or would be; None if nothing says which car it is.

    Args:
        plan: what is to be rated.
        command: command that starts the car's own node; empty or None where there is none.
        graph: how the node graph is run, as plain data; None: episodes run in process.
    """
    if plan.car.is_external and not command:
        return None  # whatever somebody has started
    files = [*_sources(controller_files(plan.car, command or ""), whole=not plan.car.is_external)]
    if plan.simulator not in SIMULATORS.own and (file := module_file(SIMULATORS.target(plan.simulator))) is not None:
        files += _sources([file], whole=True)
    with suppress(importlib.metadata.PackageNotFoundError):
        graph = {**(graph or {}), "scikit-learn": importlib.metadata.version("scikit-learn")}
    follows_from = {
        "controller": plan.controller,
        "multiplier": plan.car.stated_multiplier,
        "command": command or "",
        "simulator": plan.simulator,
        "scenario": plan.scenario.as_dict(),
        "graph": dict(graph or {}),
        "files": {str(file): _digest_of_file(file) for file in sorted(set(files))},
        "likeness": dict(likeness()),
    }
    found = hashlib.sha256(json.dumps(follows_from, sort_keys=True).encode())
    return kept_models() / found.hexdigest()[:32]


def _sources(files: list[Path], *, whole: bool) -> list[Path]:
    """Return files and, if asked for, all others that their packages hold, or the modules beside them."""
    found = list(files)
    for file in files if whole else ():
        folder = file.parent
        while (folder.parent / "__init__.py").exists():
            folder = folder.parent
        others = folder.rglob("*") if (folder / "__init__.py").exists() else folder.glob("*.py")
        for count, other in enumerate(others):
            if count >= _MOST:
                break
            if "__pycache__" not in other.parts and other.is_file() and os.access(other, os.R_OK):
                found.append(other)
    return found


def _digest_of_file(file: Path) -> str:
    known = file.stat()
    if known.st_size > _LARGEST:
        return f"{known.st_size} {known.st_mtime_ns}"
    return sha256_of(file)


def kept_model(folder: Path, scenario: Scenario) -> str | None:
    """Return the text of a model that is kept; None where there is none, or none that can be read."""
    with suppress(UsageError, OSError):
        return car_model_for_scenario(folder, scenario) if folder.is_dir() else None
    return None


def keep_model(folder: Path, car: FittedCar) -> bool:
    """Keep a model, by one rename of what is complete; return whether that was possible."""
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        made = make_temporary(folder.parent)
        try:
            write_car_model(made / "car_model.yaml", car)
            if folder.is_dir():  # of somebody who learned it at the same time, or one that cannot be read
                shutil.rmtree(folder, ignore_errors=True)
            made.rename(folder)
        finally:
            shutil.rmtree(made, ignore_errors=True)
    except OSError:
        return folder.is_dir()
    return True


def forget_model(folder: Path) -> None:
    """Remove a model that is kept, by one rename, so that nobody reads half of it."""
    with suppress(OSError):
        made = make_temporary(folder.parent)
        try:
            folder.rename(made / folder.name)
        finally:
            shutil.rmtree(made, ignore_errors=True)
