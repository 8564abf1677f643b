"""`skd assess --reference`: between which reference drivers a car stands."""

from __future__ import annotations

import numpy as np
import pytest
from skd_evaluator.assessment.files.assessment_json import assessment_schema
from skd_evaluator.assessment.stages import margin
from skd_evaluator.library import assess
from skd_evaluator.margin import basic_margins
from skd_evaluator.metrics.margins import ReferenceMargin, reference_text

FEW = {"safe_count": 2, "kamikaze_count": 2, "collision_runs": 4, "margin_limit": 64, "simulations": 20, "workers": 1}
FEW |= {"objective": "deviation", "behaviour": "none"}


def test_drivers_are_compared_by_their_own_margins_in_the_same_trials_and_kept(monkeypatch, tmp_path):
    monkeypatch.setattr(margin, "REFERENCE_DRIVERS", ("reg157",))
    monkeypatch.setattr(basic_margins, "cache_folder", lambda: tmp_path / "kernels")
    first = assess("basic", reference=True, **FEW)
    (entry,) = first.as_dict()["reference"]
    own, theirs = first.margins, assess("reg157", **FEW).margins
    assert own is not None
    assert theirs is not None
    assert entry["driver"] == "reg157"
    assert entry["margin"] == pytest.approx(theirs.mean, abs=1e-12)
    assert entry["difference"] == pytest.approx(np.mean(own.values - theirs.values), abs=1e-12)
    searches, search = [], margin.minimal_deviations
    monkeypatch.setattr(margin, "minimal_deviations", lambda *given: searches.append(given) or search(*given))
    assert assess("basic", reference=True, **FEW).as_dict()["reference"] == [entry]
    assert len(searches) == 1  # of the car alone
    assert set(entry) == set(assessment_schema()["$defs"]["reference"]["required"])
    assert "reference" not in assess("basic", **FEW).as_dict()


@pytest.mark.parametrize(
    ("ends", "bounds", "verdict"),
    [
        ((0.1, 0.2), (False, True), "safer than"),
        ((0.1, 0.2), (True, False), "not told apart from"),
        ((-0.1, 0.2), (False, False), "not told apart from"),
        ((-0.2, -0.1), (True, False), "less safe than"),
        ((-0.2, -0.1), (False, True), "not told apart from"),
    ],
)
def test_a_bound_calls_no_car_safer(ends, bounds, verdict):
    """A margin whose search has not converged may be less."""
    assert ReferenceMargin("rss", 1.0, 0.0, ends, 4, bounds).verdict == verdict


def test_a_line_says_between_which_drivers_a_car_stands():
    found = [{"driver": "fsm", "verdict": "less safe than"}, {"driver": "rss", "verdict": "safer than"}]
    assert reference_text(found) == "safer than rss; less safe than fsm"
    assert reference_text([]) == ""
