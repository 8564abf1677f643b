"""`skd list`: results under a folder, and a car from result to result."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from skd_evaluator.assessment.files.result_folder import MANIFEST
from skd_evaluator.assessment.files.results import read_result
from skd_evaluator.cli.main import main
from skd_evaluator.files import unfinished
from skd_evaluator.metrics.aborted import NOT_CREDIBLE
from skd_evaluator.report.history import Run, find_runs, trends_of


@pytest.fixture(scope="module")
def figures(sweep) -> dict[str, Any]:
    return json.loads((sweep / "synthetic" / "C_0.5" / "assessment.json").read_text())


def written(figures: dict[str, Any], folder: Path, **changes: Any) -> Path:
    folder.mkdir(parents=True)
    (folder / "assessment.json").write_text(json.dumps({**figures, **changes}))
    return folder


def origin(figures: dict[str, Any], number: int) -> dict[str, Any]:
    git = {"revision": f"{number:040x}", "modified": number % 2 == 1}
    date = f"2026-{1 + number // 28:02d}-{1 + number % 28:02d}T12:00:00Z"
    return {**figures["provenance"], "date": date, "controller_git": git}


def test_results_are_listed_sorted_and_filtered(tmp_path, figures, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    for number in range(40):
        changes = {"car": "basic" if number % 4 else "my_cars:Careful", "margin": 0.01 * ((7 * number) % 40)}
        written(figures, tmp_path / f"group{number % 3}" / f"{number}", **changes, provenance=origin(figures, number))
    assert main(["list", str(tmp_path), "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["results"]
    assert [row["date"] for row in rows] == sorted(row["date"] for row in rows)
    assert {row["folder"] for row in rows} == {str(path.parent) for path in tmp_path.rglob("assessment.json")}
    assert [row["revision"] for row in rows[:2]] == ["0000000", "0000000+"]  # files of the second were changed
    words = ["list", str(tmp_path), "--car", "careful", "--sort", "margin", "--last", "5"]
    assert main(words) == 0
    shown = capsys.readouterr().out
    assert "5 results" in shown
    for value in sorted(0.01 * ((7 * number) % 40) for number in range(0, 40, 4))[-5:]:
        assert f"{value:.3f} [0.00, 0.11]" in shown  # whole, however narrow it is


def test_what_was_changed_or_is_no_result_is_said(tmp_path, sweep, capsys):
    shutil.copytree(sweep / "synthetic" / "C_0.5", tmp_path / "kept")
    shutil.copytree(tmp_path / "kept", tmp_path / "forged")
    better = json.loads((tmp_path / "forged" / "assessment.json").read_text()) | {"margin": 3.0}
    (tmp_path / "forged" / "assessment.json").write_text(json.dumps(better))
    written({"margin": 1.0}, tmp_path / "foreign")
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "assessment.json").write_text("{")
    unfinished(tmp_path / "half").touch()
    assert (tmp_path / "kept" / MANIFEST).exists()
    remarks = {run.folder.name: run.remark for run in find_runs([tmp_path])}
    assert remarks["kept"] == ""
    assert remarks["forged"] == "changed since it was written"
    assert main(["list", str(tmp_path)]) == 0
    captured = capsys.readouterr()
    assert f"* {tmp_path / 'forged'}: changed since it was written" in captured.out
    assert "foreign" not in captured.out
    assert f"unfinished: {tmp_path / 'half'}; go on with: skd assess --resume {tmp_path / 'half'}" in captured.out
    assert all(f"skd list: warning: {tmp_path / name}: " in captured.err for name in ("foreign", "broken"))
    assert main(["list", str(tmp_path), "--scenario", "nowhere"]) == 2
    assert main(["list", str(tmp_path / "nothing")]) == 2
    assert main(["list", str(tmp_path), "--trend", "margin"]) == 2  # not past what is broken


def test_a_trend_follows_each_car_by_date(sweep):
    """A car that gets better by 0.1 m with each of four revisions, and another one."""
    stored = read_result(sweep / "synthetic" / "C_1")
    results = []
    for number in reversed(range(4)):
        figures = {**stored.figures, "margin": 0.1 * number, "provenance": origin(stored.figures, number)}
        results.append(replace(stored, folder=Path(f"{number}"), figures=figures))
    other = replace(stored, folder=Path("other"), figures={**stored.figures, "car": "my_cars:Careful"})
    found, lines = trends_of([*results, other], "margin")
    assert [one["car"] for one in found] == ["basic, C = 1", "my_cars:Careful"]
    mine, theirs = (one["runs"] for one in found)
    assert [row["value"] for row in mine] == pytest.approx([0.0, 0.1, 0.2, 0.3])
    assert [row["folder"] for row in mine] == ["0", "1", "2", "3"]
    assert [row["difference"] for row in mine] == [None, 0.0, 0.0, 0.0]  # of the trials, which are the same
    assert [row["verdict"] for row in mine[1:]] == ["the same in every trial"] * 3
    assert found[0]["confidence"] == pytest.approx(1.0 - 0.05 / 3)
    assert len(theirs) == 1
    assert lines == []


def test_what_is_not_credible_is_marked_in_lists_and_trends(tmp_path, sweep, capsys, monkeypatch):
    """A car that was another one when it was run again stood there like any other."""
    monkeypatch.setenv("COLUMNS", "120")
    stored = read_result(sweep / "synthetic" / "C_0.5")
    figures = stored.figures
    doubted = {**figures, "warnings": [f"{NOT_CREDIBLE}it counts"]}
    written(doubted, tmp_path / "doubted")
    assert main(["list", str(tmp_path)]) == 0
    shown = capsys.readouterr().out
    assert "doubted*" in shown
    assert f"* {tmp_path / 'doubted'}: {NOT_CREDIBLE}it counts" in shown
    pairs = (("1", figures), ("2", doubted), ("3", figures))
    results = [replace(stored, folder=Path(name), figures=one) for name, one in pairs]
    ((trend,), _) = trends_of(results, "margin")
    assert [one["credible"] for one in trend["runs"]] == [True, False, True]


@pytest.mark.parametrize("figure", ["nominal_collision_rate", "time_lost"])
def test_a_trend_judges_as_compare_does(tmp_path, sweep, capsys, monkeypatch, figure):
    """The basic car with C = 0.5, and then with 1 under the same name: it got safer."""
    monkeypatch.setattr(Run, "car", property(lambda _run: "my car"))
    folders = [str(sweep / "synthetic" / name) for name in ("C_0.5", "C_1")]
    assert main(["list", *folders, "--trend", figure, "--json"]) == 0
    (car,) = json.loads(capsys.readouterr().out)["cars"]
    assert main(["compare", *folders, "--json", "--no-pictures", "--out", str(tmp_path / "compared")]) == 0
    (judged,) = json.loads(capsys.readouterr().out)["comparisons"]
    first, second = car["runs"]
    assert first["verdict"] == ""
    assert second["verdict"] == judged["verdict"]
    assert second["difference"] == pytest.approx(second["value"] - first["value"])
