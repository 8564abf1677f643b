"""Scenarios that were written when the adversary was still called pedestrian."""

from __future__ import annotations

import copy
from pathlib import Path

import pytest
import yaml
from common import scenario_of_before
from skd_sim.encounter.known_scenarios import shipped_scenarios
from skd_sim.encounter.scenario import load_scenario, scenario_from_dict
from skd_sim.errors import UsageError
from skd_sim.former_names import options_of_today


@pytest.mark.parametrize("name", shipped_scenarios())
def test_a_file_of_before_is_the_same_scenario(name: str, tmp_path: Path) -> None:
    today = load_scenario(name)
    before = scenario_of_before(today.as_dict())
    assert "pedestrian" in before
    assert "adversary" not in before
    given = copy.deepcopy(before)
    assert scenario_from_dict(before) == today
    assert before == given
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump(before))
    found = load_scenario(str(tmp_path / "mine.yaml"))
    assert found == today
    assert "pedestrian" not in found.as_dict()


def test_both_names_of_a_section_are_refused() -> None:
    today = load_scenario("crossing").as_dict()
    with pytest.raises(UsageError) as caught:
        scenario_from_dict({**scenario_of_before(today), **today}, "mine.yaml")
    assert str(caught.value) == (
        "mine.yaml: has section adversary and section pedestrian, its former name; leave pedestrian out"
    )


def test_a_mistake_in_a_file_of_before_is_named_as_today() -> None:
    before = scenario_of_before(load_scenario("crossing").as_dict())
    before["pedestrian"] = {**before["pedestrian"], "colour": 1}
    with pytest.raises(UsageError, match=r"^mine\.yaml: unknown key adversary\.colour; "):
        scenario_from_dict(before, "mine.yaml")


@pytest.mark.parametrize("data", [None, 3, "text", [1], {}, {3: 4}])
def test_what_is_no_scenario_is_left_to_others(data: object) -> None:
    with pytest.raises(UsageError, match=r"^mine\.yaml: "):
        scenario_from_dict(data, "mine.yaml")


def test_keys_of_a_scenario_among_options() -> None:
    given = {"scenario": "crossing", "scenario.pedestrian.speed": 1, "scenario.car.front": 2, "scenario.pedestrian": 3}
    assert options_of_today({**given, 7: 8}, "x") == {
        "scenario": "crossing",
        "scenario.adversary.speed": 1,
        "scenario.car.front": 2,
        "scenario.adversary": 3,
        7: 8,
    }
    left_alone = {"pedestrian": 1, "scenario.pedestrians.speed": 2, "scenario.car.pedestrian": 3}
    assert options_of_today(left_alone, "x") == left_alone
