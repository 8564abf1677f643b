"""Two cars are compared on the trajectories that were found for either: no search is less lucky than the other."""

import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from skd_evaluator import assess
from skd_evaluator.assessment.compare.comparison import SAFER, compare
from skd_evaluator.assessment.files.results import StoredResult, read_result
from skd_evaluator.margin.common_trajectories import check_not_worse, check_repeats, on_common_trajectories
from skd_evaluator.report.terminal import headline

EVASIVE = Path(__file__).parents[2] / "examples" / "evasive" / "evasive.py"
CAR = '''
class StoodStill:
    """Brakes for whoever is near, but ignores for five ticks whoever stood still for two."""

    def reset(self, scenario, rng):
        self.before, self.still, self.ignores = None, 0, 0

    def command(self, car, adversary):
        place = adversary.x, adversary.y
        self.still = self.still + 1 if place == self.before else 0
        self.before = place
        self.ignores = 5 if self.still >= 2 else self.ignores - 1
        near = -1.0 <= adversary.y - car.y - 2.25 <= 20.0 and adversary.x < 2.0
        return -8.0 if near and self.ignores < 0 else 0.0
'''
SMALL = {"safe_count": 4, "kamikaze_count": 3, "collision_runs": 4, "simulations": 20, "adversary_model": "generic"}


def quiet(_label: str, _done: int, _total: int) -> None:
    pass


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, StoredResult]]:
    """Results of one car: searched well at two seeds, and hardly at all at the first of them."""
    folder = tmp_path_factory.mktemp("common")
    (folder / "memory_car.py").write_text(CAR, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        patch.syspath_prepend(folder)
        for name, seed, limit in (("deep", 1, 32), ("deep, other seed", 2, 32), ("shallow", 1, 1)):
            asked = {"seed": seed, "margin_limit": limit, "behaviour": "none", "workers": 1}
            assess("memory_car:StoodStill", out=folder / name, **asked, **SMALL)
        yield {one.name: read_result(one) for one in folder.iterdir() if (one / "assessment.json").is_file()}


def test_a_margin_that_is_too_high_is_corrected(results):
    deep, shallow = results["deep"], results["shallow"]
    first, second, lines = on_common_trajectories(deep, shallow, quiet)
    for before, after, other in zip(*(one.groups["margin"] for one in (shallow, second, deep)), strict=True):
        assert (after <= np.minimum(before, other) + 1e-9).all()  # same car and draws: it is hit as the other is
    assert (np.concatenate(first.groups["margin"]) <= np.concatenate(deep.groups["margin"])).all()
    assert lines[-1].startswith(f"{shallow.folder}: its margin falls from ")
    assert any("its margin falls" in line for line in check_not_worse(Path(shallow.folder), deep).remarks)
    unchanged = check_not_worse(Path(shallow.folder), shallow)  # although it is an upper bound
    assert unchanged.passed
    assert unchanged.text == "no difference: the same in every trial"


@pytest.mark.parametrize("pair", [("deep", "deep, other seed"), ("deep, other seed", "shallow"), ("deep", "shallow")])
def test_a_car_is_never_safer_than_itself(results, pair):
    # as if both searches had said that they have converged
    sure = [replace(one, figures={**one.figures, "margin_converged": True}) for one in map(results.get, pair)]
    for first, second in (sure, sure[::-1]):
        assert compare(*on_common_trajectories(first, second, quiet)[:2]).verdict != SAFER


def test_a_car_that_does_not_repeat_its_hits_is_left_as_it_was(results):
    deep = results["deep"]
    changed = replace(deep, figures={**deep.figures, "controller": "cal"})
    first, _, lines = on_common_trajectories(changed, results["shallow"], quiet)
    assert first is changed
    assert lines[-1].startswith(f"{deep.folder}: not tried on the other's trajectories")
    assert lines[-1].endswith("its code has changed, or it does not repeat itself")


def test_exact_margins_stay(results):
    exact = [
        replace(one, figures={**one.figures, "margin_budget": None}) for one in map(results.get, ("deep", "shallow"))
    ]
    assert on_common_trajectories(*exact, quiet) == (*exact, ())


def test_the_margin_of_a_car_that_uses_the_oncoming_lane_is_the_lower_one(tmp_path):
    """It hits the car that comes there before anybody has strayed; with the lane free it gets away."""
    small = SMALL | {"safe_count": 2, "margin_limit": 8, "behaviour": "none", "workers": 1}
    found = assess(f"{EVASIVE}:OtherLane", out=tmp_path, scenario="oncoming_lane", **small)
    figures = found.as_dict()
    assert figures["margin"] == figures["margin_lanes"]["occupied"] < 0.1
    assert list(figures["margin_lanes"]) == ["occupied", "free"]
    assert figures["margin_lanes"]["free"] > 0.5
    assert figures["optimality_gap"] is None  # the kamikazes planned with it free
    said = (
        f" The margin is with the oncoming lane occupied; with it free it is {figures['margin_lanes']['free']:.3f} m."
    )
    assert said in headline(figures)
    result = read_result(tmp_path)
    assert result.figures["margin_lanes"] == figures["margin_lanes"]
    check_repeats(result, quiet)  # with the lane occupied


def test_a_car_that_keeps_to_its_lane_has_one_margin(tmp_path):
    small = SMALL | {"safe_count": 2, "margin_limit": 1, "behaviour": "none", "workers": 1}
    assert "margin_lanes" not in assess(f"{EVASIVE}:Brakes", out=tmp_path, scenario="oncoming_lane", **small).as_dict()
