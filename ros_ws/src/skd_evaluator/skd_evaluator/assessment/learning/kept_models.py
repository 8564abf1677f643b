"""Models of cars that were learned before, kept for those who rate the same car again.

A model is kept under a digest of all that it follows from, as far as that is known: the files of the car
(`fingerprint`), the command that starts it, the scenario, how the graph is run, and SKD itself. Where it is known that
these are not all of its files, none is kept. SKD cannot see what a controller reads elsewhere, from the environment or
from a server: if that changes, delete the folder.
"""

from __future__ import annotations

import datetime
import hashlib
import importlib.metadata
import json
import os
import shutil
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from skd_adversary.car_models.car_model_file import FittedCar, car_model_for_scenario, write_car_model
from skd_sim.errors import UsageError
from skd_sim.options.car_under_test import SIMULATORS
from skd_sim.scenario.scenario import Scenario

from skd_evaluator.assessment.plan.plan import Plan
from skd_evaluator.files import make_temporary
from skd_evaluator.provenance import CodeFiles, code_files, environment

_MODEL = "car_model.yaml"


def kept_models() -> Path:
    """Return the folder of the models: `skd/car_models` in the user's cache (XDG_CACHE_HOME)."""
    cache = os.environ.get("XDG_CACHE_HOME") or ""
    base = Path(cache) if Path(cache).is_absolute() else Path.home() / ".cache"
    return base / "skd" / "car_models"


def folder_of(plan: Plan, command: str | None, graph: Mapping[str, Any] | None) -> Path | None:
    """Return where the model of a plan's car is kept, or would be; None if not all that says which car it is is known.

    Args:
        plan: what is to be rated.
        command: command that starts the car's own node; empty or None where there is none.
        graph: how the node graph is run, as plain data; None: episodes run in process.
    """
    files = files_of(plan, command)
    if files.why_not:
        return None
    with suppress(importlib.metadata.PackageNotFoundError):
        graph = {**(graph or {}), "scikit-learn": importlib.metadata.version("scikit-learn")}
    follows_from = {
        "controller": plan.controller,
        "multiplier": plan.car.stated_multiplier,
        "command": command or "",
        "simulator": plan.simulator,
        "scenario": plan.scenario.as_dict(),
        "graph": dict(graph or {}),
        "files": dict(files.digests),
        "environment": dict(environment()),
    }
    found = hashlib.sha256(json.dumps(follows_from, sort_keys=True).encode())
    return kept_models() / found.hexdigest()[:32]


def files_of(plan: Plan, command: str | None) -> CodeFiles:
    """Return the files of a plan's car, and of a simulator that is not SKD's own."""
    others = [SIMULATORS.target(plan.simulator)] if plan.simulator not in SIMULATORS.own else []
    return code_files(plan.car, command or "", others)


def day_of(folder: Path) -> str:
    """Return the day (UTC) of which a model is that is kept; empty where there is none."""
    with suppress(OSError, OverflowError):
        changed = (folder / _MODEL).stat().st_mtime
        return datetime.datetime.fromtimestamp(changed, datetime.UTC).date().isoformat()
    return ""


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
            write_car_model(made / _MODEL, car)
            if folder.is_dir():  # of somebody who learned it at the same time, or one that cannot be read
                shutil.rmtree(folder, ignore_errors=True)
            made.rename(folder)
        finally:
            shutil.rmtree(made, ignore_errors=True)
    except OSError:
        return folder.is_dir()
    return True
