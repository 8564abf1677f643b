"""Scenarios that build upon others, those at an impact place, and what is said relative to the test speed."""

from __future__ import annotations

from pathlib import Path

import pytest
from skd_sim.errors import UsageError
from skd_sim.scenario.scenario import changed_scenario, load_scenario
from skd_sim.scenario.scenario_file import is_named


def written(folder: Path, name: str, text: str) -> str:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return str(path)


def test_five_lines_make_a_scenario(tmp_path: Path) -> None:
    mine = load_scenario(
        written(tmp_path, "mine.yaml", "name: mine\ndescription: slower\nextends: cpna-75\ncar:\n  start_speed: 5.0\n")
    )
    base = load_scenario("cpna-75")
    assert mine.protocol == base.protocol
    assert base.protocol is not None
    assert base.protocol.impact_places == (75.0,)
    assert (mine.name, mine.car.start_speed, mine.car.start_gap) == ("mine", 5.0, 22.5)  # 4.5 s of its way
    assert mine.adversary == base.adversary


def test_files_build_upon_files_beside_them(tmp_path: Path) -> None:
    written(tmp_path, "one.yaml", "name: one\ndescription: d\nextends: crossing\neta_max: 3.0\nsensor: null\n")
    two = load_scenario(written(tmp_path, "two.yaml", "name: two\ndescription: d\nextends: one.yaml\nhorizon: 9.0\n"))
    assert (two.eta_max, two.horizon, two.sensor) == (3.0, 9.0, None)
    assert two.adversary == load_scenario("crossing").adversary


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("extends: a.yaml\n", "leads back to"),
        ("extends: nowhere\n", "not a readable file"),
        ("extends: 3\n", "extends must be the name or the path"),
        ("extends: cpna-33\n", "its impact places are 0, 10, 25, 50, 75, 90, 100 %"),
        ("extends: crossing-50\n", "it has no impact places"),
        ("extends: cpna\nprotocol:\n  headway: 1.0\n", "protocol: acceleration_distance .* leave one out"),
    ],
)
def test_mistakes_are_one_line_that_names_the_file(tmp_path: Path, text: str, message: str) -> None:
    path = written(tmp_path, "a.yaml", f"name: a\ndescription: d\n{text}")
    with pytest.raises(UsageError, match=message) as caught:
        load_scenario(path)
    assert path in str(caught.value) or "cpna" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_names_with_an_impact_place() -> None:
    assert all(map(is_named, ("cpna", "cpna-25", "ccrs--25", "crossing")))
    assert not is_named("nothing-25")
    assert not is_named("./cpna.yaml")
    places = load_scenario("ccrs--25").protocol
    assert places is not None
    assert places.impact_places == (-25.0,)


def test_what_is_relative_follows_the_test_speed() -> None:
    for kmh in (30, 50, 130):
        fast = changed_scenario("ccrb", {"car.start_speed": kmh / 3.6})
        assert fast.car.start_gap == pytest.approx(kmh / 3.6)
        assert fast.car.start_gap_range == pytest.approx(0.3 * kmh / 3.6)
        assert fast.protocol is not None
        assert fast.protocol.speed == fast.adversary.start_speed == pytest.approx(kmh / 3.6)
    assert changed_scenario("cut_in", {"adversary.start_y": -9.0}).adversary.start_y == -9.0
