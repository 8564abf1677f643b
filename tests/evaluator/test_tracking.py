"""Results in MLflow: what its client reads back from a folder."""

from __future__ import annotations

import json
import sys

import pytest
from cli_support import one_line
from skd_evaluator.assessing.tracking import EXPERIMENT, log_to_mlflow
from skd_evaluator.cli.main import main

mlflow = pytest.importorskip("mlflow")


@pytest.fixture(scope="module")
def result(sweep):
    return sweep / "synthetic" / "C_0.5"


def test_figures_parameters_and_files_are_read_back(tmp_path, result):
    figures = json.loads((result / "assessment.json").read_text())
    uri = (tmp_path / "store").as_uri()
    names = [log_to_mlflow(uri, figures, result) for _ in range(2)]
    client = mlflow.MlflowClient(tracking_uri=uri)
    (experiment,) = [one for one in client.search_experiments() if one.name == EXPERIMENT]
    runs = client.search_runs([experiment.experiment_id])
    assert {run.info.run_id for run in runs} == set(names)
    run = client.get_run(names[0])
    assert run.info.status == "FINISHED"
    assert run.data.metrics["margin"] == figures["margin"]
    assert [run.data.metrics[f"margin_ci95_{end}"] for end in ("low", "high")] == figures["margin_ci95"]
    assert run.data.params["seed"] == str(figures["seed"])
    assert run.data.params["scenario"] == figures["scenario"]["name"]
    assert run.data.params["safe_count"] == str(len(figures["per_safe_trajectory"]))
    copy = client.download_artifacts(names[0], "assessment.json", str(tmp_path))
    assert json.loads(open(copy, encoding="utf-8").read()) == figures  # noqa: PTH123, SIM115
    assert {"episodes.npz", "manifest.sha256"} <= {one.path for one in client.list_artifacts(names[0])}


SMALL = (
    *("--safe-count", "1", "--kamikaze-count", "1", "--collision-runs", "1", "--simulations", "5", "--workers", "1"),
    *("--no-pictures", "--margin-limit", "0", "--behaviour", "none"),
)


def test_what_cannot_be_logged_leaves_the_result(tmp_path, capsys):
    (tmp_path / "file").touch()
    uri = (tmp_path / "file" / "store").as_uri()
    code = main(["assess", *SMALL, "--mlflow", uri, "--out", str(tmp_path / "o")])
    assert code == 1
    assert f"skd assess: --mlflow {uri}: not logged (" in capsys.readouterr().err
    assert (tmp_path / "o" / "assessment.json").exists()


def test_without_mlflow_it_is_said_before_any_work(skd_here, here, monkeypatch):
    monkeypatch.setitem(sys.modules, "mlflow", None)
    one_line(
        skd_here("assess", "--mlflow", "file:///x", "--out", "o"), 2, "--mlflow needs MLflow: python -m pip install"
    )
    assert not (here / "o").exists()
