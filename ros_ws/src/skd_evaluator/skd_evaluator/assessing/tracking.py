"""Results in MLflow: figures, parameters and files of an assessment as a run of the experiment `SKD`."""

from __future__ import annotations

import importlib
import math
import os
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from skd_sim.errors import UsageError

from skd_evaluator.errors import AssessmentError
from skd_evaluator.provenance import code_of_car

EXPERIMENT = "SKD"
_PARAMETERS = ("controller", "multiplier", "safe", "simulations", "maximum_distance", "knowledge", "seed", "version")
_LONGEST = 500  # characters of a parameter that every version of MLflow takes
_AT_ONCE = 900  # figures in a request, of which it takes a thousand


def require_mlflow() -> Any:
    """Return the library.

    Raises:
        UsageError: it is not installed.
    """
    try:
        return importlib.import_module("mlflow")
    except ModuleNotFoundError as error:
        raise UsageError("--mlflow needs MLflow: python -m pip install 'skd[mlflow]'") from error


def log_to_mlflow(uri: str, figures: Mapping[str, Any], folder: Path) -> str:
    """Log an assessment and return the id of its run.

    Args:
        uri: of the tracking server, or of a folder, as MLflow takes it.
        figures: content of assessment.json.
        folder: folder of the result; its files become artefacts.

    Raises:
        UsageError: MLflow is not installed.
        AssessmentError: it could not be logged; the result is not touched.
    """
    mlflow = require_mlflow()
    if urlsplit(uri).scheme in (
        "",
        "file",
    ):  # MLflow would rather have a database, and refuses
        os.environ.setdefault("MLFLOW_ALLOW_FILE_STORE", "true")
    try:
        client = mlflow.MlflowClient(tracking_uri=uri)
        known = client.get_experiment_by_name(EXPERIMENT)
        experiment = client.create_experiment(EXPERIMENT) if known is None else known.experiment_id
        run = client.create_run(experiment, tags=_tags(figures, folder), run_name=str(figures["controller"]))
        name, now = str(run.info.run_id), int(1000.0 * time.time())
        metrics = [mlflow.entities.Metric(key, value, now, 0) for key, value in metrics_of(figures)]
        parameters = [mlflow.entities.Param(key, value) for key, value in parameters_of(figures).items()]
        for start in range(0, len(metrics), _AT_ONCE):
            client.log_batch(name, metrics=metrics[start : start + _AT_ONCE])
        client.log_batch(name, params=parameters)
        client.log_artifacts(name, str(folder))
        client.set_terminated(name)
    except Exception as error:  # of any library behind it
        reason = " ".join(str(error).split())[:300]
        raise AssessmentError(f"--mlflow {uri}: not logged ({type(error).__name__}: {reason})") from error
    return name


def metrics_of(figures: Mapping[str, Any]) -> Iterator[tuple[str, float]]:
    """Yield the name and the value of every figure at the top of assessment.json, an interval's ends one by one."""
    for key, value in figures.items():
        if key in _PARAMETERS:
            continue
        ends = {"": value} if _is_number(value) else {}
        if isinstance(value, list) and len(value) == 2 and "_ci95" in key:
            ends = {"_low": value[0], "_high": value[1]}
        for end, number in ends.items():
            if _is_number(number):
                yield f"{key}{end}", float(number)


def parameters_of(figures: Mapping[str, Any]) -> dict[str, str]:
    """Return what was assessed and how, by name."""
    found = {key: figures.get(key) for key in _PARAMETERS}
    found |= {"scenario": figures["scenario"]["name"], "safe_count": len(figures["per_safe_trajectory"])}
    found |= {f"options.{key}": value for key, value in figures["options"].items()}
    return {key: str(value)[:_LONGEST] for key, value in found.items() if value is not None}


def _tags(figures: Mapping[str, Any], folder: Path) -> dict[str, str]:
    git = code_of_car(figures) or {}
    tags = {"skd.folder": str(folder.resolve()), "mlflow.source.git.commit": git.get("revision", "")}
    tags["skd.warnings"] = "\n".join(figures["warnings"])[:5000]
    return {key: value for key, value in tags.items() if value}


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
