"""A user's YAML may hold anything: it is data of a page, or one line says why not, soon and in little memory."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from skd_adversary.car_models.car_model_file import read_car_model
from skd_sim.errors import UsageError
from skd_sim.inputs.yaml_file import LARGEST, parse_yaml, to_yaml
from skd_sim.scenario.scenario import load_scenario

SCENARIO = yaml.safe_dump(load_scenario("crossing").as_dict())
NO_MODELS = {
    "aliases": "a: &a [x, x]\nb: [*a, *a]\n",
    "a list": "[1, 2]\n",
    "nothing": "",
    "a key that is a list": "? [1, 2]\n: 3\n",
    "too long": "# " + "x" * LARGEST + "\n",
    "a key twice": SCENARIO + "horizon: 5.0\n",
    "a key twice, further in": SCENARIO.replace("  width:", "  width: 9.0\n  width:"),
    "infinite": SCENARIO.replace("horizon: 12.0", "horizon: .inf"),
    "not a number": SCENARIO.replace("horizon: 12.0", "horizon: .nan"),
}


@pytest.mark.parametrize("text", NO_MODELS.values(), ids=NO_MODELS.keys())
@pytest.mark.parametrize("read", [lambda path: load_scenario(str(path)), read_car_model], ids=["scenario", "car model"])
def test_what_is_no_model_is_one_short_line(tmp_path: Path, text: str, read: Callable[[Path], object]) -> None:
    path = tmp_path / "file.yaml"
    path.write_text(text)
    with pytest.raises(UsageError) as caught:
        read(path)
    said = str(caught.value)
    assert str(path) in said
    assert len(said) < 700
    assert "\n" not in said


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("013", 13),
        ("08", 8),
        ("+3", 3),
        ("0o17", 15),
        ("0x1f", 31),
        ("1e3", 1000.0),
        ("-1.5e-3", -0.0015),
        (".5", 0.5),
        ("1:30", "1:30"),
        ("1_000", "1_000"),
        ("on", "on"),
        ("NO", "NO"),
        ("2024-01-01", "2024-01-01"),
        ("true", True),
        ("null", None),
        ("", None),
    ],
)
def test_scalars_are_those_of_yaml_1_2(text: str, value: object) -> None:
    """In YAML 1.1 a start_gap of 013 m is 11 m, and a scenario called on is called True."""
    found = parse_yaml(f"key: {text}\n", "here")["key"]
    assert (found, type(found)) == (value, type(value))


TEXT = st.text(st.characters(exclude_categories=["C", "Z"]) | st.just(" "), max_size=9)


@given(st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**63) | st.floats(allow_nan=False) | TEXT
    | st.sampled_from(["013", "1e3", "yes", "~", "1:30", "0o7", "2024-01-01", ".inf"]),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXT, inner, max_size=3),
    max_leaves=6,
))  # fmt: skip
def test_what_is_written_reads_the_same_by_either_version_of_yaml(data: object) -> None:
    text = to_yaml([data])
    assert parse_yaml(text, "here") == [data]
    assert yaml.safe_load(text) == [data]
