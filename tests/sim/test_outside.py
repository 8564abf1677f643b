"""Files of others: regular ones of limited size; JSON and XML that cannot be used are said in one line."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from skd_sim.errors import UsageError
from skd_sim.inputs.files import finite_number, parse_json, read_bytes, read_json, read_text, read_xml


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
        "NaN", "[Infinity]", "1e999", "[" * 100_000, "9" * 30, "-" + "9" * 5000, "", "{", b"\xff\xfe\x00",
        '{"a": 1, "b": 2, "a": 1}',
    ],
)  # fmt: skip
def test_json_that_two_readers_may_take_otherwise_is_refused(text: str | bytes) -> None:
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
