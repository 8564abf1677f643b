"""A user's files: regular ones of limited size; JSON, XML and YAML that cannot be used are said in one line."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from common import refused
from hypothesis import given
from hypothesis import strategies as st
from skd_adversary.car_models.car_model_file import read_car_model
from skd_sim import UsageError, load_scenario
from skd_sim.inputs.files import finite_number, parse_json, read_bytes, read_json, read_text, read_xml
from skd_sim.inputs.yaml_file import LARGEST, parse_yaml, to_yaml


def test_only_regular_files_of_some_size_are_read(tmp_path: Path) -> None:
    (tmp_path / "long").write_bytes(b"1" * 1025)
    os.mkfifo(tmp_path / "pipe")
    assert read_bytes(tmp_path / "long", 1025) == b"1" * 1025
    for name, said in (("long", "more than 1 KiB"), ("pipe", "no regular file"), ("missing", "No such file")):
        with pytest.raises(UsageError, match=said):
            read_bytes(tmp_path / name, 1024)
    with pytest.raises(UsageError, match="no regular file"):
        read_json(Path("/dev/zero"))


@pytest.mark.parametrize(
    "text",
    [
        "NaN", "[Infinity]", "[" * 100_000, "", "{", "{'a': 1}", '{"a": 1,}', b"\xff\xfe\x00",
    ],
)  # fmt: skip
def test_what_is_no_json_is_refused(text: str | bytes) -> None:
    with pytest.raises(UsageError, match=r"^here: not JSON that SKD reads") as caught:
        parse_json(text, "here")
    assert len(str(caught.value)) < 250


def test_text_is_utf_8_with_or_without_a_mark(tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_bytes("\ufeffφ".encode())
    assert read_text(path) == "φ"
    path.write_bytes(b"\xe9")
    with pytest.raises(UsageError, match="not a text file in UTF-8"):
        read_text(path)


@pytest.mark.parametrize("text", ["0x10", "1,5", "1_0", "", "nan", "inf"])
def test_a_number_in_a_table_is_finite(text: str) -> None:
    with pytest.raises(UsageError, match=r"^x must be (a number|finite), got"):
        finite_number(text, "x")
    assert [finite_number(one, "x") for one in ("10", " +1.5e1", "-.5", "3.")] == [10.0, 15.0, -0.5, 3.0]


@pytest.mark.parametrize("content", [b"", b"<a></b>", b"<?xml version='1.0' encoding='nowhere'?><a/>", b"<a>\xff</a>"])
def test_what_is_no_xml_is_said_in_one_line(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "x.xml"
    path.write_bytes(content)
    with pytest.raises(UsageError, match=r"x\.xml: not XML that SKD reads: [^\n]+$"):
        read_xml(path)


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
    with refused(path) as caught:
        read(path)
    assert len(str(caught.value)) < 700


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
