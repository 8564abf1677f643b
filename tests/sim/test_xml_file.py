"""XML of others: taken as it is, or refused in one line before it costs memory or reads another file."""

from __future__ import annotations

import os
from pathlib import Path
from xml.etree import ElementTree

import pytest
from skd_sim.errors import UsageError
from skd_sim.inputs.xml_file import DEEPEST, parse_xml, read_xml

_LAUGHS = "".join(f'<!ENTITY l{n} "{f"&l{n - 1};" * 10}">' for n in range(1, 10))


def test_a_document_is_what_the_standard_library_makes_of_it():
    text = "<?xml version='1.0' encoding='UTF-8'?><a x='1'><b>φ &amp; ψ</b>tail<c/></a>".encode()
    assert ElementTree.tostring(parse_xml(text, "it")) == ElementTree.tostring(ElementTree.fromstring(text))
    assert parse_xml(b'<o:a xmlns:o="u"><o:b/></o:a>', "it").find("b") is not None  # names have no prefix


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (f'<!DOCTYPE a [<!ENTITY l0 "ha">{_LAUGHS}]><a>&l9;</a>'.encode(), "document type"),
        (b'<!DOCTYPE a [<!ENTITY x SYSTEM "file:///etc/passwd">]><a>&x;</a>', "document type"),
        (b'<!DOCTYPE a SYSTEM "http://example.com/a.dtd"><a/>', "document type"),
        (b"<a>&undeclared;</a>", "undefined entity"),
        (b"<a>" * (DEEPEST + 1) + b"</a>" * (DEEPEST + 1), "nested deeper"),
        (b"<a>" * 1_000_000, "nested deeper"),
        (b"", "no element found"),
        (b"<a></b>", "mismatched tag"),
        (b"<a/><a/>", "junk after document"),
        (b"<?xml version='1.0' encoding='nowhere'?><a/>", "encoding"),
        (b"<a>\xff</a>", "not well-formed"),
    ],
)
def test_what_is_none_is_said_in_one_line(content: bytes, says: str):
    with pytest.raises(UsageError) as caught:
        parse_xml(content, "it")
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_files_that_are_none(tmp_path: Path):
    os.mkfifo(tmp_path / "pipe.xml")
    for name in ("pipe.xml", "nowhere.xml"):
        with pytest.raises(UsageError):
            read_xml(tmp_path / name)
    (tmp_path / "large.xml").write_bytes(b"<a>" + b" " * 1000 + b"</a>")
    with pytest.raises(UsageError, match="more than"):
        read_xml(tmp_path / "large.xml", largest=500)
