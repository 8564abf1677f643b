"""`skd scenarios reference`: basic cars as a yardstick, in scenarios in which their margins are searched for."""

from __future__ import annotations

import json

import pytest
from cli_support import one_line
from skd_evaluator.assessment.files.results import read_result
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.cli.reference import asked_of_result, equivalent_in, reference_sweep
from skd_evaluator.library import assess

SIZES = {"collision_runs": 1, "simulations": 20, "behaviour": "none", "objective": "deviation", "workers": 1}


def silent(*_told: object) -> None:
    pass


def test_margins_rise_with_c_where_they_are_searched_for(skd_here, here):
    done = skd_here("scenarios", "reference", "cpna-50", "cbna-50", "--multipliers", "0.5", "1", "1.5",
                    "--trials", "3", "--margin-limit", "256", "--workers", "1", "--out", "out")  # fmt: skip
    assert done.returncode == 0, done.stderr
    entries = json.loads((here / "out" / "reference.json").read_text("utf-8"))["references"]
    assert [one["name"] for one in entries] == ["cpna-50", "cbna-50"]
    for entry in entries:
        margins = [row["margin"] for row in entry["rows"]]
        assert margins == sorted(margins)
        assert margins[0] + 1.0 < margins[-1]
        assert [[len(one) for one in row["margins"]] for row in entry["rows"]] == [[3]] * 3
    assert "cbna-50: basic cars, 1 φ × 3 trials" in done.stdout


def test_where_margins_are_exact_they_are_those_of_an_assessment(here):
    """And so the equivalent multiplier is what the assessment says."""
    rating = assess(multiplier=1.0, safe_count=2, kamikaze_count=3, out=here / "assessed", **SIZES)
    asked = asked_of_result(read_result(here / "assessed"))
    found = reference_sweep(asked, (0.9, 1.0, 1.1), InProcessRunner(1), silent, 256)
    assert rating.margins is not None
    assert found[1.0].exact
    assert [one.tolist() for one in found[1.0].per_phi] == [one.tolist() for one in rating.margins.per_phi]
    equivalent = equivalent_in(asked, found)
    assert equivalent is not None
    assert equivalent.value == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("reference",), "needs a name"),
        (("reference", "cpnaa"), "cpna"),
        (("reference", "cpna", "--margin-limit", "0"), "without margins there is no reference"),
        (("list", "--multipliers", "1"), "goes with skd scenarios reference"),
    ],
)
def test_what_cannot_be_asked_is_said_in_one_line(skd_here, here, words, said):
    one_line(skd_here("scenarios", *words, "--out", "out"), 2, said)
    assert not (here / "out").exists()
