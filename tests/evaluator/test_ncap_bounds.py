"""A margin of `skd ncap` that is only a bound says so: in its file, in its legend, and by `skd verify`."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from skd_evaluator.assessment.files.verification import Verified
from skd_evaluator.extensions.ncap.layout import LEGEND
from skd_evaluator.extensions.ncap.result import (
    RESULT,
    Grid,
    Ncap,
    NcapCell,
    as_data,
    checked,
    with_regulator,
)
from skd_sim.errors import UsageError

MEASURED = NcapCell(speed=30.0, place=50.0, margin=0.5, margins=(0.25, 0.75))
LOWER = replace(MEASURED, speed=35.0, margin=3.0, margins=(1.0, 5.0), beyond=1, margin_is="at least")
UPPER = replace(MEASURED, speed=40.0, converged=False, margin_is="at most")


def result(*cells: NcapCell) -> Ncap:
    return Ncap(skd="0", car="a car", seed=0, trials=2, margin_limit=9, room=0.5, grids=(Grid("cpna", "x", cells),))


def test_a_margin_that_is_a_bound_says_so(tmp_path: Path) -> None:
    found = result(MEASURED, LOWER, UPPER)
    (tmp_path / RESULT).write_text(json.dumps(as_data(found)), encoding="utf-8")
    verified = with_regulator(Verified(tmp_path, None))
    assert not verified.problems
    lower, upper = verified.remarks[:2]
    assert lower.startswith("1 of 3 margins are lower bounds: no hit was found")
    assert upper.startswith("1 of 3 margins are upper bounds: the search has not converged")
    assert [cell.get("margin_is") for cell in as_data(found)["grids"][0]["cells"]] == [None, "at least", "at most"]
    assert "≥ is a lower bound" in LEGEND


def test_a_bound_that_does_not_follow_from_the_search_is_refused() -> None:
    checked(result(replace(LOWER, margin_is="")), Path("of an older version"))
    for cell in (replace(LOWER, margin_is="at most"), replace(MEASURED, margin_is="at least")):
        with pytest.raises(UsageError, match=r"which does not follow from its search"):
            checked(result(cell), Path("x"))
