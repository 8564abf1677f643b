"""The margin that 10 % of the trials do not exceed: what it is, and that every output of figures has it."""

from __future__ import annotations

import io
import json
import math
from pathlib import Path
from typing import Any

import pytest
from report_support import make_sweep
from rich.console import Console
from skd_evaluator.assessment.compare.gate import Limit, check_limits
from skd_evaluator.assessment.files.assessment_json import check_figure
from skd_evaluator.assessment.files.results import read_result
from skd_evaluator.cli.commands import make_parser
from skd_evaluator.cli.compare import run as compare
from skd_evaluator.metrics.deviation import Hit
from skd_evaluator.metrics.margins import Margins
from skd_evaluator.report.html.subjects import read_subjects
from skd_evaluator.report.rows import figure_rows
from skd_evaluator.report.terminal import details_table
from skd_sim.world.state import Trajectory

FIGURE = "margin_p10"
LABEL = "margin that 10 % of the trials do not exceed (m)"


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    sweep = make_sweep(tmp_path_factory.mktemp("worst") / "sweep")
    return [sweep / "synthetic" / f"C_{multiplier}" for multiplier in ("0.5", "1")]


def figures_of(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "assessment.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize(
    ("distances", "found"),
    [
        ([0.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0], 2.0),
        ([0.0, 0.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0], 0.0),
        ([1.0, 3.0], 1.2),
        ([0.7], 0.7),
        ([None, None, None], 5.0),
    ],
)
def test_it_is_the_tenth_between_order_statistics(distances, found):
    phi = Trajectory([[0.0, 0.0], [1.0, 0.0]], 0.3, "phi")
    ways = tuple(None if one is None else Hit(one, phi, 1.0, 4.0, 0.0) for one in distances)
    assert Margins((ways,), 5.0).quantile(0.1) == pytest.approx(found)


def test_a_tenth_of_the_trials_of_a_car_is_at_or_below_it(folders):
    for folder in folders:
        result = read_result(folder)
        margins = sorted(value for phi in result.groups["margin"] for value in phi.tolist())
        place = (len(margins) - 1) / 10
        low, high = margins[math.floor(place)], margins[math.ceil(place)]
        assert low <= result.figures[FIGURE] <= high
        assert result.figures[FIGURE] <= result.figures["margin"]
    assert figures_of(folders[0])[FIGURE] < figures_of(folders[1])[FIGURE]


def test_every_output_has_it(folders, tmp_path, capsys):
    figures = figures_of(folders[1])
    check_figure(FIGURE)
    (failed,) = check_limits(figures, [Limit(FIGURE, figures[FIGURE] + 0.01)])
    assert failed.failed
    console = Console(width=150, record=True, file=io.StringIO())
    console.print(details_table(figures))
    (line,) = [line for line in console.export_text().splitlines() if LABEL in line]
    assert f"{figures[FIGURE]:.3f}" in line
    (row,) = [row for row in figure_rows(read_subjects([folders[1]])[0].figures) if row.name == LABEL]
    assert row.value == f"{figures[FIGURE]:.3f}"
    words = ["compare", *map(str, folders), "--json", "--out", str(tmp_path / "compared")]
    assert compare(make_parser().parse_args(words)) == 0
    said = json.loads(capsys.readouterr().out)
    assert [row[FIGURE] for row in said["rows"]] == [figures_of(folder)[FIGURE] for folder in folders]
