"""The margin that 10 % of the trials do not exceed: what it is, and that every output of figures has it."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest
from report_support import make_sweep
from skd_evaluator.assessment.files.results import read_result
from skd_evaluator.metrics.deviation import Hit
from skd_evaluator.metrics.margins import Margins
from skd_sim.world.state import Trajectory

FIGURE = "margin_p10"


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
